"""Studies of a spacecraft: residuals and nuisance parameters along a known trajectory."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arc_cases import epochs_tai, observed_at
from spk_files import ORBITER, circular, low_lunar_orbit, tracking, write_states

import radioloc
from radioloc.cli import main
from radioloc.errors import FileFormatError, InputError, KernelError
from radioloc.io import TdmAgreement, write_table, write_tdm
from radioloc.measurements.observations import Observations

BIAS_M = 12.5
SIGMA_M = 0.5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A trajectory, its tracking through the day with a bias at one station, and a study of it."""
    folder = tmp_path_factory.mktemp("study")
    model = radioloc.measurements.PhysicalModel.build()
    file = write_states(folder / "orbiter.bsp", low_lunar_orbit(model.ephemeris))
    trajectory = radioloc.ephemeris.Trajectory.open(file, ORBITER)
    parts = [tracking(f"KASHI>orbiter>{name}", epochs_tai(40, 20.0)) for name in ("KASHI", "JIAMUSI")]
    plan = Observations.concatenate(parts)
    computed = radioloc.measurements.ExactPredictor(model, plan, trajectory).compute()
    seed = np.random.default_rng(5)
    observed_m = computed.value_m + SIGMA_M * seed.standard_normal(len(plan))
    observed_m[40:] += BIAS_M
    write_table(
        folder / "ranges.csv",
        observed_at(
            plan.epoch, plan.links, link=plan.link, value_m=observed_m, sigma_m=SIGMA_M, tag=plan.tag
        ),
    )
    return folder


def study_file(
    folder, target='trajectory = "orbiter.bsp"\nbody = -85', estimate='position = "none"', extra=""
):
    path = folder / "orbiter.toml"
    path.write_text(
        f'[target]\n{target}\n[observations]\nfiles = ["ranges.csv"]\n[estimate]\n{estimate}\n{extra}\n'
    )
    return path


@pytest.mark.study
def test_residuals_along_a_trajectory(folder):
    assert main(["residuals", str(study_file(folder)), "--out", str(folder / "out"), "--terms"]) == 0
    names = {path.name for path in (folder / "out").iterdir()}
    figures = {f"{name}.{end}" for name in ("residuals", "terms") for end in ("png", "svg")}
    assert names == {"solution.json", "residuals.csv", "terms.csv"} | figures
    record = json.loads((folder / "out" / "solution.json").read_text())
    assert (record["position"], record["sigma"], record["covariance"]) == (None, None, None)
    assert record["trajectory"].startswith("body -85 of orbiter.bsp")
    assert record["provenance"]["trajectory"]["body"] == ORBITER
    assert len(record["provenance"]["trajectory"]["sha256"]) == 64
    header = (folder / "out" / "terms.csv").read_text().splitlines()[0]
    assert "shapiro_m" in header
    assert "lunar" not in header


def test_a_bias_is_found_along_a_trajectory(folder):
    study = radioloc.read_study(
        study_file(folder, estimate='position = "none"\nrange_bias = ["JIAMUSI", "KASHI"]')
    )
    solution = radioloc.locate(replace(study, consider_defaults=False))
    assert solution.converged
    for station, truth_m in (("JIAMUSI", BIAS_M), ("KASHI", 0.0)):
        value_m, sigma_m = solution.biases()[station]
        assert abs(value_m - truth_m) < 4.0 * sigma_m
        assert sigma_m < 0.25


@pytest.mark.parametrize(
    ("target", "estimate", "extra", "message"),
    [
        ('trajectory = "orbiter.bsp"', 'position = "none"', "", r"\[target\] body: is missing"),
        ('trajectory = "orbiter.bsp"\nbody = -85', "", "", r"toml: \[estimate\] position: expected .none."),
    ],
)
def test_what_does_not_go_with_a_trajectory(folder, target, estimate, extra, message):
    with pytest.raises(InputError, match=message) as caught:
        radioloc.read_study(study_file(folder, target, estimate, extra))
    assert "\n" not in str(caught.value)


def test_another_body_and_arcs_are_refused(folder):
    with pytest.raises(KernelError, match=r"NAIF.*-86.*-85"):
        radioloc.read_study(study_file(folder, 'trajectory = "orbiter.bsp"\nbody = -86'))
    study = radioloc.read_study(study_file(folder))
    with pytest.raises(InputError, match="arc-length"):
        radioloc.arcs(study, [6.0])


@pytest.mark.parametrize("form", ["table", "tdm"])
def test_a_spacecraft_on_its_way_has_ranges_of_its_own(tmp_path, form):
    """Half way to the Moon: what would be a mistake in ranges to the Moon."""
    model = radioloc.measurements.PhysicalModel.build()
    states = circular(2.0e8, model.ephemeris.constants.gm_earth_m3_s2, inclination_deg=20.0)
    file = write_states(tmp_path / "cruise.bsp", states, center=399, step_s=600.0)
    plan = tracking("KASHI>cruise>KASHI", epochs_tai(200, 30.0))
    arc = radioloc.measurements.ExactPredictor(model, plan, radioloc.ephemeris.Trajectory.open(file, ORBITER))
    computed = arc.compute()
    visible = np.flatnonzero(computed.usable)
    observed = observed_at(
        plan.epoch, plan.links, value_m=computed.value_m, sigma_m=SIGMA_M, tag=plan.tag
    ).select(visible)
    if form == "table":
        write_table(tmp_path / "ranges.dat", observed)
    else:
        write_tdm(tmp_path / "ranges.dat", observed, originator="TEST")
    with pytest.raises(FileFormatError, match="between Earth and Moon"):
        radioloc.read_observations(tmp_path / "ranges.dat", tdm=TdmAgreement({"range": SIGMA_M}))
    path = tmp_path / "cruise.toml"
    path.write_text(
        '[target]\ntrajectory = "cruise.bsp"\nbody = -85\n[estimate]\nposition = "none"\n'
        '[observations]\nfiles = ["ranges.dat"]\nsigma_m = { range = 0.5 }\n'
    )
    solution = radioloc.compute_residuals(radioloc.read_study(path))
    assert solution.residuals.used.all()
    # Both files have micrometres or better.
    assert np.abs(solution.residuals.residual_m).max() < 1e-5
