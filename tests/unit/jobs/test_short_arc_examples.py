"""The examples of short arcs do what their page says, data made anew included."""

import numpy as np
import pytest
from ldem import write_ldem_4
from paths import EXAMPLES

import radioloc
from radioloc import cli

FOLDER = EXAMPLES / "change5"
LIKELY_SIGMAS = 5.1  # 1e-5 of chance in three coordinates


def horizontal_m(solution):
    return float(np.hypot(*solution.sigma_enu_m()[:2]))


def test_an_hour_of_ranges():
    solution = radioloc.locate(radioloc.read_study(FOLDER / "short_arc.toml"))
    assert solution.converged
    assert horizontal_m(solution) == pytest.approx(110.0, abs=3.0)
    assert solution.reference.combined_sigmas < LIKELY_SIGMAS


def test_an_hour_of_ranges_with_a_map():
    pytest.importorskip("rasterio")
    solution = radioloc.locate(radioloc.read_study(FOLDER / "short_arc_dem.toml"))
    assert solution.converged
    assert horizontal_m(solution) < 50.0
    assert solution.reference.combined_sigmas < LIKELY_SIGMAS


def test_data_are_what_the_study_says(tmp_path, capsys):
    assert cli.main(["simulate", str(FOLDER / "short_arc.toml"), "--out", str(tmp_path / "new.csv")]) == 0
    second, new = (
        radioloc.read_observations(file) for file in (FOLDER / "short_arc.csv", tmp_path / "new.csv")
    )
    assert (second.paths() == new.paths()).all()
    # A machine whose sine rounds otherwise may move a last digit.
    assert np.abs(second.value_m - new.value_m).max() < 1e-3


def test_map_is_an_excerpt(tmp_path):
    """Cells of the map are the whole map's own."""
    pytest.importorskip("rasterio")
    from radioloc.lunar import TerrainModel

    part = TerrainModel.open(FOLDER / "ldem_4_landing_site.tif")
    assert float(part.height_m(*np.radians([-51.9162, 43.0584]))) == pytest.approx(-2547.1, abs=0.1)
    longitude, latitude = np.radians(np.random.default_rng(1).uniform((-55, 40), (-49, 46), (100, 2))).T
    np.testing.assert_allclose(
        part.height_m(longitude, latitude),
        TerrainModel.open(write_ldem_4(tmp_path)).height_m(longitude, latitude),
        atol=1e-3,
    )
