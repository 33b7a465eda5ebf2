"""Elevation maps as files: formats, labels, units, reference spheres, and the maps that are refused."""

import sys

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import Affine
from terrain_maps import (
    BILINEAR_M,
    EQC,
    FLOAT32_M,
    GLOBE,
    MAPS,
    PLACE,
    PLACE_M,
    SLOPING,
    SMALL,
    degrees,
    grid_of_points,
    heights_of_map,
    surface_m,
    write,
    write_pds3,
    write_raster,
)

from radioloc.errors import FileFormatError, InputError
from radioloc.lunar import TerrainModel

QUANTISED_M = BILINEAR_M + 0.25  # half of the 0.5 m step


def test_point_registered_geotiff_is_not_shifted(tmp_path):
    # GDAL stores the tie point at the first cell's centre then, and its transform stays that of the corner
    proj4, affine, rows, columns, (lon, lat) = MAPS["transverse Mercator"]
    path = write(
        tmp_path / "p.tif", heights_of_map(proj4, affine, rows, columns), proj4, affine, AREA_OR_POINT="Point"
    )
    np.testing.assert_allclose(
        TerrainModel.open(path).height_m(lon, lat), surface_m(lon, lat), rtol=0, atol=BILINEAR_M
    )


@pytest.mark.parametrize(("driver", "name"), [("ISIS3", "a.cub"), ("PDS4", "a.xml")])
@pytest.mark.parametrize("projection", ["equirectangular about 180", "polar stereographic, south"])
def test_other_formats(tmp_path, driver, name, projection):
    proj4, affine, rows, columns, (lon, lat) = MAPS[projection]
    path = write(tmp_path / name, heights_of_map(proj4, affine, rows, columns), proj4, affine, driver)
    model = TerrainModel.open(path)
    assert model.metadata.driver == driver
    np.testing.assert_allclose(model.height_m(lon, lat), surface_m(lon, lat), rtol=0, atol=BILINEAR_M)


@pytest.mark.parametrize("north", [True, False])
def test_pds3_polar_by_the_equations_of_its_catalogue(tmp_path, north):
    """Cells placed by LOLA's own equations (DSMAP_POLAR.CAT, 2021): X = (I - N/2 - 0.5) MAP_SCALE and so on."""
    n, scale_m = 80, 15000.0
    i, j = np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1))
    x, y = (i - n / 2 - 0.5) * scale_m, (j - n / 2 - 0.5) * scale_m
    colatitude = 2.0 * np.arctan(0.5 * np.hypot(x, y) / 1737400.0)
    lon = np.arctan2(x, y if north else -y)
    lat = np.pi / 2 - colatitude if north else colatitude - np.pi / 2
    path = write_pds3(
        tmp_path, surface_m(lon, lat), projection="POLAR STEREOGRAPHIC", lat_0=90 if north else -90, lon_0=0,
        map_scale="15000 <m/pix>",
    )  # fmt: skip
    model = TerrainModel.open(path)
    at = grid_of_points((-180, 180), (72.0, 90.0) if north else (-90.0, -72.0))
    np.testing.assert_allclose(model.height_m(*at), surface_m(*at), rtol=0, atol=QUANTISED_M)


def test_pds3_global_map_closes_in_spite_of_its_rounded_scale(tmp_path):
    row, column = np.mgrid[0:360, 0:720]
    heights = surface_m(np.radians((column + 0.5) * 0.5), np.radians(90.0 - (row + 0.5) * 0.5))
    path = write_pds3(tmp_path, heights, projection="SIMPLE CYLINDRICAL", map_scale="15162 <m/pix>")
    model = TerrainModel.open(path)  # 15161.675 m is exact: 117 m too much at either end
    np.testing.assert_allclose(model.height_m(*GLOBE), surface_m(*GLOBE), rtol=0, atol=QUANTISED_M)
    lon, lat = degrees((-1e-9, 10.0), (1e-9, 10.0))
    first, second = model.height_m(lon, lat)
    assert first == pytest.approx(second, abs=1e-5)


