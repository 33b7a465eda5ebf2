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


@pytest.fixture(scope="module")
def bodies():
    """Earth and Sun in principal axes over two nodal periods."""
    tdb = Epochs.from_jd(2440422.5 + np.arange(0.0, 2 * NODAL_PERIOD_DAYS, 0.5), 0.0, "TDB")
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


@pytest.mark.parametrize("direction_me", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (-1, 2, 1)])
def test_removed_leaves_no_mean(bodies, direction_me):
    point = TO_ME.T @ (np.array(direction_me) * 1e6)
    remainder = solid_tide(point, *bodies, DE421, permanent="removed")
    np.testing.assert_allclose(remainder.mean(axis=0), 0.0, atol=MEAN_LEFT_M)
    constant = solid_tide(point, *bodies, DE421) - remainder
    assert np.ptp(constant, axis=0).max() < 1e-12
