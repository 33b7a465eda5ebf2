"""A point on the Moon seen from the barycentre."""

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M

from radioloc.constants import C_M_S
from radioloc.lunar.tide import solid_tide
from radioloc.measurements.lunar_motion import lunar_motion
from radioloc.time import Epochs

REFERENCE = Epochs.from_jd(2459185.5 + 13.7 * np.arange(27), 0.25, "TDB")
COUNT = len(REFERENCE)

# psi, which runs on since the kernel's start, reaches 1e4 rad; its last place turns the surface by 3 micrometres.
LAST_PLACE_OF_PSI_M = 4e-6


def moon(model, offset_s=0.0):
    return lunar_motion(model, REFERENCE, model.ephemeris.earth(REFERENCE), np.full(COUNT, offset_s))


def place(model, offset_s=0.0, pa_m=APOLLO15_PA_M):
    return moon(model, offset_s).point(model, pa_m).position_m


def test_velocity_is_the_derivative_of_the_position(model):
    expected = (place(model, 1.0) - place(model, -1.0)) / 2.0
    # Contraction and tide change by less than 1e-7 m/s.
    np.testing.assert_allclose(
        moon(model).point(model, APOLLO15_PA_M).velocity_m_s, expected, rtol=0, atol=LAST_PLACE_OF_PSI_M
    )


def test_tide_is_added_in_the_moons_axes(model):
    state = moon(model)
    moved_m = np.einsum("nij,ni->nj", state.rot_pa_to_icrf, place(model) - place(model.without("lunar_tide")))
    tide = solid_tide(APOLLO15_PA_M, state.earth_pa_m, state.sun_pa_m, model.ephemeris.constants)
    np.testing.assert_allclose(moved_m, tide, rtol=0, atol=3e-7)
    assert 0.3 < np.linalg.norm(tide, axis=-1).max() < 0.7
    varying = place(model.without("lunar_tide_constant")) - place(model.without("lunar_tide"))
    assert 0.01 < np.linalg.norm(varying, axis=-1).max() < 0.25


def test_scale_and_contraction(model):
    full, state = place(model), moon(model)
    vector = np.einsum("nij,j->ni", state.rot_pa_to_icrf, APOLLO15_PA_M)
    v = state.centre.velocity_m_s
    scale = full - place(model.without("lunar_scale"))
    contraction = full - place(model.without("lunar_lorentz"))
    ratio = -np.einsum("ni,ni->n", scale, vector) / np.einsum("ni,ni->n", vector, vector)
    sun_m, _ = model.ephemeris.geocentric("sun", REFERENCE)
    distance_au = np.linalg.norm(sun_m - state.moon_gcrs_m, axis=-1) / 1.495978707e11
    # L_C, the Sun, and the Earth at 384400 km (1.15e-11).
    np.testing.assert_allclose(
        ratio, 1.48082686741e-8 + 9.87062e-9 / distance_au + 1.15e-11, rtol=0, atol=2e-12
    )
    assert np.linalg.norm(scale, axis=-1) == pytest.approx(np.full(COUNT, 0.043), abs=0.001)
    # The contraction of the tide of 0.5 m is 2e-9 m.
    np.testing.assert_allclose(
        contraction, -v * np.einsum("ni,ni->n", v, vector)[:, None] / (2 * C_M_S**2), rtol=0, atol=3e-7
    )
    assert 0.006 < np.linalg.norm(contraction, axis=-1).max() < 0.009


def test_earth_and_sun_in_the_moons_axes(model):
    state = moon(model)
    towards_earth = state.earth_pa_m / np.linalg.norm(state.earth_pa_m, axis=-1)[:, None]
    # The x axis points at the Earth but for librations of up to 8 and 7 degrees.
    assert (np.degrees(np.arccos(towards_earth[:, 0])) < 11.0).all()
    # The position of the Moon cancels in the difference; 1.5e11 m are rounded to 3e-5 m, some times over.
    between_m = np.einsum("nij,nj->ni", state.rot_pa_to_icrf, state.sun_pa_m - state.earth_pa_m)
    sun_m, _ = model.ephemeris.geocentric("sun", REFERENCE)
    np.testing.assert_allclose(between_m, sun_m, rtol=0, atol=3e-4)


def test_geocentric_position_at_another_epoch(model):
    """The geocentric position at an offset equals the one computed for the later epoch."""
    reference = moon(model)
    position_m, velocity_m_s = reference.geocentric(
        reference.point(model, APOLLO15_PA_M), np.full(COUNT, 1e-3)
    )
    later = moon(model, 1e-3)
    expected_m, expected_m_s = later.geocentric(later.point(model, APOLLO15_PA_M), np.full(COUNT, 1e-3))
    np.testing.assert_allclose(position_m, expected_m, rtol=0, atol=LAST_PLACE_OF_PSI_M)
    np.testing.assert_allclose(velocity_m_s, expected_m_s, rtol=0, atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(position_m - reference.moon_gcrs_m, axis=-1),
        np.linalg.norm(APOLLO15_PA_M),
        rtol=0,
        atol=10.0,
    )
