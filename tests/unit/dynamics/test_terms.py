"""Each acceleration against its definition, computed in another way."""

from dataclasses import replace

import numpy as np
import pytest
from low_orbit import EPOCH, POSITION_M, STATE, VELOCITY_M_S, forces
from moyer import post_newtonian

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import Acceleration, GravityField, acceleration_sizes
from radioloc.dynamics._force_kernels import (
    AU_M,
    EARTH_J2,
    EARTH_RADIUS_M,
    SUN_RADIUS_M,
    SUNLIGHT_N_M2,
    sunlit,
)
from radioloc.dynamics.accelerations import acceleration_terms
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs

EPHEMERIS = Ephemeris.open()
GM = EPHEMERIS.constants.gm_m3_s2
MOON_M, _ = (values[0] for values in EPHEMERIS.geocentric("moon", EPOCH))
EARTH_M, SUN_M = -MOON_M, EPHEMERIS.geocentric("sun", EPOCH)[0][0] - MOON_M
POSITIONS_M = {"earth": EARTH_M} | {
    body: EPHEMERIS.geocentric(body, EPOCH)[0][0] - MOON_M for body in ("sun", "venus", "jupiter", "saturn")
}


def terms(position_m=POSITION_M, velocity_m_s=VELOCITY_M_S, degree=20, **changes):
    return acceleration_terms(EPOCH, position_m, velocity_m_s, forces(degree, **changes))


