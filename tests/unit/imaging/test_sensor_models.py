"""Rays, ground and image of frame and line-scan cameras: geometry by hand, partials."""

from dataclasses import replace

import numpy as np
import pytest
from paths import ISDS
from plane_surface import Plane

from radioloc.errors import InputError
from radioloc.imaging import (
    Camera,
    ConstantOrientation,
    FrameModel,
    Sphere,
    read_isd,
)
from radioloc.imaging.ground_points import image_to_ground, image_to_ground_and_partials
from radioloc.imaging.orientation import (
    matrices_from_quaternions,
    quaternions_from_matrices,
    rotation_matrices,
)

PARTIALS_RELATIVE = 1e-5  # of central differences of a pixel, 10 m or 10 microradians
KINKS_RELATIVE = 1e-3  # along lines: the rate of an interpolated attitude jumps at nodes

R_M = 1737400.0


def frame():
    """Return a camera 10 km above the Moon, tilted by 30 degrees, with Brown's distortion."""
    camera = Camera.of_pinhole(8.3, 6.7, [511.5, 500.0], [-0.1, 0.02, 1e-3, -5e-4])
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    rotation = down @ rotation_matrices(np.radians([[30.0, 5.0, 20.0]]))[0]
    return FrameModel(camera, ConstantOrientation([R_M + 1e4, 0.0, 0.0], rotation), (1024, 1024))


MODELS = {
    "frame": frame,
    "lro": lambda: read_isd(ISDS / "lro_nac.json.gz").model,
    "kaguya": lambda: read_isd(ISDS / "kaguya_tc.json.gz").model,
    "polar": lambda: read_isd(ISDS / "lro_nac_polar.json.gz").model,
}
SURFACES = {
    "sphere": lambda point: Sphere(R_M + 500.0),
    "plane": lambda point: Plane(point, point / np.linalg.norm(point) + [0.1, -0.2, 0.05]),
}


def moved(model, shift_m):
    orientation = model.orientation
    name = "position_m" if isinstance(model, FrameModel) else "positions_m"
    return replace(model, orientation=replace(orientation, **{name: getattr(orientation, name) + shift_m}))


def turned(model, angles_rad):
    x, y, z = angles_rad
    turn = np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.linalg.svd(turn)[0] @ np.linalg.svd(turn)[2]
    orientation = model.orientation
    if isinstance(model, FrameModel):
        return replace(
            model, orientation=replace(orientation, rot_camera_to_moon=orientation.rot_camera_to_moon @ turn)
        )
    turned_table = quaternions_from_matrices(matrices_from_quaternions(orientation.quaternions) @ turn)
    return replace(model, orientation=replace(orientation, quaternions=turned_table))


def pixels_of(model, n=40):
    lines, samples = model.shape
    return np.random.default_rng(7).uniform([10.0, 10.0], [samples - 10.0, lines - 10.0], size=(n, 2))


def assert_close(values, expected, relative=PARTIALS_RELATIVE):
    assert np.abs(values - expected).max() < relative * np.abs(expected).max()


@pytest.mark.parametrize("surface_name", SURFACES)
@pytest.mark.parametrize("model_name", MODELS)
def test_partials_of_ground_points(model_name, surface_name):
    model, pixels = MODELS[model_name](), pixels_of(MODELS[model_name]())
    surface = SURFACES[surface_name](image_to_ground(model, pixels[:1], Sphere())[0])
    ground = image_to_ground_and_partials(model, pixels, surface)
    for k in range(2):
        step = 0.5 * np.eye(2)[k]
        assert_close(
            ground.by_pixel[:, :, k],
            image_to_ground(model, pixels + step, surface) - image_to_ground(model, pixels - step, surface),
            (PARTIALS_RELATIVE if model_name == "frame" else KINKS_RELATIVE),
        )
    for k in range(3):
        for partials, change, step in ((ground.by_position, moved, 10.0), (ground.by_angles, turned, 1e-5)):
            two = [
                image_to_ground(change(model, sign * step * np.eye(3)[k]), pixels, surface)
                for sign in (1, -1)
            ]
            assert_close(partials[:, :, k], (two[0] - two[1]) / (2 * step))
    if isinstance(surface, Sphere):
        two = [image_to_ground(model, pixels, Sphere(surface.radius_m + h)) for h in (10.0, -10.0)]
    else:
        two = [
            image_to_ground(model, pixels, replace(surface, point_m=surface.point_m + h * surface.normal))
            for h in (10.0, -10.0)
        ]
    assert_close(ground.by_height, (two[0] - two[1]) / 20.0)


