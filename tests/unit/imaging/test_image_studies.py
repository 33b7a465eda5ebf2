"""Location of a lander by descent images: the example, errors of input, output files."""

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from paths import EXAMPLES
from rasterio.transform import Affine
from rasterio.windows import Window
from terrain_maps import write_raster

import radioloc
from radioloc.cli import main
from radioloc.imaging import read_image_study
from radioloc.lunar import TangentPlane

EXAMPLE = EXAMPLES / "images"
SHIFT_M = (30.0, -20.0)  # planted in the map, see its simulate.py
MAP_PIXEL_M = 8.0


@pytest.fixture(scope="module")
def study():
    return read_image_study(EXAMPLE / "descent.toml")


@pytest.fixture(scope="module")
def some(study, tmp_path_factory):
    """Study of the first frames, then every second one, on the middle of the map."""
    path, cells, first = tmp_path_factory.mktemp("map") / "map.tif", 506, 309
    with rasterio.open(study.images.base_map) as dataset:
        values = dataset.read(window=Window(first, first, cells, cells))
        (cell_m, _), bounds = dataset.res, dataset.bounds
        west_m, north_m = bounds.left + first * cell_m, bounds.top - first * cell_m
        place = {"crs": dataset.crs, "transform": Affine(cell_m, 0.0, west_m, 0.0, -cell_m, north_m)}
    write_raster(path, values, **place)
    files = study.images.files
    return replace(study, images=replace(study.images, base_map=path, files=(*files[:3], *files[3::2])))


@pytest.fixture(scope="module")
def solution(some):
    return radioloc.imaging.locate_images(some)


def error_m(solution):
    """Return the horizontal error less the planted shift, east and north."""
    truth = json.loads((EXAMPLE / "truth.json").read_text())["lander"]
    plane = TangentPlane(truth["longitude_deg"], truth["latitude_deg"])
    longitude, latitude, _ = solution.position.selenographic
    return plane.from_longitude_latitude([[longitude, latitude]])[0] - SHIFT_M


@pytest.mark.study
def test_lander_is_located_within_a_pixel_of_the_map(solution):
    assert solution.converged
    assert np.hypot(*error_m(solution)) < MAP_PIXEL_M
    relative = solution.relative_covariance_en_m2
    assert error_m(solution) @ np.linalg.solve(relative, error_m(solution)) < 13.8  # 1 in 1000
    # The tie of the map is nearly all of the total sigma, and the height follows the elevation model.
    assert solution.sigma_enu_m[:2] == pytest.approx([25.0, 25.0], abs=0.5)
    assert solution.position.selenographic[2] == pytest.approx(-2544.8, abs=3.0 * solution.sigma_enu_m[2])


@pytest.mark.study
@pytest.mark.parametrize("point", ["centre", (159.5, 159.5)])
def test_high_last_image_widens_the_sigma_by_the_unknown_descent(some, point):
    # 0003.png is from 2.3 km, and the descent is still oblique.
    images = replace(some.images, files=some.images.files[:3], base_map_sigma_m=(0.1, 0.1), point=point)
    solution = radioloc.imaging.locate_images(replace(some, images=images))
    offset_m, sigma_m = np.abs(error_m(solution)), solution.sigma_enu_m[:2]
    notes = [note for note in solution.notes if "unknown motion" in note]
    if point == "centre":
        assert solution.converged
        assert len(notes) == 1
        assert (offset_m < 2.0 * sigma_m).all()
        assert 400.0 < sigma_m.max() < 1000.0  # the image shows 1.9 km
    else:  # the pixel of the lander
        assert not notes
        assert sigma_m.max() < 10.0


@pytest.mark.study
def test_altitudes_agree_with_the_truth(solution):
    truth = {f["file"]: f["altitude_m"] for f in json.loads((EXAMPLE / "truth.json").read_text())["frames"]}
    assert len(solution.altitudes_m) == 10
    for name, altitude_m in solution.altitudes_m.items():
        assert altitude_m == pytest.approx(truth[name], rel=0.06)  # above the visible ground


@pytest.mark.study
@pytest.mark.usefixtures("undrawn")
def test_written_solution_has_the_common_keys_and_the_images(solution, tmp_path):
    paths = radioloc.write_report(tmp_path, solution)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == {*paths}
    content = json.loads((tmp_path / "solution.json").read_text())
    assert {"converged", "position", "sigma", "biases", "fit", "provenance", "images"} <= set(content)
    assert content["position"]["pa"]["frame"] == "PA_DE421"
    images = content["images"]
    assert [image["status"] for image in images] == ["registered"] * 10
    assert all(len(image["parameters"]) == 8 and np.shape(image["covariance"]) == (8, 8) for image in images)
    assert radioloc.compare([tmp_path / "solution.json"]).rows[0].method == "images"


@pytest.mark.slow
def test_command_runs_the_complete_example(tmp_path, capsys):
    assert main(["images", str(EXAMPLE / "descent.toml"), "--out", str(tmp_path / "out")]) == 0
    assert "16 of 16 registered" in " ".join(capsys.readouterr().out.split())
    content = json.loads((tmp_path / "out" / "solution.json").read_text())
    assert content["reference"]["horizontal_m"] == pytest.approx(np.hypot(*SHIFT_M), abs=MAP_PIXEL_M)


@pytest.mark.slow
def test_shaded_elevation_model_serves_as_a_map(study, tmp_path):
    import importlib.util

    spec = importlib.util.spec_from_file_location("simulate", EXAMPLE / "simulate.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.GROUND.write_heights(tmp_path / "dem.tif", 10.0, 9000.0, SHIFT_M)
    chosen = replace(
        study.images,
        base_map=None,
        dem=tmp_path / "dem.tif",
        shade=True,
        sun_azimuth_deg=script.DESCENT.sun_azimuth_deg,
        sun_elevation_deg=script.DESCENT.sun_elevation_deg,
    )
    shaded = radioloc.imaging.locate_images(replace(study, images=chosen))
    assert shaded.converged
    assert np.hypot(*error_m(shaded)) < 10.0  # a cell


WRONG = {
    'base_map = "map.tif"': ("", "base_map is missing"),
    "base_map_sigma_m = [25.0, 25.0]": ("", "base_map_sigma_m: is missing"),
    'files = ["frames/*.png"]': ('files = ["frames/*.jpg"]', "matches no file"),
    'dem = "dem.tif"': ('dem = "dem.tif"\nheight_m = 3.0', "either dem or height_m"),
    "[camera]": ("[cameras]", "'cameras' is not known; did you mean 'camera'"),
    "[images]": ('[images]\npoint = "middle"', "[images] point: expected"),
}


@pytest.mark.parametrize("text", WRONG)
def test_invalid_studies_are_refused_in_one_line(text, tmp_path, capsys):
    content = (EXAMPLE / "descent.toml").read_text()
    new, says = WRONG[text]
    assert content.count(text) == 1
    for name in ("map.tif", "dem.tif"):
        (tmp_path / name).symlink_to(EXAMPLE / name)
    (tmp_path / "frames").symlink_to(EXAMPLE / "frames")
    (tmp_path / "study.toml").write_text(content.replace(text, new))
    assert main(["images", str(tmp_path / "study.toml")]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
