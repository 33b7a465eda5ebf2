"""Simulated tracking of an orbiter: a truth that differs from the fit's a-priori orbit is found again."""

import json
from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc import light_times, visibility
from radioloc.dynamics import Orbit, propagate
from radioloc.errors import InputError
from radioloc.measurements import ExactPredictor, PhysicalModel
from radioloc.simulation import TruthSigma, windows
from radioloc.study.orbit_choice import ProcessNoise
from radioloc.time import tt_to_tdb, utc_strings, utc_to_tt

TRUE_M = np.array([575839.0, -463349.0, -1631539.0])
VELOCITY_M_S = np.array([-567.864, 1434.223, -600.209])
SIGMA_M = 1e-3


def written(folder, extra="", observations='files = ["sim.csv"]', forces="radiation_m2_kg = 0.02\n"):
    path = folder / "orbit.toml"
    path.write_text(f"""
[target]
name = "craft"
dynamics = "moon"
epoch = "2012-04-09T04:30:00"
position_m = [575739.0, -463249.0, -1631639.0]
velocity_m_s = [-567.864, 1434.223, -600.209]
[forces]
degree = 20
radiation_m2_kg = 0.018
gravity_errors = 0
[observations]
{observations}
[consider]
defaults = false
[simulation.state]
position_m = [575839.0, -463349.0, -1631539.0]
[simulation.forces]
{forces}
[simulation.sessions.doppler]
kind = "doppler"
stations = ["DSS-24", "DSS-65"]
start = 2012-04-09T04:40:00
stop = 2012-04-09T08:40:00
step_s = 60.0
count_s = 60.0
sigma_m = {SIGMA_M}
wavelength_um = 36000.0
[simulation.noise.doppler]
white_m = {SIGMA_M}
{extra}
""")
    return path


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    study = radioloc.read_study(written(tmp_path_factory.mktemp("orbit")))
    return study, radioloc.simulate(study, seed=3)


def test_the_world_is_the_tracking_of_the_true_orbit(scene):
    study, simulated = scene
    observations, orbit = simulated.observations, simulated.targets[0].trajectory
    assert isinstance(orbit, Orbit)
    assert orbit.states(orbit.epoch)[0][0] == pytest.approx(TRUE_M, abs=1e-6)
    # Integrated by itself, not by way of the study.
    truth = propagate(
        study.target.epoch,
        TRUE_M,
        VELOCITY_M_S,
        study.target.forces.with_parameters({"radiation": 0.02}),
        (0.0, 16000.0),
    )
    predicted = ExactPredictor(PhysicalModel.build(), observations, truth).compute()
    assert predicted.usable.all()
    assert np.abs(observations.value_m - simulated.noise_m - predicted.value_m).max() < 1e-6
    assert {path.upper() for path in observations.paths()} <= {"DSS-24>CRAFT>DSS-24", "DSS-65>CRAFT>DSS-65"}


def test_who_sees_it_is_told_from_the_study(scene):
    study, simulated = scene
    result = visibility(study, ["DSS-24"])
    masks = study.simulation.schedule.masks
    limits = (
        PhysicalModel.build(),
        simulated.targets[0].trajectory,
        ["DSS-24"],
        result.start_utc,
        result.stop_utc,
        masks,
    )
    assert [(item.start_utc, item.stop_utc) for item in result.passes] == [
        (item.start_utc, item.stop_utc) for item in windows(*limits)
    ]
    # The Moon hides it at each turn of two hours, for less than half of it.
    assert [(item.rises, item.sets) for item in result.passes] == [(True, True), (True, False)]


