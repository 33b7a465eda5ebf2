"""Pixels to the ground: intersection of rays with a surface, its partials, and the covariance of an image point.

A point measured in one image, such as a lander in an orbital image, is the intersection of the ray of its pixel with
ground of known height (Wang et al. 2021, section 2.2). The partials propagate errors of the pixel, the position and
attitude of the camera, and the height of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc import vectors
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import Rays, SensorModel, require_mean_earth
from radioloc.imaging.surfaces import Surface
from radioloc.lunar import LunarPosition, cartesian_to_selenographic, east_north_up
from radioloc.vectors import Floats


class GroundPoints(NamedTuple):
    """Points on the ground with derivatives by pixel, orientation and height of the ground."""

    points_m: Floats  # (n, 3)
    by_pixel: Floats  # (n, 3, 2), m / pixel
    by_position: Floats  # (n, 3, 3)
    by_angles: Floats  # (n, 3, 3), m / rad
    by_height: Floats  # (n, 3)


def image_to_ground(model: SensorModel, pixels: ArrayLike, surface: Surface) -> Floats:
    """Return the first points of a surface on the rays of pixels, (n, 2), in the model's axes, m, shape (n, 3)."""
    return _intersections(model, model.rays(pixels), pixels, surface)


def image_to_ground_and_partials(
    model: SensorModel, pixels: ArrayLike, surface: Surface, *, level: bool = False
) -> GroundPoints:
    """Return points as :func:`image_to_ground`, with derivatives, which slopes do not enter if `level`."""
    rays, ray_partials = model.rays_and_partials(pixels)
    points = _intersections(model, rays, pixels, surface)
    gradient = vectors.normalized(points) if level else surface.gradient(points)
    by_height = rays.directions / vectors.dot(gradient, rays.directions)[:, None]
    along_ground = np.eye(3) - by_height[:, :, None] * gradient[:, None, :]
    distance_m = vectors.length(points - rays.origins_m)[:, None, None]
    by_pixel = along_ground @ (ray_partials.origins_by_pixel + distance_m * ray_partials.directions_by_pixel)
    by_angles = along_ground @ (distance_m * ray_partials.directions_by_angles)
    return GroundPoints(points, by_pixel, along_ground, by_angles, by_height)


def _intersections(model: SensorModel, rays: Rays, pixels: ArrayLike, surface: Surface) -> Floats:
    if surface.mean_earth:
        require_mean_earth(model)
    points, hits = surface.intersect(rays.origins_m, rays.directions)
    if not hits.all():
        sample, line = np.asarray(pixels, dtype=np.float64)[np.argmin(hits)]
        raise InputError(
            f"the ray at sample {sample:.6g}, line {line:.6g} does not meet the ground: it misses the Moon or leaves "
            "the elevation map; check the pixel and the orientation"
        )
    return points


@dataclass(frozen=True, slots=True)
class ImagePointSigmas:
    """Standard deviations of the quantities that determine a ground point; scalars hold for all components."""

    pixel: ArrayLike  #: measurement of the point, pixels
    position_m: ArrayLike  #: camera position, in the axes of the ground point, m
    attitude_rad: ArrayLike  #: camera rotation about its axes, rad
    height_m: float  #: height of the ground, m


@dataclass(frozen=True, slots=True, eq=False)
class ImagePoint:
    """Point on the ground from one image."""

    pixel: tuple[float, float]
    position_me: LunarPosition
    # East, north, up of each error of one sigma, (3, k), m: pixel, position, attitude, height.
    errors_enu_m: dict[str, Floats]
    pixel_size_m: tuple[float, float]  # on the ground, along sample and line

    @property
    def covariance_enu_m2(self) -> Floats:
        """Total covariance of east, north and up, shape (3, 3)."""
        return sum((errors @ errors.T for errors in self.errors_enu_m.values()), np.zeros((3, 3)))

    @property
    def sigma_enu_m(self) -> Floats:
        """Standard deviations east, north and up, m, shape (3,)."""
        return np.sqrt(np.diag(self.covariance_enu_m2))


def locate_image_point(
    model: SensorModel, pixel: ArrayLike, surface: Surface, sigmas: ImagePointSigmas
) -> ImagePoint:
    """Locate a point measured in one image on the ground, with its covariance.

    Parameters
    ----------
    model : FrameModel or LineScanModel
        In ``ME_DE421`` (:func:`radioloc.imaging.read_isd` with ``axes="ME_DE421"``).
    pixel : array_like, shape (2,)
        Sample and line.
    surface : Terrain or Sphere
        The ground.
    sigmas : ImagePointSigmas

    Raises
    ------
    InputError
        The pixel is outside the image, its ray does not meet the ground, the axes are not mean-Earth, or a sigma is
        negative or not finite.

    Notes
    -----
    Errors of orientation and map are nearly common to all points of an image: differences of two points are better
    determined than each point.

    Examples
    --------
    >>> from radioloc.imaging import (Camera, ConstantOrientation, FrameModel, ImagePointSigmas, Sphere,
    ...                               locate_image_point)
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    >>> down = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    >>> model = FrameModel(camera, ConstantOrientation([1747400.0, 0.0, 0.0], down), (1024, 1024))
    >>> sigmas = ImagePointSigmas(pixel=0.5, position_m=10.0, attitude_rad=1e-3, height_m=5.0)
    >>> point = locate_image_point(model, [511.5, 511.5], Sphere(), sigmas)
    >>> point.sigma_enu_m.round(2).tolist()
    [14.71, 14.71, 5.0]
    """
    require_mean_earth(model)
    lines, samples = model.shape
    try:
        sample, line = np.array(pixel, dtype=np.float64)
        in_image = -0.5 <= sample < samples - 0.5 and -0.5 <= line < lines - 0.5
    except (TypeError, ValueError):
        in_image = False
    if not in_image:
        raise InputError(
            f"expected a pixel (sample, line) in the image of {samples} samples and {lines} lines, got {pixel!r}"
        )
    ground = image_to_ground_and_partials(model, [[sample, line]], surface)
    [point] = ground.points_m
    to_enu = east_north_up(*cartesian_to_selenographic(point)[:2])
    partials = {
        "pixel": (ground.by_pixel[0], sigmas.pixel),
        "position": (ground.by_position[0] @ to_enu.T, sigmas.position_m),
        "attitude": (ground.by_angles[0], sigmas.attitude_rad),
        "height": (ground.by_height[0][:, np.newaxis], sigmas.height_m),
    }
    errors = {
        name: to_enu @ by_error * _sigmas(name, sigma, by_error.shape[1])
        for name, (by_error, sigma) in partials.items()
    }
    position = LunarPosition.from_cartesian(point, model.axes)
    by_sample, by_line = np.linalg.norm(ground.by_pixel[0], axis=0)
    return ImagePoint((float(sample), float(line)), position, errors, (float(by_sample), float(by_line)))


def _sigmas(name: str, sigma: ArrayLike, count: int) -> Floats:
    """Return a sigma for each component."""
    try:
        values = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (count,))
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if not (np.isfinite(values) & (values >= 0.0)).all():
        raise InputError(
            f"sigma of {name}: expected 1 or {count} finite numbers of at least 0, got {sigma!r}"
        )
    return values
