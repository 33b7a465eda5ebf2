"""Differences of points near the lunar surface: horizontally along the sphere, vertically as heights.

In a tangent plane a point 76 km away at the same height lies 1.6 km below. Here the horizontal part is the arc of the
great circle, with its direction at the origin (geodesic normal coordinates), so it is regular at the poles and at
180 degrees of longitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up
from radioloc.vectors import Floats, cross_matrices

EAST_NORTH_UP = ("east", "north", "up")
"""Names of the local axes."""


@dataclass(frozen=True, slots=True)
class LocalDifference:
    """Difference of a point to an origin."""

    east_m: float  # components, at the origin, of the great circle's arc from the origin to the point
    north_m: float
    up_m: float  # height of the point less that of the origin

    @property
    def horizontal_m(self) -> float:
        """Length of the arc, m."""
        return math.hypot(self.east_m, self.north_m)

    @property
    def distance_m(self) -> float:
        """Length of arc and height difference together, m."""
        return math.hypot(self.east_m, self.north_m, self.up_m)

    @property
    def enu_m(self) -> Floats:
        """East, north, up, m, shape (3,)."""
        return np.array([self.east_m, self.north_m, self.up_m])


def axes_at(origin_m: Floats) -> Floats:
    """Rotation to east, north and up at a point, from the axes that its coordinates are given in, shape (3, 3)."""
    return east_north_up(*cartesian_to_selenographic(origin_m)[:2])


def rot_pa_to_enu(position_pa_m: Floats, rot_pa_to_me: Floats) -> Floats:
    """Rotation from principal axes to east, north and up of mean-Earth axes at a position, shape (3, 3)."""
    return np.asarray(axes_at(rot_pa_to_me @ position_pa_m) @ rot_pa_to_me)


def local_difference(
    point_m: Floats, origin_m: Floats, axes: Floats | None = None, radius_m: float | None = None
) -> LocalDifference:
    """Return the difference of a point to an origin, both in the same Moon-fixed axes, m, shape (3,)."""
    # `axes`: rotation to east, north, up at the origin, by default of the axes of the coordinates; `radius_m`: of the
    # sphere of the arc, by default the mean of both distances from the Moon's centre.
    axes = axes_at(origin_m) if axes is None else axes
    origin_radius_m, point_radius_m = np.linalg.norm(origin_m), np.linalg.norm(point_m)
    horizontal_m = (axes @ (point_m - origin_m))[:2]
    chord_m = math.hypot(*horizontal_m)
    angle_rad = math.atan2(chord_m, float(axes[2] @ point_m))
    # The arc vanishes on the same vertical, and its direction is arbitrary at the antipode.
    direction = horizontal_m / chord_m if chord_m else np.array([0.0, 1.0])
    if radius_m is None:
        radius_m = float(0.5 * (origin_radius_m + point_radius_m))
    east_m, north_m = (radius_m * angle_rad * direction).tolist()
    return LocalDifference(east_m, north_m, float(point_radius_m - origin_radius_m))


def displaced(origin_m: Floats, enu_m: Floats, axes: Floats | None = None) -> Floats:
    """Return points by their local differences (..., 3) from an origin: the inverse of :func:`local_difference`."""
    axes = axes_at(origin_m) if axes is None else axes
    origin_radius_m = np.linalg.norm(origin_m)
    angles_rad = enu_m[..., :2] / (origin_radius_m + 0.5 * enu_m[..., 2:])
    angle_rad = np.linalg.norm(angles_rad, axis=-1, keepdims=True)
    # sinc(x / pi) = sin(x) / x, also for an arc of length zero.
    unit = np.concatenate([angles_rad * np.sinc(angle_rad / np.pi), np.cos(angle_rad)], axis=-1)
    return np.asarray((origin_radius_m + enu_m[..., 2:]) * (unit @ axes))


def rot_enu_between(origin_m: Floats, other_m: Floats) -> Floats:
    """Rotation from east, north, up at one point to those at another, carried along their great circle, (3, 3)."""
    # Parallel transport keeps the angle of a direction to the arc; near a pole the axes of neighbours differ much.
    up, other_up = origin_m / np.linalg.norm(origin_m), other_m / np.linalg.norm(other_m)
    cross = cross_matrices(np.cross(up, other_up))
    carry = np.eye(3) + cross + cross @ cross / (1.0 + float(up @ other_up))
    return np.asarray(axes_at(other_m) @ carry @ axes_at(origin_m).T)
