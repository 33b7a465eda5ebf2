"""Orthophotos read by GDAL: places of spots, relief, masks, data types, errors of input."""

import numpy as np
import pytest
import rasterio
import rasterio.warp
import terrain_maps
from paths import ISDS
from rasterio.transform import Affine

from radioloc.imaging import (
    Camera,
    ConstantOrientation,
    FrameModel,
    Terrain,
    read_isd,
    write_orthophoto,
)
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.orientation import rotation_matrices
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, east_north_up, selenographic_to_cartesian

R_M = 1737400.0
PLACE_CELLS = 0.1  # error of the centroid of a resampled spot of 4 pixels
CONTRAST = 200.0


def hilly(path, longitude_deg, latitude_deg, proj4):
    """Write hills of 200 m in cells of 10 m around a place."""
    size, cell_m = 400, 10.0
    steps_m = (np.arange(size) - (size - 1) / 2) * cell_m
    x, y = np.meshgrid(steps_m, -steps_m)
    heights = 200.0 * np.cos(x / 300.0) * np.cos(y / 250.0) - 1000.0
    crs = rasterio.crs.CRS.from_string(proj4)
    [east], [north] = rasterio.warp.transform(terrain_maps.LONGLAT, crs, [longitude_deg], [latitude_deg])
    affine = Affine(cell_m, 0.0, east - size * cell_m / 2, 0.0, -cell_m, north + size * cell_m / 2)
    return TerrainModel.open(terrain_maps.write(path, heights, proj4, affine))


def local_projection(longitude_deg, latitude_deg):
    return f"+proj=stere +lat_0={latitude_deg} +lon_0={longitude_deg} +R=1737400"


def camera_over(longitude_deg, latitude_deg, off_nadir_deg=0.0, height_m=3000.0, size=300):
    """Return a camera tilted to the south, with north up in the image of a nadir view."""
    longitude, latitude = np.radians([longitude_deg, latitude_deg])
    east, north, up = east_north_up(longitude, latitude)
    tilt = rotation_matrices(np.radians([[off_nadir_deg, 0.0, 0.0]]))[0]
    rotation = np.stack([east, -north, -up], axis=-1) @ tilt
    looks = rotation @ [0.0, 0.0, 1.0]
    place = selenographic_to_cartesian(longitude, latitude, -1000.0) - height_m / (-looks @ up) * looks
    camera = Camera.of_pinhole(10.0, 10.0, [(size - 1) / 2, (size - 1) / 2], [-0.05])
    return FrameModel(camera, ConstantOrientation(place, rotation), (size, size))


def spots(model, terrain, dtype="float32"):
    """Draw an image with five bright spots; return it with longitudes and latitudes of the spots, deg."""
    size = model.shape[0]
    pixels = np.array([[60.3, 70.8], [240.2, 65.5], [150.0, 150.0], [75.6, 220.1], [230.0, 235.4]])
    line, sample = np.mgrid[:size, : model.shape[1]]
    image = np.full(model.shape, 20.0)
    for x, y in pixels:
        image += CONTRAST * np.exp(-0.5 * ((sample - x) ** 2 + (line - y) ** 2) / 4.0**2)
    longitude, latitude, _ = cartesian_to_selenographic(image_to_ground(model, pixels, Terrain(terrain)))
    return image.astype(dtype), np.degrees(longitude), np.degrees(latitude)


def centroid(values, row, column, half=12):
    """Return the centroid of the brightness around a cell, in cells."""
    r, c = round(row), round(column)
    part = values[r - half : r + half + 1, c - half : c + half + 1] - 20.0
    part = np.where(part > 0.05 * CONTRAST, part, 0.0)
    rows, columns = np.mgrid[r - half : r + half + 1, c - half : c + half + 1]
    return (part * rows).sum() / part.sum(), (part * columns).sum() / part.sum()


CASES = {
    "equator": (23.47, 0.67, "IAU_2015:30110", 0.0),
    "oblique": (-19.51, 44.12, "+proj=eqc +lat_ts=44 +lon_0=-19 +R=1737400", 25.0),
    "far side": (179.999, -20.0, "IAU_2015:30115", 10.0),
    "south pole": (120.0, -89.9, "IAU_2015:30135", 10.0),
}


