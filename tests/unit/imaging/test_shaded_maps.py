"""Elevation models shaded as maps: the same ground, drawn as the renderer draws it."""

import numpy as np
import pytest
import rasterio

from radioloc.errors import InputError
from radioloc.imaging import Map, TangentPlane
from radioloc.imaging.shaded_maps import write_shaded_map
from radioloc.imaging.shading import sun_direction
from radioloc.simulation.ground import Ground

GROUND = Ground(TangentPlane(-51.9162, 43.0584), seed=3)


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
    with pytest.raises(InputError, match="lights no ground"):
        write_shaded_map(tmp_path / "dem.tif", tmp_path / "shaded.tif", 100.0, -5.0)
