"""Heights, slopes and roughness of an analytic surface, in the projections that lunar maps come in."""

import tracemalloc

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import Affine
from terrain_maps import (
    BICUBIC_M,
    BILINEAR_M,
    CELL_DEG,
    CELL_M,
    DEGREE_M,
    EQC,
    FLOAT32_M,
    MAPS,
    SLOPING,
    SMALL,
    R,
    degrees,
    heights_of_map,
    surface_m,
    write,
)

from radioloc.errors import InputError
from radioloc.lunar import TerrainModel
from radioloc.lunar.terrain import height_and_gradient


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    paths = {}
    for number, (name, (proj4, affine, rows, columns, _)) in enumerate(MAPS.items()):
        heights = heights_of_map(proj4, affine, rows, columns)
        paths[name] = write(folder / f"{number}.tif", heights, proj4, affine)
    return paths


@pytest.mark.parametrize("name", MAPS)
def test_heights_in_each_projection(maps, name):
    lon, lat = MAPS[name][-1]
    bilinear = TerrainModel.open(maps[name]).height_m(lon, lat)
    np.testing.assert_allclose(bilinear, surface_m(lon, lat), rtol=0, atol=BILINEAR_M)
    model = TerrainModel.open(maps[name], interpolation="bicubic")
    np.testing.assert_allclose(model.height_m(lon, lat), surface_m(lon, lat), rtol=0, atol=BICUBIC_M)
    assert model.metadata.resolution_m == pytest.approx(CELL_M, abs=1e-3)


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
@pytest.mark.parametrize("name", MAPS)
def test_slope_is_the_derivative_of_the_height(maps, name, interpolation):
    model = TerrainModel.open(maps[name], interpolation=interpolation)
    lon, lat = MAPS[name][-1]
    lon, lat = lon * 0.999 + 1e-4, lat * 0.999 + 1e-4  # room for a step before 2 pi and the poles
    within_cell = np.ones(lon.shape, dtype=bool)
    if interpolation == "bilinear":  # the slope jumps between cells; a step is a thousandth of one
        row, column = model._grid.cells(lon, lat)
        within_cell = (np.abs(row - np.rint(row)) > 0.01) & (np.abs(column - np.rint(column)) > 0.01)
        assert within_cell.mean() > 0.9
    lon, lat = lon[within_cell], lat[within_cell]
    step = 1e-5
    height, by_lon, by_lat = model.height_and_slope(lon, lat)
    np.testing.assert_array_equal(height, model.height_m(lon, lat))
    # third derivatives of 1e5 m/rad^3 (bicubic, within a cell) times step^2 / 6, and rounding of 1e-9 m over 2e-5
    tolerance_m_rad = 2e-3
    for derivative, d_lon, d_lat in ((by_lon, step, 0.0), (by_lat, 0.0, step)):
        difference = model.height_m(lon + d_lon, lat + d_lat) - model.height_m(lon - d_lon, lat - d_lat)
        np.testing.assert_allclose(derivative, difference / (2 * step), rtol=0, atol=tolerance_m_rad)


def test_the_gradient_at_the_pole_of_a_polar_map(maps):
    model = TerrainModel.open(maps["polar stereographic, south"], interpolation="bicubic")
    place = degrees((0.0, -90.0), (90.0, -90.0), (37.0, -90.0), (37.0, -89.9999999))
    height_m, gradient = height_and_gradient(model.height_and_slope, *place)
    np.testing.assert_allclose(height_m, model.height_m(*place), rtol=0, atol=1e-5)
    np.testing.assert_allclose(gradient, [[1500.0, 1000.0, 0.0]] * 4, rtol=0, atol=1.0)
    with pytest.raises(InputError, match="beyond a pole"):
        height_and_gradient(model.height_and_slope, *degrees((0.0, -95.0)))


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_cell_centres_are_reproduced(tmp_path, interpolation):
    heights = np.random.default_rng(3).normal(0.0, 1000.0, (20, 30)).astype("float32")
    affine = Affine(CELL_M, 0, -15 * CELL_M, 0, -CELL_M, 10 * CELL_M)
    model = TerrainModel.open(write(tmp_path / "a.tif", heights, EQC, affine), interpolation=interpolation)
    row, column = np.mgrid[2:18, 2:28]
    lat, lon = np.radians(5.0 - (row + 0.5) * CELL_DEG), np.radians(-7.5 + (column + 0.5) * CELL_DEG)
    np.testing.assert_allclose(model.height_m(lon, lat), heights[2:18, 2:28], rtol=0, atol=FLOAT32_M)


def test_outside_names_point_and_map(tmp_path):
    model = TerrainModel.open(write(tmp_path / "a.tif", SLOPING, EQC, SMALL))
    message = r"longitude 6\.000000, latitude 1\.000000 degrees \(and 1 more points\) is outside .*a\.tif"
    with pytest.raises(
        InputError, match=message + r".*longitudes -5\.0000 to 5\.0000, latitudes -5\.0000 to 5\.0000"
    ):
        model.height_m(*degrees((0.0, 0.0), (6.0, 1.0), (0.0, 7.0)))


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_edge_is_the_last_centre_with_a_full_stencil(tmp_path, interpolation):
    path = write(tmp_path / "a.tif", SLOPING, f"+proj=longlat +R={R}", Affine(0.5, 0, -5, 0, -0.5, 5))
    model = TerrainModel.open(path, interpolation=interpolation)
    edge_deg = 4.75 if interpolation == "bilinear" else 4.25
    edge_points = degrees((edge_deg, 0.0), (0.0, -edge_deg), (-edge_deg, edge_deg))
    assert np.isfinite(model.height_m(*edge_points)).all()
    with pytest.raises(InputError, match="too near its edge"):
        model.height_m(*degrees((edge_deg + 0.001, 0.0)))
    with pytest.raises(InputError, match="too near its edge"):
        model.height_m(*degrees((0.0, edge_deg + 0.001)))


