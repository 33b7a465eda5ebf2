"""Sigmas of orbits with process noise, for drawn accelerations and for errors of the gravity field beyond the fit."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at
from low_orbit import EPOCH
from tracked_orbit import OFF, PASSES_S, STATE, craft, tracked

import radioloc
from radioloc.dynamics import Forces, GravityField
from radioloc.dynamics.stochastic import stochastic_forces
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.problem import EstimationProblem
from radioloc.jobs.stochastic import IndependentAccelerations, StochasticProblem
from radioloc.measurements import ExactPredictor, Link
from radioloc.measurements.observations import DOPPLER
from radioloc.study import EstimateChoice
from radioloc.study.orbit_choice import OrbitChoice, ProcessNoise

SIGMA_M = 2.2e-3  # of 60 s of two-way Doppler: 0.018 mm/s in the distance
FIELDS = 60


@pytest.fixture(scope="module")
def problem(model):
    forces = Forces(GravityField.open("GRGM660PRIM", 150))
    observations, usable, _ = tracked(model, forces, SIGMA_M, PASSES_S)
    study = radioloc.Study(
        craft(STATE, forces, FIELDS, gravity_error_degree=220), consider_defaults=False, name="orbit"
    )
    arc, _ = prepared_arc(study, observations.select(np.flatnonzero(usable)))
    return EstimationProblem.from_study(study, arc, study.estimate)


def nees_of_position(problem, noise):
    """Return the expected NEES of the position over 3, for a fit with process noise of drawn gravity errors."""
    x, rows = problem.model.parameters.prior_values, np.arange(len(problem.predictor.observations))
    orbits = problem.orbits_with_gravity_errors(x)
    errors_m = problem.unadjusted_errors(problem.model, x, orbits).partials(rows)
    [target] = problem.model.targets
    model = replace(problem.model, targets=(replace(target, process_noise=noise),))
    [process] = IndependentAccelerations.from_problem(StochasticProblem.linearized_about(model, x))
    by_process = process.effects_m(rows)
    by_state = problem.model.linearize(x).partials(rows)[:, :6]
    covariance_m2 = SIGMA_M**2 * np.eye(len(rows)) + by_process @ by_process.T
    weighted = np.linalg.solve(covariance_m2, by_state)
    claimed = np.linalg.inv(by_state.T @ weighted)
    gain = claimed @ weighted.T
    true = gain @ (SIGMA_M**2 * np.eye(len(rows)) + errors_m @ errors_m.T) @ gain.T
    return np.trace(np.linalg.solve(claimed[:3, :3], true[:3, :3])) / 3.0


@pytest.mark.slow
def test_short_intervals_are_needed_for_sigmas_of_the_size_of_the_errors(problem):
    """White accelerations have one spectral density, twice that of Kaula's rule."""
    short = ProcessNoise(1.1e-6, 2.8e-7, 1.1e-6, interval_s=130.0)
    long = replace(
        short,
        **{
            f"{axis}_m_s2": value * np.sqrt(130.0 / 600.0)
            for axis, value in zip(("radial", "along", "across"), short.sigma_m_s2, strict=True)
        },
        interval_s=600.0,
    )
    assert 0.8 < nees_of_position(problem, short) < 1.25
    assert nees_of_position(problem, long) > 4.0


@pytest.mark.slow
def test_states_of_two_orbits_with_process_noise_cover_the_truth(model):
    """Two spacecraft with epochs of their own, each moved by accelerations that are drawn by the process noise."""
    forces = Forces(GravityField.open("GRGM660PRIM", 10), gradient_degree=10)
    noise = ProcessNoise(1e-7, 5e-8, 1e-7, interval_s=600.0, correlation_s=600.0)
    # Of the 16 intervals of the arc, 6 and 9 are before the epoch.
    epochs, earlier = {"craft": EPOCH, "other": EPOCH.shifted(2000.0)}, {"craft": 6, "other": 9}
    states = {"craft": STATE, "other": STATE[[1, 0, 2, 4, 3, 5]]}
    seconds, stations = np.arange(-3000.0, 6000.0, 120.0), ("DSS-24", "DSS-65")
    links = [Link(station, name, station) for station in stations for name in epochs]
    observations = observed_at(
        EPOCH.shifted(np.tile(seconds, len(links))),
        links,
        link=np.repeat(np.arange(len(links)), len(seconds)),
        kind=DOPPLER,
        sigma_m=2e-3,
        count_s=60.0,
        wavelength_um=3.6e4,
    )
    estimate = EstimateChoice(orbit=OrbitChoice(process_noise=noise))
    random, nees = np.random.default_rng(40), list[list[float]]()
    for _ in range(40):
        targets, orbits = {}, []
        for name, epoch in epochs.items():
            u = [random.normal(size=3)]
            for _ in range(15):
                u.append(
                    noise.persistence * u[-1] + np.sqrt(1.0 - noise.persistence**2) * random.normal(size=3)
                )
            values = np.array(u) * noise.sigma_m_s2
            drawn = stochastic_forces(
                epoch, (values[earlier[name] :], values[: earlier[name]][::-1]), noise.interval_s
            )
            moved = replace(forces, accelerations=drawn)
            orbits.append(
                replace(craft(states[name], moved), epoch=epoch, name=name).orbit(model, observations, ())
            )
            targets[name] = replace(craft(states[name] + 0.1 * np.array(OFF), forces), epoch=epoch, name=name)
        computed = ExactPredictor(model, observations, orbits, targets=tuple(epochs)).compute()
        noise_m = observations.sigma_m * random.normal(size=len(observations))
        tracking = replace(observations, value_m=computed.value_m + noise_m).select(computed.usable)
        study = radioloc.Study(targets=targets, estimate=estimate, consider_defaults=False)
        solution = radioloc.locate(study, tracking)
        assert solution.converged, solution.message
        errors = {
            name: np.concatenate([state.position_m, state.velocity_m_s]) - states[name]
            for name, state in solution.states.items()
        }
        nees.append(
            [
                errors[k][:3] @ np.linalg.solve(solution.states[k].covariance[:3, :3], errors[k][:3])
                for k in epochs
            ]
        )
    # 40 squares of three degrees of freedom are 120 +- 15.5
    np.testing.assert_allclose(np.sum(nees, axis=0), 120.0, atol=3.0 * np.sqrt(240.0))
