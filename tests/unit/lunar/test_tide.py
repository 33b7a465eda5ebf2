from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import CONSTANTS, Ephemeris, LunarOrientation
from radioloc.lunar import rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.tide import solid_tide
from radioloc.time import Epochs

DE421 = CONSTANTS["DE421"]
TO_ME = rot_pa_to_me(DE421)
# What the tabulated mean leaves: its terms off the diagonal, 2e-4 of 13 m times the Love number.
MEAN_LEFT_M = 3e-4
NODAL_PERIOD_DAYS = 6798.38
FAR_M = 1.0e30  # pulls on nothing


@pytest.fixture(scope="module")
def bodies():
    """Earth and Sun in principal axes over two nodal periods."""
    tdb = Epochs.from_jd(2440422.5 + np.arange(0.0, 2 * NODAL_PERIOD_DAYS, 0.5))
    ephemeris = Ephemeris.open()
    rot = rot_icrf_to_pa(LunarOrientation.open().angles(tdb)[0])
    moon_m, sun_m = ephemeris.geocentric("moon", tdb)[0], ephemeris.geocentric("sun", tdb)[0]
    return np.einsum("nij,nj->ni", rot, -moon_m), np.einsum("nij,nj->ni", rot, sun_m - moon_m)


def iers_form_m(point, body, mass_ratio, h2, l2):
    """IERS Conventions (2010), eq. 7.5, for one body, as printed there."""
    up, toward = point / np.linalg.norm(point), body / np.linalg.norm(body)
    cosine = toward @ up
    scale = mass_ratio * MEAN_LUNAR_RADIUS_M**4 / np.linalg.norm(body) ** 3
    return scale * (h2 * up * (1.5 * cosine**2 - 0.5) + 3 * l2 * cosine * (toward - cosine * up))


def test_against_the_printed_form(bodies):
    earth, sun = (b[::4001] for b in bodies)
    point = np.array([1554678.231, 98095.485, 765005.355])
    ours = solid_tide(point, earth, sun, DE421)
    for i in range(len(earth)):
        expected = iers_form_m(
            point, earth[i], DE421.gm_earth_m3_s2 / DE421.gm_moon_m3_s2, DE421.h2, DE421.l2
        )
        expected += iers_form_m(point, sun[i], DE421.gm_sun_m3_s2 / DE421.gm_moon_m3_s2, DE421.h2, DE421.l2)
        np.testing.assert_allclose(ours[i], expected, rtol=0, atol=1e-12)


def test_size_under_the_earth_and_at_the_limb():
    # 81.3 x (1737.4 km)^4 / (384399 km)^3 is 13.04 m; times h2 up, minus half of it at the limb.
    earth, sun = np.array([[384399.0e3, 0.0, 0.0]]), np.array([[FAR_M, 0.0, 0.0]])
    up = solid_tide([MEAN_LUNAR_RADIUS_M, 0, 0], earth, sun, DE421)
    np.testing.assert_allclose(up, [[0.4942, 0, 0]], rtol=0, atol=1e-4)
    limb = solid_tide([0, 0, MEAN_LUNAR_RADIUS_M], earth, sun, DE421)
    np.testing.assert_allclose(limb, [[0, 0, -0.2471]], rtol=0, atol=1e-4)


def test_tangential_part_pulls_toward_the_earth():
    earth, sun = np.array([[384399.0e3, 0.0, 0.0]]), np.array([[FAR_M, 0.0, 0.0]])
    point = MEAN_LUNAR_RADIUS_M * np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    moved = solid_tide(point, earth, sun, dataclasses.replace(DE421, h2=0.0))[0]
    # 3/2 l2 sin(90 degrees) times 13.04 m, along the surface.
    assert np.linalg.norm(moved) == pytest.approx(1.5 * DE421.l2 * 13.04, abs=1e-4)
    assert moved @ point == pytest.approx(0.0, abs=1e-6)
    assert moved[0] > 0


def test_the_sun_adds_up_to_three_millimetres(bodies):
    earth, sun = bodies
    point = [MEAN_LUNAR_RADIUS_M, 0.0, 0.0]
    part = solid_tide(point, earth, sun, DE421) - solid_tide(point, earth, FAR_M * sun / 1.5e11, DE421)
    assert 0.002 < np.abs(part).max() < 0.0035


@pytest.mark.parametrize("direction_me", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (-1, 2, 1)])
def test_removed_leaves_no_mean(bodies, direction_me):
    point = TO_ME.T @ (np.array(direction_me) * 1e6)
    left = solid_tide(point, *bodies, DE421, permanent="removed")
    np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=MEAN_LEFT_M)
    constant = solid_tide(point, *bodies, DE421) - left
    assert np.ptp(constant, axis=0).max() < 1e-12


def test_sizes_that_are_documented(bodies):
    whole = solid_tide(TO_ME.T @ [MEAN_LUNAR_RADIUS_M, 0, 0], *bodies, DE421) @ TO_ME.T
    assert whole[:, 0].mean() == pytest.approx(0.487, abs=0.001)
    varying = solid_tide(TO_ME.T @ [MEAN_LUNAR_RADIUS_M, 0, 0], *bodies, DE421, "removed") @ TO_ME.T
    assert varying[:, 0].min() == pytest.approx(-0.077, abs=0.002)
    assert varying[:, 0].max() == pytest.approx(0.133, abs=0.002)
    limb = solid_tide(TO_ME.T @ [0, MEAN_LUNAR_RADIUS_M, 0], *bodies, DE421) @ TO_ME.T
    assert limb[:, 1].mean() == pytest.approx(-0.243, abs=0.001)


def test_one_point_or_one_for_each_epoch(bodies):
    earth, sun = (b[:5] for b in bodies)
    points = np.tile([MEAN_LUNAR_RADIUS_M, 1e5, -3e5], (5, 1))
    one = solid_tide(points[0], earth, sun, DE421)
    assert one.shape == (5, 3)
    np.testing.assert_array_equal(one, solid_tide(points, earth, sun, DE421))
