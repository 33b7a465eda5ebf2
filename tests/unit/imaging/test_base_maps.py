"""Base maps from orbital images: adjustment against drawn errors, mosaic, ground points, one image, the command."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rasterio
from orbital_strips import Strips
from rasterio.transform import Affine
from terrain_maps import write_raster

from radioloc.cli import main
from radioloc.imaging import Sphere, Terrain, make_base_map, read_image_study, read_isd, write_orthophoto
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.mosaic import write_mosaic
from radioloc.imaging.strip_adjustment import GroundTies, adjust_strips, agreement_m, corrected_model
from radioloc.lunar import TerrainModel
from radioloc.lunar.local import axes_at

GROUND = Sphere(1737400.0 - 2550.0)
STRIPS = Strips(2, 2, (600, 400), 5.0)
NOISE_PX = 0.3
DEM_SIGMA_M = 1e-3


def ties_of(models, rng, wrong=0):
    """Return tie points at drawn places of the ground with noise of pixels, some of them wrong."""
    corners = np.concatenate([image_to_ground(m, [[0.0, 0.0], [399.0, 599.0]], GROUND) for m in models])
    points = rng.uniform(corners.min(axis=0), corners.max(axis=0), (600, 3))
    points *= GROUND.radius_m / np.linalg.norm(points, axis=1)[:, None]
    parts = []
    for k, model in enumerate(models):
        pixels, visible = model.project(points)
        shown = np.flatnonzero(visible & ((pixels > 0.0) & (pixels < [399.0, 599.0])).all(axis=1))
        parts.append((np.full(len(shown), k), shown, pixels[shown]))
    image, point, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
    several = np.bincount(point, minlength=len(points))[point] > 1
    image, pixels = image[several], pixels[several]
    _, point = np.unique(point[several], return_inverse=True)
    pixels = pixels + rng.normal(0.0, NOISE_PX, pixels.shape)
    pixels[:wrong] += 20.0
    count = point.max() + 1
    unknown = np.full((count, 3), np.nan), np.full(count, np.inf)
    return GroundTies(image, point, pixels, np.full(len(image), 0.5), *unknown)


def adjusted(seed, wrong=0, control_points=0):
    """Return true models, the adjustment of erroneous ones, the tie points and the drawn errors."""
    strips = replace(STRIPS, seed=seed)
    errors = strips.drawn_errors()
    truth = [strips.model(k) for k in range(4)]
    ties = ties_of(truth, np.random.default_rng(seed), wrong)
    if control_points:
        places, sigmas = ties.places_m.copy(), ties.place_sigma_m.copy()
        for point in range(control_points):
            row = np.flatnonzero(ties.point == point)[0]
            places[point] = image_to_ground(truth[ties.image[row]], ties.pixels[row][None], GROUND)[0]
            sigmas[point] = 2.0
        ties = replace(ties, places_m=places, place_sigma_m=sigmas)
    models = [corrected_model(model, error) for model, error in zip(truth, errors, strict=True)]
    return truth, adjust_strips(models, ties, GROUND, strips.sigmas, DEM_SIGMA_M), ties, errors


def test_errors_of_adjusted_images_have_their_covariance():
    squares = []
    for seed in range(4):
        _, result, _, errors = adjusted(seed)
        error = (result.corrections + errors).ravel()
        squares.append(error @ np.linalg.solve(result.covariance, error) / error.size)
        assert result.sigma_factor == pytest.approx(NOISE_PX / 0.5, rel=0.1)
    # Four sigmas of the mean of four normalized squares of 48 parameters.
    assert np.mean(squares) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (4 * 48)))


def test_neighbours_agree_and_wrong_tie_points_are_rejected():
    _, result, ties, _ = adjusted(1, wrong=5)
    assert not result.used[ties.point[:5]].any()
    assert result.used.mean() > 0.97
    for east_m, north_m, count in agreement_m(ties, result).values():
        assert np.hypot(east_m, north_m) < 4.0 * NOISE_PX * STRIPS.pixel_m / np.sqrt(count)


def test_ground_points_tie_the_map():
    middle = np.array([[199.5, 299.5]])
    for control_points, limit_m in ((0, 300.0), (6, 8.0)):
        truth, result, _, _ = adjusted(2, control_points=control_points)
        error_m = [
            np.linalg.norm(image_to_ground(a, middle, GROUND) - image_to_ground(b, middle, GROUND))
            for a, b in zip(truth, result.models, strict=True)
        ]
        assert max(error_m) < limit_m
        if not control_points:
            assert max(error_m) > 20.0


def grey(path, west, north, values):
    """Write an orthophoto of cells of 2 m."""
    transform = Affine(2.0, 0.0, west, 0.0, -2.0, north)
    return write_raster(path, values, crs="+proj=eqc +R=1737400 +units=m", transform=transform, nodata=0)


def test_mosaic_balances_brightness_and_shows_all_cells(tmp_path):
    rng = np.random.default_rng(5)
    line, sample = np.mgrid[:200, :300]
    scene = 120.0 + 30.0 * np.sin(sample / 17.0) * np.cos(line / 23.0) + rng.normal(0.0, 1.0, (200, 300))
    west = np.rint(scene[:, :180] * 0.8).astype(np.uint8)
    east = np.rint(scene[:, 120:] * (1.2 + 0.1 * sample[:, 120:] / 300.0)).astype(np.uint8)
    files = [grey(tmp_path / "a.tif", 0.0, 400.0, west), grey(tmp_path / "b.tif", 240.0, 400.0, east)]
    assert abs(write_mosaic(tmp_path / "mosaic.tif", files)[0, 1]) < 0.005
    with rasterio.open(tmp_path / "mosaic.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert (file.read_masks(1) > 0).all()
        ratio = file.read(1) / scene
    columns = ratio.mean(axis=0)
    # Without balance the step is 40 %.
    assert np.abs(np.diff(columns)).max() < 0.02
    assert np.ptp(columns) / columns.mean() < 0.15


def test_one_image_is_its_orthophoto(tmp_path):
    Strips(1, 1, (60, 80), 10.0).write(tmp_path)
    result = make_base_map(tmp_path / "strips.toml", tmp_path / "out")
    assert not result.adjustment.corrections.any()
    chosen = read_image_study(tmp_path / "strips.toml").chosen
    image = cv2.imread(str(tmp_path / "strip00.png"), cv2.IMREAD_UNCHANGED)
    options = {"projection": chosen.projection, "resolution_m": 10.0}
    model = read_isd(tmp_path / "strip00.json").model
    write_orthophoto(tmp_path / "alone.tif", [(image, model)], TerrainModel.open(chosen.dem), **options)
    with (
        rasterio.open(tmp_path / "alone.tif") as expected,
        rasterio.open(tmp_path / "out/orthophotos/strip00.tif") as file,
        rasterio.open(tmp_path / "out/mosaic.tif") as mosaic,
    ):
        assert (file.read(1) == expected.read(1)).all()
        shown = expected.read_masks(1) > 0
        assert (mosaic.read(1)[shown] == expected.read(1)[shown]).all()
    # Without tie points, the a-priori errors of position and attitude.
    assert result.map_sigma_m == pytest.approx([100.5, 100.5], rel=0.02)


@pytest.mark.slow
def test_twelve_strips_become_a_seamless_map(tmp_path):
    """Offsets of 100 m with drifts: neighbours within a pixel, errors within three sigmas, no steps."""
    strips = Strips(4, 3, (400, 320), 5.0)
    truth = strips.write(tmp_path)
    assert main(["base-map", str(tmp_path / "strips.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    content = json.loads((tmp_path / "out/base_map.json").read_text())
    assert len(content["pairs"]) >= 17
    for pair in content["pairs"]:
        if pair["tie_points"] >= 10:
            assert np.hypot(pair["east_m"], pair["north_m"]) < strips.pixel_m
        # The eye sees steps from 2 % (Weber fraction of brightness).
        assert abs(pair["seam_step"] or 0.0) < 0.02
    assert np.sqrt(np.mean([(pair["seam_step"] or 0.0) ** 2 for pair in content["pairs"]])) < 0.005
    terrain = Terrain(TerrainModel.open(tmp_path / "dem.tif"))
    middle = np.array([[159.5, 199.5]])
    for k, (model, image) in enumerate(zip(truth, content["images"], strict=True)):
        corrections = np.array(list(image["corrections"].values()))
        final = corrected_model(read_isd(tmp_path / f"strip{k:02d}.json").model, corrections)
        expected = image_to_ground(model, middle, terrain)
        error_m = (image_to_ground(final, middle, terrain) - expected) @ axes_at(expected[0]).T
        assert (np.abs(error_m[0, :2]) < 3.0 * np.array(image["ground_sigma_m"])).all()
