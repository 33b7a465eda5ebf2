"""Elevation models shaded as maps: the same ground, drawn as the renderer draws it."""

import numpy as np
import pytest
import rasterio
from paths import ISDS
from procedural_ground import Ground

from radioloc.errors import InputError
from radioloc.imaging import read_isd
from radioloc.imaging.shading import sun_direction, sun_over_map, write_shaded_map
from radioloc.lunar import Map, TangentPlane
from radioloc.time import Epochs, epochs_from_strings, to_scale

ABERRATION_DEG = 0.0058  # of 30.3 km/s: USGS has the Sun as it is seen
GROUND = Ground(TangentPlane(-51.9162, 43.0584), seed=3)


@pytest.mark.slow
def test_a_shaded_model_looks_as_the_ground_does_under_the_same_sun(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 20.0, 12000.0)
    GROUND.write_map(tmp_path / "map.tif", 20.0, 12000.0, sun_direction(100.0, 35.0), noise=0.0)
    images = {}
    for azimuth_deg in (100.0, 260.0):
        write_shaded_map(tmp_path / "dem.tif", tmp_path / "shaded.tif", azimuth_deg, 35.0)
        with rasterio.open(tmp_path / "shaded.tif") as file:
            images[azimuth_deg] = file.read(1)
    with rasterio.open(tmp_path / "map.tif") as file:
        true = file.read(1)
        transform = file.transform
    # The map has the ground's own brightness and exact slopes, the model differences of heights.
    assert np.corrcoef(images[100.0].ravel(), true.ravel())[0, 1] > 0.85
    assert np.corrcoef(images[260.0].ravel(), true.ravel())[0, 1] < 0.2
    shaded = Map.open(tmp_path / "shaded.tif")
    assert shaded.shape == true.shape
    assert rasterio.open(tmp_path / "shaded.tif").transform == transform
    # Blocks of 512 pixels meet without an edge.
    steps = np.abs(np.diff(images[100.0].astype(float), axis=1)).mean(axis=0)
    assert steps[511] < 1.5 * np.median(steps)


def test_the_sun_is_one_direction_over_a_pole(tmp_path):
    """Ground that falls along x faces a Sun there on both sides of the pole, where its azimuth is another."""
    crs = "+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m +no_defs"
    # The middle is 60 km from the pole at longitude 90 degrees, where x is to the north.
    transform = rasterio.Affine(5000.0, 0.0, -100e3, 0.0, -5000.0, 160e3)
    heights = np.tile(-0.02 * 5000.0 * np.arange(64.0), (64, 1))
    with rasterio.open(tmp_path / "dem.tif", "w", "GTiff", 64, 64, 1, crs, transform, "float32") as file:
        file.write(heights.astype(np.float32), 1)
    images = {}
    for azimuth_deg in (0.0, 180.0):
        write_shaded_map(tmp_path / "dem.tif", tmp_path / "shaded.tif", azimuth_deg, 30.0)
        with rasterio.open(tmp_path / "shaded.tif") as file:
            images[azimuth_deg] = file.read(1).astype(int)
    assert (images[0.0] > images[180.0]).all()


def test_a_sun_below_the_horizon_is_refused(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 100.0, 1000.0)
    with pytest.raises(InputError, match="elevation above 0"):
        write_shaded_map(tmp_path / "dem.tif", tmp_path / "shaded.tif", 100.0, -5.0)


@pytest.mark.parametrize("name", ["lro_nac.json.gz", "lro_nac_polar.json.gz", "kaguya_tc.json.gz"])
def test_the_sun_of_an_epoch_is_where_support_data_of_real_images_have_it(tmp_path, name):
    known = read_isd(ISDS / name, axes="ME_DE421")
    east, north, up = known.sun_m / np.linalg.norm(known.sun_m)
    sub_solar = np.array([np.arctan2(north, east), np.arcsin(up)])
    # Below it, 40 degrees of longitude away: by the spherical triangle of both places and the pole.
    longitude, latitude = sub_solar[0] - np.radians(40.0), np.radians(20.0)
    Ground(TangentPlane(*np.degrees([longitude, latitude]).tolist()), seed=3).write_heights(
        tmp_path / "dem.tif", 100.0, 1e3
    )
    cosines = np.array([np.sin(latitude) * np.sin(sub_solar[1]), np.cos(latitude) * np.cos(sub_solar[1])])
    elevation_deg = np.degrees(np.arcsin(cosines @ [1.0, np.cos(np.radians(40.0))]))
    azimuth_deg = np.degrees(
        np.arctan2(
            np.sin(np.radians(40.0)),
            np.cos(latitude) * np.tan(sub_solar[1]) - np.sin(latitude) * np.cos(np.radians(40.0)),
        )
    )
    utc = to_scale(Epochs.from_tdb_seconds([known.epoch_tdb_s]), "UTC")
    found = sun_over_map(tmp_path / "dem.tif", utc)
    assert found[1] == pytest.approx(elevation_deg, abs=ABERRATION_DEG)
    assert found[0] == pytest.approx(azimuth_deg % 360.0, abs=ABERRATION_DEG / np.cos(np.radians(found[1])))


def test_an_epoch_at_night_is_refused(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 100.0, 1000.0)
    with pytest.raises(InputError, match=r"at 2020-12-20T00:00:00 UTC .* [\d.]+ degrees below the horizon"):
        sun_over_map(tmp_path / "dem.tif", epochs_from_strings("2020-12-20", "UTC"))