def test_gravity_in_the_axes_of_the_field():
    computed = terms(degree=60)
    field = forces(60).gravity
    rot = rot_icrf_to_pa(LunarOrientation.open().angles(EPOCH)[0])[0]
    expected = rot.T @ field.acceleration(rot @ POSITION_M) * GM("moon") / field.gm_m3_s2
    np.testing.assert_allclose(computed["central"] + computed["harmonics"], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("body", POSITIONS_M)
def test_third_bodies(body):
    to_m = POSITIONS_M[body] - POSITION_M
    expected = to_m / np.linalg.norm(to_m) ** 3 - POSITIONS_M[body] / np.linalg.norm(POSITIONS_M[body]) ** 3
    np.testing.assert_allclose(terms()[body], GM(body) * expected, rtol=0, atol=1e-17)


def test_tides_against_the_gradient_of_the_potential():
    k2, radius_m = 0.02416, 1738.0e3

    def potential(r):
        total = 0.0
        for body, gm in ((EARTH_M, GM("earth")), (SUN_M, GM("sun"))):
            distance = np.linalg.norm(body)
            cosine = r @ body / np.linalg.norm(r) / distance
            total += gm / distance**3 * (1.5 * cosine**2 - 0.5)
        return k2 * total * radius_m**5 / np.linalg.norm(r) ** 3

    h = 100.0
    expected = [(potential(POSITION_M + h * e) - potential(POSITION_M - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(terms()["tides"], expected, rtol=0, atol=1e-14)


def test_zero_tide_fields_agree_with_tide_free_fields():
    """Mean tide over 18.6 years by coefficients (IERS Conventions 2010, eq. 6.6), not by the tensor."""
    k2, free = 0.02416, forces(20).gravity
    days = np.arange(0.0, 18.613 * 365.25, 0.5)
    tdb = Epochs.from_tdb_seconds((days + 3.0 * 365.25) * 86400.0)
    moon_m, sun_m = (EPHEMERIS.geocentric(body, tdb)[0] for body in ("moon", "sun"))
    rot = rot_icrf_to_pa(LunarOrientation.open().angles(tdb)[0])
    permanent = np.zeros((2, 3))
    for gm, to_m in ((GM("earth"), -moon_m), (GM("sun"), sun_m - moon_m)):
        x, y, z = np.einsum("nij,nj->in", rot, to_m)
        distance_m, plane_m = np.sqrt(x**2 + y**2 + z**2), np.hypot(x, y)
        sine, cosine, longitude = z / distance_m, plane_m / distance_m, np.arctan2(y, x)
        legendre = np.stack([1.5 * sine**2 - 0.5, 3.0 * sine * cosine, 3.0 * cosine**2])
        legendre *= np.sqrt([5.0, 5.0 / 3.0, 5.0 / 12.0])[:, np.newaxis]
        size = k2 / 5.0 * gm / free.gm_m3_s2 * (free.radius_m / distance_m) ** 3 * legendre
        turn = np.multiply.outer(np.arange(3), longitude)
        permanent += [(size * np.cos(turn)).mean(axis=1), (size * np.sin(turn)).mean(axis=1)]
    c, s = free.c.copy(), free.s.copy()
    c[2, :3] += permanent[0]
    s[2, :3] += permanent[1]
    assert permanent[0] == pytest.approx([-4.02e-8, 0.0, 6.93e-8], abs=1e-10)
    of_free, of_zero = (
        acceleration_terms(EPOCH, POSITION_M, VELOCITY_M_S, replace(forces(20), gravity=field))
        for field in (free, replace(free, c=c, s=s, tide_system="zero_tide"))
    )
    of_free, of_zero = (terms["harmonics"] + terms["tides"] for terms in (of_free, of_zero))
    # The mean tide is 2e-7 m/s^2; means over spans of 18.6 years from 1995, 2003 and 2010 on differ by 3e-4.
    np.testing.assert_allclose(of_zero, of_free, rtol=0, atol=2e-10)


def test_figures_of_earth_and_moon():
    c = np.zeros((3, 3))
    c[2, 0] = -EARTH_J2 / np.sqrt(5.0)
    zero = np.zeros((3, 3))
    earth = GravityField("J2", GM("earth"), EARTH_RADIUS_M, "ICRF", "unknown", c, zero, zero, zero)
    expected = earth.acceleration(POSITION_M - EARTH_M) - earth.acceleration(-EARTH_M)
    # Reaction to the pull of the Moon's figure at the Earth, by the ratio of masses.
    field = forces(20).gravity
    rot = rot_icrf_to_pa(LunarOrientation.open().angles(EPOCH)[0])[0]
    at_earth = rot.T @ (field.acceleration(rot @ EARTH_M) - field.to_degree(0).acceleration(rot @ EARTH_M))
    expected += at_earth * GM("earth") / field.gm_m3_s2
    assert np.linalg.norm(expected) > 1e-12
    np.testing.assert_allclose(terms()["figures"], expected, rtol=0, atol=1e-17)


def test_relativity_of_moon_earth_and_sun_in_barycentric_coordinates():
    earth = EPHEMERIS.earth(EPOCH)
    names = ["moon", "earth", "sun"]
    gm = np.array([0.0] + [GM(name) for name in names])
    states = [(earth.position_m[0], earth.velocity_m_s[0]) if name == "earth" else None for name in names]
    states = [
        state or tuple(values[0] for values in EPHEMERIS.barycentric(name, EPOCH))
        for name, state in zip(names, states, strict=True)
    ]
    places = np.array([states[0][0] + POSITION_M] + [state[0] for state in states])
    speeds = np.array([states[0][1] + VELOCITY_M_S] + [state[1] for state in states])
    pulls = np.zeros((4, 3))
    for j in range(4):
        for k in range(1, 4):
            if k != j:
                separation = places[k] - places[j]
                pulls[j] += gm[k] * separation / np.linalg.norm(separation) ** 3
    of_craft = post_newtonian(0, places, speeds, pulls, gm)
    of_moon = post_newtonian(0, places[1:], speeds[1:], pulls[1:], gm[1:])
    assert np.linalg.norm(of_craft - of_moon) > 5e-8
    np.testing.assert_allclose(terms()["relativity"], of_craft - of_moon, rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 0.9, 0.9705, 0.9740, 0.9755, 1.2])
def test_visible_fraction_of_the_sun(angle_rad):
    """Count of points of the disk; angles about the limb of the Moon seen from 360 km above."""
    r = np.array([-2.1e6, 0.0, 0.0])
    sun = AU_M * np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    to_sun = sun - r
    distance = np.linalg.norm(to_sun)
    to_sun /= distance
    side = np.array([-to_sun[1], to_sun[0], 0.0])
    x, y = np.meshgrid(np.linspace(-1, 1, 801), np.linspace(-1, 1, 801))
    on_disk = x**2 + y**2 <= 1.0
    tangent = SUN_RADIUS_M / distance
    rays = to_sun + tangent * (x[on_disk][:, None] * side + y[on_disk][:, None] * np.array([0.0, 0.0, 1.0]))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    nearest = np.linalg.norm(r + np.maximum(0.0, -rays @ r)[:, None] * rays, axis=1)
    visible = (nearest > MEAN_LUNAR_RADIUS_M).mean()
    assert sunlit(r, sun, np.zeros(3), MEAN_LUNAR_RADIUS_M) == pytest.approx(visible, abs=2e-3)


@pytest.mark.parametrize("height_m", [50e3, 5000e3])
@pytest.mark.parametrize("from_sun_deg", [0.0, 50.0, 90.0, 120.0])
def test_moonlight_of_a_lambert_sphere(height_m, from_sun_deg):
    """Sum over 100,000 elements of a Lambert sphere that returns all sunlight."""
    to_sun = SUN_M / np.linalg.norm(SUN_M)
    side = np.cross(to_sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = np.radians(from_sun_deg)
    r = (MEAN_LUNAR_RADIUS_M + height_m) * (np.cos(angle) * to_sun + np.sin(angle) * side)
    computed = terms(r, np.cross(to_sun + np.array([0.1, 0.2, 0.3]), r) * 1e-3, 0, radiation_m2_kg=1.0)[
        "moonlight"
    ]
    n = 100_000
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n)
    ground = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=-1)
    ray = r - MEAN_LUNAR_RADIUS_M * ground
    distance = np.linalg.norm(ray, axis=1)
    rising = np.maximum(0.0, (ray * ground).sum(1) / distance)
    sent = np.maximum(0.0, ground @ to_sun) * rising / distance**2
    area = 4.0 * np.pi * MEAN_LUNAR_RADIUS_M**2 / n
    pressure = SUNLIGHT_N_M2 * (AU_M / np.linalg.norm(SUN_M)) ** 2
    expected = pressure * area / np.pi * (sent[:, None] * ray / distance[:, None]).sum(0)
    assert (
        np.linalg.norm(computed - expected) < 0.04 * pressure * (MEAN_LUNAR_RADIUS_M / np.linalg.norm(r)) ** 2
    )


def test_sunlight_pressure():
    computed = terms(SUN_M / np.linalg.norm(SUN_M) * 1.8e6, radiation_m2_kg=0.02)["sunlight"]
    expected = -0.02 * SUNLIGHT_N_M2 * (AU_M / np.linalg.norm(SUN_M)) ** 2 * SUN_M / np.linalg.norm(SUN_M)
    np.testing.assert_allclose(computed, expected, rtol=3e-5)
    assert not terms(-SUN_M / np.linalg.norm(SUN_M) * 1.8e6, radiation_m2_kg=0.02)["sunlight"].any()


def test_empirical_accelerations_at_the_epoch():
    burn = Acceleration("burn", "RTN", (1.0, 2.0, 3.0), (0.5, 0.0, 0.0), (9.0, 9.0, 9.0))
    computed = terms(accelerations=(burn, Acceleration("other", "ICRF", (0.0, 0.0, 1.0))))["empirical"]
    radial = POSITION_M / np.linalg.norm(POSITION_M)
    normal = np.cross(STATE[:3], STATE[3:])
    normal /= np.linalg.norm(normal)
    expected = 1.5 * radial + 2.0 * np.cross(normal, radial) + 3.0 * normal + [0.0, 0.0, 1.0]
    np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bodies": ("mars",)}, "got 'mars'"),
        ({"gradient_degree": -1}, "gradient_degree"),
        ({"accelerations": (Acceleration("a"), Acceleration("a", "ICRF"))}, "unique names"),
        ({"k2": np.nan}, "k2"),
        ({"radiation_m2_kg": np.nan}, "radiation_m2_kg"),
    ],
)
def test_invalid_forces(changes, words):
    with pytest.raises(InputError, match=words):
        forces(0, **changes)


def test_sizes_are_root_mean_squares_over_a_polar_orbit():
    """Constant central term, and a tide that is larger with the Earth overhead."""
    sizes = acceleration_sizes(EPOCH, 100e3, forces(0))
    radius_m = MEAN_LUNAR_RADIUS_M + 100e3
    assert sizes["central"] == pytest.approx(GM("moon") / radius_m**2, rel=1e-12)
    # GM r / R^3 times a root mean square between 1 (at right angles to the Earth) and 2 (in line with it).
    ratio = sizes["earth"] * np.linalg.norm(EARTH_M) ** 3 / (GM("earth") * radius_m)
    assert 1.0 < ratio < 2.0
