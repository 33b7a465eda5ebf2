"""LOLA's global elevation model at 4 pixels per degree, read through its PDS3 label, against outside values.

Of the map those cells are its own that tests/data holds: around the sites, at the seam, and one in 49.
"""

import numpy as np
import pytest
from ldem import write_ldem_4

from radioloc.lunar import TerrainModel

# Longitude and latitude (mean Earth), height above 1737.4 km. Reflectors: JPL IOM 335-JW,DB,WF-20130722-016, table 7,
# and radii of the DE421 solution; landers: LROC, posts 1172 and 1374 (lroc.sese.asu.edu), within 20 and 30 m.
# Tolerances: a cell is 7.6 km wide and holds the mean of its terrain; mare plains vary by tens of metres within it,
# and the Apollo 15 site lies 5 km from the front of the Apennines (4 km high).
SITES = {
    "Apollo 11": (23.4730244, 0.6734595, -1927.3, 40.0),
    "Apollo 14": (-17.4786937, -3.6441535, -1063.9, 60.0),
    "Apollo 15": (3.6284572, 26.1334178, -1922.7, 100.0),
    "Chang'e-5": (308.0839, 43.0576, -2570.0, 40.0),
    "Chang'e-6": (206.0148, -41.6385, -5256.0, 60.0),
}


@pytest.fixture(scope="module")
def label(tmp_path_factory):
    return write_ldem_4(tmp_path_factory.mktemp("dem"))


@pytest.fixture(scope="module", params=["bilinear", "bicubic"])
def model(request, label):
    return TerrainModel.open(label, interpolation=request.param)


@pytest.fixture(scope="module")
def heights_m(label):
    """The image without GDAL: 720 by 1440 integers of 0.5 m, as the label says."""
    numbers = np.fromfile(label.with_suffix(".IMG"), dtype="<i2")
    return 0.5 * numbers.reshape(720, 1440)


def test_label_is_understood(model):
    metadata = model.metadata
    assert (metadata.driver, metadata.quantity, metadata.unit) == ("PDS", "radius", "m")
    assert (metadata.scale, metadata.offset) == (0.5, 1737400.0)
    assert metadata.coordinate_system == "MEAN EARTH/POLAR AXIS OF DE421"
    assert metadata.coverage == "all longitudes, latitudes -90.0000 to 90.0000 degrees"
    assert metadata.resolution_m == pytest.approx(7580.84, abs=0.01)
    assert {f.path.name: f.size_bytes for f in metadata.files}["LDEM_4.IMG"] == 2073600


def test_every_cell_centre_is_where_the_label_puts_it(model, heights_m):
    row, column = np.mgrid[0:720:7, 0:1440:7]
    lon, lat = np.radians((column + 0.5) / 4.0), np.radians(90.0 - (row + 0.5) / 4.0)
    # places in the grid are exact to 1e-8 of a cell, and neighbours differ by up to 5 km
    np.testing.assert_allclose(model.height_m(lon, lat), heights_m[::7, ::7], rtol=0, atol=1e-4)


@pytest.mark.parametrize("site", SITES)
def test_known_heights(model, site):
    lon_deg, lat_deg, height_m, tolerance_m = SITES[site]
    assert model.height_m(*np.radians([lon_deg, lat_deg])) == pytest.approx(height_m, abs=tolerance_m)


def test_highest_and_lowest_points(model, heights_m):
    """5.41 N, 201.37 E (LROC, 2010) and 70.43 S, 187.42 E (Kaguya, 2009), seen through cells of 0.25 degrees."""
    for flat, lon_deg, lat_deg in ((heights_m.argmax(), 201.37, 5.41), (heights_m.argmin(), 187.42, -70.43)):
        row, column = divmod(int(flat), 1440)
        at_deg = (column + 0.5) / 4.0, 90.0 - (row + 0.5) / 4.0
        assert at_deg == pytest.approx((lon_deg, lat_deg), abs=0.3)
        assert model.height_m(*np.radians(at_deg)) == pytest.approx(heights_m.flat[flat], abs=1e-4)


def test_map_closes_at_its_seam(model):
    lat = np.radians(np.linspace(-89.0, 89.0, 90))
    west, east = model.height_m(-1e-9, lat), model.height_m(1e-9, lat)
    np.testing.assert_allclose(west, east, rtol=0, atol=1e-3)  # slopes of 1e5 m/rad times 2e-9 rad


def test_roughness_tells_mare_from_mountains(model):
    def roughness_m(site):
        return model.roughness_m(*np.radians(SITES[site][:2]), 15e3)

    assert roughness_m("Chang'e-5") < 30.0
    assert roughness_m("Apollo 15") > 300.0
