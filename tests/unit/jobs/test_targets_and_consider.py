"""Several targets in one study, and considered parameters, from the study file to solution.json."""

import json

import numpy as np
import pytest

import radioloc
from radioloc import LunarPosition, compare
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.io.formats import write_observations
from radioloc.jobs.comparison import read_solutions
from radioloc.measurements import FixedPoint, Link, Observations, PhysicalModel, prepare_predictor
from radioloc.measurements.registry import KINDS, TIME_TAGS
from radioloc.time import Epochs, tai_to_utc

LANDER = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
ROVER = LunarPosition.from_selenographic(-51.9120, 43.0600, -2548.0)
PATHS = (
    ("range", "KASHI>lander>KASHI"),
    ("range", "JIAMUSI>lander>KASHI"),
    ("vlbi_delay", "SESHAN25<lander>URUMQI"),
    ("vlbi_delay", "SESHAN25<lander>KUNMING"),
    ("differenced_delay", "SESHAN25<rover|lander>URUMQI"),
    ("differenced_delay", "SESHAN25<rover|lander>KUNMING"),
    ("differenced_delay", "KUNMING<rover|lander>URUMQI"),
)
STUDY = """
[targets.lander]
longitude_deg = -51.90
latitude_deg = 43.05
height_m = -2500.0
[targets.rover]
longitude_deg = -51.92
latitude_deg = 43.05
height_m = -2500.0
[observations]
files = ["table.csv"]
[model]
off = ["ionosphere"]
[estimate]
range_bias = "all"
range_bias_sigma_m = 5.0
range_bias_per = "link"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A table of ranges and delays of a lander and its rover, without errors."""
    model = PhysicalModel.build(off=["ionosphere"])
    hours = 15.2 + np.arange(9) * 0.5
    tai = Epochs.from_jd(2459185.5, np.repeat(hours, len(PATHS)) / 24.0, "TAI")
    link = np.tile(np.arange(len(PATHS)), len(hours))
    columns = {
        "epoch": tai_to_utc(tai),
        "links": [Link.from_path(path) for _, path in PATHS],
        "link": link,
        "kind": np.array([KINDS.index(kind) for kind, _ in PATHS])[link],
        "tag": TIME_TAGS.index("receive"),
        "sigma_m": np.where(link < 2, 1.0, np.where(link < 4, 0.1, 0.003)),
        "wavelength_um": 35394.6,
    }
    requested = Observations.from_columns(value_m=1.0, **columns)
    places_m = np.array([p.to_axes("PA", model.ephemeris.constants).xyz_m for p in (LANDER, ROVER)])
    arc = prepare_predictor(
        model, requested, [FixedPoint(item) for item in places_m], "exact", targets=("lander", "rover")
    )
    simulated = Observations.from_columns(value_m=arc.predict().value_m, **columns)
    path = tmp_path_factory.mktemp("targets")
    write_observations(path / "table.csv", simulated)
    return path


def study(folder, text=STUDY):
    file = folder / "study.toml"
    file.write_text(text)
    return radioloc.read_study(file)


def test_a_lander_and_its_rover(folder):
    solution = radioloc.locate(study(folder))
    assert solution.converged
    simulated = solution.to_dict()
    for name, truth in (("lander", LANDER), ("rover", ROVER)):
        result = solution.of_target(name)
        apart_m = np.linalg.norm(result.position_me_m - truth.to_axes("ME", CONSTANTS).xyz_m)
        assert apart_m < 0.01
        assert simulated["targets"][name]["position"]["me"]["longitude_deg"] == pytest.approx(
            result.selenographic[0], abs=1e-12
        )
    # Across the line of sight the rover is known beside the lander far better than on the Moon.
    partials = solution.targets[1].position_partials - solution.targets[0].position_partials
    eigenvalues = np.linalg.eigvalsh(partials @ solution.covariance @ partials.T)
    on_the_moon = np.linalg.eigvalsh(solution.of_target("rover").position_covariance("pa", "scaled"))
    assert (eigenvalues[:2] < 0.3**2 * on_the_moon[:2]).all()
    assert set(solution.biases()) == {"KASHI>lander>KASHI", "JIAMUSI>lander>KASHI"}
    with pytest.raises(InputError, match="target:"):
        solution.of_target("orbiter")


