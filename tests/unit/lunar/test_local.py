"""Differences along the sphere and in height: on great circles, at the poles, across 180 degrees."""

import math

import numpy as np
import pytest

from radioloc.lunar import rot_between, selenographic_to_cartesian
from radioloc.lunar.local import axes_at, displaced, local_difference, rot_enu_between

HEIGHT_M = -2550.0
RADIUS_M = 1737400.0 + HEIGHT_M


def point(longitude_deg, latitude_deg, height_m=HEIGHT_M):
    return selenographic_to_cartesian(math.radians(longitude_deg), math.radians(latitude_deg), height_m)


@pytest.mark.parametrize(
    ("point_1", "origin", "angle_deg", "azimuth_deg"),
    [
        ((10.0, 45.5, HEIGHT_M), (10.0, 43.0, HEIGHT_M), 2.5, 0.0),
        ((12.5, 0.0, HEIGHT_M), (10.0, 0.0, HEIGHT_M), 2.5, 90.0),
        ((-179.0, 0.0, HEIGHT_M), (179.0, 0.0, HEIGHT_M), 2.0, 90.0),
        ((180.0, 89.0, HEIGHT_M), (0.0, 89.0, HEIGHT_M), 2.0, 0.0),  # over the pole
        ((90.0, -89.0, HEIGHT_M), (0.0, -90.0, HEIGHT_M), 1.0, 90.0),  # at the pole itself
        ((10.0, 43.0, HEIGHT_M + 40.0), (10.0, 43.0, HEIGHT_M), 0.0, 0.0),
        ((189.9, 0.0, HEIGHT_M), (10.0, 0.0, HEIGHT_M), 179.9, 90.0),
    ],
)
def test_difference_is_the_arc_of_the_great_circle_and_the_height(point_1, origin, angle_deg, azimuth_deg):
    difference = local_difference(point(*point_1), point(*origin))
    arc_m, azimuth_rad = math.radians(angle_deg) * RADIUS_M, math.radians(azimuth_deg)
    expected_m = (arc_m * math.sin(azimuth_rad), arc_m * math.cos(azimuth_rad), point_1[2] - origin[2])
    np.testing.assert_allclose(difference.enu_m, expected_m, atol=1e-6)
    assert difference.horizontal_m == pytest.approx(arc_m, abs=1e-6)
    np.testing.assert_allclose(displaced(point(*origin), difference.enu_m), point(*point_1), atol=1e-6)


def test_difference_does_not_depend_on_the_axes_of_the_coordinates():
    one_m, origin_m = point(12.0, 44.0, 100.0), point(10.0, 43.0)
    to_pa = rot_between("ME_DE421", "PA_DE421")
    difference = local_difference(to_pa @ one_m, to_pa @ origin_m, axes_at(origin_m) @ to_pa.T)
    np.testing.assert_allclose(difference.enu_m, local_difference(one_m, origin_m).enu_m, atol=1e-6)


def test_directions_keep_their_angle_to_the_arc_across_a_pole():
    one_m, other_m = point(30.0, 89.99), point(-150.0, 89.99)
    np.testing.assert_allclose(rot_enu_between(one_m, other_m), np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    forward, back = local_difference(other_m, one_m).enu_m, local_difference(one_m, other_m).enu_m
    np.testing.assert_allclose(rot_enu_between(one_m, other_m) @ forward, -back, atol=1e-6)
