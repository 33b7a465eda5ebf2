"""Simulated ground, maps of it and descents over it: each place is where the sensor models and the maps say."""

import json

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.imaging import Camera, ConstantOrientation, FrameModel, read_frame
from radioloc.imaging.shading import lunar_lambert, sun_direction
from radioloc.lunar import Map, TangentPlane
from radioloc.lunar.selenographic import selenographic_to_cartesian
from radioloc.simulation.descents import Descent
from radioloc.simulation.ground import Ground

PLANE = TangentPlane(-51.9162, 43.0584)
LEVEL_M = -2550.0
GROUND = Ground(PLANE, seed=3, heights_m=np.full((2, 2), LEVEL_M))
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


def test_slopes_are_the_derivatives_of_heights():
    rng = np.random.default_rng(1)
    base = Ground(
        PLANE, seed=8, heights_m=rng.normal(0.0, 30.0, (12, 9)), corner_m=(-400.0, 500.0), pixel_m=100.0
    )
    places = rng.uniform(-350.0, 350.0, (300, 2))
    step = 1e-5
    relief = base._relief(places, 2.0)
    for axis in (0, 1):
        move = step * np.eye(2)[axis]
        ends = [base.heights_at_m(places + sign * move, 2.0) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        # A few places lie within a step of a crater's rim, where the slope jumps.
        assert np.quantile(np.abs(slope - relief[:, 1 + axis]), 0.97) < 1e-5


def test_given_heights_are_met_at_their_places():
    heights = np.random.default_rng(2).normal(0.0, 500.0, (5, 4))
    coarse = Ground(PLANE, heights_m=heights, corner_m=(-3000.0, 4000.0), pixel_m=2000.0, largest_m=1e-3)
    east, north = np.meshgrid(-3000.0 + 2000.0 * np.arange(4), 4000.0 - 2000.0 * np.arange(5))
    found = coarse.heights_at_m(np.stack([east.ravel(), north.ravel()], axis=1), 100.0)
    np.testing.assert_allclose(found, heights.ravel(), atol=1e-9)


def test_slopes_are_alike_on_all_scales():
    """Gradient noise and craters of each octave alone: rms slopes of 2 to 12 degrees, none twice another."""
    rng = np.random.default_rng(3)
    places = rng.uniform(-2e4, 2e4, (20000, 2))
    slopes = []
    for largest in (4000.0, 250.0, 16.0):
        relief = Ground(PLANE, seed=4, largest_m=largest)._relief(places, largest / 5.0)
        slopes.append(np.degrees(np.sqrt((relief[:, 1:3] ** 2).sum(axis=1).mean())))
    assert 2.0 < min(slopes) <= max(slopes) < min(2.0 * min(slopes), 12.0)


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


def test_a_descent_is_written_with_its_truth(tmp_path):
    written = list(DESCENT.write(tmp_path))
    assert [path.name for path in written] == [
        *(f"{k + 1:04d}.png" for k in range(6)),
        "mask.png",
        "truth.json",
    ]
    truth = json.loads((tmp_path / "truth.json").read_text())
    altitudes = [frame["altitude_m"] for frame in truth["frames"]]
    assert altitudes[0] == 9000.0
    assert altitudes[-1] == pytest.approx(4.0)
    assert np.ptp(np.diff(np.log(altitudes))) < 1e-9
    # The lander is in the middle of the last frame, which is 0.5 m wide per 10 pixels there.
    lander = truth["lander"]
    point = selenographic_to_cartesian(
        np.radians(lander["longitude_deg"]), np.radians(lander["latitude_deg"]), lander["height_m"]
    )
    np.testing.assert_allclose(DESCENT.model(5).project(point[None]).pixels, [[47.5, 47.5]], atol=0.2)
    assert read_frame(written[0]).shape == (96, 96)
    again = Descent(GROUND, CAMERA, (96, 96), frames=6).frame(2)[0]
    np.testing.assert_array_equal(again, DESCENT.frame(2)[0])
    assert (again != Descent(GROUND, CAMERA, (96, 96), frames=6, seed=1).frame(2)[0]).mean() > 0.5


def test_the_camera_looks_ahead_above_three_kilometres_and_down_below():
    for k, expected_deg in ((0, 30.0), (3, 0.0), (5, 0.0)):
        pose = DESCENT.model(k).orientation
        down = -pose.position_m / np.linalg.norm(pose.position_m)
        tilt = np.degrees(np.arccos(pose.rot_camera_to_moon[:, 2] @ down))
        assert tilt == pytest.approx(expected_deg, abs=2.5)  # attitudes waver by half a degree


def test_what_cannot_be_simulated_is_refused():
    with pytest.raises(InputError, match="two frames or more"):
        Descent(GROUND, CAMERA, (96, 96), frames=1)
    with pytest.raises(InputError, match="heights_m"):
        Ground(PLANE, heights_m=[[0.0, np.nan], [0.0, 0.0]])
    with pytest.raises(InputError, match="pixels look past the ground"):
        Descent(GROUND, CAMERA, (96, 96), tilt_deg=80.0).frame(0)


def test_ground_that_lies_lower_than_its_grid_is_seen_from_close_by():
    """The site of this relief is 143 m below the heights that are given: a camera above it stands below those."""
    hollow = Ground(PLANE, seed=1, heights_m=np.full((2, 2), -2985.0))
    camera = Camera.of_pinhole(8.3, 6.7 * 1024 / 8, [3.5, 3.5])
    low = Descent(hollow, camera, (8, 8), frames=2, altitudes_m=(100.0, 4.0), spacecraft=False)
    _, points = low.frame(1)
    np.testing.assert_allclose(
        points[..., 2], hollow.heights_at_m(np.zeros((1, 2)), 0.5)[0], rtol=0, atol=2.0
    )


def test_a_ray_along_a_rough_slope_meets_the_ground():
    """Newton's steps alone lead one of these rays from one side of a rim to the other again and again."""
    rough = Ground(PLANE, seed=68, heights_m=np.full((2, 2), -1938.7062597632605))
    camera = Camera.of_pinhole(8.3, 6.7 * 4, [127.5, 127.5], [-0.05])
    high = Descent(
        rough,
        camera,
        (256, 256),
        frames=12,
        altitudes_m=(6000.0, 4.0),
        heading_deg=130.6652370128568,
        seed=68,
    )
    lines, samples = np.mgrid[:256, :256]
    _, points = high.frame(0)
    found = high.model(0).project(on_the_moon(points.reshape(-1, 3)))
    expected = np.stack([samples.ravel(), lines.ravel()], axis=1)
    np.testing.assert_allclose(found.pixels, expected, atol=0.08)
