"""Simulated ground, maps of it and descents over it: each place is where the sensor models and the maps say."""

import numpy as np
import pytest
from procedural_descents import Descent
from procedural_ground import Ground

from radioloc.imaging import Camera
from radioloc.lunar import TangentPlane
from radioloc.lunar.selenographic import selenographic_to_cartesian

PLANE = TangentPlane(-51.9162, 43.0584)
LEVEL_M = -2550.0
GROUND = Ground(PLANE, seed=3, level_m=LEVEL_M)
CAMERA = Camera.of_pinhole(8.3, 6.7 * 1024 / 96, [47.5, 47.5], [-0.05])
DESCENT = Descent(GROUND, CAMERA, (96, 96), frames=6)


def on_the_moon(points):
    """Mean-Earth coordinates of places in the plane with their heights."""
    lon_lat = np.radians(PLANE.to_longitude_latitude(points[:, :2]))
    return selenographic_to_cartesian(lon_lat[:, 0], lon_lat[:, 1], points[:, 2])


@pytest.mark.parametrize("k", [0, 1, 3, 5])
def test_pixels_show_the_ground_that_the_sensor_model_projects_there(k):
    """Distortion, oblique view and the Moon's curvature included: rays are settled to a twentieth of a pixel."""
    _, points = DESCENT.frame(k)
    found = DESCENT.model(k).project(on_the_moon(points.reshape(-1, 3)))
    lines, samples = np.mgrid[:96, :96]
    expected = np.stack([samples.ravel(), lines.ravel()], axis=1)
    assert found.seen.all()
    np.testing.assert_allclose(found.pixels, expected, atol=0.08)
    flat = points.reshape(-1, 3)
    distance = DESCENT.altitude_m(k) * 6.7 * 1024 / 96 * 1e-3 / 8.3
    same = GROUND.heights_at_m(flat[:, :2], distance)
    # Heights of the very point, but for detail near the pixel's size, which fades with distance in an oblique view.
    assert np.median(np.abs(same - flat[:, 2])) < 0.3 * distance
