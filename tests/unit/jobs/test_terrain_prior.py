"""A study with a terrain map: the height follows the map wherever the estimate goes, and the report names the map."""

import json

import numpy as np
import pytest
from change5_case import LANDER, NEAR, observations
from terrain_maps import MAPS, heights_of_map, surface_m, write

import radioloc
from radioloc import Study
from radioloc.lunar import TerrainModel
from radioloc.report.figure_types import FIGURES
from radioloc.report.files import write_report
from radioloc.study import EstimateChoice, Reference
from radioloc.study.study import TerrainPrior


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    """Hilly, and as high as the lander where that stands."""
    longitude_deg, latitude_deg, height_m = LANDER.selenographic
    raised_m = height_m - float(surface_m(np.radians(longitude_deg), np.radians(latitude_deg)))
    proj4, affine, rows, columns, *_ = MAPS["equirectangular, -180 to 180"]
    path = tmp_path_factory.mktemp("map") / "heights.tif"
    return TerrainModel.open(
        write(path, heights_of_map(proj4, affine, rows, columns) + raised_m, proj4, affine)
    )


@pytest.mark.study
@pytest.mark.usefixtures("undrawn")
def test_an_hour_of_ranges_with_a_map(model, terrain, tmp_path):
    tracked = observations(model, 60.0, stop="2020-12-01T16:11:00", vlbi=False, bias_m={})
    choice = EstimateChoice(
        range_bias="all", range_bias_sigma_m=10.0, height_prior=TerrainPrior(terrain, sigma_m=5.0)
    )
    # The start is 10 km off, where the map is otherwise high.
    study = Study(target=NEAR, estimate=choice, reference=Reference(LANDER, "truth"), consider_defaults=False)
    solution = radioloc.locate(study, tracked)
    assert solution.converged
    assert solution.reference.combined_sigmas < 5.1  # 1e-5 of chance in three coordinates
    assert np.hypot(*solution.sigma_enu_m()[:2]) < 100.0
    above_m, sigma_m = (column["position.height_above_terrain"] for column in values_and_sigmas(solution))
    assert abs(above_m) < 4.4 * sigma_m
    longitude_deg, latitude_deg, height_m = solution.selenographic
    map_m = float(terrain.height_m(np.radians(longitude_deg), np.radians(latitude_deg)))
    assert height_m == pytest.approx(map_m + above_m, abs=1e-3)
    write_report(tmp_path, solution)
    prior = json.loads((tmp_path / "solution.json").read_text())["provenance"]["estimate"]["height_prior"]
    [file] = terrain.metadata.files
    assert prior == {
        "dem": [{"name": "heights.tif", "sha256": file.sha256}],
        "interpolation": "bilinear",
        "sigma_m": 5.0,
    }


def values_and_sigmas(solution):
    names = solution.parameters.names
    return dict(zip(names, solution.values, strict=True)), dict(zip(names, solution.sigmas(), strict=True))


@pytest.mark.study
def test_the_position_is_drawn_on_terrain_as_fine_as_its_sigma(tmp_path, monkeypatch):
    monkeypatch.setattr("radioloc.report.files.available_figures", lambda _: [FIGURES["map"]])
    solution = radioloc.locate("examples/change5/short_arc_dem.toml")
    drawn = tmp_path / "map.png"
    # Cells of 60 m and of 7.6 km; sigmas of 25 and 40 m.
    for name, shaded in (("images/dem.tif", True), ("change5/ldem_4_landing_site.tif", False)):
        write_report(tmp_path, solution, dem=TerrainModel.open(f"examples/{name}"))
        assert drawn.is_file() is shaded
