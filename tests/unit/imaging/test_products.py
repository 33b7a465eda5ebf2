"""Products of descent images as GDAL opens them: maps, layers, tables; views of registered images."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
import rasterio.warp
from image_descents import PIXEL_M, SITE, Descent, scene
from terrain_maps import LONGLAT

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging.image_chain import Frame
from radioloc.imaging.mosaic import balanced
from radioloc.imaging.products import FILES, pose_table, product_files
from radioloc.imaging.registration import register_chain
from radioloc.imaging.solution import ImageSolution
from radioloc.lunar import LunarPosition, Map, TangentPlane
from radioloc.lunar.map_grid import MapGrid
from radioloc.report.files import write_content

pytestmark = pytest.mark.study

FRAMES = (0, 2, 4, 7)
DESCENT = Descent()


@pytest.fixture(scope="module")
def solution(tmp_path_factory):
    """Solution of four images on a map of 4 m a pixel, without a camera."""
    folder = tmp_path_factory.mktemp("descent")
    base = Map.open(DESCENT.write_map(folder / "map.tif"))
    paths = {}
    for k in FRAMES:
        paths[f"{k}.png"] = folder / f"{k}.png"
        cv2.imwrite(str(paths[f"{k}.png"]), DESCENT.image(k))
    frames = [Frame(f"{k}.png", lambda k=k: DESCENT.image(k)) for k in FRAMES]
    registration = register_chain(frames, base, map_sigma_m=(5.0, 5.0))
    point = registration.ground_point("7.png")
    position = LunarPosition.from_selenographic(point.longitude_deg, point.latitude_deg, 0.0, "ME_DE421")
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = point.covariance_m2
    return ImageSolution(
        "site", "", position, covariance, "map.tif", (5.0, 5.0), registration, base, paths=paths
    )


@pytest.fixture(scope="module")
def folder(solution, tmp_path_factory):
    folder = tmp_path_factory.mktemp("products")
    for name, content in product_files(solution).items():
        write_content(folder / name, content)
    return folder


def test_maps_open_with_their_reference_system_overviews_and_masks(folder):
    assert {pattern.split("/")[0] for pattern in FILES} == {path.name for path in folder.iterdir()}
    names = ["mosaic.tif", *(f"rectified/{n:03d}_{k}.tif" for n, k in enumerate(FRAMES, 1))]
    for name in names:
        with rasterio.open(folder / name) as file:
            assert file.crs.to_authority() == ("IAU_2015", "30110")
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert bool(file.overviews(1)) == (max(file.shape) > 512)
            assert file.dtypes == ("uint8",)
            assert 0.2 < file.dataset_mask().astype(bool).mean() <= 1.0


@pytest.mark.parametrize("name", ["mosaic.tif", "rectified/001_0.tif", "rectified/004_7.tif"])
def test_ground_is_at_its_place_in_the_maps(folder, name):
    """Draw the true ground in the middle of a map by GDAL's georeference, and correlate."""
    with rasterio.open(folder / name) as file:
        middle, half = np.array(file.shape) // 2, 100
        first, last = np.maximum(middle - half, 0), middle + half
        window = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        values = file.read(1)[window]
        rows, columns = np.mgrid[window]
        x, y = file.transform @ (columns.ravel() + 0.5, rows.ravel() + 0.5)
        degrees = np.transpose(rasterio.warp.transform(file.crs, LONGLAT, x, y))
        cell_m = file.res[0]
    ground_px = TangentPlane(*SITE).from_longitude_latitude(degrees) / [PIXEL_M, -PIXEL_M] + 999.5
    smooth = cv2.GaussianBlur(scene(), (0, 0), max(0.5, 0.4 * cell_m / PIXEL_M))
    truth = cv2.remap(
        smooth, *ground_px.astype(np.float32).reshape(*values.shape, 2).transpose(2, 0, 1), cv2.INTER_LINEAR
    )
    window = cv2.createHanningWindow(values.shape[::-1], cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(truth.astype(np.float32), values.astype(np.float32), window)
    assert response > 0.3
    assert np.abs(shift).max() < 0.3  # cells


def test_mosaic_has_the_brightness_of_the_map_and_finer_images_over_it(solution, folder):
    with rasterio.open(folder / "mosaic.tif") as file:
        mosaic, shown = file.read(1), file.dataset_mask() > 0
        cells = MapGrid.of_map(file.crs, file.transform, *file.shape, MEAN_LUNAR_RADIUS_M)
    values, on_map = solution.base.on_grid(cells)
    assert shown[on_map].all()
    assert 0.02 < np.mean(mosaic[on_map] != values[on_map]) < 0.36  # by images of less than 4 m a pixel
    coarse = cv2.blur(np.float32([mosaic, values]).transpose(1, 2, 0), (25, 25))[on_map]
    assert np.percentile(np.abs(np.diff(coarse)), 99.0) < 8.0


def test_mosaic_ends_at_the_edges_of_the_map(solution, tmp_path):
    """Cut the map through the middle of all images; they show ground on both sides."""
    with rasterio.open(solution.base.path) as file:
        half = file.width // 2
        values, profile = file.read(1)[:, half:], {**file.profile, "width": file.width - half}
        profile["transform"] = file.transform @ rasterio.Affine.translation(half, 0)
    with rasterio.open(tmp_path / "half.tif", "w", **profile) as file:
        file.write(values, 1)
    product_files(replace(solution, base=Map.open(tmp_path / "half.tif")))["mosaic.tif"](
        tmp_path / "mosaic.tif"
    )
    with rasterio.open(tmp_path / "mosaic.tif") as file:
        row = file.read(1)[file.height // 2]
        x, _ = file.transform @ (np.arange(2), np.zeros(2))
        [edge_deg], _ = rasterio.warp.transform(file.crs, LONGLAT, x[:1], [file.bounds.top])
        assert file.dataset_mask().all()
    [[edge_m, _]] = TangentPlane(*SITE).from_longitude_latitude([[edge_deg, SITE[1]]])
    assert abs(edge_m) < 2.0 * solution.base.resolution_m
    assert row.min() < row.max()


def test_balanced_image_has_the_brightness_of_the_canvas():
    canvas = np.random.default_rng(1).integers(40, 100, (80, 120)).astype(np.uint8)
    slope = np.exp(np.add.outer(np.linspace(-0.3, 0.3, 80), np.linspace(0.5, 0.0, 120)))
    values = np.rint(canvas * slope).astype(np.uint8)
    common = np.arange(120) < np.full((80, 1), 60)
    result = balanced(values, canvas, common)
    assert np.abs(result.astype(int) - canvas).max() <= 4  # ten cells hold slopes to zero
    assert (balanced(values, canvas, np.zeros_like(common)) == values).all()


def test_layers_and_tables_hold_tie_points_outlines_and_the_ellipse(solution, folder):
    layers = dict(pyogrio.list_layers(folder / "images.gpkg").tolist())
    assert layers == {
        "tie_points": "Point", "outlines": "Polygon", "positions": "Point", "ellipses": "Polygon"
    }  # fmt: skip
    for name in layers:
        info = pyogrio.read_info(folder / "images.gpkg", layer=name)
        assert 'AUTHORITY["IAU","30100"]' in info["crs"]
    with (folder / "tie_points.csv").open() as file:
        rows = list(csv.DictReader(file))
    used = [row for row in rows if row["used"] == "1"]
    info = pyogrio.read_info(folder / "images.gpkg", layer="tie_points")
    assert info["features"] == len({row["point"] for row in used})
    by_image = {frame.name: frame.inliers for frame in solution.registered}
    for name, count in by_image.items():
        assert sum(row["observed_in"] == name for row in used) == count
    residuals = np.array(
        [[float(row[f"residual_{axis}_px"]) for axis in ("sample", "line")] for row in used if row["sample"]]
    )
    rms = [frame.rms_px for frame in solution.registered]
    assert min(rms) < np.sqrt(np.mean(residuals**2)) < max(rms)
    # A tie point is in the truth at its place on the map.
    places = np.array([[float(row[f"{axis}_deg"]) for axis in ("longitude", "latitude")] for row in used])
    k = int(np.argmax([row["observed_in"] == "0.png" for row in used]))
    pixel = [float(used[k]["sample"]), float(used[k]["line"])]
    assert np.abs(places[k] - DESCENT.truth_deg(0, pixel)).max() < 2e-4  # 6 m, a pixel of the image


def test_without_a_camera_no_pose_is_claimed(solution):
    assert solution.registration.sensor_model("0.png") is None
    assert solution.registration.pose_covariance("0.png") is None
    assert not pose_table(solution)["file"]


def test_view_and_ground_are_inverse_and_bounded(solution):
    view = solution.registration.view("0.png")
    pixels = np.array([[10.0, 20.0], [250.0, 200.0], [480.0, 390.0]])
    angles, hits = view.ground(pixels)
    back, visible = view.pixels(angles, 1.0)
    assert hits.all()
    assert visible.all()
    assert np.abs(back - pixels).max() < 1e-6
    [far_away] = view.pixels(angles[:1] + 0.01, 1.0)[1]
    assert not far_away
