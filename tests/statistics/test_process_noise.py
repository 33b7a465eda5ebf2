"""Sigmas of an orbit with process noise, for drawn errors of the gravity field beyond the degree of the fit."""

from dataclasses import replace

import numpy as np
import pytest
from tracked_orbit import PASSES_S, STATE, craft, tracked

import radioloc
from radioloc.dynamics import Forces, GravityField
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.problem import EstimationProblem
from radioloc.jobs.stochastic import IndependentAccelerations, StochasticProblem
from radioloc.study.orbit_choice import ProcessNoise

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
    by_process = IndependentAccelerations.from_problem(
        StochasticProblem.linearized_about(problem.model, noise, x)
    ).effects_m(rows)
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