def test_light_times_are_those_of_the_true_orbit(scene):
    study, simulated = scene
    result = light_times(study, ["DSS-65"], start_utc="2012-04-09T04:50:00", stop_utc="2012-04-09T05:30:00")
    rows = simulated.observations.select(simulated.observations.paths() == "DSS-65>craft>DSS-65")
    counts = {
        str(tag)[:16]: value / 60.0 for tag, value in zip(utc_strings(rows.epoch), rows.value_m, strict=True)
    }
    rates = [counts[str(tag)[:16]] for tag in utc_strings(result.epoch)]
    assert len(rates) == 5
    # The mean of a minute differs from its middle by 60^2/24 times the rate's curvature: 2 km/s at one turn in 7100 s.
    np.testing.assert_allclose(result["range_rate_m_s"], rates, atol=0.25)
    assert np.ptp(rates) > 1000.0


def test_the_true_state_is_found_again(scene):
    study, simulated = scene
    solution = radioloc.locate(study, simulated.observations)
    assert solution.converged
    error = np.concatenate([solution.state.position_m - TRUE_M, solution.state.velocity_m_s - VELOCITY_M_S])
    # Six directions together: a chi squared of 6 degrees of freedom.
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5
    assert solution.fit.total.wrms_m < 1.3 * SIGMA_M


def test_a_true_field_beyond_that_of_the_fit_is_in_the_values(tmp_path, scene):
    further = radioloc.simulate(written(tmp_path, forces="degree = 40\n"), seed=3)
    assert further.targets[0].trajectory.forces.gravity.degree == 40
    assert further.targets[0].trajectory.forces.radiation_m2_kg == 0.018
    assert len(further.observations) > 50
    by_time = [item.observations.epoch.mjd for item in (further, scene[1])]
    common = np.intersect1d(*by_time, return_indices=True)[1:]
    change_m = further.error_free_m[common[0]] - scene[1].error_free_m[common[1]]
    assert np.abs(change_m).max() > 100.0 * SIGMA_M


@pytest.mark.study
def test_a_covariance_study_claims_what_a_fit_of_the_tracking_does(scene):
    study, simulated = scene
    result = radioloc.covariance(replace(study, candidates=()), hours=4.0).longest
    fitted = radioloc.locate(study, simulated.observations)
    assert result.count == fitted.fit.total.used
    # The truth is 170 m from where the fit begins, and noise is weighed by residuals: sigmas agree to some percent.
    sigmas = [np.sqrt(np.diag(state.covariance)) for state in (result.state, fitted.state)]
    np.testing.assert_allclose(*sigmas, rtol=0.15)


@pytest.mark.slow
def test_what_errors_of_gravity_do_to_a_plan_is_in_its_budget(scene, tmp_path):
    study = replace(scene[0], candidates=())
    plan = replace(study, target=replace(study.target, gravity_errors=4, gravity_error_degree=30))
    result = radioloc.covariance(plan, hours=[2.0, 4.0])
    arc = result.longest
    tdb = tt_to_tdb(utc_to_tt(scene[1].observations.epoch))
    elapsed_h = tdb.seconds_since(study.target.epoch) / 3600.0
    first_h, last_h = elapsed_h[0], elapsed_h[elapsed_h <= elapsed_h[0] + 4.0 + 1e-9].max()
    count = int((last_h - first_h) * 6.0) + 1
    tdb = study.target.epoch.shifted(3600.0 * np.linspace(first_h, last_h, count))
    mean_m2 = arc.state.covariance_rtn(tdb)[:, :3, :3].mean(axis=0)
    np.testing.assert_allclose(arc.sigma_m, np.sqrt(np.diag(mean_m2))[[1, 2, 0]], rtol=1e-9)
    assert arc.sources[0].source == "gravity_error"
    assert result.improvements[0].change == "gravity_error known"
    assert result.improvements[0].radius_95_m == pytest.approx(
        radioloc.covariance(study, hours=4.0).longest.radius_95_m, rel=1e-6
    )
    written = json.loads(json.dumps(result.to_dict()))["arcs"][-1]
    assert written["sigma_along_m"] == pytest.approx(arc.sigma_m[0])
    assert len(written["state"]["mapped"]) == 25
    names = {path.name for path in radioloc.write_report(tmp_path, result)}
    assert {"covariance.png", "covariance.csv"} <= names


