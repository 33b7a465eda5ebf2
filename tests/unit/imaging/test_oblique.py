"""Oblique images: views straight down, attitudes from tables and homographies, the study's keys."""

import numpy as np
import pytest

from radioloc.errors import FileFormatError, InputError
from radioloc.imaging import Camera
from radioloc.imaging.cameras import distorted, undistorted
from radioloc.imaging.oblique import TurnedImage, read_attitudes, searched_verticals, vertical_of_homography
from radioloc.imaging.orientation import quaternions_from_matrices, rotation_matrices
from radioloc.imaging.study import ImageChoice, ImageStudy

SIZE = (300, 240)
CAMERA = Camera.of_pinhole(10.0, 30.0, [149.5, 119.5], [-0.05])
TILTS_DEG = (20.0, 40.0, 60.0)
HEIGHT_M = 1000.0


def oblique(tilt_deg):
    """Return the rotation from east, north, up to the camera, tilted to the north, and the image of a grid of discs."""
    looks = np.array(
        [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    )  # straight down, north up in the image
    return rotation_matrices(np.radians([[tilt_deg, 0.0, 0.0]]))[0] @ looks


def drawn_ground(rotation):
    """Return an image of brightness that varies with east and north, and the places of its pixels, in heights."""
    pixels = (
        np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 2).astype(float)
    )
    rays = CAMERA.directions(pixels) @ rotation
    places = rays[:, :2] / -rays[:, 2:]
    image = 120.0 + 60.0 * np.sin(places[:, 0] * 40.0) * np.cos(places[:, 1] * 40.0)
    return np.rint(image).astype(np.uint8).reshape(SIZE[::-1]), places


@pytest.mark.parametrize("tilt_deg", TILTS_DEG)
def test_turned_images_show_the_ground_to_scale(tilt_deg):
    """Ground points on a lattice have pixels on a lattice, as in an image taken straight down."""
    rotation = oblique(tilt_deg)
    turned = TurnedImage.of_vertical(CAMERA, SIZE, -rotation[:, 2])
    image, _ = drawn_ground(rotation)
    view, valid = turned.drawn(image, None, 1)
    assert 0.2 < valid.mean() < 1.0
    lines, samples = np.nonzero(valid)
    pick = slice(None, None, 97)
    pixels, sizes = turned.straight(np.column_stack([samples, lines])[pick].astype(float), 1)
    rays = CAMERA.directions(distorted(CAMERA)(pixels)[0]) @ rotation
    places = rays[:, :2] / -rays[:, 2:]
    # A similarity from places to pixels of the view.
    design = np.column_stack([places, np.ones(len(places))])
    fitted, *_ = np.linalg.lstsq(design, np.column_stack([samples, lines])[pick].astype(float), rcond=None)
    assert np.abs(design @ fitted - np.column_stack([samples, lines])[pick]).max() < 1e-6
    east, north = fitted[0], fitted[1]
    assert np.hypot(*east) == pytest.approx(np.hypot(*north), rel=1e-9)
    assert east @ north == pytest.approx(0.0, abs=1e-6)
    # The area of pixels in the middle is kept.
    middle = np.argmin(np.hypot(*(undistorted(CAMERA)(np.array([[149.5, 119.5]])) - pixels).T))
    assert sizes[middle] == pytest.approx(1.0, abs=0.1)
    expected = 120.0 + 60.0 * np.sin(places[:, 0] * 40.0) * np.cos(places[:, 1] * 40.0)
    assert np.abs(view[lines, samples][pick] - expected).mean() < 4.0


@pytest.mark.parametrize("tilt_deg", TILTS_DEG)
def test_vertical_follows_from_the_homography_of_the_previous_image(tilt_deg):
    rotation = oblique(tilt_deg)
    position_m = np.array([0.0, 0.0, HEIGHT_M])
    to_pixel = CAMERA.matrix @ rotation @ np.column_stack([np.eye(3)[:, :2], -position_m])
    vertical = vertical_of_homography(CAMERA, np.linalg.inv(to_pixel), np.array([149.5, 119.5]))
    np.testing.assert_allclose(vertical, -rotation[:, 2], rtol=0, atol=1e-6)


def test_searched_verticals_are_within_25_degrees_of_tilts_up_to_60_degrees():
    verticals = np.array(list(searched_verticals()))
    np.testing.assert_allclose(np.linalg.norm(verticals, axis=1), 1.0)
    rng = np.random.default_rng(1)
    tilt, angle = np.radians(rng.uniform(0.0, 60.0, 500)), rng.uniform(0.0, 2.0 * np.pi, 500)
    drawn = np.column_stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)])
    assert (drawn @ verticals.T).max(axis=1).min() > np.cos(np.radians(25.0))


def test_attitudes_are_read_from_a_table(tmp_path):
    rotation = oblique(40.0).T
    numbers = ",".join(f"{part:.9f}" for part in quaternions_from_matrices(rotation[np.newaxis])[0])
    path = tmp_path / "attitudes.csv"
    path.write_text(f"file,qw,qx,qy,qz\n0001.png,{numbers}\n")
    np.testing.assert_allclose(read_attitudes(path)["0001.png"], rotation, rtol=0, atol=1e-8)
    path.write_text("file,qw,qx,qy,qz\n0001.png,2.0,0,0,0\n")
    with pytest.raises(FileFormatError, match="length 1"):
        read_attitudes(path)


def test_keys_of_oblique_images_need_each_other(tmp_path):
    files, options = (tmp_path / "a.png",), {"base_map": tmp_path / "map.tif"}
    with pytest.raises(InputError, match="rectify = true"):
        ImageChoice(files, (1.0, 1.0), attitudes=tmp_path / "a.csv", **options)
    with pytest.raises(InputError, match="camera"):
        ImageStudy(ImageChoice(files, (1.0, 1.0), rectify=True, **options))