@pytest.mark.study
@pytest.mark.parametrize("case", CASES)
def test_spots_are_at_their_places_on_the_ground(tmp_path, case):
    longitude, latitude, projection, off_nadir_deg = CASES[case]
    centre = -90.0 if latitude < -80.0 else latitude
    terrain = hilly(tmp_path / "dem.tif", longitude, latitude, local_projection(longitude, centre))
    model = camera_over(longitude, latitude, off_nadir_deg)
    image, longitudes, latitudes = spots(model, terrain)
    write_orthophoto(
        tmp_path / "map.tif",
        [(image, model)],
        terrain,
        projection=projection,
        resolution_m=3.0,
    )
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.crs.to_dict()["R"] == R_M
        values, visible = file.read(1), file.read_masks(1) > 0
        xs, ys = rasterio.warp.transform(terrain_maps.LONGLAT, projection, longitudes, latitudes)
        for x, y in zip(xs, ys, strict=True):
            # GDAL counts from the corner of the first cell
            column, row = (x - file.transform.c) / 3.0 - 0.5, (file.transform.f - y) / 3.0 - 0.5
            assert visible[round(row), round(column)]
            place = centroid(values, row, column)
            tolerance = PLACE_CELLS * (3 if off_nadir_deg > 20 else 1)
            assert place == pytest.approx((row, column), abs=tolerance), case
    assert 0.2 < visible.mean() < 1.0


@pytest.mark.study
def test_data_types_are_kept_and_hidden_cells_masked(tmp_path):
    longitude, latitude, projection, _ = CASES["equator"]
    terrain = hilly(tmp_path / "dem.tif", longitude, latitude, local_projection(longitude, latitude))
    model = camera_over(longitude, latitude)
    for dtype, value in (("uint8", 255), ("uint16", 4000), ("float32", 0.25)):
        image = np.full(model.shape, value, dtype=dtype)
        write_orthophoto(tmp_path / "map.tif", [(image, model)], terrain, resolution_m=5.0)
        with rasterio.open(tmp_path / "map.tif") as file:
            assert file.dtypes == (dtype,)
            values, visible = file.read(1), file.read_masks(1) > 0
            assert (values[visible] == value).all()
            assert not values[~visible].any()
            assert file.transform.c % 5.0 == 0.0
            assert file.crs.to_dict()["proj"] == "eqc"
    assert projection == "IAU_2015:30110"


def test_ground_behind_a_ridge_is_masked(tmp_path):
    """A ridge of 400 m hides 1000 m of plain from a camera 2600 m away and 700 m up."""
    size, cell_m = 800, 20.0
    steps_m = (np.arange(size) - (size - 1) / 2) * cell_m
    _, north = np.meshgrid(steps_m, -steps_m)
    affine = Affine(cell_m, 0.0, -8000.0, 0.0, -cell_m, 8000.0)
    heights = 400.0 * np.exp(-0.5 * (north / 150.0) ** 2) - 1000.0
    terrain = TerrainModel.open(terrain_maps.write(tmp_path / "dem.tif", heights, terrain_maps.EQC, affine))
    model = camera_over(0.0, 0.0, off_nadir_deg=75.0, height_m=700.0)
    camera_side = -np.sign(model.orientation.position_m[2])  # rays go from it
    write_orthophoto(
        tmp_path / "map.tif", [(np.full(model.shape, 100, "uint8"), model)], terrain, resolution_m=20.0
    )
    with rasterio.open(tmp_path / "map.tif") as file:
        visible = file.read_masks(1) > 0
        north_m = file.transform.f - 20.0 * (np.arange(file.height) + 0.5)
        column = int((0.0 - file.transform.c) / 20.0)
    beyond_m = camera_side * north_m
    assert visible[(beyond_m > -400.0) & (beyond_m < -100.0), column].all()  # the slope that faces the camera
    behind = (beyond_m > 200.0) & (beyond_m < 1200.0)
    assert behind.sum() > 20
    assert not visible[behind, column].any()


def test_line_scan_over_real_terrain(tmp_path):
    from ldem import write_ldem_4

    terrain = TerrainModel.open(write_ldem_4(tmp_path))
    model = read_isd(ISDS / "lro_nac.json.gz", axes="ME_DE421").model
    image = np.add.outer(np.arange(400.0), np.arange(5064.0)).astype("float32")  # line + sample
    write_orthophoto(
        tmp_path / "map.tif", [(image, model)], terrain, projection="IAU_2015:30110", resolution_m=20.0
    )
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.crs.to_authority() == ("IAU_2015", "30110")
        values = file.read(1)
        rows, columns = np.nonzero(file.read_masks(1))
        pick = slice(None, None, 301)
        x, y = file.xy(rows[pick], columns[pick])
        longitude, latitude = map(np.radians, rasterio.warp.transform(file.crs, terrain_maps.LONGLAT, x, y))
    ground = selenographic_to_cartesian(longitude, latitude, terrain.height_m(longitude, latitude))
    expected = model.project(ground).pixels.sum(axis=1)
    inner = (expected > 30.0) & (expected < 5400.0)
    assert inner.sum() > 20
    assert values[rows[pick], columns[pick]][inner] == pytest.approx(expected[inner], abs=0.01)
