"""Elevation models shaded as maps, against rendered ground, and brightness under the Sun by hand."""

import numpy as np
import pytest
import rasterio
from paths import ISDS
from procedural_ground import Ground
from terrain_maps import write_raster

from radioloc.errors import InputError
from radioloc.imaging import read_isd
from radioloc.imaging.shading import lunar_lambert, sun_direction, sun_over_map, write_shaded_map
from radioloc.lunar import Map, TangentPlane
from radioloc.time import Epochs, epochs_from_strings, to_scale

ABERRATION_DEG = 0.0058  # of 30.3 km/s: USGS states the apparent Sun
GROUND = Ground(TangentPlane(-51.9162, 43.0584), seed=3)


@pytest.mark.slow
def test_shaded_model_is_similar_to_rendered_ground_under_the_same_sun(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 20.0, 12000.0)
    GROUND.write_map(tmp_path / "map.tif", 20.0, 12000.0, sun_direction(100.0, 35.0), noise=0.0)
    images = {}
    for azimuth_deg in (100.0, 260.0):
        write_shaded_map(tmp_path / "shaded.tif", tmp_path / "dem.tif", azimuth_deg, 35.0)
        with rasterio.open(tmp_path / "shaded.tif") as file:
            images[azimuth_deg] = file.read(1)
    with rasterio.open(tmp_path / "map.tif") as file:
        true = file.read(1)
        transform = file.transform
    # The map has albedo and exact slopes, the model differences of heights.
    assert np.corrcoef(images[100.0].ravel(), true.ravel())[0, 1] > 0.85
    assert np.corrcoef(images[260.0].ravel(), true.ravel())[0, 1] < 0.2
    assert Map.open(tmp_path / "shaded.tif").shape == true.shape
    assert rasterio.open(tmp_path / "shaded.tif").transform == transform
    # Blocks of 512 pixels are continuous.
    steps = np.abs(np.diff(images[100.0].astype(float), axis=1)).mean(axis=0)
    assert steps[511] < 1.5 * np.median(steps)


def test_sun_has_one_direction_on_both_sides_of_a_pole(tmp_path):
    """Ground that falls along x faces the Sun on both sides of the pole, at different azimuths."""
    crs = "+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m +no_defs"
    # The middle is 60 km from the pole at longitude 90 degrees, where x is to the north.
    transform = rasterio.Affine(5000.0, 0.0, -100e3, 0.0, -5000.0, 160e3)
    heights = np.tile(-0.02 * 5000.0 * np.arange(64.0), (64, 1))
    write_raster(tmp_path / "dem.tif", heights.astype(np.float32), crs=crs, transform=transform)
    images = {}
    for azimuth_deg in (0.0, 180.0):
        write_shaded_map(tmp_path / "shaded.tif", tmp_path / "dem.tif", azimuth_deg, 30.0)
        with rasterio.open(tmp_path / "shaded.tif") as file:
            images[azimuth_deg] = file.read(1).astype(int)
    assert (images[0.0] > images[180.0]).all()


def test_sun_below_the_horizon_is_refused(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 100.0, 1000.0)
    with pytest.raises(InputError, match="elevation above 0"):
        write_shaded_map(tmp_path / "shaded.tif", tmp_path / "dem.tif", 100.0, -5.0)


@pytest.mark.parametrize("name", ["lro_nac.json.gz", "lro_nac_polar.json.gz", "kaguya_tc.json.gz"])
def test_sun_of_an_epoch_agrees_with_support_data_of_real_images(tmp_path, name):
    support = read_isd(ISDS / name, axes="ME_DE421")
    east, north, up = support.sun_m / np.linalg.norm(support.sun_m)
    sub_solar = np.array([np.arctan2(north, east), np.arcsin(up)])
    # At 40 degrees of longitude from the subsolar point: spherical triangle of both places and the pole.
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
    utc = to_scale(Epochs.from_tdb_seconds([support.epoch_tdb_s]), "UTC")
    sun_azimuth_deg, sun_elevation_deg = sun_over_map(Map.open(tmp_path / "dem.tif"), utc)
    assert sun_elevation_deg == pytest.approx(elevation_deg, abs=ABERRATION_DEG)
    assert sun_azimuth_deg == pytest.approx(
        azimuth_deg % 360.0, abs=ABERRATION_DEG / np.cos(np.radians(sun_elevation_deg))
    )


def test_epoch_at_night_is_refused(tmp_path):
    GROUND.write_heights(tmp_path / "dem.tif", 100.0, 1000.0)
    with pytest.raises(InputError, match="degrees below the horizon"):
        sun_over_map(Map.open(tmp_path / "dem.tif"), epochs_from_strings("2020-12-20", "UTC"))


def test_lunar_lambert_law_by_hand():
    """Level ground, camera above, the Sun 30 degrees from the zenith: L = 1 - 0.57 + 0.2178 - 0.03942."""
    weight = 1.0 - 0.019 * 30.0 + 2.42e-4 * 900.0 - 1.46e-6 * 27000.0
    cosine = np.cos(np.radians(30.0))
    expected = 2.0 * weight * cosine / (1.0 + cosine) + (1.0 - weight) * cosine
    assert lunar_lambert(cosine, 1.0, np.radians(30.0)) == pytest.approx(expected, rel=1e-14)


def test_direction_of_the_sun_by_its_angles():
    np.testing.assert_allclose(sun_direction(90.0, 30.0), [np.cos(np.pi / 6), 0.0, 0.5], atol=1e-15)
    np.testing.assert_allclose(sun_direction(0.0, 90.0), [0.0, 0.0, 1.0], atol=1e-15)
