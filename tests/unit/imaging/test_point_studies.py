"""A rover by stereo images of landmarks, and a lander in one orbital image: examples and errors of input."""

import json
import runpy
import shutil
from dataclasses import replace

import numpy as np
import pytest
from descent_images import FOLDER
from paths import EXAMPLES

import radioloc
from radioloc import compare
from radioloc.cli import main
from radioloc.imaging import (
    Camera,
    ConstantOrientation,
    FrameModel,
    Sphere,
    read_image_study,
    read_isd,
)
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.stereo import resect
from radioloc.lunar import TangentPlane
from radioloc.study import PlaceOnMap

STEREO = EXAMPLES / "stereo" / "stereo.toml"
ORBITAL = EXAMPLES / "images" / "orbital_image.toml"
CUBE = FOLDER / "M143947267L.cal.echo.crop.cub"

# Horizontal distances and the place printed in the Chang'e-3 paper (descent images, 2014).
PAPER_M = [15.888, 13.648, 17.584, 15.896]
PAPER_DEG = (-19.5126, 44.1188)
PRINTED_M = 5e-4


@pytest.fixture(scope="module")
def stereo():
    return read_image_study(STEREO)


@pytest.fixture(scope="module")
def by_stereo(stereo):
    return radioloc.imaging.locate_images(stereo)


@pytest.fixture(scope="module")
def orbital():
    return read_image_study(ORBITAL)


@pytest.fixture(scope="module")
def by_image(orbital):
    return radioloc.imaging.locate_images(orbital)


def changed(study, **fields):
    return replace(study, chosen=replace(study.chosen, **fields))


def from_place_m(solution, place_deg=PAPER_DEG, height_m=-2640.0):
    """Return east and north of a place on the ground, m."""
    longitude, latitude, _ = solution.position.selenographic
    scale = 1.0 + height_m / 1737400.0
    return scale * TangentPlane(*place_deg).from_longitude_latitude([[longitude, latitude]])[0]


def relative_en_m2(solution):
    """Return the covariance relative to the map."""
    return sum(source.covariance_enu_m2[:2, :2] for source in solution.sources if not source.shared)


def test_pixels_reproduce_distances_and_place_of_the_paper(by_stereo):
    distances_m = [landmark["distance_m"] for landmark in by_stereo.details["landmarks"]]
    np.testing.assert_allclose(distances_m, PAPER_M, rtol=0, atol=PRINTED_M)
    error_m = from_place_m(by_stereo)
    assert error_m @ np.linalg.solve(relative_en_m2(by_stereo), error_m) < 5.991  # 95 %
    assert by_stereo.sigma_enu_m[0] == pytest.approx(np.hypot(40.0, np.sqrt(relative_en_m2(by_stereo)[0, 0])))