@pytest.mark.study
def test_arcs_show_all_targets_each_beside_its_longest(folder, tmp_path):
    result = radioloc.arcs(study(folder), [2.0, 4.0])
    assert [row.name for row in result.rows] == ["lander, 4 h", "lander, 2 h", "rover, 4 h", "rover, 2 h"]
    for row, place in zip(result.rows, (LANDER, LANDER, ROVER, ROVER), strict=True):
        assert row.longitude_deg == pytest.approx(place.selenographic[0], abs=1e-3)
        assert (row.east_m is None) == ("4 h" in row.name)
        assert row.east_m is None or abs(row.east_m) < 1.0  # not the 100 m from the lander to the rover
    names = {path.name for path in radioloc.write_report(tmp_path, result, html=True)}
    assert {"arcs.png", "arcs_2.png", "table1.csv"} <= names
    assert "rover, 2 h" in (tmp_path / "table1.csv").read_text()


def test_solutions_of_several_targets_are_compared_by_the_one_that_is_named(folder, tmp_path, capsys):
    path = radioloc.write_report(tmp_path, radioloc.locate(study(folder)))[0]
    with pytest.raises(InputError, match=r"solution.json:.*lander, rover.*got none"):
        compare([path])
    with pytest.raises(InputError, match="got 'orbiter'"):
        compare([path], target="orbiter")
    content = json.loads(path.read_text())
    content["targets"]["rover"]["covariance"]["enu_m2"][0][1] = 1e12
    damaged = tmp_path / "damaged.json"
    damaged.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"targets.rover"):
        compare([damaged], target="rover")
    for name, place in (("lander", LANDER), ("rover", ROVER)):
        assert main(["compare", str(path), "--target", name, "--json"]) == 0
        [row] = json.loads(capsys.readouterr().out)["positions"]
        assert row["latitude_deg"] == pytest.approx(place.selenographic[1], abs=1e-5)
    of_rover = json.loads(path.read_text())["targets"]["rover"]
    [estimate] = [item.of_target("rover").estimate for item in read_solutions(path)[0]]
    assert estimate.priors_enu_m.keys() == {
        "range_bias.KASHI>lander>KASHI",
        "range_bias.JIAMUSI>lander>KASHI",
    }
    np.testing.assert_allclose(estimate.total_enu_m2, of_rover["covariance"]["enu_m2"], rtol=1e-6)


CONSTANTS = PhysicalModel.build().ephemeris.constants


SUBOPTIMAL = '[consider]\ndefaults = false\nsuboptimal = ["station_position", "clock", "ut1"]\n'
"""Errors that stay out of the weights: the estimate is that without them."""


@pytest.mark.study
def test_considered_parameters_are_in_the_total_sigma(folder):
    plain = radioloc.locate(study(folder, STUDY + "[consider]\ndefaults = false\n"))
    text = (
        STUDY
        + SUBOPTIMAL
        + (
            'station_position = "all"\nstation_position_sigma_m = 0.1\n'
            'clock = ["URUMQI"]\nclock_sigma_s = 1e-9\nut1 = true\nut1_sigma_s = 2e-5\n'
        )
    )
    solution = radioloc.locate(study(folder, text))
    np.testing.assert_allclose(solution.values[:6], plain.values[:6], atol=1e-3)
    assert (solution.sigma_enu_m("total") > solution.sigma_enu_m("scaled")).all()
    np.testing.assert_allclose(solution.sigma_enu_m("scaled"), plain.sigma_enu_m("scaled"), rtol=1e-6)
    simulated = solution.to_dict()
    for k, record in enumerate(simulated["parameters"]):
        assert record["total_sigma"] == solution.sigmas("total")[k] >= record["sigma"]
    names = [record["name"] for record in simulated["considered"]]
    assert {"clock.URUMQI", "ut1", "station_position.KASHI.up"} <= set(names)
    sizes = [np.linalg.norm(record["position_enu_m"]) for record in simulated["considered"]]
    assert sizes == sorted(sizes, reverse=True)
    # The whole: what is added to the covariance is the sum over the considered parameters.
    added = solution.position_covariance("enu", "total") - solution.position_covariance("enu", "scaled")
    assert np.trace(added) == pytest.approx(np.sum(np.square(sizes)), rel=1e-6)
