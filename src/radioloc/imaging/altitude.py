"""How high a camera is that looks straight down, from what its image covers, and the reverse.

A check of each descent image's scale: half of the image over the focal length is half of the ground over the altitude
(Chang'e-3 descent images, 2014, equation 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera

Floats = NDArray[np.float64]


def field_of_view_rad(camera: Camera, size_px: int) -> float:
    """Full angle that a row of so many pixels through the principal point covers, without distortion, rad.

    Examples
    --------
    >>> import math
    >>> from radioloc.imaging import Camera
    >>> from radioloc.imaging.altitude import field_of_view_rad
    >>> round(math.degrees(field_of_view_rad(Camera.of_pinhole(8.3, 6.7, [511.5, 511.5]), 1024)), 1)
    44.9
    """
    return float(2.0 * np.arctan(0.5 * size_px * _slope_per_pixel(camera)))


def ground_width_m(camera: Camera, altitude_m: ArrayLike, size_px: int) -> Floats:
    """Ground that a row of so many pixels covers from altitudes, looking straight down, m (equation 5)."""
    return size_px * ground_pixel_m(camera, altitude_m)


def ground_pixel_m(camera: Camera, altitude_m: ArrayLike) -> Floats:
    """Ground that a pixel covers from altitudes, looking straight down, m."""
    return _slope_per_pixel(camera) * _positive(altitude_m, "altitude_m")


def altitude_m(camera: Camera, ground_pixel_m: ArrayLike) -> Floats:
    """Altitudes at which a pixel covers so much ground, looking straight down, m."""
    return _positive(ground_pixel_m, "ground_pixel_m") / _slope_per_pixel(camera)


@dataclass(frozen=True, slots=True)
class FittedFocalLength:
    """Focal length with its standard deviation, mm, and what is left of each altitude, m."""

    focal_length_mm: float
    sigma_mm: float
    residuals_m: tuple[float, ...]


def fitted_focal_length(
    pixel_size_um: float, altitude_m: ArrayLike, ground_pixel_m: ArrayLike
) -> FittedFocalLength:
    """The focal length that leads from what pixels cover to altitudes, with the sigma that the scatter gives.

    Parameters
    ----------
    pixel_size_um : float
    altitude_m, ground_pixel_m : array_like, shape (n,)
        Of two images or more.

    Raises
    ------
    InputError
        There are fewer than two images, or a number is not positive.

    Examples
    --------
    >>> from radioloc.imaging.altitude import fitted_focal_length
    >>> round(fitted_focal_length(6.7, [785.5, 548.4], [657.2 / 1024, 458.8 / 1024]).focal_length_mm, 2)
    8.2
    """
    altitude, pixel = _positive(altitude_m, "altitude_m"), _positive(ground_pixel_m, "ground_pixel_m")
    if altitude.shape != pixel.shape or altitude.ndim != 1 or len(altitude) < 2:
        raise InputError(
            "altitude_m and ground_pixel_m: two images or more are needed, a number of each for each"
        )
    # Altitudes are read to a part of themselves, so that each image counts alike.
    ratios = altitude / pixel * pixel_size_um * 1e-3
    focal_mm = float(ratios.mean())
    sigma_mm = float(ratios.std(ddof=1)) / len(ratios) ** 0.5
    return FittedFocalLength(focal_mm, sigma_mm, tuple((altitude * (1.0 - focal_mm / ratios)).tolist()))


def _slope_per_pixel(camera: Camera) -> float:
    """Tangent of the angle that a pixel at the principal point covers, mean of both directions."""
    return float(abs(np.linalg.det(camera.pixel_per_mm)) ** -0.5 / camera.focal_length_mm)


def _positive(values: ArrayLike, name: str) -> Floats:
    found = np.asarray(values, dtype=np.float64)
    if not (np.isfinite(found).all() and (found > 0.0).all()):
        raise InputError(f"{name} = {values!r} is not a positive number of metres")
    return found