@pytest.fixture(scope="module")
def with_process_noise(scene):
    noise = ProcessNoise(interval_s=600.0, radial_m_s2=1e-8, along_m_s2=1e-8, across_m_s2=1e-8)
    orbit = replace(scene[0].estimate.orbit, process_noise=noise)
    estimate = replace(scene[0].estimate, orbit=orbit)
    return replace(scene[0], estimate=estimate, observations=replace(scene[0].observations, hours=2.0))


@pytest.mark.study
def test_planned_process_noise_is_that_of_a_fit(scene, with_process_noise):
    """The batch of independent accelerations against the information filter and smoother of a fit."""
    planned = radioloc.covariance(with_process_noise, hours=2.0).longest
    fitted = radioloc.locate(with_process_noise, scene[1].observations).state
    times = fitted.orbit.times(7)
    np.testing.assert_allclose(planned.state.sigma_rtn_m(times), fitted.sigma_rtn_m(times), rtol=2e-3)
    assert "process_noise" in planned.by_source()
    total_m2 = sum(item.total_m**2 for item in planned.sources)
    assert np.sqrt(total_m2) == pytest.approx(np.linalg.norm(planned.sigma_m), rel=1e-9)


@pytest.mark.parametrize(
    ("forces", "extra", "message"),
    [
        ("gravity_errors = 3", "", r"\[simulation.forces\] gravity_errors: belongs to the fit"),
        ("", "[simulation.position]\nheight_m = 3.0", r"\[simulation\] position: belongs to a place"),
        (
            "",
            "[simulation.truth_sigma]\nposition_enu_m = [1.0, 1.0, 1.0]",
            r"\[simulation.truth_sigma\] position_enu_m belongs to a place",
        ),
    ],
)
def test_mistakes_are_told(tmp_path, forces, extra, message):
    with pytest.raises(InputError, match=message):
        radioloc.read_study(written(tmp_path, extra, forces=forces))


@pytest.mark.slow
def test_trials_of_an_orbit_are_those_of_full_fits(scene, tmp_path):
    study, _ = scene
    result = radioloc.monte_carlo(study, trials=20, hours=4.0)
    assert result.linear
    assert result.linearity.passed
    assert result.converged
    assert result.sides == ("along", "across", "radial")
    np.testing.assert_allclose(result.at_h, [0.0, 2.185, 4.185], atol=0.01)
    claimed = radioloc.covariance(replace(study, candidates=()), hours=4.0).longest.state
    tdb = claimed.epoch.shifted(3600.0 * np.array(result.at_h))
    # Noise by the residuals of each trial: the median is that of the noise stated to some percent.
    expected_m = claimed.sigma_rtn_m(tdb)[:, [1, 2, 0]]
    np.testing.assert_allclose(np.median(result.sigmas_m, axis=0), expected_m, rtol=0.1)
    names = {path.name for path in radioloc.write_report(tmp_path, result)}
    assert {"trials.csv", "trials.png"} <= names
    assert (tmp_path / "trials.csv").read_text().startswith("trial,hours,at_h,converged,")


def test_errors_of_gravity_are_drawn_beside_the_noise(scene):
    study, reduced = scene
    scenario = replace(study.simulation, truth_sigma=TruthSigma(gravity_errors=2))
    # What degrees 21 and 22, which the field has not, do to the orbit is far more than the noise.
    target = replace(scenario.position, gravity_error_degree=22)
    drawn = radioloc.simulate(
        replace(study, simulation=replace(scenario, position=target)), seed=3, draw_errors=True
    )
    assert list(drawn.drawn) == ["gravity_error.1", "gravity_error.2"]
    np.testing.assert_allclose(
        drawn.observations.value_m - reduced.observations.value_m, drawn.drawn_m, atol=1e-9
    )
    assert np.ptp(drawn.drawn_m) > 100.0 * SIGMA_M
    assert "gravity_errors" in scenario.truth_sigma.keys
    with pytest.raises(InputError, match="gravity_errors:"):
        TruthSigma(gravity_errors=-1)
