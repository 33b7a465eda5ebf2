"""Poses of images over relief with a calibrated camera: recovered from exact tie points, covariance with noise."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from image_chains import CENTRE, Chain
from image_chains import drawn_ties as drawn_plane_ties
from procedural_descents import Descent
from procedural_ground import Ground

from radioloc.errors import InputError
from radioloc.imaging import Camera, FrameModel, Terrain
from radioloc.imaging.adjustment import TiePoints, adjust, approximate_places
from radioloc.imaging.image_chain import Frame, ImageChain
from radioloc.imaging.map_features import MapFeatures
from radioloc.imaging.projections import Homographies, Poses, Relief
from radioloc.imaging.registration import adjusted_registration
from radioloc.imaging.self_calibration import self_calibration
from radioloc.imaging.tracks import MAP
from radioloc.lunar import Map, TangentPlane, TerrainModel, cartesian_to_selenographic

PLANE = TangentPlane(-51.9162, 43.0584)
SIZE = 320
CAMERA = Camera.of_pinhole(8.3, 21.44, [0.5 * (SIZE - 1)] * 2)
GROUND = Ground(PLANE, seed=5, level_m=-2550.0)
# Oblique above 3 km; from 9 km, where the Moon's curvature is 7 m over half of what is seen.
DESCENT = Descent(GROUND, CAMERA, (SIZE, SIZE), frames=6, altitudes_m=(9000.0, 500.0))
DRAWS = 40
MIDDLE = np.array([0.5 * (SIZE - 1)] * 2)


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    GROUND.write_heights(path, 100.0, 22000.0)
    return TerrainModel.open(path, interpolation="bicubic")


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """Map that is too coarse for a search."""
    path = tmp_path_factory.mktemp("map") / "map.tif"
    GROUND.write_heights(path, 1000.0, 22000.0)
    return Map.open(path)


@cache
def frame_models() -> list[FrameModel]:
    return [DESCENT.model(k) for k in range(DESCENT.frames)]


def places_of(points):
    longitude, latitude, _ = cartesian_to_selenographic(points)
    return PLANE.from_longitude_latitude(np.degrees(np.column_stack([longitude, latitude])))


def drawn_ties(terrain, rng, sigma_px=0.0, map_sigma_m=0.0):
    """Project ground points by the sensor models; the map has half of those of the first three frames."""
    pixels = np.concatenate([rng.uniform(0.0, SIZE, (40, 2)) for _ in frame_models()])
    owner = np.repeat(np.arange(len(frame_models())), 40)
    points = np.concatenate(
        [
            Terrain(terrain).intersect(*model.rays(pixels[owner == k]))[0]
            for k, model in enumerate(frame_models())
        ]
    )
    image, point, pixels = [], [], []
    for k, model in enumerate(frame_models()):
        projected = model.project(points).pixels
        rows = np.flatnonzero((np.abs(projected - MIDDLE) < SIZE / 2).all(axis=1) & (np.abs(owner - k) < 2))
        image += [k] * len(rows)
        point += rows.tolist()
        pixels += projected[rows].tolist()
    on_map = np.flatnonzero((owner < 3) & (np.arange(len(points)) % 2 == 0))
    pixels = np.array(pixels)
    return TiePoints(
        image=np.array(image),
        point=np.array(point),
        pixels=pixels + rng.normal(0.0, sigma_px, pixels.shape),
        sigma_px=np.full(len(pixels), sigma_px or 0.5),
        map_point=on_map,
        map_m=places_of(points[on_map]) + rng.normal(0.0, map_sigma_m, (len(on_map), 2)),
        map_sigma_m=np.full(len(on_map), map_sigma_m or 2.0),
    ), places_of(points)


def homographies(ties, places):
    """Fit homographies of a plane."""
    fits = [
        cv2.findHomography(places[ties.point[k]], ties.pixels[k])[0]
        for k in ties.image == np.arange(6)[:, None]
    ]
    return np.array(fits)


def adjusted(terrain, ties, places):
    matrices = homographies(ties, places)
    start = approximate_places(ties, matrices)
    relief = Relief.around(PLANE, terrain, start)
    cameras = np.repeat(CAMERA.matrix[None], 6, axis=0)
    flat = Homographies.of_matrices(matrices, np.full((6, 2), SIZE))
    model = Poses.of_homographies(relief, cameras, flat, ties.image, start[ties.point])
    return adjust(ties, replace(model, low=np.zeros(6, bool)), start)


def test_exact_tie_points_determine_cameras_and_ground(terrain):
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    result = adjusted(terrain, ties, places)
    tied = np.bincount(np.concatenate([ties.point, ties.map_point])) > 1
    assert (result.used == tied[ties.point]).all()
    np.testing.assert_allclose(result.places_m[tied], places[tied], rtol=0, atol=1e-5)
    for k, model in enumerate(frame_models()):
        position, rotation = (values[0] for values in model.orientation.poses(np.zeros(1)))
        np.testing.assert_allclose(result.model.positions_m[k], PLANE.axes() @ position, rtol=0, atol=1e-4)
        to_camera = result.model.rotations[k] @ PLANE.axes() @ rotation
        np.testing.assert_allclose(to_camera, np.eye(3), rtol=0, atol=1e-7)
        pixel = np.array([70.0, 290.0])
        ground = Terrain(terrain).intersect(*model.rays([pixel]))[0]
        np.testing.assert_allclose(result.place(k, pixel)[0], places_of(ground)[0], rtol=0, atol=1e-4)


@pytest.mark.slow
def test_ellipses_over_relief_contain_the_truth(terrain):
    """Draw 3 % wrong tie points, and state sigmas that are too small by a factor of 1.5."""
    truth = places_of(Terrain(terrain).intersect(*frame_models()[-1].rays([MIDDLE]))[0])[0]
    chi2 = []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        ties, places = drawn_ties(terrain, rng, 0.5, 2.0)
        pixels, wrong = ties.pixels.copy(), rng.random(len(ties.pixels)) < 0.03
        pixels[wrong] += rng.uniform(-60.0, 60.0, (wrong.sum(), 2))
        stated = replace(
            ties, pixels=pixels, sigma_px=ties.sigma_px / 1.5, map_sigma_m=ties.map_sigma_m / 1.5
        )
        place, covariance = adjusted(terrain, stated, places).place(5, MIDDLE)
        chi2.append((place - truth) @ np.linalg.solve(covariance, place - truth))
    assert np.mean(chi2) == pytest.approx(2.0, abs=3.0 * 2.0 / np.sqrt(DRAWS))
    assert np.mean(np.array(chi2) < 5.991) > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / DRAWS)


def registered(terrain, base, ties, places):
    """Register images without detail by tie points and approximate homographies."""
    chain = ImageChain([], MapFeatures(base, PLANE), None, None)
    matrices = homographies(ties, places)
    map_number = chain.tracks.add(MAP, 0, ties.map_m, ties.map_sigma_m)
    first = {j: map_number + k for k, j in enumerate(ties.map_point)}
    for k in range(6):
        chain.add(Frame(f"{k}", lambda: np.full((SIZE, SIZE), 90, np.uint8), lambda _: CAMERA))
        chain.images[k].to_plane = np.linalg.inv(matrices[k])
        points = ties.point[ties.image == k]
        numbers = chain.tracks.add(k, 0, ties.pixels[ties.image == k], np.full(len(points), 0.5))
        numbers += np.arange(len(points))
        chain.tracks.join(numbers, [first.setdefault(j, n) for j, n in zip(points, numbers, strict=True)])
    return adjusted_registration(chain, (0.0, 0.0), terrain)


def error_m(registration, name, pixel, terrain):
    point = registration.ground_point(name, pixel)
    truth = places_of(Terrain(terrain).intersect(*frame_models()[int(name)].rays([pixel]))[0])[0]
    return np.hypot(*(PLANE.from_longitude_latitude([[point.longitude_deg, point.latitude_deg]])[0] - truth))


@pytest.mark.study
def test_elevation_model_that_covers_the_images_removes_errors_of_metres(terrain, base, tmp_path):
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    GROUND.write_heights(tmp_path / "small.tif", 100.0, 3000.0)
    small = TerrainModel.open(tmp_path / "small.tif")
    with_relief, plane = (registered(model, base, ties, places) for model in (terrain, small))
    assert (with_relief.relief, plane.relief) == (True, False)
    for name, tolerance_m in (("0", 1e-3), ("4", 1e-2), ("5", 1.0)):
        assert error_m(with_relief, name, MIDDLE, terrain) < tolerance_m
        assert error_m(plane, name, MIDDLE, terrain) > 2.0
    truth_m = [DESCENT.altitude_m(k) for k in range(6)]
    heights_m = [f.altitude_m for f in with_relief.frames[2:5]]
    assert heights_m == pytest.approx(truth_m[2:5], rel=0.05)  # the ground is not level
    # Images of less than four cells of the elevation model have homographies without altitude.
    GROUND.write_heights(tmp_path / "coarse.tif", 200.0, 22000.0)
    coarse = registered(TerrainModel.open(tmp_path / "coarse.tif"), base, ties, places)
    assert np.isnan([f.altitude_m for f in coarse.frames]).tolist() == [False] * 4 + [True] * 2


@pytest.mark.study
def test_pixels_far_beyond_the_tie_points_are_refused(terrain, base):
    """Tie an oblique image in its lower half only; its upper part shows ground kilometres farther, or the sky."""
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    selected = (ties.image > 0) | (ties.pixels[:, 1] > 240.0)
    low = replace(
        ties,
        image=ties.image[selected],
        point=ties.point[selected],
        pixels=ties.pixels[selected],
        sigma_px=ties.sigma_px[selected],
    )
    result = registered(terrain, base, low, places)
    assert error_m(result, "0", [160.0, 200.0], terrain) < 1e-2
    with pytest.raises(InputError, match=r"0:.*160.0.*60.0"):
        result.ground_point("0", [160.0, 60.0])
    with pytest.raises(InputError, match=r"0: .* does not meet"):
        result.ground_point("0", [160.0, -2000.0])


def with_errors(ties, camera, focal_error, k1_error):
    """Return tie points of a camera with errors of focal length and k1."""
    from_axis = ties.pixels - camera[:2, 2]
    radius2 = (from_axis**2).sum(axis=1, keepdims=True) / camera[0, 0] ** 2
    return replace(ties, pixels=ties.pixels + from_axis * (focal_error + k1_error * radius2))


def calibrated(terrain, seed, prior_sigmas=(0.02, 0.05), focal_error=0.0, k1_error=0.0):
    """Return calibration and adjustment of tie points of a camera with errors of focal length and k1."""
    ties, places = drawn_ties(terrain, np.random.default_rng(seed), 0.3, 2.0)
    ties = with_errors(ties, CAMERA.matrix, focal_error, k1_error)
    result = adjusted(terrain, ties, places)
    cameras = np.repeat(CAMERA.matrix[None], 6, axis=0)
    return self_calibration(ties, result, cameras, np.array(prior_sigmas)), result


def test_focal_length_and_distortion_are_estimated_within_their_sigma(terrain):
    calibration, _ = calibrated(terrain, 3, focal_error=0.01, k1_error=0.03)
    assert calibration.is_estimated == (True, True)
    # The step is linear: right to a twentieth of the errors.
    error = np.abs(calibration.values - [0.01, 0.03])
    assert (error < 3.0 * calibration.sigmas + 0.05 * np.array([0.01, 0.03])).all()


def test_precise_calibration_is_considered_and_without_sigma_fixed(terrain):
    calibration, _ = calibrated(terrain, 4, prior_sigmas=(1e-6, 0.0))
    assert calibration.is_estimated == (False, False)
    assert calibration.sigmas == pytest.approx([1e-6, 0.0], rel=0.01)
    assert calibration.values[1] == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_relief_of_ground_taken_as_a_plane_is_not_estimated_as_distortion(terrain, seed):
    ties, places = drawn_ties(terrain, np.random.default_rng(seed), 0.3, 2.0)
    matrices = homographies(ties, places)
    plane = Homographies.of_matrices(matrices, np.full((6, 2), SIZE))
    result = adjust(ties, plane, approximate_places(ties, matrices))
    cameras = np.repeat(CAMERA.matrix[None], 6, axis=0)
    calibration = self_calibration(ties, result, cameras, np.array([0.0, 0.02]))
    assert not calibration.is_estimated[1]
    assert abs(calibration.values[1]) < 2.0 * calibration.sigmas[1]


@pytest.mark.parametrize("seed", range(4))
def test_distortion_is_estimated_on_ground_that_is_a_plane(seed):
    chain = Chain(images=10, map_below=4)
    camera = np.array([[1000.0, 0.0, CENTRE[0]], [0.0, 1000.0, CENTRE[1]], [0.0, 0.0, 1.0]])
    ties = drawn_plane_ties(chain, np.random.default_rng(seed), sigma_px=0.3, map_sigma_m=2.0)
    result = chain.adjusted(with_errors(ties, camera, 0.0, 0.02))
    calibration = self_calibration(
        with_errors(ties, camera, 0.0, 0.02),
        result,
        np.repeat(camera[None], 10, axis=0),
        np.array([0.0, 0.02]),
    )
    assert calibration.is_estimated[1]
    assert abs(calibration.values[1] - 0.02) < 3.0 * calibration.sigmas[1] + 0.1 * 0.02


def test_place_follows_the_focal_length(terrain):
    """Add the partial to the place by a wrong focal length; the true place is that of the other camera."""
    _, right = calibrated(terrain, 5)
    error, pixel = 5e-3, np.array([220.0, 90.0])
    calibration, wrong = calibrated(terrain, 5, focal_error=error)
    moved_m = calibration.place_partials(wrong, 3, pixel)[:, 0] * error
    true_m = right.place(3, MIDDLE + (pixel - MIDDLE) / (1.0 + error))[0]
    np.testing.assert_allclose(wrong.place(3, pixel)[0] + moved_m, true_m, rtol=0, atol=0.03)
    assert np.linalg.norm(moved_m) > 0.2
