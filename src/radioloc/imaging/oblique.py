"""Oblique images: views straight down by the attitude, in which features are detected.

A rotation R of the camera that turns the vertical onto its axis changes undistorted pixels by the homography
:math:`K R K^{-1}`, whatever the position (Hartley and Zisserman 2004, section 8.4.2). Features of the turned image look
as on a map. The attitude is known, follows from the previous image, or is searched for: the turned image with the least
number of false alarms on the map is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import FileFormatError
from radioloc.imaging.cameras import Camera, distorted, sight_matrix
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import derivative, transformed
from radioloc.imaging.orientation import matrices_from_quaternions
from radioloc.imaging.projections import pose_of_homography
from radioloc.lunar.grey_images import Image, Mask
from radioloc.text_files import parse_numbers, read_rows
from radioloc.vectors import Floats, cross_matrices

_COLUMNS = ("file", "qw", "qx", "qy", "qz")
_MAX_NORM_ERROR = 1e-3  # of a quaternion written with three digits
_CANVAS_PART = 1.5  # sides of the turned image, in sides of the image
_SEARCHED_TILTS_DEG, _SEARCHED_DIRECTIONS = (30.0, 50.0), 8


@dataclass(frozen=True, slots=True, eq=False)
class TurnedImage:
    """Geometry of an image turned straight down."""

    camera: Camera
    size: tuple[int, int]  # samples and lines of the image
    to_turned: Floats  # from undistorted pixels, shape (3, 3)

    @classmethod
    def of_vertical(cls, camera: Camera, size: tuple[int, int], vertical: Floats) -> TurnedImage:
        """Build from the unit vector down in axes with z along the line of sight; the middle keeps its scale."""
        cross = cross_matrices(np.cross(vertical, [0.0, 0.0, 1.0]))
        turn = np.eye(3) + cross + cross @ cross / (1.0 + vertical[2])
        matrix = sight_matrix(camera)
        turned = matrix @ turn @ np.linalg.inv(matrix)
        middle = 0.5 * (np.array([size], dtype=np.float64) - 1.0)
        scale = abs(np.linalg.det(derivative(turned, middle)[0])) ** -0.5
        shift = middle[0] * _CANVAS_PART - scale * transformed(turned, middle)[0]
        return cls(camera, size, np.array([[scale, 0, shift[0]], [0, scale, shift[1]], [0, 0, 1.0]]) @ turned)

    def drawn(self, image: Image, mask: Mask | None, reduction: int) -> tuple[Image, Mask]:
        """Draw an image, reduced by a whole number, with the mask of pixels that show usable ground."""
        cv2 = load_opencv()
        samples, lines = (int(_CANVAS_PART * side / reduction) for side in self.size)
        grid = np.mgrid[:lines, :samples][::-1].reshape(2, -1).T.astype(np.float64)
        places = (grid + 0.5) * reduction - 0.5
        straight = transformed(np.asarray(np.linalg.inv(self.to_turned), np.float64), places)
        usable = np.column_stack([places, np.ones(len(places))]) @ np.linalg.inv(self.to_turned)[2] > 0.0
        pixels, on_lens = distorted(self.camera)(np.nan_to_num(straight))
        pixels = (pixels + 0.5) / reduction - 0.5
        in_image = ((pixels >= 0.0) & (pixels <= np.array(image.shape[::-1]) - 1.0)).all(axis=1)
        x, y = pixels.T.astype(np.float32).reshape(2, lines, samples)
        valid = (usable & on_lens & in_image).reshape(lines, samples)
        if mask is not None:
            valid &= cv2.remap(mask.astype(np.uint8), x, y, cv2.INTER_NEAREST) == 1
        return cv2.remap(image, x, y, cv2.INTER_LINEAR), valid

    def straight(self, places: Floats, reduction: int) -> tuple[Floats, Floats]:
        """Return undistorted pixels of places in the drawn image, and their size in its pixels, shape (n,)."""
        matrix = np.asarray(np.linalg.inv(self.to_turned), np.float64)
        full = (places + 0.5) * reduction - 0.5
        area = np.abs(np.linalg.det(derivative(matrix, full)))
        return transformed(matrix, full), reduction * np.sqrt(area)


def searched_verticals() -> Iterator[Floats]:
    """Yield unit vectors down in axes with z along the line of sight: straight down, then oblique by two angles."""
    yield np.array([0.0, 0.0, 1.0])
    for tilt in np.radians(_SEARCHED_TILTS_DEG):
        for angle in 2.0 * math.pi * np.arange(_SEARCHED_DIRECTIONS) / _SEARCHED_DIRECTIONS:
            yield np.array(
                [math.sin(tilt) * math.cos(angle), math.sin(tilt) * math.sin(angle), math.cos(tilt)]
            )


def vertical_of_homography(camera: Camera, to_plane: Floats, middle_px: Floats) -> Floats:
    """Return the unit vector down in axes with z along the line of sight by a homography to places in a plane."""
    place = transformed(to_plane, middle_px[np.newaxis])[0]
    on_ground = np.append(place, MEAN_LUNAR_RADIUS_M)
    matrix = np.asarray(np.linalg.inv(to_plane), np.float64)
    return -pose_of_homography(sight_matrix(camera), matrix, on_ground)[0][:, 2]


def read_attitudes(path: Path) -> dict[str, Floats]:
    """Read rotations from the camera's axes to the Moon's by image: quaternions, scalar first, in a table."""
    attitudes = {}
    for number, cells in read_rows(path, _COLUMNS, "a table of attitudes"):
        quaternion = np.array(
            parse_numbers(path, number, [cells[name] for name in _COLUMNS[1:]], "quaternion")
        )
        if abs(np.linalg.norm(quaternion) - 1.0) > _MAX_NORM_ERROR:
            raise FileFormatError(
                path, f"expected a quaternion of length 1, got {quaternion.tolist()}", number
            )
        attitudes[cells["file"]] = matrices_from_quaternions(quaternion)
    return attitudes
