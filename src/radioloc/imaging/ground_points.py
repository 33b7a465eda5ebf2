"""From pixels to the ground and back: where rays meet a surface, how that answers to errors, and the way back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc import vectors
from radioloc.boundary import bare_arguments
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import Rays, SensorModel, require_mean_earth
from radioloc.imaging.surfaces import Surface

Floats = NDArray[np.float64]


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
    """As :func:`image_to_ground`, with derivatives by pixel, orientation and height of the ground.

    Notes
    -----
    The point P = S + lambda d stays on the surface: with the gradient g of the height above it,
    dP = (1 - d g^T / g.d) (dS + lambda dd) + d dh / g.d.

    Examples
    --------
    >>> from radioloc.imaging import Camera, ConstantOrientation, FrameModel, Sphere, image_to_ground_and_partials
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    >>> down = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    >>> model = FrameModel(camera, ConstantOrientation([1747400.0, 0.0, 0.0], down), (1024, 1024))
    >>> ground = image_to_ground_and_partials(model, [[511.5, 511.5]], Sphere())
    >>> ground.by_pixel.round(2).tolist()  # metres by sample and line
    [[[0.0, 0.0], [8.07, 0.0], [0.0, -8.07]]]
    """
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


@bare_arguments
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
