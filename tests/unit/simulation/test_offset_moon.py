"""The offset Moon: offsets of the size and direction asked for, velocities that belong to them."""

import numpy as np
import pytest
from offset_moon import OffsetEphemeris, OffsetOrientation

from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs

TDB = Epochs.from_jd(2459184.5, np.linspace(0.0, 30.0, 61), "TDB")
STEP_S = 10.0
# Offsets of 100 m: positions of 4e8 m are rounded to 6e-8 m.
ROUNDING_M = 3e-7
# The orbit's plane turns by 5e-9 rad/s at most, which is left out: 100 m move with 5e-7 m/s.
PLANE_M_S = 6e-7


@pytest.fixture
def moved(model):
    return OffsetEphemeris.of(model.ephemeris, (100.0, 200.0, -50.0))


def test_the_moon_is_moved_out_along_and_across(model, moved):
    plain_m, plain_m_s = model.ephemeris.geocentric("moon", TDB)
    offset_m = moved.geocentric("moon", TDB)[0] - plain_m

    def along(direction):
        return np.einsum("ni,ni->n", offset_m, direction / np.linalg.norm(direction, axis=-1)[:, None])

    np.testing.assert_allclose(along(plain_m), 100.0, atol=ROUNDING_M)
    np.testing.assert_allclose(along(np.cross(plain_m, plain_m_s)), -50.0, atol=ROUNDING_M)
    np.testing.assert_allclose(
        np.linalg.norm(offset_m, axis=-1), np.hypot(150.0, np.sqrt(30000.0)), atol=1e-6
    )
    # The velocity is nearly along the orbit (eccentricity 0.055), and positive there.
    assert along(plain_m_s).min() > 180.0


def test_the_velocity_is_that_of_the_moved_moon(moved, model):
    before_m, after_m = (moved.geocentric("moon", TDB.shifted(s))[0] for s in (-STEP_S, STEP_S))
    plain_before_m, plain_after_m = (
        model.ephemeris.geocentric("moon", TDB.shifted(s))[0] for s in (-STEP_S, STEP_S)
    )
    differenced = ((after_m - before_m) - (plain_after_m - plain_before_m)) / (2 * STEP_S)
    given = moved.geocentric("moon", TDB)[1] - model.ephemeris.geocentric("moon", TDB)[1]
    np.testing.assert_allclose(given, differenced, rtol=0.0, atol=PLANE_M_S)
    assert np.abs(given).max() > 100.0 * PLANE_M_S


def test_all_else_stays(moved, model):
    for body in ("sun", "jupiter"):
        for one, two in zip(moved.geocentric(body, TDB), model.ephemeris.geocentric(body, TDB), strict=True):
            assert (one == two).all()
        assert (moved.barycentric(body, TDB)[0] == model.ephemeris.barycentric(body, TDB)[0]).all()
    assert (moved.earth(TDB).position_m == model.ephemeris.earth(TDB).position_m).all()
    assert moved.bodies == model.ephemeris.bodies
    assert moved.kernel == model.ephemeris.kernel
    barycentric = moved.barycentric("moon", TDB)
    for k, tolerance in ((0, 1e-4), (1, 1e-9)):
        earth = (moved.earth(TDB).position_m, moved.earth(TDB).velocity_m_s)[k]
        np.testing.assert_allclose(barycentric[k] - earth, moved.geocentric("moon", TDB)[k], atol=tolerance)


ROTATION = np.array([3e-6, -2e-6, 5e-6])
# Second order of 6e-6 rad, over the sine of the axes' inclination.
SECOND_ORDER = 2e-10


def test_a_point_moves_by_the_rotation_about_the_principal_axes(model):
    turned = OffsetOrientation.of(model.libration, tuple(ROTATION.tolist()))
    plain, other = (rot_icrf_to_pa(orientation.angles(TDB)[0]) for orientation in (model.libration, turned))
    point = np.array([0.3, -0.8, 0.5])
    # Where the point is in the principal axes of the nominal Moon.
    moved = np.einsum("nij,nkj,k->ni", plain, other, point)
    np.testing.assert_allclose(
        moved - point, np.tile(np.cross(ROTATION, point), (len(TDB), 1)), rtol=0.0, atol=SECOND_ORDER
    )


def test_the_rates_are_those_of_the_turned_moon(model):
    turned = OffsetOrientation.of(model.libration, tuple(ROTATION.tolist()))
    _, rates = turned.angles(TDB)
    before, after = (turned.angles(TDB.shifted(s))[0] for s in (-600.0, 600.0))
    plain_before, plain_after = (model.libration.angles(TDB.shifted(s))[0] for s in (-600.0, 600.0))
    # Differences of the changes alone, so that rounding of psi and curvature do not enter.
    differenced = ((after - plain_after) - (before - plain_before)) / 1200.0
    change = rates - model.libration.angles(TDB)[1]
    # psi is rounded to 1e-12 rad, over 1200 s; the change itself is 1e-11 rad/s.
    np.testing.assert_allclose(change, differenced, rtol=0.0, atol=5e-15)
    assert np.abs(change).max() > 1e-11