def test_pds3_regional_tile_of_floats_in_kilometres(tmp_path):
    row, column = np.mgrid[0:60, 0:90]  # 0 to 30 N, 0 to 45 E, about a centre at 180 as LOLA's tiles are
    heights = surface_m(np.radians((column + 0.5) * 0.5), np.radians(30.0 - (row + 0.5) * 0.5))
    path = write_pds3(
        tmp_path, heights, projection="SIMPLE CYLINDRICAL", map_scale="15.16167521 <km/pix>", type="PC_REAL", bits=32,
        bytes=360, unit="KILOMETER", scale=1, offset="1737.4", line_offset=59.5, sample_offset=359.5,
    )  # fmt: skip
    model = TerrainModel.open(path)
    assert (model.metadata.quantity, model.metadata.unit) == ("radius", "km")
    at = grid_of_points((0.5, 44.5), (0.5, 29.5))
    np.testing.assert_allclose(model.height_m(*at), surface_m(*at), rtol=0, atol=BILINEAR_M)
    with pytest.raises(InputError, match=r"0\.0000.*45\.0000.*0\.0000.*30\.0000"):
        model.height_m(*degrees((46.0, 10.0)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "MARS"}, "map of MARS"),
        ({"axes": "PRINCIPAL AXES OF DE421"}, "principal axes"),
        ({"offset": "1737.4"}, r"adds 1737\.4 m .* radius in kilometres"),
        ({"scale": 0}, "values are 0 times a number"),
        ({"sample_offset": "1e999"}, "do not lie on the Moon"),
    ],
)
def test_pds3_labels_refused(tmp_path, changes, message):
    values = {"projection": "SIMPLE CYLINDRICAL", "map_scale": "151616.75 <m/pix>"} | changes
    path = write_pds3(tmp_path, np.full((36, 72), 100.0), **values)
    with pytest.raises(InputError, match=message):
        TerrainModel.open(path)


@pytest.mark.parametrize(
    ("values", "kwargs", "open_with", "quantity", "unit", "shift_m"),
    [
        (SLOPING, {"units": "metre"}, {}, "height", "m", 0.0),
        (SLOPING / 1e3, {"units": "KILOMETER"}, {}, "height", "km", 0.0),
        (SLOPING, {"units": None}, {}, "height", "m", 0.0),  # 760 m is no height in km
        (SLOPING / 1e3, {"units": None}, {"unit": "km"}, "height", "km", 0.0),
        (SLOPING / 1e3 + 1737.4, {"units": "km", "dtype": "float64"}, {}, "radius", "km", 0.0),
        (SLOPING + 1737400.0, {"units": None, "dtype": "float64"}, {}, "radius", "m", 0.0),
        (SLOPING * 2.0, {"dtype": "int16", "scale": 0.5, "offset": 0.0}, {}, "height", "m", 0.0),
        (SLOPING * 2.0, {"dtype": "int16", "scale": 0.5, "offset": 1737400.0}, {}, "radius", "m", 0.0),
        (SLOPING, {}, {"radius_m": 1738000.0}, "height", "m", 600.0),
    ],
)
def test_units_and_references(tmp_path, values, kwargs, open_with, quantity, unit, shift_m):
    model = TerrainModel.open(write(tmp_path / "a.tif", values, EQC, SMALL, **kwargs), **open_with)
    assert (model.metadata.quantity, model.metadata.unit) == (quantity, unit)
    assert model.height_m(*PLACE)[0] == pytest.approx(PLACE_M + shift_m, abs=FLOAT32_M)


def test_heights_above_the_map_s_own_sphere(tmp_path):
    proj4, affine = "+proj=longlat +R=1738000 +no_defs", Affine(0.5, 0, -5, 0, -0.5, 5)
    model = TerrainModel.open(write(tmp_path / "a.tif", SLOPING, proj4, affine))
    assert model.metadata.reference_radius_m == 1738000.0
    assert model.height_m(*PLACE)[0] == pytest.approx(PLACE_M + 600.0, abs=FLOAT32_M)


@pytest.mark.parametrize(
    ("values", "kwargs", "open_with", "message"),
    [
        (SLOPING / 1e3, {"units": None}, {}, "metres or kilometres; set it .*say unit="),
        (SLOPING, {"units": "degree"}, {}, "in \\['degree'\\], not in metres"),
        (SLOPING + 20e3, {}, {}, "neither heights .* nor radii"),
        (SLOPING, {}, {"interpolation": "cubic"}, "use 'bilinear' or 'bicubic'"),
        (SLOPING, {"TARGET_NAME": "Mercury"}, {}, "map of Mercury"),
        (SLOPING, {"dtype": "uint8"}, {}, "expected an elevation map"),
        (np.full((20, 20), -9999.0), {"nodata": -9999.0}, {}, "is void"),
    ],
)
def test_maps_refused(tmp_path, values, kwargs, open_with, message):
    path = write(
        tmp_path / "a.tif", np.clip(values, -1e9, 255) if "dtype" in kwargs else values, EQC, SMALL, **kwargs
    )
    with pytest.raises(InputError, match=message):
        TerrainModel.open(path, **open_with)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("+proj=eqc +R=3396190", "not a map of the Moon: .* 3396.190 km"),
        ("EPSG:4326", "not a map of the Moon: .*WGS 84.* 6378.137 km"),
        ("+proj=longlat +a=1738100 +b=1736000", "refers to an ellipsoid"),
    ],
)
def test_other_bodies_refused(tmp_path, reference, message):
    affine = Affine(0.5, 0, -5, 0, -0.5, 5)
    with pytest.raises(InputError, match=message):
        TerrainModel.open(write(tmp_path / "a.tif", SLOPING, reference, affine))