def test_frame_by_hand():
    """A pixel is 10 m at 1 km with a focal length of 100 pixels."""
    camera = Camera.of_pinhole(1.0, 10.0, [50.0, 40.0])
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    model = FrameModel(camera, ConstantOrientation([R_M + 1000.0, 0.0, 0.0], down), (100, 100))
    plane = Plane([R_M, 0.0, 0.0], [2.0, 0.0, 0.0])
    ground = image_to_ground_and_partials(model, [[50.0, 40.0], [60.0, 30.0]], plane)
    assert ground.points_m == pytest.approx(np.array([[R_M, 0.0, 0.0], [R_M, 100.0, 100.0]]), abs=1e-6)
    assert ground.by_pixel[0] == pytest.approx(np.array([[0.0, 0.0], [10.0, 0.0], [0.0, -10.0]]), abs=1e-9)
    assert ground.by_height[1] == pytest.approx([1.0, -0.1, -0.1])  # higher ground is closer to the axis


def test_points_behind_the_camera_are_not_visible():
    model = frame()
    points = np.array([[R_M, 0.0, 0.0], [R_M + 3e4, 0.0, 0.0], [-R_M, 0.0, 0.0]])
    # The Moon does not hide points in a projection.
    assert model.project(points).visible.tolist()[1:] == [False, True]
    level = replace(model, orientation=ConstantOrientation([R_M + 1e4, 0.0, 0.0], np.eye(3)))
    with pytest.raises(InputError, match="does not meet"):
        image_to_ground(level, [[511.0, 500.0]], Sphere())


def test_points_that_do_not_pass_the_detector_are_not_visible():
    model = MODELS["lro"]()
    ahead = image_to_ground(model, [[100.0, 0.0], [100.0, 399.0]], Sphere())
    beyond = ahead[0] + 40.0 * (ahead[0] - ahead[1])  # 40 images before the first line
    projected = model.project(np.vstack([ahead, beyond]))
    assert projected.visible.tolist() == [True, True, False]
    assert np.isfinite(projected.pixels[:2]).all()


def test_lines_of_two_rates():
    """Two rates: lines from 100 on last twice as long."""
    model = MODELS["lro"]()
    first = model.line_times[0]
    two = replace(
        model, line_times=[first, [99.5, first[1] + 100 * first[2], 2 * first[2]]], shape=(250, 5064)
    )
    lines = np.array([0.0, 99.0, 100.0, 200.0])
    times, _ = two.times_s(lines)
    assert np.diff(times) / first[2] == pytest.approx([99.0, 1.5, 200.0])
    assert two.lines_at(times)[0] == pytest.approx(lines, abs=1e-9)
    pixels = np.array([[10.0, 50.0], [3000.0, 180.0]])
    assert two.project(image_to_ground(two, pixels, Sphere())).pixels == pytest.approx(pixels, abs=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(-1.0), "radius_m: expected a positive"),
        (lambda: image_to_ground(frame(), [[np.nan, 0.0]], Sphere()), "pixels: expected finite numbers"),
        (lambda: replace(MODELS["lro"](), line_times=[[0.0, 0.0, 0.0]]), "line_times"),
    ],
)
def test_invalid_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_rays_from_inside_a_sphere_meet_it():
    sphere = Sphere(10.0)
    points, hits = sphere.intersect(np.array([[5.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 0.0, 0.0]]),
                                    np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))  # fmt: skip
    assert hits.tolist() == [True, True, False]
    assert points[:2, 0].tolist() == [10.0, 10.0]
