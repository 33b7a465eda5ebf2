"""Simulated ground, maps of it and descents over it: each place is where the sensor models and the maps say."""

import numpy as np
import pytest
from procedural_descents import Descent
from procedural_ground import Ground

from radioloc.imaging import Camera, ConstantOrientation, FrameModel
from radioloc.imaging.shading import lunar_lambert, sun_direction
from radioloc.lunar import Map, TangentPlane
from radioloc.lunar.selenographic import selenographic_to_cartesian

PLANE = TangentPlane(-51.9162, 43.0584)
LEVEL_M = -2550.0
GROUND = Ground(PLANE, seed=3, level_m=LEVEL_M)
CAMERA = Camera.of_pinhole(8.3, 6.7 * 1024 / 96, [47.5, 47.5], [-0.05])
DESCENT = Descent(GROUND, CAMERA, (96, 96), frames=6)
SUN = sun_direction(100.0, 35.0)


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


@pytest.mark.study
def test_a_map_says_where_things_are_but_for_the_shift_that_is_planted(tmp_path):
    shift_m = (40.0, -25.0)
    GROUND.write_map(tmp_path / "map.tif", 10.0, 3010.0, SUN, shift_m)
    GROUND.write_heights(tmp_path / "dem.tif", 10.0, 3000.0)
    base = Map.open(tmp_path / "map.tif")
    assert base.shape == (301, 301)
    # The middle of the map is the point of contact, which it says is elsewhere.
    said = base.longitude_latitude_deg([[150.0, 150.0]])[0]
    moved = PLANE.from_longitude_latitude([said])[0]
    np.testing.assert_allclose(moved, shift_m, atol=0.02)  # the projection's curvature over 50 m
    places = np.stack(
        np.meshgrid(np.arange(-1000.0, 1001.0, 10.0), np.arange(1000.0, -1001.0, -10.0)), axis=-1
    )
    relief = GROUND._relief(places.reshape(-1, 2), 10.0)
    normal = np.column_stack([-relief[:, 1], -relief[:, 2], np.ones(len(relief))])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    bright = relief[:, 3] * lunar_lambert(normal @ SUN, normal[:, 2], np.arccos(SUN[2]))

    def likeness(east_m, north_m):
        west, north = -1000.0 + shift_m[0] + east_m, 1000.0 + shift_m[1] + north_m
        image, seen = base.view(PLANE, west, north, 10.0, (201, 201))
        assert seen.all()
        return np.corrcoef(bright, image.ravel())[0, 1]

    right = likeness(0.0, 0.0)
    assert right > 0.98  # noise of the map
    for east_m, north_m in ((10.0, 0.0), (-10.0, 0.0), (0.0, 10.0), (0.0, -10.0)):
        assert likeness(east_m, north_m) < right - 0.05
    import rasterio

    with rasterio.open(tmp_path / "dem.tif") as file:
        heights = file.read(1)
    there = PLANE.from_longitude_latitude(
        Map.open(tmp_path / "dem.tif").longitude_latitude_deg([[20.0, 250.0]])
    )
    assert heights[250, 20] == pytest.approx(GROUND.heights_at_m(there, 10.0)[0], abs=1e-3)


@pytest.mark.study
def test_one_ground_looks_the_same_from_camera_and_on_the_map(tmp_path):
    """A frame straight down, laid over the map of the same Sun."""
    pixel_m, camera = 5.0, Camera.of_pinhole(10.0, 50.0, [99.5, 99.5])
    axes = PLANE.axes()
    place = axes.T @ [0.0, 0.0, 1737400.0 + LEVEL_M + 1000.0]
    rotation = axes.T @ np.diag([1.0, -1.0, -1.0])
    bright, points = GROUND.seen_by(FrameModel(camera, ConstantOrientation(place, rotation), (200, 200)), SUN)
    GROUND.write_map(tmp_path / "map.tif", pixel_m, 3000.0, SUN, noise=0.0)
    base = Map.open(tmp_path / "map.tif")
    image, _ = base.view(PLANE, -1490.0, 1490.0, pixel_m, (597, 597))
    sample = np.rint((points[..., 0] + 1490.0) / pixel_m).astype(int)
    line = np.rint((1490.0 - points[..., 1]) / pixel_m).astype(int)
    there = image[line, sample]
    assert np.corrcoef(bright.ravel(), there.ravel())[0, 1] > 0.9  # the phase angle differs over the frame
    turned = image[::-1][line, sample]
    assert abs(np.corrcoef(bright.ravel(), turned.ravel())[0, 1]) < 0.4
