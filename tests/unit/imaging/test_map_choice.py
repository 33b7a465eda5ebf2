"""Choice among several base maps: coverage of a region, Sun, pixel size; cross-validation of positions on them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from paths import EXAMPLES
from rasterio.transform import Affine
from terrain_maps import EQC, write_raster

from radioloc.errors import DataQualityWarning, InputError
from radioloc.imaging import image_chain, locate_images, read_image_study
from radioloc.imaging.map_choice import confidence_ellipse, find_candidates
from radioloc.imaging.matching import detect
from radioloc.imaging.study import ImageChoice
from radioloc.lunar import TangentPlane
from radioloc.time import epochs_from_strings

EXAMPLE = EXAMPLES / "images"
SHIFT_M = (24.0, 8.0)  # of a second map, east and north


@pytest.fixture
def maps(tmp_path):
    """Write maps of 2 km about longitudes on the equator: fine and coarse, one with a strip of values only."""

    def write(name, longitude_deg, pixel_m, filled=1.0):
        size = int(2000.0 / pixel_m)
        values = np.full((size, size), 100, np.uint8)
        values[:, int(filled * size) :] = 0
        west_m = np.radians(longitude_deg) * 1737400.0 - 1000.0
        transform = Affine(pixel_m, 0.0, west_m, 0.0, -pixel_m, 1000.0)
        return write_raster(tmp_path / name, values, crs=EQC, transform=transform, nodata=0)

    return (
        write("coarse.tif", 10.0, 20.0),
        write("fine.tif", 10.0, 10.0),
        write("strip.tif", 10.0, 5.0, 0.4),
        write("elsewhere.tif", 11.0, 5.0),
    )


def choice(maps, **options):
    return ImageChoice((Path("a.png"),), (1.0, 1.0), base_map=maps, **options)


def region(reach_deg=0.01):
    angle = np.linspace(0.0, 2.0 * np.pi, 20)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * reach_deg + [10.0, 0.0]
    return np.vstack([ring, [10.0, 0.0]])


def names(candidates):
    return [candidate.base.path.name for candidate in candidates]


def test_maps_with_values_all_over_the_region_are_searched_the_finest_first(maps):
    assert names(find_candidates(choice(maps), region())) == ["fine.tif", "coarse.tif"]
    assert len(find_candidates(choice(maps), None)) == 4
    with pytest.raises(InputError, match="elsewhere"):
        find_candidates(choice(maps), region(0.1))


def test_a_map_under_another_sun_is_searched_last_with_a_warning(maps):
    """The Sun is east of the site in the lunar morning and west in the afternoon."""
    morning, afternoon = "2020-11-24T00:00:00", "2020-12-04T00:00:00"
    epochs = (morning, afternoon)
    chosen = choice(maps[:2], base_map_epochs=epochs, epoch=epochs_from_strings(morning, "UTC"))
    with pytest.warns(DataQualityWarning, match="fine.tif"):
        candidates = find_candidates(chosen, region())
    assert names(candidates) == ["coarse.tif", "fine.tif"]
    assert candidates[0].sun_difference_deg == pytest.approx(0.0, abs=1e-9)
    assert candidates[1].sun_difference_deg > 150.0
    by_angle = choice(maps[:2], base_map_epochs=epochs, sun_azimuth_deg=90.0)
    with pytest.warns(DataQualityWarning, match="fine.tif"):
        assert names(find_candidates(by_angle, region())) == ["coarse.tif", "fine.tif"]
    with pytest.raises(InputError, match="expected 2"):
        choice(maps[:2], base_map_epochs=(morning,), sun_azimuth_deg=90.0)
    with pytest.raises(InputError, match="needs the epoch"):
        choice(maps[:2], base_map_epochs=epochs)


def test_ellipse_of_a_recorded_solution_contains_95_percent():
    sigma_m = (100.0, 30.0)
    content = {
        "position": {"me": {"longitude_deg": 10.0, "latitude_deg": 0.0}},
        "covariance": {"enu_m2": np.diag([*np.square(sigma_m), 1.0]).tolist()},
    }
    places_m = TangentPlane(10.0, 0.0).from_longitude_latitude(confidence_ellipse(content))
    distance = np.hypot(*(places_m[:-1] / sigma_m).T)
    np.testing.assert_allclose(distance, 2.4477, rtol=0, atol=1e-3)
    assert np.hypot(*places_m[-1]) < 1e-6


@pytest.mark.study
def test_positions_on_two_maps_are_compared(tmp_path, monkeypatch):
    """The second map is the first one, shifted; a third one is mirrored. Features are detected once."""
    detected = []
    monkeypatch.setattr(
        image_chain,
        "detect",
        lambda image, *options: detected.append(image.tobytes()) or detect(image, *options),
    )
    study = read_image_study(EXAMPLE / "descent.toml")
    first = study.images.base_map
    with rasterio.open(first) as file:
        values, profile = file.read(1), file.profile
    shifted = Affine.translation(*SHIFT_M) @ profile["transform"]
    for name, band, transform in (
        ("shifted.tif", values, shifted),
        ("mirrored.tif", values[:, ::-1], profile["transform"]),
    ):
        write_raster(tmp_path / name, band, **(profile | {"transform": transform}))
    files = study.images.files[:6]
    base_map = (tmp_path / "mirrored.tif", first, tmp_path / "shifted.tif")
    chosen = replace(study.images, base_map=base_map, base_map_sigma_m=(25.0, 25.0), files=files)
    solution = locate_images(replace(study, images=chosen))
    assert solution.map_name == "map.tif"
    rows = {row["map"]: row for row in solution.to_dict()["maps"]}
    assert "no image was found" in rows["mirrored.tif"]["status"]
    assert rows["map.tif"]["served"]
    difference = rows["shifted.tif"]["difference"]
    assert difference["east_m"] == pytest.approx(SHIFT_M[0], abs=1.0)
    assert difference["north_m"] == pytest.approx(SHIFT_M[1], abs=1.0)
    # The sigma of the difference is that of both ties.
    assert rows["shifted.tif"]["misfit_sigmas"] == pytest.approx(
        np.hypot(*SHIFT_M) / np.hypot(25.0, 25.0), rel=0.1
    )
    assert "map.tif served" in str(solution)
    assert json.dumps(solution.to_dict()["maps"])
    assert len(detected) == len(set(detected))
