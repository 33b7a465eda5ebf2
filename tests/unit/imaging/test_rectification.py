"""Images turned by software."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from image_descents import SITE, Descent, scene

from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera, rectification, undistorted
from radioloc.imaging.homography import transformed
from radioloc.imaging.image_chain import Frame
from radioloc.imaging.registration import register_chain
from radioloc.lunar.maps import Map

CENTRE = np.array([249.5, 199.5])
CAMERA = Camera.of_pinhole(8.3, 16.6, CENTRE)  # focal length of 500 pixels
K = np.array([[500.0, 0.0, CENTRE[0]], [0.0, 500.0, CENTRE[1]], [0.0, 0.0, 1.0]])
LENS = (-0.12, 0.03, 1e-3, -5e-4, 0.0)


def test_undistorted_pixels_are_opencv_s():
    camera = Camera.of_pinhole(8.3, 16.6, CENTRE, LENS)
    pixels = np.random.default_rng(1).uniform(0.0, 400.0, (50, 2))
    ideal = undistorted(camera)(pixels)
    directions = np.column_stack([(ideal - CENTRE) / 500.0, np.ones(len(ideal))])
    expected, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), K, np.array(LENS))
    np.testing.assert_allclose(pixels, expected[:, 0], rtol=0, atol=1e-6)


def tilted(angle_deg):
    """The axis of a camera tilted about x: its view of a plane below, and the direction down in its axes."""
    angle = np.radians(angle_deg)
    down = np.array([0.0, np.sin(angle), np.cos(angle)])
    # columns: the camera's axes in (sample, line, down) of a camera that looks straight down
    to_level = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    return K @ to_level @ np.linalg.inv(K), down


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 60.0])
def test_the_view_from_above(angle_deg):
    expected, down = tilted(angle_deg)
    found = rectification(CAMERA, 3.0 * down)
    pixels = np.array([[100.0, 350.0], [400.0, 380.0], [249.5, 199.5]])
    np.testing.assert_allclose(transformed(found, pixels), transformed(expected, pixels), rtol=0, atol=1e-6)


def test_a_camera_that_looks_along_minus_z():
    camera = Camera(8.3, np.eye(2) * 1e3 / 16.6, CENTRE, looks_along_z=-1)
    pixel = np.array([[249.5, 350.0]])
    down = camera.directions(pixel)[0]
    np.testing.assert_allclose(transformed(rectification(camera, down), pixel)[0], CENTRE, rtol=0, atol=1e-6)


def oblique(angle_deg, pixel):
    """An image that sees the site at its centre, tilted; pixels of the drawn ground at the nadir's distance."""
    to_level, down = tilted(angle_deg)
    at_centre = transformed(to_level, CENTRE[np.newaxis])[0]
    to_ground = np.array(
        [[pixel, 0, 999.5 - pixel * at_centre[0]], [0, pixel, 999.5 - pixel * at_centre[1]], [0, 0, 1.0]]
    )
    matrix = to_ground @ to_level
    smooth = cv2.GaussianBlur(scene(), (0, 0), 0.8)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(smooth, matrix, (500, 400), flags=flags, borderMode=cv2.BORDER_REFLECT)
    return image, down


@pytest.mark.slow
def test_the_approximate_attitude_finds_more_in_a_very_oblique_image(tmp_path):
    """Seen 65 degrees off the vertical; the attitude is 4 degrees wrong. Without, only its lower part is tied."""
    base = Map.open(Descent().write_map(tmp_path / "map.tif"))
    assert (base.plane().longitude_deg, base.plane().latitude_deg) == pytest.approx(SITE, abs=1e-9)
    image, _ = oblique(65.0, 2.0)
    about = rectification(CAMERA, tilted(61.0)[1])
    inliers = []
    for turned in (None, about):
        frames = [Frame("oblique", lambda: image, rectification=turned)]
        result = register_chain(frames, base, map_sigma_m=(5.0, 5.0))
        inliers.append(result.frames[0].inliers)
        if turned is None:
            with pytest.raises(InputError, match="far beyond the ground"):
                result.ground_point("oblique")
            continue
        point = result.ground_point("oblique")
        found_m = base.plane().from_longitude_latitude([[point.longitude_deg, point.latitude_deg]])[0]
        assert found_m @ np.linalg.solve(point.covariance_m2, found_m) < 13.8  # chi squared, once in 1000
    assert inliers[1] > 2 * inliers[0]
    np.testing.assert_allclose(found_m, 0.0, rtol=0, atol=2.0)  # half a pixel of the map


@pytest.mark.parametrize(
    ("down", "message"),
    [
        ([0.0, 0.0, 0.0], "not before the camera"),
        ([0.0, np.nan, 1.0], "not 3 finite numbers"),
        ([0, 0, -1.0], "looks up"),
    ],
)
def test_directions_refused(down, message):
    with pytest.raises(InputError, match=message):
        rectification(CAMERA, down)
