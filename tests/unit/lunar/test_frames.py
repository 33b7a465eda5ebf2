import numpy as np
import pytest

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import CONSTANTS
from radioloc.lunar import cartesian_to_selenographic, rot_pa_to_me


def rotation_angles_rad(rot):
    """Angle of rotation matrices that turn by little, from their antisymmetric part."""
    x, y, z = (
        rot[..., 1, 2] - rot[..., 2, 1],
        rot[..., 2, 0] - rot[..., 0, 2],
        rot[..., 0, 1] - rot[..., 1, 0],
    )
    return np.arcsin(0.5 * np.sqrt(x**2 + y**2 + z**2))


def test_distance_between_principal_and_mean_earth_axes():
    # NAIF's moon_080317.tf says 0.0288473 degrees, 875 m along a great circle; older literature says 860 m.
    rot = rot_pa_to_me(CONSTANTS["DE421"])
    points = np.random.default_rng(1).normal(size=(20000, 3))
    points *= MEAN_LUNAR_RADIUS_M / np.linalg.norm(points, axis=1, keepdims=True)
    moved_m = np.linalg.norm(points @ rot.T - points, axis=1).max()
    assert 870.0 < moved_m < 880.0
    assert np.degrees(rotation_angles_rad(rot)) == pytest.approx(0.0288473, abs=5e-8)
    assert rotation_angles_rad(rot) * MEAN_LUNAR_RADIUS_M == pytest.approx(874.75, abs=0.01)


def test_mean_earth_axes_of_de440_are_those_of_de421():
    # The principal axes of the two differ by about a metre; so must the rotations to one and the same ME.
    ours = rot_pa_to_me(CONSTANTS["DE440"]) @ rot_pa_to_me(CONSTANTS["DE421"]).T
    assert rotation_angles_rad(ours) * MEAN_LUNAR_RADIUS_M < 1.5


# Retroreflectors: principal axes x, y, z, m, and mean-Earth latitude and longitude, degrees, both of DE430
# (Williams, Boggs and Folkner 2013, JPL IOM 335-JW,DB,WF-20130722-016, tables 6 and 7).
REFLECTORS = [
    ("Apollo 11", (1591966.550, 690699.375, 21003.866), (0.6734595, 23.4730244)),
    ("Apollo 14", (1652689.504, -520997.525, -109730.417), (-3.6441535, -17.4786937)),
    ("Apollo 15", (1554678.231, 98095.485, 765005.355), (26.1334178, 3.6284572)),
]
ROUNDING_M = 0.003  # of the published angles, 1e-7 degrees


@pytest.mark.parametrize(("name", "pa_m", "me_deg"), REFLECTORS)
def test_reflectors_of_de430(name, pa_m, me_deg):
    longitude, latitude, _ = cartesian_to_selenographic(rot_pa_to_me(CONSTANTS["DE430"]) @ pa_m)
    radius_m = np.linalg.norm(pa_m)
    assert np.radians(np.degrees(latitude) - me_deg[0]) * radius_m == pytest.approx(0.0, abs=ROUNDING_M), name
    assert np.radians(np.degrees(longitude) - me_deg[1]) * radius_m == pytest.approx(0.0, abs=ROUNDING_M), (
        name
    )