@pytest.mark.parametrize(("void", "kwargs"), [(np.nan, {}), (-32768.0, {"nodata": -32768.0})])
def test_void_names_the_point(tmp_path, void, kwargs):
    values = SLOPING.copy()
    values[5, 12] = void
    model = TerrainModel.open(write(tmp_path / "a.tif", values, EQC, SMALL, **kwargs))
    with pytest.raises(InputError, match=r"1\.100000.*2\.200000"):
        model.height_m(*degrees((1.1, 2.2)))
    with pytest.raises(InputError, match="void"):
        model.roughness_m(*degrees((1.6, 2.7)))
    assert np.isfinite(model.height_m(*degrees((-1.1, 2.2)))).all()


def test_value_that_no_terrain_has_is_refused_where_it_is_met(tmp_path):
    values = np.zeros((200, 200)) + 50.0
    values[103, 101] = -32767.0  # not among the cells sampled on opening
    affine = Affine(CELL_M, 0, -100 * CELL_M, 0, -CELL_M, 100 * CELL_M)
    model = TerrainModel.open(write(tmp_path / "a.tif", values, EQC, affine))
    with pytest.raises(InputError, match=r"-32767.*0\.600000"):
        model.height_m(*degrees((0.6, -1.6)))


@pytest.mark.parametrize("kind", ["longlat", "polar"])
def test_roughness_is_the_scatter_about_a_plane(tmp_path, kind):
    """The roughness of a plane is zero, and that of noise of 20 m is 20 m."""
    rng = np.random.default_rng(11)
    x, y = (np.arange(400) - 199.5) * 100.0, (199.5 - np.arange(400)) * 100.0
    plane = np.add.outer(0.1 * y, -0.2 * x)
    cell_deg = 100.0 / DEGREE_M
    proj4, affine, at = {
        "longlat": (
            f"+proj=longlat +R={R}",
            Affine(cell_deg, 0, 33 - 200 * cell_deg, 0, -cell_deg, 200 * cell_deg),
            degrees((33.0, 0.0)),
        ),
        "polar": (
            f"+proj=stere +lat_0=90 +R={R}", Affine(100, 0, -20000, 0, -100, 20000), degrees((0.0, 90.0)),
        ),
    }[kind]  # fmt: skip
    smooth = TerrainModel.open(write(tmp_path / "a.tif", plane, proj4, affine))
    for radius_m in (None, 1000.0, 5000.0):
        assert smooth.roughness_m(*at, radius_m)[0] == pytest.approx(0.0, abs=0.1)  # projections bend a plane
    noisy = plane + rng.normal(0.0, 20.0, plane.shape)
    model = TerrainModel.open(write(tmp_path / "b.tif", noisy, proj4, affine))
    sample_error_m = 5 * 20.0 / np.sqrt(2 * 700)  # five sigma of a standard deviation from some 700 cells
    rough_m = model.roughness_m(*at, 5000.0)[0]
    assert rough_m == pytest.approx(20.0, abs=sample_error_m)
    assert model.sigma_m(*at, 15.0, 5000.0)[0] == pytest.approx(np.hypot(15.0, rough_m), abs=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda model: model.height_m(np.nan, 0.0), "not a finite"),
        (lambda model: model.height_m(0.1, 3.6), "degrees instead"),
        *((lambda model, s=s: model.sigma_m(0.0, 0.0, s), "own_sigma_m") for s in (0.0, np.nan, np.inf)),
    ],
)
def test_arguments_that_cannot_be(maps, call, message):
    with pytest.raises(InputError, match=message):
        call(TerrainModel.open(maps["equirectangular, 0 to 360"]))


@pytest.mark.study
def test_only_the_cells_needed_are_read(tmp_path):
    """A map of 7 GB (sparse on disk) is opened and read within 40 MB."""
    path = tmp_path / "large.tif"
    cell_m = 360.0 * DEGREE_M / 60000
    affine = Affine(cell_m, 0, -30000 * cell_m, 0, -cell_m, 15000 * cell_m)
    profile = {"driver": "GTiff", "width": 60000, "height": 30000, "count": 1, "dtype": "float32"}
    profile |= {"tiled": True, "sparse_ok": True}
    with rasterio.open(path, "w", crs=CRS.from_string(EQC), transform=affine, **profile) as dataset:
        dataset.units = ("m",)
        block = np.full((256, 256), 77.0, dtype="float32")
        dataset.write(block, 1, window=((14848, 15104), (29952, 30208)))
    tracemalloc.start()
    model = TerrainModel.open(path)
    assert model.height_m(1e-4, 1e-4) == pytest.approx(77.0, abs=FLOAT32_M)
    rng = np.random.default_rng(5)
    model.height_m(rng.uniform(-3, 3, 200), rng.uniform(-1.5, 1.5, 200))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 40e6
