r"""How images show places in the plane: what their adjustment needs to know, and homographies, which know a plane.

A place is east and north, m, in a plane that touches the Moon (:class:`~radioloc.imaging.TangentPlane`). Without a
camera or heights the ground is taken as a plane, and an image has the eight parameters of a homography (equation 7 of
Wang et al. 2021); with both it has a pose (:mod:`radioloc.imaging.poses`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.imaging.homography import Homography, by_correction, corrected, of_correction, transformed

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class Projected(NamedTuple):
    """Pixels of places, with derivatives."""

    pixels: Floats  # (n, 2)
    by_place: Floats  # (n, 2, 2), pixel / m
    by_parameters: Floats  # (n, 2, 8)


class Projections(Protocol):
    """What the adjustment needs of all images together."""

    @property
    def images(self) -> int:
        """How many."""
        ...

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points, by numbers of images and of points, shape (n,), at places, shape (points, 2)."""
        ...

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places the model of the ground has."""
        ...

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect, shape (images, 8)."""
        ...

    def corrected(self, steps: Floats) -> Self:
        """After corrections of all parameters, shape (images, 8)."""
        ...

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows, shape (2,).

        Raises
        ------
        InputError
            It shows no ground.
        """
        ...

    def homography(self, image: int, covariance: Floats) -> Homography:
        """From places to pixels as if the ground were a plane, with the covariance of the image's parameters."""
        ...

    def altitude_m(self, image: int) -> float:
        """Height of the camera above the middle of the ground that it sees; NaN where that is not known."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Homographies:
    """Images of a plane.

    A correction moves the places before the image is taken of them: when the ground on which a chain of images stands
    turns out to be elsewhere, by many widths of the low ones, all of these follow in one step. Corrections of pixels
    would lead such an image beyond its horizon.
    """

    matrices: Floats  # from places to pixels, shape (images, 3, 3)
    normals: Floats  # from pixels to numbers of size one, shape (images, 3, 3)

    @classmethod
    def of_matrices(cls, matrices: Floats, sizes: Floats) -> Homographies:
        """From approximate matrices, and samples and lines of the images, shape (images, 2)."""
        unit = [matrix / np.linalg.norm(matrix) for matrix in matrices]
        return cls(np.array(unit), np.array([_of_size(size) for size in sizes]))

    @property
    def images(self) -> int:
        """How many."""
        return len(self.matrices)

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points."""
        matrix, normals = self.matrices[image], self._normals_of_places()
        normal, place_by_normalized = normals[image], np.linalg.inv(normals[:, :2, :2])[image]
        ahead = np.einsum("nij,nj->ni", matrix[:, :, :2], places_m[point]) + matrix[:, :, 2]
        pixels, by_place = dehomogenized(ahead, matrix[:, :, :2])
        normalized = np.einsum("nij,nj->ni", normal[:, :2, :2], places_m[point]) + normal[:, :2, 2]
        return Projected(pixels, by_place, by_place @ place_by_normalized @ by_correction(normalized))

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """All of the plane."""
        return np.ones(len(places_m), bool)

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect: none."""
        return np.zeros((self.images, 8), bool)

    def corrected(self, steps: Floats) -> Homographies:
        """After corrections."""
        normals = self._normals_of_places() @ np.linalg.inv(self.matrices)
        matrices = [corrected(*one) for one in zip(self.matrices, normals, steps, strict=True)]
        return replace(self, matrices=np.array(matrices))

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows."""
        matrix = self.matrices[image]
        place = transformed(np.linalg.inv(matrix), pixel[np.newaxis])[0]
        # What is before a camera above the plane has a third coordinate whose sign is not the determinant's.
        if not (matrix[2] @ [*place, 1.0]) * np.linalg.det(matrix) < 0.0:
            raise InputError(
                f"the pixel (sample {pixel[0]:.1f}, line {pixel[1]:.1f}) looks above the horizon"
            )
        return place

    def homography(self, image: int, covariance: Floats) -> Homography:
        """Of the image."""
        matrix = self.matrices[image]
        return of_correction(matrix, self._normals_of_places()[image] @ np.linalg.inv(matrix), covariance)

    def altitude_m(self, image: int) -> float:
        """Not known."""
        return float("nan")

    def _normals_of_places(self) -> Floats:
        """From places to numbers of size one, as the middle of each image shows its surroundings."""
        normal = self.normals @ self.matrices
        middle = np.linalg.inv(normal)[:, :, 2]
        middle = middle[:, :2] / middle[:, 2:]
        ahead = np.einsum("nij,nj->ni", normal[:, :, :2], middle) + normal[:, :, 2]
        result = np.zeros_like(normal)
        result[:, :2, :2] = normal[:, :2, :2] / ahead[:, 2, np.newaxis, np.newaxis]
        result[:, :2, 2] = -np.einsum("nij,nj->ni", result[:, :2, :2], middle)
        result[:, 2, 2] = 1.0
        return result


def dehomogenized(values: Floats, partials: Floats) -> tuple[Floats, Floats]:
    """Pixels, shape (n, 2), of homogeneous ones, shape (n, 3), and their derivatives of those, shape (n, 3, m)."""
    pixels = values[:, :2] / values[:, 2:]
    of_pixels = partials[:, :2] - pixels[:, :, np.newaxis] * partials[:, 2:]
    return pixels, of_pixels / values[:, 2:, np.newaxis]


def _of_size(size: Floats) -> Floats:
    """The similarity that brings the pixels of an image to between -1 and 1."""
    half = 0.5 * float(np.max(size))
    return np.array([[1 / half, 0, -0.5 * size[0] / half], [0, 1 / half, -0.5 * size[1] / half], [0, 0, 1.0]])