@pytest.mark.parametrize(
    ("reference", "bands", "message"),
    [("Moon (principal axes)", 1, "is in principal axes"), ("Moon", 3, r"3 band\(s\)")],
)
def test_principal_axes_and_several_bands_are_refused(tmp_path, reference, bands, message):
    named = CRS.from_string(EQC).to_wkt().replace('GEOGCS["unknown', f'GEOGCS["{reference}')
    values = np.stack([SLOPING.astype("float32")] * bands)
    write_raster(tmp_path / "a.tif", values, crs=CRS.from_wkt(named), transform=SMALL)
    with pytest.raises(InputError, match=message):
        TerrainModel.open(tmp_path / "a.tif")


def test_missing_rasterio_says_what_to_install(monkeypatch, tmp_path):
    path = write(tmp_path / "a.tif", SLOPING, EQC, SMALL)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match=r"pip install 'radioloc\[terrain\]'"):
        TerrainModel.open(path)


VOID_AFFINE = Affine(0.02, 0, -2.2, 0, -0.02, 1.2)  # cells of 606 m


def write_undeclared(tmp_path, numbers, dtype, scale):
    proj4 = "+proj=longlat +R=1737400 +no_defs"
    return write(tmp_path / "a.tif", numbers, proj4, VOID_AFFINE, dtype=dtype, scale=scale, offset=0.0)


@pytest.mark.parametrize(
    ("dtype", "void", "scale"),
    [
        ("int16", -9999, None),
        ("int16", -32768, 0.25),
        ("int32", -99999, 0.01),
        ("float32", -9999.0, None),
        ("float32", -3.4028226e38, None),  # 0xFF7FFFFB, NULL of ISIS
        ("float32", np.inf, None),
        ("float32", np.nan, None),
    ],
)
@pytest.mark.parametrize("cells", [1, 3, 12])
def test_undeclared_void_values_are_no_ground(tmp_path, dtype, void, scale, cells):
    """Voids of any number, scale and extent leave adjacent ground unchanged and remove heights at their edge."""
    rows, columns = np.mgrid[:40, :40]
    heights_m = -2500.0 + 3.0 * columns + 2.0 * rows
    numbers = heights_m / (scale or 1.0)
    numbers[10 : 10 + cells, 20 : 20 + cells] = void

    def place(row, column):
        return np.radians(-2.2 + 0.02 * (column + 0.5)), np.radians(1.2 - 0.02 * (row + 0.5))

    path = write_undeclared(tmp_path, numbers, dtype, scale)
    for row, column in ((10, 20), (10, 19.5), (9.5, 20.0), (9 + cells, 19 + cells)):
        with pytest.raises(InputError, match="void"):
            TerrainModel.open(path).height_m(*place(row, column))
    try:
        model = TerrainModel.open(path)
    except InputError:  # as above: a sample of the cells has a height that the Moon does not have
        return
    assert model.height_m(*place(30, 5)) == pytest.approx(heights_m[30, 5], abs=0.3)
    window = model.window(*place(np.array([5, 25]), np.array([15, 35])))
    assert np.isnan(window.heights_m).sum() == cells**2


@pytest.mark.parametrize("scale", [0.5, 0.1])
def test_ground_of_the_height_of_a_void_value_is_read(tmp_path, scale):
    """Half metres from -5010 m up, as of a basin: one cell in twenty of a slope has the number -9999."""
    rows, columns = np.mgrid[:40, :40]
    numbers = -9999 + (columns - 20) * 4 + (rows // 10)
    model = TerrainModel.open(write_undeclared(tmp_path, numbers, "int16", scale))
    assert (numbers == -9999).any()
    assert np.isfinite(model.window(np.radians([-2.1, -1.5]), np.radians([0.5, 1.1])).heights_m).all()


@pytest.mark.parametrize("dtype", ["int16", "float32"])
@pytest.mark.parametrize("big", ["NO", "YES"])
def test_geotiff_cut_at_its_end_refused(tmp_path, dtype, big):
    """The last bytes are GDAL's scale and unit, without which GDAL reads other heights."""
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "width": 72, "height": 36, "count": 1, "dtype": dtype, "BIGTIFF": big}
    with rasterio.open(path, "w", crs=CRS.from_string(EQC), transform=SMALL, **profile) as dataset:
        dataset.write(SLOPING.astype(dtype)[:36, :72], 1)
        dataset.scales, dataset.units = (0.5,), ("m",)
    TerrainModel.open(path)
    content = path.read_bytes()
    for n_bytes in (1, 100, 200):
        path.write_bytes(content[:-n_bytes])
        with pytest.raises(FileFormatError, match=r"a\.tif: was cut"):
            TerrainModel.open(path)
