"""Manoeuvres that a study does not name: found by the residuals, and gone when they are named."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from low_orbit import EPOCH
from tracked_orbit import OFF, PASSES_S, STATE, craft, tracked

import radioloc
from radioloc.dynamics import Acceleration, Forces, GravityField, Impulse
from radioloc.errors import InputError
from radioloc.estimation import FitStatus
from radioloc.measurements import PhysicalModel
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.time import epochs_from_strings

SIGMA_M = 2e-3  # of 60 s: what counts of real links of 0.03 mm/s have
FORCES = Forces(GravityField.open("GRGM660PRIM", 20), radiation_m2_kg=0.018, gradient_degree=20)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build()


def burn(time_s, delta_v_m_s):
    return Impulse("burn", EPOCH.shifted(time_s), delta_v_m_s)


def counts(model, forces):
    return tracked(model, forces, SIGMA_M, seed=7)[0]


def located(forces, observations):
    target = craft(STATE + OFF, forces)
    estimate = radioloc.study.EstimateChoice(orbit=OrbitChoice())
    study = radioloc.Study(target, estimate=estimate, consider_defaults=False, name="orbit")
    return radioloc.locate(study, observations)


def told(message):
    """Time from the epoch, its sigma, and radial, along and across velocities that a message names."""
    found = re.search(r"jump at (\S+) TDB \(\+- (\d+) s\).* manoeuvre of .*delta_v_m_s = \[(.*?)\]", message)
    time_s = epochs_from_strings(found[1], "TDB").seconds_since(EPOCH)[0]
    return time_s, float(found[2]), np.array([float(one) for one in found[3].split(",")])


@pytest.mark.study
@pytest.mark.parametrize(
    ("time_s", "delta_v_m_s"),
    [
        (6000.0, (0.03, 0.04, 0.0)),
        pytest.param(9500.0, (0.0, 0.5, 0.1), marks=pytest.mark.slow),
        pytest.param(9500.0, (1.0, 4.0, 3.0), marks=pytest.mark.slow),
    ],
)
def test_a_manoeuvre_that_is_not_named_is_told_by_time_and_size(model, time_s, delta_v_m_s):
    solution = located(FORCES, counts(model, replace(FORCES, impulses=(burn(time_s, delta_v_m_s),))))
    assert solution.status is FitStatus.MANOEUVRE
    found_s, sigma_s, found_m_s = told(solution.message)
    assert abs(found_s - time_s) < 4.0 * sigma_s + 1.0
    # What is short of it in a pass is made up by the state: per cent.
    assert np.abs(found_m_s - delta_v_m_s).max() < 0.02 * np.linalg.norm(delta_v_m_s)
    assert ("in the gap of the data from 2012-04-09T05:5" in solution.message) == (time_s == 6000.0)
    # The state is that of the orbit before it, from what was observed before it.
    before = np.count_nonzero(time_s > PASSES_S + 30.0)
    assert before - 8 < solution.residuals.used.sum() <= before
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    assert (np.abs(error) < 4.0 * np.sqrt(np.diag(solution.state.covariance))).all()


@pytest.mark.slow
def test_a_burn_of_a_minute_is_told_as_an_impulse(model):
    thrust = Acceleration(
        "burn", constant_m_s2=(0.0, 0.01, 0.0), start=EPOCH.shifted(9470.0), stop=EPOCH.shifted(9530.0)
    )
    solution = located(FORCES, counts(model, replace(FORCES, accelerations=(thrust,))))
    found_s, _, found_m_s = told(solution.message)
    assert abs(found_s - 9500.0) < 15.0
    np.testing.assert_allclose(found_m_s, [0.0, 0.6, 0.0], atol=0.02)


@pytest.mark.study
def test_a_manoeuvre_that_is_named_is_estimated(model):
    observations = counts(model, replace(FORCES, impulses=(burn(9500.0, (0.0, 0.5, 0.1)),)))
    solution = located(replace(FORCES, impulses=(burn(9500.0, (0.0, 0.45, 0.0)),)), observations)
    assert solution.converged
    values = dict(zip([one.name for one in solution.parameters], solution.values, strict=True))
    sigmas = dict(zip([one.name for one in solution.parameters], solution.sigmas(), strict=True))
    for name, true in zip("rtn", (0.0, 0.5, 0.1), strict=True):
        assert abs(values[f"force.burn.{name}"] - true) < 4.0 * sigmas[f"force.burn.{name}"]


@pytest.mark.study
def test_an_orbit_without_a_manoeuvre_is_left_alone(model):
    assert located(FORCES, counts(model, FORCES)).converged


@pytest.mark.parametrize(
    ("forces", "message"),
    [
        (
            replace(FORCES, impulses=(burn(20000.0, (0.0, 0.5, 0.1)),)),
            r"impulses\]\] burn acts after the arc",
        ),
        (
            replace(FORCES, accelerations=(Acceleration("thrust", stop=EPOCH.shifted(-900.0)),)),
            r"accelerations\]\] thrust acts before the arc, which is from 2012-04-09T04:30:00 to 2012-04-09T07:51",
        ),
        (
            replace(FORCES, impulses=(burn(0.0, (0.0, 0.5, 0.1)),)),
            "burn is at 2012-04-09T04:30:00.000 TDB, .* at the epoch of craft",
        ),
    ],
)
def test_manoeuvres_that_are_not_on_the_arc(model, forces, message):
    with pytest.raises(InputError, match=message):
        located(forces, counts(model, FORCES))
