"""Undocumented manoeuvres: note of the fit, search, and estimation."""

from dataclasses import replace

import numpy as np
import pytest
from low_orbit import EPOCH
from tracked_orbit import OFF, STATE, craft, tracked

import radioloc
from radioloc.dynamics import Acceleration, Forces, GravityField, Impulse
from radioloc.errors import InputError
from radioloc.estimation import FitStatus
from radioloc.search import search
from radioloc.study.orbit_choice import OrbitChoice

SIGMA_M = 2e-3  # of counts of 60 s on links of 0.03 mm/s
FORCES = Forces(GravityField.open("GRGM660PRIM", 20), radiation_m2_kg=0.018, gradient_degree=20)


def burn(time_s, delta_v_m_s):
    return Impulse("burn", EPOCH.shifted(time_s), delta_v_m_s)


def counts(model, forces):
    return tracked(model, forces, SIGMA_M, seed=7)[0]


def study(forces):
    target = craft(STATE + OFF, forces)
    estimate = radioloc.study.EstimateChoice(orbit=OrbitChoice())
    return radioloc.Study(target, estimate=estimate, consider_defaults=False, name="orbit")


@pytest.mark.study
@pytest.mark.parametrize(
    ("time_s", "delta_v_m_s"),
    [
        (6000.0, (0.03, 0.04, 0.0)),
        pytest.param(9500.0, (0.0, 0.5, 0.1), marks=pytest.mark.slow),
        pytest.param(9500.0, (1.0, 4.0, 3.0), marks=pytest.mark.slow),
    ],
)
def test_undocumented_manoeuvre_is_detected_and_estimated(model, time_s, delta_v_m_s):
    observations = counts(model, replace(FORCES, impulses=(burn(time_s, delta_v_m_s),)))
    fit_without = radioloc.locate(study(FORCES), observations)
    assert fit_without.status is FitStatus.MISFIT
    assert any("`radioloc search STUDY.toml` looks for manoeuvres" in note for note in fit_without.notes)
    result = search(study(FORCES), observations)
    (manoeuvre,) = result.manoeuvres
    assert abs(manoeuvre.epoch.seconds_since(EPOCH)[0] - time_s) < 4.0 * max(manoeuvre.sigma_s, 1.0) + 1.0
    # The state absorbs some per cent of it within a pass.
    assert np.abs(manoeuvre.delta_v_m_s - delta_v_m_s).max() < 0.02 * np.linalg.norm(delta_v_m_s)
    assert (manoeuvre.gap is not None) == (time_s == 6000.0)
    solution = radioloc.locate(result.study, observations)
    assert solution.converged
    assert solution.residuals.used.sum() > len(observations) - 8
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    assert (np.abs(error) < 4.0 * np.sqrt(np.diag(solution.state.covariance))).all()
    sigmas = dict(zip([parameter.name for parameter in solution.parameters], solution.sigmas(), strict=True))
    values = dict(zip([parameter.name for parameter in solution.parameters], solution.values, strict=True))
    for name, true in zip("rtn", delta_v_m_s, strict=True):
        # The epoch has an error of its sigma, and is fixed.
        tolerance_m_s = 5.0 * sigmas[f"force.found_1.{name}"] + 1e-3 * np.linalg.norm(delta_v_m_s)
        assert abs(values[f"force.found_1.{name}"] - true) < tolerance_m_s


@pytest.mark.slow
def test_burn_of_a_minute_is_detected_as_an_impulse(model):
    thrust = Acceleration(
        "burn", constant_m_s2=(0.0, 0.01, 0.0), start=EPOCH.shifted(9470.0), stop=EPOCH.shifted(9530.0)
    )
    result = search(study(FORCES), counts(model, replace(FORCES, accelerations=(thrust,))))
    (manoeuvre,) = result.manoeuvres
    assert abs(manoeuvre.epoch.seconds_since(EPOCH)[0] - 9500.0) < 15.0
    np.testing.assert_allclose(manoeuvre.delta_v_m_s, [0.0, 0.6, 0.0], atol=0.02)


@pytest.mark.study
def test_orbit_without_manoeuvres_has_no_detection(model):
    observations = counts(model, FORCES)
    assert radioloc.locate(study(FORCES), observations).converged
    assert search(study(FORCES), observations).manoeuvres == ()


@pytest.mark.parametrize(
    ("forces", "message"),
    [
        (replace(FORCES, impulses=(burn(20000.0, (0.0, 0.5, 0.1)),)), "burn acts after"),
        (
            replace(FORCES, accelerations=(Acceleration("thrust", stop=EPOCH.shifted(-900.0)),)),
            "thrust acts before the arc",
        ),
        (replace(FORCES, impulses=(burn(0.0, (0.0, 0.5, 0.1)),)), "impulse burn"),
    ],
)
def test_manoeuvres_outside_the_arc_are_refused(model, forces, message):
    with pytest.raises(InputError, match=message):
        radioloc.locate(study(forces), counts(model, FORCES))
