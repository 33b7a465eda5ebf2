"""Interior orientation: pixels to directions in the camera's axes and back; scale.

A pixel is (sample, line), to the right and down; the centre of the first is (0, 0). The focal plane has axes x and y
in millimetres. A direction is (x, y, f) without distortion, over f: (x / f, y / f, 1) for a camera that looks along +z.

For a camera that looks straight down, half of the image over the focal length is half of the ground over the altitude
(Chang'e-3 descent images, 2014, equation 5), a check of each descent image's scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.imaging.distortion import Distortion
from radioloc.quantities import accepts_quantities, convert_fields
from radioloc.units import set_fields
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Interior orientation of a camera; for a pinhole camera with square pixels see :meth:`Camera.of_pinhole`.

    Raises
    ------
    InputError
        A number is not finite, the focal length not positive, or pixels do not span the focal plane.
    """

    focal_length_mm: float
    #: (2, 2), derivatives of (sample, line) by the focal plane's (x, y), pixels per millimetre.
    pixel_per_mm: Floats
    principal_point_px: Floats  #: (2,), the pixel at which x = y = 0
    distortion: Distortion = field(default_factory=lambda: Distortion("none", ()))
    looks_along_z: int = 1  #: 1, or -1 where the camera looks along -z

    def __post_init__(self) -> None:
        convert_fields(self)
        matrix = np.array(self.pixel_per_mm, dtype=np.float64)
        point = as_vector(self.principal_point_px, 2, "principal_point_px")
        if not (np.isfinite(self.focal_length_mm) and self.focal_length_mm > 0.0):
            raise InputError(f"focal_length_mm: expected a positive number, got {self.focal_length_mm!r}")
        if matrix.shape != (2, 2) or not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 2:
            raise InputError(f"pixel_per_mm: expected an invertible (2, 2) matrix, got {matrix.tolist()}")
        for name, value in (("pixel_per_mm", matrix), ("principal_point_px", point)):
            value.flags.writeable = False
            set_fields(self, **{name: value})

    @classmethod
    @accepts_quantities
    def of_pinhole(
        cls,
        focal_length_mm: float,
        pixel_size_um: float,
        principal_point_px: ArrayLike,
        distortion: Sequence[float] = (),
    ) -> Camera:
        """Return a camera with x to the right, y down and z forward, as in OpenCV.

        Parameters
        ----------
        focal_length_mm, pixel_size_um : float
        principal_point_px : array_like, shape (2,)
            Sample and line.
        distortion : sequence of float
            k1, k2, p1, p2, k3; those left out are zero.

        Examples
        --------
        >>> from radioloc.imaging import Camera
        >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
        >>> camera.directions([[511.5, 511.5]]).tolist()
        [[0.0, 0.0, 1.0]]
        """
        if not (np.isfinite(pixel_size_um) and pixel_size_um > 0.0):
            raise InputError(f"pixel_size_um: expected a positive number, got {pixel_size_um!r}")
        lens = Distortion("brown", distortion) if len(distortion) else Distortion("none", ())
        return cls(focal_length_mm, np.eye(2) * 1e3 / pixel_size_um, np.asarray(principal_point_px), lens)

    @property
    def matrix(self) -> Floats:
        """Matrix from directions to homogeneous pixels without distortion, shape (3, 3)."""
        matrix = np.eye(3)
        matrix[:2, :2] = self.focal_length_mm * self.pixel_per_mm
        matrix[:2, 2] = self.principal_point_px
        return matrix

    def directions(self, pixels: ArrayLike) -> Floats:
        """Return directions in the camera's axes, not normalized, shape (n, 3), of pixels, shape (n, 2)."""
        return self.directions_and_partials(pixels)[0]

    def directions_and_partials(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Return directions and their derivatives by (sample, line), shape (n, 3, 2)."""
        pixel = as_points(pixels, 2, "pixels")
        to_plane = np.linalg.inv(self.pixel_per_mm) * self._unit_per_mm
        ideal, by_measured, valid = self.distortion.ideal((pixel - self.principal_point_px) @ to_plane.T)
        if not valid.all():
            worst = pixel[np.flatnonzero(~valid)[0]]
            raise InputError(
                f"the distortion cannot be removed at sample {worst[0]:.6g}, line {worst[1]:.6g}; check the pixel, and "
                "unit and order of the coefficients"
            )
        scale = self.looks_along_z / (self.focal_length_mm * self._unit_per_mm)
        directions = np.full((len(pixel), 3), float(self.looks_along_z))
        directions[:, :2] = ideal * scale
        partials = np.zeros((len(pixel), 3, 2))
        partials[:, :2] = by_measured @ to_plane * scale
        return directions, partials

    def pixels(self, directions: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Return pixels, shape (n, 2), of directions, (n, 3), and whether the lens sees them, inside the image or not.

        Pixels of directions behind the camera or beyond the lens are meaningless.
        """
        ideal, _, ahead = self._ideal(as_points(directions, 3, "directions"))
        measured, _, valid = self.distortion.measured(ideal)
        return self._on_detector(measured), ahead & valid

    def pixels_and_partials(self, directions: ArrayLike) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return pixels, their derivatives by the direction, shape (n, 2, 3), and whether the lens sees them."""
        ideal, scale, ahead = self._ideal(as_points(directions, 3, "directions"))
        measured, by_ideal, valid = self.distortion.measured(ideal)
        by_direction = np.zeros((len(ideal), 2, 3))
        by_direction[:, 0, 0] = by_direction[:, 1, 1] = scale
        by_direction[:, :, 2] = -ideal * (scale / (self.focal_length_mm * self._unit_per_mm))[:, None]
        partials = self.pixel_per_mm / self._unit_per_mm @ by_ideal @ by_direction
        return self._on_detector(measured), partials, ahead & valid

    def _ideal(self, direction: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return undistorted points on the focal plane, the focal length over the depth, and whether it is positive."""
        ahead = self.looks_along_z * direction[:, 2] > 0.0
        scale = self.focal_length_mm * self._unit_per_mm / np.where(ahead, direction[:, 2], 1.0)
        return direction[:, :2] * scale[:, None], scale, ahead

    def _on_detector(self, measured: Floats) -> Floats:
        return measured @ (self.pixel_per_mm / self._unit_per_mm).T + self.principal_point_px

    @property
    def _unit_per_mm(self) -> float:
        """Unit of the distortion: a millimetre, or the focal length."""
        return 1.0 if self.distortion.definition.in_millimetres else 1.0 / self.focal_length_mm


def as_points(values: ArrayLike, components: int, name: str) -> Floats:
    """Return finite points as an array of floats, shape (n, components)."""
    try:
        points = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != components or not np.isfinite(points).all():
        raise InputError(f"{name}: expected finite numbers, shape (n, {components})")
    return points


def as_vector(values: ArrayLike, size: int, name: str) -> Floats:
    """Return finite numbers as a new array."""
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: expected {size} finite numbers, got {values!r}")
    return vector


def altitude_m(camera: Camera, ground_pixel_m: ArrayLike) -> Floats:
    """Return the altitudes, m, of a camera that looks straight down, from the size of its pixels on the ground, m."""
    # The scale is the mean of both directions.
    focal_length_px = abs(np.linalg.det(camera.pixel_per_mm)) ** 0.5 * camera.focal_length_mm
    return np.asarray(ground_pixel_m, dtype=np.float64) * focal_length_px


def sight_matrix(camera: Camera) -> Floats:
    """Return the matrix to pixels without distortion from axes with z along the line of sight, shape (3, 3)."""
    return camera.matrix * [camera.looks_along_z, 1.0, 1.0]


def undistorted(camera: Camera) -> Callable[[Floats], Floats]:
    """Return the function from pixels, shape (n, 2), to those of the same camera without distortion."""
    straight = _straight(camera)
    return lambda pixels: straight.pixels(camera.directions(pixels))[0]


def distorted(camera: Camera) -> Callable[[Floats], tuple[Floats, NDArray[np.bool_]]]:
    """Return the inverse function of :func:`undistorted`, with the mask of pixels that the lens sees."""
    straight = _straight(camera)
    return lambda pixels: camera.pixels(straight.directions(pixels))


def _straight(camera: Camera) -> Camera:
    return replace(camera, distortion=Distortion("none", ()))
