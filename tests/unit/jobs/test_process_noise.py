"""Orbits with stochastic accelerations, located from Doppler before and behind the epoch."""

from dataclasses import replace

import numpy as np
import pytest
from low_orbit import EPOCH
from tracked_orbit import OFF, PASSES_S, STATE, craft, tracked

import radioloc
from radioloc.dynamics import Forces, GravityField
from radioloc.dynamics.stochastic import stochastic_forces
from radioloc.errors import InputError
from radioloc.measurements import ExactPredictor
from radioloc.study.orbit_choice import OrbitChoice, ProcessNoise
from radioloc.vectors import rtn_axes

SIGMA_M = 2e-4
SIGMA_M_S2 = 1e-7
NOISE = ProcessNoise(SIGMA_M_S2, 0.5 * SIGMA_M_S2, SIGMA_M_S2, interval_s=600.0, correlation_s=600.0)


@pytest.fixture(scope="module")
def forces():
    return Forces(GravityField.open("GRGM660PRIM", 20), gradient_degree=20)


def drawn(seed, interval_s, correlation_s, span_s=(-4100.0, 12100.0)):
    """Accelerations of first order by the sigmas of NOISE."""
    random = np.random.default_rng(seed)
    earlier, later = (int(np.ceil(abs(end_s) / interval_s)) for end_s in span_s)
    persistence = np.exp(-interval_s / correlation_s)
    values = [random.normal(size=3)]
    for _ in range(earlier + later - 1):
        values.append(persistence * values[-1] + np.sqrt(1.0 - persistence**2) * random.normal(size=3))
    in_order = np.array(values) * NOISE.sigma_m_s2
    return stochastic_forces(EPOCH, (in_order[earlier:], in_order[:earlier][::-1]), interval_s)


def counts(model, forces, accelerations, seed=20120409):
    """Return counts of three passes, and the orbit."""
    seconds = np.concatenate([np.arange(-4000.0, -1000.0, 60.0), PASSES_S])
    true = replace(forces, accelerations=accelerations)
    observations, _, orbit = tracked(model, true, SIGMA_M, seconds, seed=seed)
    return observations, orbit


def study_of(acting, estimate=None, **orbit):
    target = craft(STATE + 0.1 * np.array(OFF), acting)
    chosen = radioloc.study.EstimateChoice(orbit=OrbitChoice(**orbit), **(estimate or {}))
    return radioloc.Study(target, estimate=chosen, consider_defaults=False, name="orbit")


@pytest.fixture(scope="module")
def doppler(model, forces):
    return counts(model, forces, drawn(1, 600.0, 600.0))


@pytest.fixture(scope="module")
def solution(forces, doppler):
    return radioloc.locate(study_of(forces, process_noise=NOISE), doppler[0])


def errors_m(solution, orbit, times):
    """Radial, along, across."""
    r, v = orbit.states(times)
    return np.einsum("nij,nj->ni", rtn_axes(r, v), solution.state.orbit.states(times)[0] - r)


@pytest.mark.study
def test_the_orbit_is_found_within_sigmas_that_a_fit_without_process_noise_misses(forces, doppler, solution):
    observations, orbit = doppler
    assert solution.converged
    assert solution.fit.total.wrms_m < 1.1 * SIGMA_M
    times = solution.state.orbit.times(15)
    sigma_m = solution.state.sigma_rtn_m(times)
    assert (np.abs(errors_m(solution, orbit, times)) < 4.0 * sigma_m).all()
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    # A chi squared of 6 degrees of freedom.
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5
    reduced = radioloc.locate(study_of(forces), observations)
    assert not reduced.converged
    assert reduced.fit.total.wrms_m > 3.0 * SIGMA_M


def test_residuals_are_those_of_the_smoothed_orbit(model, doppler, solution):
    observations, _ = doppler
    predictor = ExactPredictor(model, observations, solution.state.orbit)
    left_m = observations.value_m - predictor.compute().value_m
    used = solution.residuals.used
    np.testing.assert_allclose(solution.residuals.residual_m[used], left_m[used], atol=0.02 * SIGMA_M)


def test_intervals_with_more_motion_than_the_residuals_are_noted(forces, doppler, solution):
    """White accelerations move the velocity by 25 um/s within an interval, beside one-way noise of 2 um/s."""
    white = radioloc.locate(study_of(forces, process_noise=replace(NOISE, correlation_s=0.0)), doppler[0])
    assert any("interval_s" in note for note in white.notes)
    assert not any("interval_s" in note for note in solution.notes)


def test_what_cannot_be_with_process_noise_is_refused(forces, doppler):
    study = study_of(forces, process_noise=NOISE)
    with pytest.raises(InputError, match="process_noise"):
        ProcessNoise(interval_s=600.0)
    with pytest.raises(InputError, match=r"leave .* doppler_phase_sigma_m out"):
        replace(study, observations=replace(study.observations, doppler_phase_sigma_m=0.001))
    short = replace(NOISE, interval_s=100.0)
    with pytest.raises(InputError, match=r"60.*130"):
        radioloc.locate(study_of(forces, process_noise=short), doppler[0])
