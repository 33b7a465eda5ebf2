"""Errors of a gravity field: spectrum, and effects on an orbit against integrations."""

from dataclasses import replace

import numpy as np
import pytest
from low_orbit import EPOCH, at, forces, propagated

from radioloc.dynamics import GravityField
from radioloc.dynamics.gravity_errors import draw_gravity_errors, gravity_perturbations
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError

FIELD = GravityField.open("GRGM660PRIM")
LINEAR = 2e-3  # relative: terms of second order in changes of some metres, and steps of 10 s


def test_spectrum_of_omitted_degrees_matches_the_field():
    errors = draw_gravity_errors(FIELD.to_degree(100), 50, 150, seed=1)
    squares = sum(error.c**2 + error.s**2 for error in errors)
    for n in (110, 130, 150):
        drawn = np.sqrt(squares[n, : n + 1].sum() / (2 * n + 1))
        actual = np.sqrt((FIELD.c[n] ** 2 + FIELD.s[n] ** 2).sum() / (2 * n + 1))
        assert actual == pytest.approx(drawn, rel=0.25)
    ratios = sum(error.c[60, :61] ** 2 for error in errors) / FIELD.sigma_c[60, :61] ** 2
    assert ratios.mean() == pytest.approx(1.0, abs=0.1)
    assert not any(error.c[:2].any() or np.triu(error.c, 1).any() or error.s[:, 0].any() for error in errors)


@pytest.mark.study
def test_effects_on_an_orbit_against_integrations():
    model = forces(30, gradient_degree=30)
    errors = draw_gravity_errors(model.gravity.to_degree(20), 3, 30, seed=2)
    errors = [replace(error, c=error.c * 0.02, s=error.s * 0.02) for error in errors]
    orbit = propagated(model, (-3600.0, 7200.0), parameters=())
    times_s = np.array([-3600.0, -1000.1, 0.0, 500.0, 7200.0])
    effects = gravity_perturbations(orbit, errors, LunarOrientation.open()).state_changes(
        EPOCH.shifted(times_s)
    )
    assert effects.shape == (5, 6, 3)
    assert np.linalg.norm(effects[:, :3], axis=1).max() > 1.0
    for k, error in enumerate(errors):
        field = replace(model.gravity, c=model.gravity.c + error.c, s=model.gravity.s + error.s)
        moved = at(propagated(replace(model, gravity=field), (-3600.0, 7200.0)), times_s) - at(orbit, times_s)
        for half in (slice(0, 3), slice(3, 6)):
            largest = np.abs(moved[:, half]).max()
            np.testing.assert_allclose(effects[:, half, k], moved[:, half], rtol=0, atol=LINEAR * largest)


@pytest.mark.parametrize(("count", "degree"), [(0, 60), (1, 40)])
def test_invalid_counts_and_degrees(count, degree):
    with pytest.raises(InputError, match="at least 50"):
        draw_gravity_errors(FIELD.to_degree(50), count, degree)
