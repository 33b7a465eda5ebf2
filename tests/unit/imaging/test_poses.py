"""Images of relief by a known camera: exact tie points give the cameras back, noise gives their covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from procedural_descents import Descent
from procedural_ground import Ground

from radioloc.errors import InputError
from radioloc.imaging import Camera, Frame, FrameModel, Terrain, TiePoint, register_chain
from radioloc.imaging.adjustment import TiePoints, adjust, approximate_places
from radioloc.imaging.homography import fit_homography, transformed
from radioloc.imaging.image_chain import Measurement
from radioloc.imaging.projections import Homographies, Poses, Relief
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
    """Too coarse for images to be sought on it."""
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
    """Ground points that frames see, projected by the sensor models; half of those of the first three on the map."""
    pixels = np.concatenate([rng.uniform(0.0, SIZE, (40, 2)) for _ in frame_models()])
    owner = np.repeat(np.arange(len(frame_models())), 40)
    points = np.concatenate(
        [
            Terrain(terrain).intersect(*model.rays(pixels[owner == k]))[0]
            for k, model in enumerate(frame_models())
        ]
    )
    image, point, seen = [], [], []
    for k, model in enumerate(frame_models()):
        found = model.project(points).pixels
        inside = np.flatnonzero((np.abs(found - MIDDLE) < SIZE / 2).all(axis=1) & (np.abs(owner - k) < 2))
        image += [k] * len(inside)
        point += inside.tolist()
        seen += found[inside].tolist()
    on_map = np.flatnonzero((owner < 3) & (np.arange(len(points)) % 2 == 0))
    seen = np.array(seen)
    return TiePoints(
        image=np.array(image),
        point=np.array(point),
        pixels=seen + rng.normal(0.0, sigma_px, seen.shape),
        sigma_px=np.full(len(seen), sigma_px or 0.5),
        map_point=on_map,
        map_m=places_of(points[on_map]) + rng.normal(0.0, map_sigma_m, (len(on_map), 2)),
        map_sigma_m=np.full(len(on_map), map_sigma_m or 2.0),
    ), places_of(points)


def homographies(ties, places):
    """As if the ground were a plane."""
    fits = [
        fit_homography(places[ties.point[k]], ties.pixels[k], 30.0, 3.0)
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


def test_exact_tie_points_give_the_cameras_and_the_ground_of_each_pixel(terrain):
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    result = adjusted(terrain, ties, places)
    seen = np.bincount(np.concatenate([ties.point, ties.map_point])) > 1
    assert (result.used == seen[ties.point]).all()
    np.testing.assert_allclose(result.places_m[seen], places[seen], rtol=0, atol=1e-5)
    for k, model in enumerate(frame_models()):
        position, rotation = (one[0] for one in model.orientation.at(np.zeros(1)))
        np.testing.assert_allclose(result.model.positions_m[k], PLANE.axes() @ position, rtol=0, atol=1e-4)
        to_camera = result.model.rotations[k] @ PLANE.axes() @ rotation
        np.testing.assert_allclose(to_camera, np.eye(3), rtol=0, atol=1e-7)
        pixel = np.array([70.0, 290.0])
        ground = Terrain(terrain).intersect(*model.rays([pixel]))[0]
        np.testing.assert_allclose(result.place(k, pixel)[0], places_of(ground)[0], rtol=0, atol=1e-4)


@pytest.mark.slow
def test_ellipses_over_relief_hold_the_truth(terrain):
    """With 3 % of the tie points wrong, and sigmas stated a half too small."""
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
    """Images without detail, tied by points that are given."""
    frames = [Frame(f"{k}", lambda: np.full((SIZE, SIZE), 90, np.uint8), lambda _: CAMERA) for k in range(6)]
    degrees = PLANE.to_longitude_latitude(places)
    given = []
    for j in np.unique(ties.point):
        at = np.flatnonzero(ties.point == j)
        measured = tuple(Measurement(f"{ties.image[k]}", *ties.pixels[k], 0.5) for k in at)
        given.append(TiePoint(f"{j}", measured, *(degrees[j] if j in ties.map_point else (None, None)), 2.0))
    return register_chain(frames, base, map_sigma_m=(0.0, 0.0), ties=given, terrain=terrain)


def error_m(registration, name, pixel, terrain):
    point = registration.ground_point(name, pixel)
    truth = places_of(Terrain(terrain).intersect(*frame_models()[int(name)].rays([pixel]))[0])[0]
    return np.hypot(*(PLANE.from_longitude_latitude([[point.longitude_deg, point.latitude_deg]])[0] - truth))


@pytest.mark.study
def test_without_heights_images_are_metres_off_and_with_them_not(terrain, base, tmp_path):
    """Registered as a study does; an elevation model that ends before the images do is not used."""
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    GROUND.write_heights(tmp_path / "small.tif", 100.0, 3000.0)
    small = TerrainModel.open(tmp_path / "small.tif")
    with_relief, plane = (registered(one, base, ties, places) for one in (terrain, small))
    assert (with_relief.relief, plane.relief) == (True, False)
    for name, tolerance_m in (("0", 1e-3), ("4", 1e-2), ("5", 1.0)):  # the last shows 3.6 cells: a homography
        assert error_m(with_relief, name, MIDDLE, terrain) < tolerance_m
        assert error_m(plane, name, MIDDLE, terrain) > 2.0
    truth_m = [DESCENT.altitude_m(k) for k in range(6)]
    heights_m = [f.altitude_m for f in with_relief.frames[2:5]]
    assert heights_m == pytest.approx(truth_m[2:5], rel=0.05)  # the ground is not level
    assert np.isnan(with_relief.frames[5].altitude_m)


@pytest.mark.study
def test_what_lies_far_beyond_the_tie_points_is_refused(terrain, base):
    """An oblique image tied in its lower half: its upper part shows ground kilometres farther, or none."""
    ties, places = drawn_ties(terrain, np.random.default_rng(1))
    kept = (ties.image > 0) | (ties.pixels[:, 1] > 240.0)
    low = replace(
        ties,
        image=ties.image[kept],
        point=ties.point[kept],
        pixels=ties.pixels[kept],
        sigma_px=ties.sigma_px[kept],
    )
    result = registered(terrain, base, low, places)
    assert error_m(result, "0", [160.0, 200.0], terrain) < 1e-2
    with pytest.raises(InputError, match=r"0: .* at sample 160.0, line 60.0 is .* far beyond the ground"):
        result.ground_point("0", [160.0, 60.0])
    with pytest.raises(InputError, match=r"0: the pixel .* shows no ground of"):
        result.ground_point("0", [160.0, -2000.0])


def test_homographies_for_people_lead_where_poses_do_but_for_relief(terrain):
    """Of the lowest image, which looks straight down at ground of some 30 m of relief from 500 m."""
    ties, places = drawn_ties(terrain, np.random.default_rng(1), 0.5, 2.0)
    result = adjusted(terrain, ties, places)
    block = result.block(5)
    homography = result.model.homography(5, result.covariance[block, block])
    place, covariance = result.place(5, MIDDLE)

    def ground(parameters):
        return transformed(np.linalg.inv(np.append(parameters, 1.0).reshape(3, 3)), np.array([MIDDLE]))[0]

    parameters = homography.matrix.ravel()[:8]
    np.testing.assert_allclose(ground(parameters), place, rtol=0, atol=3.0)
    steps = np.diag(1e-6 * np.abs(parameters))
    partials = np.array(
        [(ground(parameters + s) - ground(parameters - s)) / (2.0 * s.max()) for s in steps]
    ).T
    assert partials @ homography.covariance @ partials.T == pytest.approx(covariance, rel=0.1)
