"""Simulation, covariance planning and Monte Carlo of several targets: each target is found at its own truth."""

from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc.errors import InputError
from radioloc.measurements import PhysicalModel
from radioloc.simulation import TruthSigma

ROVER = "longitude_deg = -20.0\nlatitude_deg = 10.0\nheight_m = -1500.0\n"
TRUE_LONGITUDE_DEG = -20.002


def text(second, truth, *, kind_of_truth="position", extra=""):
    kinds = {"range": "sigma_m = 1.0", "doppler": "sigma_m = 0.001\ncount_s = 60.0"}
    sessions = "".join(
        f"""[simulation.sessions.{kind}]
kind = "{kind}"
stations = ["KASHI", "JIAMUSI", "DSS-43"]
start = 2020-12-01T15:40:00
stop = 2020-12-01T19:40:00
step_s = 600.0
wavelength_um = 36000.0
{keys}
[simulation.noise.{kind}]
white_m = {keys.split()[2]}
"""
        for kind, keys in kinds.items()
    )
    return f"""
[targets.lander]
longitude_deg = -51.9
latitude_deg = 43.05
height_m = -2500.0
[targets.second]
{second}
[estimate]
position = "geographic"
[consider]
defaults = false
[simulation.targets.second.{kind_of_truth}]
{truth}
{sessions}
{extra}
"""


@pytest.fixture(scope="module")
def two_points(tmp_path_factory):
    path = tmp_path_factory.mktemp("two") / "two.toml"
    path.write_text(text(ROVER, ROVER.replace("-20.0", str(TRUE_LONGITUDE_DEG))))
    return radioloc.read_study(path)


def assert_at_truth(errors_m, sigmas_m):
    """Require errors of a few sigmas of normal distributions."""
    assert (np.abs(errors_m) < 4.0 * sigmas_m).all()


def test_each_target_is_simulated_at_its_truth(two_points):
    simulated = radioloc.simulate(two_points, seed=2)
    assert {link.target for link in simulated.observations.links} == {"lander", "second"}
    assert "true position of second" in simulated.summary()
    solution = radioloc.locate(replace(two_points, simulation=None), simulated.observations)
    assert solution.converged
    for truth in simulated.targets:
        estimate = solution.of_target(truth.name)
        error = (estimate.position_pa_m - truth.position_pa_m) @ truth.enu_pa.T
        assert_at_truth(error, np.sqrt(np.diag(estimate.position_covariance("enu"))))
    east_m = 1737.4e3 * np.radians(0.002) * np.cos(np.radians(10.0))
    second = simulated.targets[1]
    apriori = two_points.targets["second"].to_axes("PA", PhysicalModel.build().ephemeris.constants)
    assert (second.position_pa_m - apriori.xyz_m) @ second.enu_pa[0] == pytest.approx(-east_m, rel=2e-3)


def test_a_session_of_one_target_tracks_only_it(two_points):
    scenario = two_points.simulation
    sessions = [replace(session, targets=["second"]) for session in scenario.schedule.sessions]
    schedule = replace(scenario.schedule, sessions=sessions)
    study = replace(two_points, simulation=replace(scenario, schedule=schedule))
    assert {link.target for link in radioloc.simulate(study).observations.links} == {"second"}
    schedule = replace(schedule, sessions=[replace(sessions[0], targets="third")])
    with pytest.raises(InputError, match="got 'third'"):
        radioloc.simulate(replace(study, simulation=replace(scenario, schedule=schedule)))


def test_drawn_positions_are_those_of_each_target(two_points):
    scenario = replace(two_points.simulation, truth_sigma=TruthSigma(position_enu_m=(3.0, 3.0, 3.0)))
    study = replace(two_points, simulation=scenario)
    drawn = radioloc.simulate(study, seed=4, draw_errors=True)
    assert {name.split(".")[1] for name in drawn.drawn} == {"lander", "second"}
    apriori = radioloc.simulate(study, seed=4)
    for with_errors, nominal in zip(drawn.targets, apriori.targets, strict=True):
        moved = (with_errors.position_pa_m - nominal.position_pa_m) @ nominal.enu_pa.T
        expected = [drawn.drawn[f"position.{nominal.name}.{axis}"] for axis in ("east", "north", "up")]
        np.testing.assert_allclose(moved, expected, atol=1e-6)


@pytest.mark.study
def test_planned_sigmas_of_each_target_are_those_of_the_trials(two_points):
    scenario = replace(two_points.simulation, truth_sigma=TruthSigma(position_enu_m=(3.0, 3.0, 3.0)))
    trial_set = radioloc.monte_carlo(replace(two_points, simulation=scenario), trials=150, hours=4.0)
    assert trial_set.linearity.passed
    assert trial_set.converged
    planned = radioloc.covariance(replace(two_points, candidates=()), hours=4.0)
    for trials, plan in zip((trial_set, *trial_set.others), (planned, *planned.others), strict=True):
        np.testing.assert_allclose(np.median(trials.sigmas_m[:, 0], axis=0), plan.longest.sigma_m, rtol=0.05)
        assert trials.arcs[0].nees.low < trials.arcs[0].nees.mean < trials.arcs[0].nees.high
    assert [result.name for result in trial_set.others] == ["two, second"]
    assert {"trials.csv", "trials_2.csv", "montecarlo.json"} == {*trial_set.files()}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[simulation.targets.second.",
            "[simulation.targets.third.",
            "expected one of .targets., lander, second",
        ),
        ("[simulation.targets.second.position]", "[simulation.targets.second.state]", "belongs to a target"),
    ],
)
def test_mistakes_name_the_table(tmp_path, old, new, message):
    path = tmp_path / "study.toml"
    path.write_text(text(ROVER, ROVER).replace(old, new))
    with pytest.raises(InputError, match=message):
        radioloc.read_study(path)