def test_script_reproduces_the_example(monkeypatch, capsys):
    monkeypatch.chdir(EXAMPLES.parent)
    runpy.run_path(str(STEREO.parent / "simulate.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.count("left_px") == 4
    assert printed.strip() in STEREO.read_text()


def test_error_sources_sum_to_the_covariance_of_the_resection(stereo, by_stereo):
    chosen = stereo.chosen
    plane = TangentPlane(*PAPER_DEG)
    degrees = [[item.longitude_deg, item.latitude_deg] for item in chosen.landmarks]
    landmarks = (1.0 + chosen.height_m / 1737400.0) * plane.from_longitude_latitude(degrees)
    table = by_stereo.details["landmarks"]
    resection = resect(landmarks, *([row[key] for row in table] for key in ("distance_m", "sigma_m")), 0.5)
    np.testing.assert_allclose(relative_en_m2(by_stereo), resection.covariance_m2, rtol=1e-4)


@pytest.mark.parametrize(
    ("mounting_m", "attitude_deg", "expected_m"),
    [
        ((1.0, 0.0, 0.0), (90.0, 0.0, 0.0), (-1.0, 0.0)),  # ahead is east
        ((0.0, 1.0, 0.0), (90.0, 0.0, 0.0), (0.0, 1.0)),  # right is south
        ((0.0, 0.0, -2.0), (0.0, 0.0, 90.0), (-2.0, 0.0)),  # up with the right side down: east
        ((0.0, 0.0, -2.0), (0.0, 90.0, 0.0), (0.0, 2.0)),  # up with the front up: south
    ],
)
def test_position_of_the_body_follows_the_mounting(stereo, mounting_m, attitude_deg, expected_m):
    camera = radioloc.imaging.locate_images(changed(stereo, camera_in_body_m=(0.0, 0.0, 0.0)))
    body = radioloc.imaging.locate_images(
        changed(stereo, camera_in_body_m=mounting_m, body_attitude_deg=attitude_deg)
    )
    np.testing.assert_allclose(from_place_m(body) - from_place_m(camera), expected_m, atol=1e-4)


def with_distances(stereo, **fields):
    """Replace pixels with distances, and fields of the landmark b."""
    landmarks = [
        replace(item, left_px=None, right_px=None, distance_m=distance_m, distance_sigma_m=0.3)
        for item, distance_m in zip(stereo.chosen.landmarks, PAPER_M, strict=True)
    ]
    landmarks[1] = replace(landmarks[1], **fields)
    return changed(stereo, landmarks=tuple(landmarks), left=None, right=None, baseline_m=None)


def test_stated_distances_replace_pixels(stereo, by_stereo):
    located = radioloc.imaging.locate_images(with_distances(stereo))
    assert located.details["landmarks"][0]["misfit_sigmas"] is None
    assert np.linalg.norm(from_place_m(located) - from_place_m(by_stereo)) < 0.1
    assert " -" in str(located)


def test_wrong_landmark_is_not_converged(stereo, tmp_path, capsys):
    located = radioloc.imaging.locate_images(with_distances(stereo, distance_m=18.0))
    assert not located.converged
    assert "the distances do not agree with the map" in located.message
    text = STEREO.read_text()
    line = next(line for line in text.splitlines() if line.startswith("left_px"))
    sample, row = json.loads(line.partition("=")[2])
    (tmp_path / "study.toml").write_text(text.replace(line, f"left_px = [{sample}, {row + 8.0}]"))
    assert main(["images", str(tmp_path / "study.toml")]) == 3
    output = " ".join(capsys.readouterr().out.split())
    assert "NOT CONVERGED: the rays of landmark a are 1" in output


def test_lander_in_an_orbital_image_has_the_errors_of_the_orbit(by_image):
    """The orbit of the simulated file is 9 m east and 6 m south of the truth; pointing and pixel add some 1.5 m."""
    truth = json.loads((EXAMPLES / "images" / "truth.json").read_text())["lander"]
    error_m = from_place_m(by_image, (truth["longitude_deg"], truth["latitude_deg"]), truth["height_m"])
    np.testing.assert_allclose(error_m, [9.0, -6.0], atol=2.0)
    assert error_m @ np.linalg.solve(by_image.covariance_enu_m2[:2, :2], error_m) < 5.991
    assert abs(by_image.position.selenographic[2] - truth["height_m"]) < 3.0 * 10.0


def test_points_of_one_image_share_its_orbit(tmp_path):
    paths = []
    for name, point in (("one", "[2124.18, 999.20]"), ("two", "[2100.0, 900.0]")):
        text = ORBITAL.read_text().replace("[2124.18, 999.20]", point)
        for file in ("orbital_image.json", "dem.tif"):
            text = text.replace(f'"{file}"', f'"{ORBITAL.parent / file}"')
        (tmp_path / f"{name}.toml").write_text(text)
        solution = radioloc.imaging.locate_images(read_image_study(tmp_path / f"{name}.toml"))
        paths.append(tmp_path / f"{name}.json")
        paths[-1].write_text(json.dumps(solution.to_dict()))
    [pair] = compare(paths).agreements
    assert json.loads(paths[0].read_text())["sigma"]["east_m"] > 10.0
    assert pair.sigma_enu_m[0] < 1.0


def test_rover_on_a_map_is_an_observation_of_tracking_studies(by_stereo, tmp_path):
    path = tmp_path / "solution.json"
    path.write_text(json.dumps(by_stereo.to_dict()))
    place = PlaceOnMap(solution=path).read()
    assert place.map == "CE2-0236"
    ties_m = [place.errors_enu_m[f"map_tie.CE2-0236.{axis}"][:2] for axis in ("east", "north")]
    np.testing.assert_allclose(ties_m, 40.0 * np.eye(2), atol=1e-9)
    np.testing.assert_allclose(place.noise_enu_m2[:2, :2], relative_en_m2(by_stereo), atol=1e-9)


def test_solution_is_verified(tmp_path, capsys):
    study = tmp_path / "study.toml"
    shutil.copy(STEREO, study)
    content = radioloc.imaging.locate_images(read_image_study(study)).to_dict()
    solution = tmp_path / "solution.json"
    solution.write_text(json.dumps(content))
    assert main(["verify", str(solution)]) == 0
    content["position"]["pa"]["x_m"] += 1.0
    solution.write_text(json.dumps(content))
    assert main(["verify", str(solution)]) == 3
    assert "position.pa.x_m" in capsys.readouterr().out


def test_point_in_a_real_cube(orbital):
    if not CUBE.exists():
        pytest.skip(f"{CUBE} is not here")
    study = changed(orbital, model=CUBE, dem=None, height_m=-2500.0, point=(300.0, 299.0))
    located = radioloc.imaging.locate_images(study)
    expected = image_to_ground(read_isd(CUBE).model, [[300.0, 299.0]], Sphere(1734900.0))[0]
    np.testing.assert_allclose(located.position.xyz_m, expected, atol=1e-6)
    # Line 15999 + 299 of the image after the first of 13:06:40.356, at 0.36483 ms each.
    assert located.details["epoch"] == "2010-11-09T13:06:46.302 UTC"
    assert "LUNAR RECONNAISSANCE ORBITER NACL" in str(located)


WRONG = [
    (STEREO, "[stereo]", "[image_point]\nmodel = 'x'\n[stereo]", "exactly one of [images], [image_point]"),
    (STEREO, 'name = "b"', 'name = "a"', "the same name"),
    (STEREO, 'name = "b"', 'name = "b"\ndistance_m = 3.0', "landmark 'b': give either"),
    (STEREO, "baseline_m =", "#", "baseline_m is missing"),
    (STEREO, "principal_point_px = [511.5, 511.5]\n\n[stereo.r", "[stereo.r",
     "left.principal_point_px is missing"),
    (STEREO, "latitude_deg = 44.1192917", "latitude_deg = -44.1192917", "farther than 10 km"),
    (ORBITAL, 'dem = "dem.tif"', "", "height of the ground"),
    (ORBITAL, "999.20]", "9999.2]", "5064 samples"),
    (ORBITAL, "[10.0, 10.0, 5.0]", "10.0", "position_sigma_m: expected"),
    (ORBITAL, "orbital_image.json", "truth.json", "key name_model is missing"),
]  # fmt: skip


@pytest.mark.parametrize(("study", "old", "new", "says"), WRONG, ids=[says for *_, says in WRONG])
def test_invalid_studies_are_refused_in_one_line(study, old, new, says, tmp_path, capsys):
    text = study.read_text()
    assert old in text
    for name in ("orbital_image.json", "truth.json", "dem.tif"):
        (tmp_path / name).symlink_to(EXAMPLES / "images" / name)
    (tmp_path / "study.toml").write_text(text.replace(old, new, 1))
    assert main(["images", str(tmp_path / "study.toml")]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_camera_may_look_straight_down(monkeypatch, orbital):
    camera = Camera.of_pinhole(700.0, 7.0, [511.5, 511.5])
    support = read_isd(orbital.chosen.model, axes="ME_DE421")
    study = changed(orbital, dem=None, height_m=0.0, point=(511.5, 511.5))
    for longitude_rad in np.linspace(0.0, 1.0, 30):
        sine, cosine = np.sin(longitude_rad), np.cos(longitude_rad)
        down = np.array([[-sine, 0.0, -cosine], [cosine, 0.0, -sine], [0.0, -1.0, 0.0]])
        orientation = ConstantOrientation([1787400.0 * cosine, 1787400.0 * sine, 0.0], down)
        model = FrameModel(camera, orientation, (1024, 1024), axes="ME_DE421")
        monkeypatch.setattr(
            "radioloc.imaging.point_location.read_isd", lambda _, model=model: replace(support, model=model)
        )
        assert radioloc.imaging.locate_images(study).details["emission_deg"] < 1e-5
