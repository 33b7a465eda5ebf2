"""From pixels to the ground and back: where rays meet a surface, how that answers to errors, and the way back.

A point measured in one image, such as a lander in an orbital image, is where the ray of its pixel meets ground of
known height (Wang et al. 2021, section 2.2). Errors of the pixel, the camera's place and attitude and the height of
the ground go through the partials.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc import vectors
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import Rays, SensorModel, inside, require_mean_earth
from radioloc.imaging.surfaces import Surface
from radioloc.lunar import LunarPosition, cartesian_to_selenographic, east_north_up
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats


class GroundPoints(NamedTuple):
    """Points on the ground, and how they answer to the pixel, the orientation and the height of the ground."""

    points_m: Floats  # (n, 3)
    by_pixel: Floats  # (n, 3, 2), m / pixel
    by_position: Floats  # (n, 3, 3)
    by_angles: Floats  # (n, 3, 3), m / rad
    by_height: Floats  # (n, 3)


def image_to_ground(model: SensorModel, pixels: ArrayLike, surface: Surface) -> Floats:
    """Points where the rays of pixels first meet a surface, in the model's axes, m, shape (n, 3).

    Parameters
    ----------
    model : FrameModel or LineScanModel
    pixels : array_like, shape (n, 2)
        Sample and line.
    surface : Sphere, Plane or Terrain
        The ground.

    Raises
    ------
    InputError
        A ray misses the ground, or a pixel has no ray.

    Examples
    --------
    >>> from radioloc.imaging import Camera, ConstantOrientation, FrameModel, Sphere, image_to_ground
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    >>> down = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    >>> model = FrameModel(camera, ConstantOrientation([1747400.0, 0.0, 0.0], down), (1024, 1024))
    >>> image_to_ground(model, [[511.5, 511.5]], Sphere()).round(3).tolist()
    [[1737400.0, 0.0, 0.0]]
    """
    return _met(model, model.rays(pixels), pixels, surface)


def image_to_ground_and_partials(model: SensorModel, pixels: ArrayLike, surface: Surface) -> GroundPoints:
    """As :func:`image_to_ground`, with derivatives by pixel, orientation and height of the ground."""
    rays, ray_partials = model.rays_and_partials(pixels)
    points = _met(model, rays, pixels, surface)
    gradient = surface.gradient(points)
    by_height = rays.directions / vectors.dot(gradient, rays.directions)[:, None]
    along_ground = np.eye(3) - by_height[:, :, None] * gradient[:, None, :]
    distance_m = vectors.length(points - rays.origins_m)[:, None, None]
    by_pixel = along_ground @ (ray_partials.origins_by_pixel + distance_m * ray_partials.directions_by_pixel)
    by_angles = along_ground @ (distance_m * ray_partials.directions_by_angles)
    return GroundPoints(points, by_pixel, along_ground, by_angles, by_height)


def _met(model: SensorModel, rays: Rays, pixels: ArrayLike, surface: Surface) -> Floats:
    """Where the rays of pixels meet the surface."""
    if surface.mean_earth:
        require_mean_earth(model)
    points, hits = surface.intersect(rays.origins_m, rays.directions)
    if not hits.all():
        pixel = np.asarray(pixels, dtype=np.float64)[np.flatnonzero(~hits)[0]]
        others = int((~hits).sum()) - 1
        more = f" (and of {others} more)" if others else ""
        raise InputError(
            f"the ray of the pixel at sample {pixel[0]:.6g}, line {pixel[1]:.6g}{more} "
            "does not meet the ground: it looks past the Moon, leaves the elevation map, or the orientation is wrong"
        )
    return points


@accepts_quantities
def ground_to_image(model: SensorModel, points_m: ArrayLike) -> Floats:
    """Pixels, shape (n, 2), of points in the model's axes, shape (n, 3); also of points beyond the image's edges.

    Raises
    ------
    InputError
        A point is behind the camera, was not before the detector while the orientation is known, or is so far from
        the axis that the lens does not see it. ``model.project`` says which.

    Examples
    --------
    >>> from radioloc.imaging import Camera, ConstantOrientation, FrameModel, ground_to_image
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    >>> down = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    >>> model = FrameModel(camera, ConstantOrientation([1747400.0, 0.0, 0.0], down), (1024, 1024))
    >>> ground_to_image(model, [[1737400.0, 0.0, 0.0]]).round(6).tolist()
    [[511.5, 511.5]]
    """
    found = model.project(points_m)
    if not found.seen.all():
        point = np.asarray(points_m, dtype=np.float64)[np.flatnonzero(~found.seen)[0]]
        raise InputError(
            f"the camera does not see the point {point.round(1).tolist()} m (and {int((~found.seen).sum()) - 1} more); "
            f"are the coordinates in {model.axes} and in metres? model.project() says which points are seen"
        )
    return found.pixels


@dataclass(frozen=True, slots=True)
class ImagePointSigmas:
    """Standard deviations of what a ground point follows from; each one number for all components, or one for each.

    Parameters
    ----------
    pixel : float or (sample, line)
        How well the point is measured, pixels.
    position_m : float or (east, north, up)
        Of the camera's place, in the axes of the ground point, m.
    attitude_rad : float or (x, y, z)
        Of its rotation about the camera's axes, rad.
    height_m : float
        Of the ground's height, m.
    """

    pixel: ArrayLike
    position_m: ArrayLike
    attitude_rad: ArrayLike
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class ImagePoint:
    """A point on the ground from one image."""

    pixel: tuple[float, float]
    position_me: LunarPosition
    # East, north, up of each error of one sigma, (3, k): pixel, position, attitude, height.
    errors_enu_m: dict[str, Floats]
    pixel_size_m: tuple[float, float]  # of the pixel on the ground, along sample and line

    @property
    def parts_enu_m2(self) -> dict[str, Floats]:
        """Covariance of east, north and up by what it is from, shape (3, 3) each."""
        return {name: errors @ errors.T for name, errors in self.errors_enu_m.items()}

    @property
    def covariance_enu_m2(self) -> Floats:
        """Covariance of east, north and up: the sum of its parts, shape (3, 3)."""
        return sum(self.parts_enu_m2.values(), np.zeros((3, 3)))

    @property
    def sigma_enu_m(self) -> Floats:
        """Standard deviations to the east, to the north and up, m, shape (3,)."""
        return np.sqrt(np.diag(self.covariance_enu_m2))

    def __str__(self) -> str:
        longitude_deg, latitude_deg, height_m = self.position_me.selenographic
        sigmas = ", ".join(f"{one:.2f}" for one in self.sigma_enu_m)
        return (
            f"{self.position_me.frame}  {longitude_deg:.6f} deg E, {latitude_deg:+.6f} deg N, height {height_m:.1f} m; "
            f"sigma east, north, up {sigmas} m"
        )


def locate_image_point(
    model: SensorModel, pixel: ArrayLike, surface: Surface, sigmas: ImagePointSigmas
) -> ImagePoint:
    """Where a point measured in an image is on the ground, with its covariance.

    Parameters
    ----------
    model : FrameModel or LineScanModel
        In ``ME_DE421`` (:func:`radioloc.imaging.read_isd` with ``axes="ME_DE421"``).
    pixel : array_like, shape (2,)
        Sample and line.
    surface : Terrain, Sphere or Plane
        The ground.
    sigmas : ImagePointSigmas

    Raises
    ------
    InputError
        The pixel is not in the image, its ray does not meet the ground, the axes are others, or a sigma is not a finite
        number of at least zero.

    Notes
    -----
    Errors of the orientation and of the map are the same, or nearly so, for all points of one image: differences of two
    points are better known than each.

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
    try:
        measured = np.array(pixel, dtype=np.float64).reshape(1, -1)
    except (TypeError, ValueError):
        measured = np.empty((0, 0))
    if measured.shape != (1, 2) or not inside(model, measured)[0]:
        lines, samples = model.shape
        raise InputError(f"the pixel {pixel!r} is not in the image of {samples} samples and {lines} lines")
    found = image_to_ground_and_partials(model, measured, surface)
    [point] = found.points_m
    to_enu = east_north_up(*cartesian_to_selenographic(point)[:2])
    partials = {
        "pixel": (found.by_pixel[0], sigmas.pixel),
        "position": (found.by_position[0] @ to_enu.T, sigmas.position_m),
        "attitude": (found.by_angles[0], sigmas.attitude_rad),
        "height": (found.by_height[0][:, np.newaxis], sigmas.height_m),
    }
    errors = {
        name: to_enu @ by_error * _sigmas(name, sigma, by_error.shape[1])
        for name, (by_error, sigma) in partials.items()
    }
    position = LunarPosition.from_cartesian(point, model.axes)
    across, along = np.linalg.norm(found.by_pixel[0], axis=0)
    return ImagePoint(
        (float(measured[0, 0]), float(measured[0, 1])), position, errors, (float(across), float(along))
    )


def _sigmas(name: str, given: ArrayLike, count: int) -> Floats:
    """One sigma for each component."""
    try:
        values = np.broadcast_to(np.asarray(given, dtype=np.float64), (count,))
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if not (np.isfinite(values) & (values >= 0.0)).all():
        raise InputError(
            f"the sigma of {name} is {given!r}; give one number or {count}, finite and at least zero"
        )
    return values
