"""Points of stereo pairs: a textured plane in front of two cameras of different focal lengths, with distortion."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.imaging import locate_images, read_image_study

SIZE = (400, 300)
STUDY = """[stereo_pair]
left_image = "left.png"
right_image = "right.png"
baseline_m = [0.27, 0.002, -0.001]
rotation_deg = [0.05, -0.3, 0.1]
camera_in_body_m = [0.25, -0.13, -1.4]
camera_attitude_deg = [0.0, -20.0, 0.0]
left = {{ focal_length_mm = 6.0, pixel_size_um = 15.0, distortion = [-0.05, 0.0, 0.0, 0.0, 0.0] }}
right = {{ focal_length_mm = 6.1, pixel_size_um = 15.0 }}
{more}
"""
FEATURES = {"a": (120.0, 160.0), "b": (290.0, 230.0)}
# The ground is the plane n . X = d in the left camera's axes, 1.4 m below a camera that looks 20 degrees down.
NORMAL, HEIGHT_M = np.array([0.0, np.cos(np.radians(20.0)), np.sin(np.radians(20.0))]), 1.4


def draw(folder, noise=1.0):
    """Write both views of a plane with texture, and the study."""
    folder.mkdir(exist_ok=True)
    features = "".join(
        f'[[stereo_pair.features]]\nname = "{k}"\nleft_px = {list(v)}\n' for k, v in FEATURES.items()
    )
    for name in ("left", "right"):
        (folder / f"{name}.png").touch()
    (folder / "study.toml").write_text(STUDY.format(more=features))
    chosen = read_image_study(folder / "study.toml").chosen
    rng = np.random.default_rng(3)
    texture = sum(
        cv2.resize(
            rng.uniform(-1.0, 1.0, (n, n)).astype(np.float32), (2000, 2000), interpolation=cv2.INTER_CUBIC
        )
        for n in (150, 400, 900)
    )
    turn = Rotation.from_rotvec(chosen.rotation_deg, degrees=True).as_matrix()
    for name, camera, place, axes in (
        ("left", chosen.left, np.zeros(3), np.eye(3)),
        ("right", chosen.right, np.array(chosen.baseline_m), turn),
    ):
        pixels = np.stack(np.meshgrid(*map(np.arange, SIZE)), axis=-1).reshape(-1, 2)
        rays = camera.camera(SIZE[::-1]).directions(pixels) @ axes.T
        with np.errstate(divide="ignore"):
            points = place + ((HEIGHT_M - NORMAL @ place) / (rays @ NORMAL))[:, None] * rays
        on_ground = (rays @ NORMAL > 0.0) & (points[:, 2] < 200.0)
        ahead = points @ np.cross([1.0, 0.0, 0.0], NORMAL)
        at = np.column_stack([1000.0 + 100.0 * points[:, 0], 1000.0 - 100.0 * ahead]).astype(np.float32)
        values = cv2.remap(texture, at.reshape(*SIZE[::-1], 2), None, cv2.INTER_LINEAR)
        grey = np.where(on_ground.reshape(SIZE[::-1]), 120.0 + 40.0 * values, 5.0)
        grey = np.clip(grey + rng.normal(0.0, noise, grey.shape), 0, 255)
        cv2.imwrite(str(folder / f"{name}.png"), grey.astype(np.uint8))
    return folder / "study.toml"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return draw(tmp_path_factory.mktemp("stereo"))


def true_point(study, pixel):
    """Return the point of the plane at a pixel of the left image, in the axes of the body."""
    chosen = read_image_study(study).chosen
    [ray] = chosen.left.camera(SIZE[::-1]).directions([pixel])
    right, down, ahead = ray * HEIGHT_M / (NORMAL @ ray)
    pitch = np.radians(20.0)
    turned = [
        ahead * np.cos(pitch) - down * np.sin(pitch),
        right,
        ahead * np.sin(pitch) + down * np.cos(pitch),
    ]
    return np.array(turned) + chosen.camera_in_body_m


def test_points_lie_on_the_ground_within_their_sigma(study):
    result = locate_images(study)
    # The ground is 1.4 m below the camera, which is 1.4 m above the body's origin.
    precise = result.cloud_sigma_m < 0.1
    assert precise.sum() > 1000
    assert np.median(np.abs(result.cloud_m[precise, 2])) < 0.02
    assert np.mean(np.abs(result.cloud_m[precise, 2]) < 3.0 * result.cloud_sigma_m[precise]) > 0.95
    # The horizon is an edge without texture along the lines.
    assert np.mean(np.abs(result.cloud_m[:, 2]) > 6.0 * result.cloud_sigma_m) < 1e-3


def test_features_and_their_distance(study):
    result = locate_images(study)
    truth = [true_point(study, pixel) for pixel in FEATURES.values()]
    for position, covariance, expected in zip(
        result.feature_m, result.feature_covariance_m2, truth, strict=True
    ):
        error = position - expected
        assert error @ np.linalg.solve(covariance, error) < 11.3  # chi squared of three, 1 in 100
    [row] = result.distances()
    assert row["distance_m"] == pytest.approx(np.linalg.norm(truth[1] - truth[0]), abs=3.0 * row["sigma_m"])


def test_command_writes_a_point_cloud(study, tmp_path):
    assert main(["images", str(study), "--out", str(tmp_path), "--quiet"]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert {"stereo_points.json", "points.csv", "points.ply", "stereo.png"} <= names
    lines = (tmp_path / "points.ply").read_text().splitlines()
    start = lines.index("end_header")
    assert f"element vertex {len(lines) - start - 1}" in lines[:start]
    assert len(lines[-1].split()) == 7


def test_feature_outside_the_right_image_is_refused(study):
    path = study.parent / "outside.toml"
    path.write_text(study.read_text().replace(str(list(FEATURES["a"])), "[3.0, 295.0]"))
    with pytest.raises(InputError, match="feature 'a'"):
        locate_images(path)
