"""Maps as images of the ground: pixels, degrees and metres in each projection, views in a plane, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
import rasterio.warp
from rasterio.crs import CRS
from rasterio.transform import Affine
from terrain_maps import LONGLAT, R, write_raster

from radioloc.errors import FileFormatError, InputError
from radioloc.lunar.map_grid import MapGrid
from radioloc.lunar.maps import Map, TangentPlane

SITE = (-19.51, 44.12)  # degrees
PIXEL_M = 30.0
SIZE = 400
TRANSFORM_DEG = 1e-9  # PROJ's own rounding, 0.03 mm
PLANE_M = 1e-6
GREY = 2.0  # one for rounding of the map, one for interpolation within pixels of a pattern 20 pixels long

PROJECTIONS = {
    "equirectangular": f"+proj=eqc +lat_ts=44 +R={R}",
    "Mercator": f"+proj=merc +R={R}",
    "degrees of the IAU": "IAU_2015:30100",
    "polar stereographic": f"+proj=stere +lat_0=90 +R={R}",
    "orthographic": f"+proj=ortho +lat_0=44 +lon_0=-19 +R={R}",
}


def pattern(lon_deg, lat_deg):
    """Grey values with waves of some 30 pixels."""
    east = (lon_deg - SITE[0]) * np.cos(np.radians(SITE[1]))
    return 127.0 + 60.0 * np.sin(east * 200.0) + 60.0 * np.cos((lat_deg - SITE[1]) * 230.0)


def write_map(path, projection, *, rotation_deg=0.0, pixel_m=PIXEL_M, size=SIZE, dtype="uint8", nodata=None):
    """A square map around the site."""
    crs = CRS.from_string(projection)
    (x,), (y,) = rasterio.warp.transform(LONGLAT, crs, [SITE[0]], [SITE[1]])
    pixel = pixel_m / np.radians(R) if crs.is_geographic else pixel_m
    turned = np.radians(rotation_deg)
    a, b = pixel * np.cos(turned), pixel * np.sin(turned)
    half = size / 2
    transform = Affine(a, b, x - half * (a + b), b, -a, y - half * (b - a))
    u, v = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    a, b, c, d, e, f = tuple(transform)[:6]
    lon, lat = rasterio.warp.transform(crs, LONGLAT, (a * u + b * v + c).ravel(), (d * u + e * v + f).ravel())
    grey = pattern(np.array(lon), np.array(lat)).reshape(size, size)
    values = np.rint(grey).astype(dtype) if dtype == "uint8" else grey.astype(dtype)
    return write_raster(path, values, crs=crs, transform=transform, nodata=nodata)


def test_plane_is_the_orthographic_projection_of_proj():
    ortho = CRS.from_string(f"+proj=ortho +lat_0={SITE[1]} +lon_0={SITE[0]} +R={R}")
    degrees = np.array([[-19.51, 44.12], [-19.2, 44.3], [-20.5, 43.0], [10.0, 60.0]])
    x, y = rasterio.warp.transform(LONGLAT, ortho, degrees[:, 0], degrees[:, 1])
    plane = TangentPlane(*SITE)
    np.testing.assert_allclose(
        plane.from_longitude_latitude(degrees), np.column_stack([x, y]), rtol=0, atol=PLANE_M
    )
    back = plane.to_longitude_latitude(np.column_stack([x, y]))
    np.testing.assert_allclose(back, degrees, rtol=0, atol=TRANSFORM_DEG)


def test_beyond_the_limb_is_no_point():
    plane = TangentPlane(*SITE)
    assert np.isnan(plane.from_longitude_latitude([[160.49, -44.12]])).all()
    assert np.isnan(plane.to_longitude_latitude([[1.8e6, 0.0]])).all()


def test_covariance_follows_east_and_north():
    """Covariances agree with differences of longitude and latitude, 2 degrees from the point of contact."""
    plane, at = TangentPlane(*SITE), np.array([60e3, -30e3])
    step_m = 10.0
    around = plane.to_longitude_latitude(at + step_m * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    change = np.radians((around[[0, 2]] - around[[1, 3]]) / (2.0 * step_m)).T * R
    change[0] *= np.cos(np.radians(around[:, 1].mean()))
    covariance_m2 = np.array([[25.0, 6.0], [6.0, 4.0]])
    expected = change @ covariance_m2 @ change.T
    np.testing.assert_allclose(plane.covariance_at(at, covariance_m2), expected, rtol=0, atol=1e-5)


def test_cells_of_a_map_about_the_far_side_are_those_of_its_projection():
    crs = CRS.from_string(f"+proj=eqc +lon_0=180 +R={R} +no_defs")
    grid = MapGrid.of_map(crs, Affine(5.0, 0.0, -1e4, 0.0, -5.0, 1e4), 4000, 4000, R)
    longitude_rad = np.radians([179.95, -179.95, 180.0, -180.0])
    assert grid.linear is not None
    expected = replace(grid, linear=None).cells(longitude_rad, np.zeros(4))
    np.testing.assert_allclose(grid.cells(longitude_rad, np.zeros(4)), expected, atol=1e-6)


@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("rotation_deg", [0.0, 23.0])
def test_pixels_and_degrees(tmp_path, name, rotation_deg):
    path = write_map(tmp_path / "a.tif", PROJECTIONS[name], rotation_deg=rotation_deg)
    base = Map.open(path)
    pixels = np.array([[0.0, 0.0], [399.0, 0.0], [10.25, 200.75], [199.5, 199.5]])
    with rasterio.open(path) as dataset:
        x, y = dataset.xy(pixels[:, 1], pixels[:, 0])  # rasterio's default is the pixel's centre
        lon, lat = rasterio.warp.transform(dataset.crs, LONGLAT, x, y)
    degrees = base.longitude_latitude_deg(pixels)
    np.testing.assert_allclose(degrees, np.column_stack([lon, lat]), rtol=0, atol=TRANSFORM_DEG)
    np.testing.assert_allclose(degrees[3], SITE, rtol=0, atol=TRANSFORM_DEG)
    np.testing.assert_allclose(base.pixels(degrees), pixels, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("pixel_m", [20.0, 45.0])
def test_view_shows_the_ground(tmp_path, name, pixel_m):
    base = Map.open(write_map(tmp_path / "a.tif", PROJECTIONS[name], rotation_deg=10.0))
    plane, shape = TangentPlane(-19.48, 44.10), (70, 90)
    west_m, north_m = -2000.0, 1500.0
    view, valid = base.view(plane, west_m, north_m, pixel_m, shape)
    line, sample = np.nonzero(valid)
    at = plane.to_longitude_latitude(np.column_stack([west_m + pixel_m * sample, north_m - pixel_m * line]))
    assert len(line) > 3000
    np.testing.assert_allclose(view[valid], pattern(*at.T), rtol=0, atol=GREY)


def test_views_outside_and_voids_are_marked(tmp_path):
    base = Map.open(write_map(tmp_path / "a.tif", PROJECTIONS["Mercator"]))
    _, _, east, north = base.extent_m(base.plane())
    assert not base.view(base.plane(), east + 1e4, north, 30.0, (40, 40))[1].any()
    half = base.view(base.plane(), east - 20 * 30.0, 0.0, 30.0, (40, 40))[1].mean()
    assert half == pytest.approx(0.5, abs=0.05)
    path = write_map(tmp_path / "b.tif", PROJECTIONS["Mercator"], dtype="float32", nodata=-1.0)
    with rasterio.open(path, "r+") as dataset:
        values = dataset.read(1)
        values[:200] = -1.0
        dataset.write(values, 1)
    assert Map.open(path).view(base.plane(), 0.0, 1800.0, 30.0, (120, 20))[1].mean() == pytest.approx(
        0.5, abs=0.02
    )


def waves(degrees):
    """Grey values from directions, without a seam, with waves of some 30 degrees."""
    lon, lat = np.radians(degrees).T
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    return 128 + 25 * np.sin(17 * x + 1) + 25 * np.sin(23 * y) + 25 * np.sin(19 * z + 2)


FULL_SHAPE = 720, 1440  # lines, samples
PART_SHAPE = 400, 400
CYLINDERS = {  # projection, degrees of a pixel, west and north edge, lines and samples
    "-180 to 180": ("+proj=eqc", 0.25, -180.0, 90.0, FULL_SHAPE),
    "0 to 360 about 180": ("+proj=eqc +lon_0=180", 0.25, -180.0, 90.0, FULL_SHAPE),
    "0 to 360 about 0": ("+proj=eqc", 0.25, 0.0, 90.0, FULL_SHAPE),
    "degrees from 0 to 360": ("+proj=longlat", 0.25, 0.0, 90.0, FULL_SHAPE),
    "a part": ("+proj=eqc", 0.025, -25.0, 50.0, PART_SHAPE),
    "a part over 180 degrees": ("+proj=eqc", 0.025, 175.0, 50.0, PART_SHAPE),
    "a part from 350 to 360 degrees": ("+proj=longlat", 0.025, 350.0, 5.0, PART_SHAPE),
    "a part on another sphere": ("+proj=eqc +R=1738140", 0.025, 175.0, 50.0, PART_SHAPE),
}


@pytest.mark.parametrize("name", CYLINDERS)
@pytest.mark.parametrize("reduction", [1.0, 3.3])
def test_views_of_cylindrical_maps_show_all_that_these_have(tmp_path, name, reduction):
    """Views west and east of the middle, over any seam and at the pole show the values of their places."""
    projection, pixel_deg, west, north, shape = CYLINDERS[name]
    crs = CRS.from_string(projection if "+R" in projection else f"{projection} +R={R}")
    scale = 1.0 if crs.is_geographic else np.radians(crs.to_dict()["R"])
    corner = Affine(pixel_deg * scale, 0, west * scale, 0, -pixel_deg * scale, north * scale)
    east = west + 180.0 * ("lon_0" in projection) + pixel_deg * (np.arange(shape[1]) + 0.5)
    places = np.stack(np.meshgrid(east, north - pixel_deg * (np.arange(shape[0]) + 0.5)), axis=-1)
    grey = np.rint(waves(places.reshape(-1, 2))).reshape(shape).astype(np.uint8)
    base = Map.open(write_raster(tmp_path / "a.tif", grey, crs=crs, transform=corner))
    planes = [base.plane()]
    if shape == FULL_SHAPE:
        planes += [TangentPlane(*at) for at in ((180.0, 5.0), (0.3, -5.0), (-20.0, 44.0), (20.0, 89.5))]
    for plane in planes:
        size, pixel_m = 240, base.resolution_m * reduction
        first = (17 - size / 2) * pixel_m  # the middle of the view is not that of the plane
        line, sample = np.mgrid[:size, :size]
        plane_m = np.column_stack([first + pixel_m * sample.ravel(), -first - pixel_m * line.ravel()])
        view, valid = base.view(plane, first, -first, pixel_m, (size, size))
        # At the limb a pixel of the view has many degrees.
        in_disk = np.hypot(*plane_m.T) < 0.8 * R
        if shape == FULL_SHAPE and plane.latitude_deg > 40.0:  # the seam goes on beyond the pole
            in_disk &= np.abs(plane_m[:, 0]) > 1.5 * pixel_m
        degrees = plane.to_longitude_latitude(plane_m[in_disk])
        pixels = base.pixels(degrees)
        margin = 2.0 * reduction
        shown = ((pixels > margin) & (pixels < np.array(shape[::-1]) - 1.0 - margin)).all(axis=1)
        beyond = ((pixels < -margin) | (pixels > np.array(shape[::-1]) - 1.0 + margin)).any(axis=1)
        if shape == FULL_SHAPE:
            shown, beyond = np.full_like(shown, True), np.full_like(beyond, False)
        assert valid.ravel()[in_disk][shown].all()
        assert not valid.ravel()[in_disk][beyond].any()
        off = np.abs(view.ravel()[in_disk][shown] - waves(degrees[shown]))
        assert off.max() < GREY


def test_maps_refused(tmp_path):
    content = write_map(tmp_path / "b.tif", PROJECTIONS["Mercator"]).read_bytes()
    (tmp_path / "b.tif").write_bytes(content[: len(content) // 2])
    with pytest.raises(FileFormatError, match=r"b\.tif:"):
        Map.open(tmp_path / "b.tif").view(TangentPlane(*SITE), -3e3, 3e3, 30.0, (200, 200))
    with pytest.raises(InputError, match="make pixel_m larger"):
        Map.open(write_map(tmp_path / "c.tif", PROJECTIONS["Mercator"])).view(
            TangentPlane(*SITE), 0.0, 0.0, 1e-3, (10**5, 10**5)
        )
