"""Interior orientation: from pixels to directions in the camera's axes, and back; scale.

A pixel is (sample, line), to the right and down; the centre of the first is (0, 0). The focal plane has axes x and y
in millimetres. A direction is (x, y, f) without distortion, over f: (x / f, y / f, 1) for a camera that looks along +z.

Of a camera that looks straight down, half of the image over the focal length is half of the ground over the altitude
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
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Interior orientation of a camera; of a common one, see :meth:`Camera.of_pinhole`.

    Parameters
    ----------
    focal_length_mm : float
    pixel_per_mm : array_like, shape (2, 2)
        Derivatives of (sample, line) by the focal plane's (x, y), pixels per millimetre.
    principal_point_px : array_like, shape (2,)
        The pixel at which x = y = 0.
    distortion : Distortion
    looks_along_z : int
        1, or -1 where the camera looks along -z.

    Raises
    ------
    InputError
        A number is not finite, the focal length not positive, or pixels do not span the focal plane.
    """

    focal_length_mm: float
    pixel_per_mm: Floats
    principal_point_px: Floats
    distortion: Distortion = field(default_factory=lambda: Distortion("none", ()))
    looks_along_z: int = 1

    def __post_init__(self) -> None:
        convert_fields(self)
        matrix = np.array(self.pixel_per_mm, dtype=np.float64)
        point = as_vector(self.principal_point_px, 2, "principal_point_px")
        if not (np.isfinite(self.focal_length_mm) and self.focal_length_mm > 0.0):
            raise InputError(
                f"focal_length_mm = {self.focal_length_mm!r} is not a positive number of millimetres"
            )
        if matrix.shape != (2, 2) or not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 2:
            raise InputError(
                f"pixel_per_mm = {matrix.tolist()} does not lead from the focal plane to pixels and back; "
                "is the size of the pixels right?"
            )
        for name, value in (("pixel_per_mm", matrix), ("principal_point_px", point)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    @accepts_quantities
    def of_pinhole(
        cls,
        focal_length_mm: float,
        pixel_size_um: float,
        principal_point_px: ArrayLike,
        distortion: Sequence[float] = (),
    ) -> Camera:
        """A camera with x to the right, y down and z forward, as OpenCV has it.

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
            raise InputError(f"pixel_size_um = {pixel_size_um!r} is not a positive number of micrometres")
        lens = Distortion("brown", distortion) if len(distortion) else Distortion("none", ())
        return cls(focal_length_mm, np.eye(2) * 1e3 / pixel_size_um, np.asarray(principal_point_px), lens)

    @property
    def matrix(self) -> Floats:
        """From directions to homogeneous pixels without distortion, shape (3, 3)."""
        matrix = np.eye(3)
        matrix[:2, :2] = self.focal_length_mm * self.pixel_per_mm
        matrix[:2, 2] = self.principal_point_px
        return matrix

    def directions(self, pixels: ArrayLike) -> Floats:
        """Return directions in the camera's axes, not normalized, shape (n, 3), of pixels, shape (n, 2)."""
        return self.directions_and_partials(pixels)[0]

    def directions_and_partials(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """As :meth:`directions`, with derivatives by (sample, line), shape (n, 3, 2)."""
        pixel = as_points(pixels, 2, "pixels")
        to_plane = np.linalg.inv(self.pixel_per_mm) * self._unit_per_mm
        ideal, by_measured, valid = self.distortion.ideal((pixel - self.principal_point_px) @ to_plane.T)
        if not valid.all():
            worst = pixel[np.flatnonzero(~valid)[0]]
            raise InputError(
                f"the distortion has no point without it for the pixel (sample {worst[0]:.6g}, line {worst[1]:.6g}); "
                "is the pixel in the image, are the coefficients in the right unit and order?"
            )
        scale = self.looks_along_z / (self.focal_length_mm * self._unit_per_mm)
        directions = np.full((len(pixel), 3), float(self.looks_along_z))
        directions[:, :2] = ideal * scale
        partials = np.zeros((len(pixel), 3, 2))
        partials[:, :2] = by_measured @ to_plane * scale
        return directions, partials

    def pixels(self, directions: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Return pixels, shape (n, 2), of directions in the camera's axes, (n, 3), and whether the lens sees them.

        Of what is behind the camera or beyond the lens pixels have no meaning. The image's edges are not considered.
        """
        ideal, _, ahead = self._ideal(as_points(directions, 3, "directions"))
        measured, _, valid = self.distortion.measured(ideal)
        return self._on_detector(measured), ahead & valid

    def pixels_and_partials(self, directions: ArrayLike) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """As :meth:`pixels`, with derivatives by the direction's components in the middle, shape (n, 2, 3)."""
        ideal, scale, ahead = self._ideal(as_points(directions, 3, "directions"))
        measured, by_ideal, valid = self.distortion.measured(ideal)
        by_direction = np.zeros((len(ideal), 2, 3))
        by_direction[:, 0, 0] = by_direction[:, 1, 1] = scale
        by_direction[:, :, 2] = -ideal * (scale / (self.focal_length_mm * self._unit_per_mm))[:, None]
        partials = self.pixel_per_mm / self._unit_per_mm @ by_ideal @ by_direction
        return self._on_detector(measured), partials, ahead & valid

    def _ideal(self, direction: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Points on the focal plane without distortion, the focal length over the depth, and what is ahead."""
        ahead = self.looks_along_z * direction[:, 2] > 0.0
        scale = self.focal_length_mm * self._unit_per_mm / np.where(ahead, direction[:, 2], 1.0)
        return direction[:, :2] * scale[:, None], scale, ahead

    def _on_detector(self, measured: Floats) -> Floats:
        return measured @ (self.pixel_per_mm / self._unit_per_mm).T + self.principal_point_px

    @property
    def _unit_per_mm(self) -> float:
        """The unit in which the distortion is given: a millimetre, or the focal length."""
        return 1.0 if self.distortion.about.in_millimetres else 1.0 / self.focal_length_mm


def as_points(values: ArrayLike, components: int, name: str) -> Floats:
    """Finite points as an array of floats, shape (n, components)."""
    try:
        points = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != components:
        raise InputError(f"{name}: {components} numbers a point are needed, shape (n, {components})")
    if not np.isfinite(points).all():
        raise InputError(f"{name}: a number is not finite")
    return points


def as_vector(values: ArrayLike, size: int, name: str) -> Floats:
    """So many finite numbers as an array that is not the one given."""
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise InputError(f"{name} = {values!r} is not {size} finite numbers")
    return vector


def as_rotation(values: ArrayLike, name: str) -> Floats:
    """A rotation matrix, shape (3, 3)."""
    rotation = np.array(values, dtype=np.float64)
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6):
        raise InputError(f"{name} is not a rotation matrix, shape (3, 3)")
    return rotation


def altitude_m(camera: Camera, ground_pixel_m: ArrayLike) -> Floats:
    """Return the altitudes, m, from which a pixel of a camera that looks straight down covers so much ground, m."""
    # The scale is the mean of both directions.
    focal_length_px = abs(np.linalg.det(camera.pixel_per_mm)) ** 0.5 * camera.focal_length_mm
    return np.asarray(ground_pixel_m, dtype=np.float64) * focal_length_px


def undistorted(camera: Camera) -> Callable[[Floats], Floats]:
    """Return the function from pixels, shape (n, 2), to those of the same camera without distortion."""
    straight = replace(camera, distortion=Distortion("none", ()))
    return lambda pixels: straight.pixels(camera.directions(pixels))[0]
