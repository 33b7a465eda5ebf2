"""What a notebook shows of objects: one line that says which one it is, and no arrays."""

from pathlib import Path

import pytest

import radioloc
from radioloc.lunar import TerrainModel

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="module")
def shown():
    study = radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml")
    arc, position_pa_m = radioloc.jobs.arc_of(study)
    solution = radioloc.locate(study)
    objects = {
        "Study": study,
        "LunarPosition": study.target,
        "PhysicalModel": arc.model,
        "PhysicalModel without": arc.model.without("shapiro", "pole_tide"),
        "Observations": arc.observations,
        "Predictor": arc,
        "Computed": arc.compute(position_pa_m),
        "Solution": solution,
        "ParameterSet": solution.parameters,
        "Residuals": solution.residuals,
        "Consider": solution.consider,
        "Consistency": solution.consistency,
        "Simulated": radioloc.simulate(EXAMPLES / "change5" / "simulation.toml", seed=3),
        "TerrainModel": TerrainModel.open(EXAMPLES / "change5" / "ldem_4_landing_site.tif"),
        "several targets": radioloc.read_study(EXAMPLES / "reflectors" / "de421.toml"),
    }
    return {name: repr(one) for name, one in objects.items()}


@pytest.mark.parametrize(
    ("name", "begin", "parts"),
    [
        ("Study", "<Study apollo15: LunarPosition 3.5000", ["1 file(s)", "estimates geographic position>"]),
        ("several targets", "<Study de421: apollo11, apollo14, ", ["8 file(s)"]),
        ("LunarPosition", "<LunarPosition 3.500000 deg E, 26.000000 deg N, -1000.0 m", ["(ME_DE421)>"]),
        ("PhysicalModel", "<PhysicalModel DE421, ", ["stations, all terms>"]),
        ("PhysicalModel without", "<PhysicalModel DE421, ", ["without shapiro, pole_tide>"]),
        ("Observations", "<Observations 153 2006-04-07 to 2007-06-19>", []),
        ("Predictor", "<ExactPredictor 153 observations by APOLLO>", []),
        ("Computed", "<Computed 153 observations, 0 unusable>", []),
        ("Solution", "<Solution apollo15: 3.62849", ["converged>"]),
        ("ParameterSet", "<ParameterSet 3: position.east, position.north, position.height>", []),
        ("Residuals", "<Residuals 153, 151 used>", []),
        ("Consider", "<Consider ", ["station_position"]),
        ("Consistency", "<Consistency of ", ["finding(s)>"]),
        ("TerrainModel", "<TerrainModel ldem_4_landing_site.tif: longitudes -56", ["of 7581 m, bilinear>"]),
        ("Simulated", "<Simulated 11005 2020-12-01 to 2020-12-03, seed 3, ", ["outliers>"]),
    ],
)
def test_an_object_is_shown_in_one_line(shown, name, begin, parts):
    text = shown[name]
    assert text.startswith(begin)
    assert all(part in text for part in parts)
    assert len(text) < 240
    assert "array(" not in text
    assert "\n" not in text
