"""What rays meet: a sphere or a plane.

A surface says where rays meet it first, and how fast the height above it grows in each direction, from which follows
how a ground point answers to changes of the ray and of the height.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.boundary import bare_fields
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError

Floats = NDArray[np.float64]


class Surface(Protocol):
    """What image to ground needs of the ground."""

    @property
    def mean_earth(self) -> bool:
        """Whether the surface is in mean-Earth axes, so that the rays have to be, too."""
        ...

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """First points on rays (unit directions), m, shape (n, 3), and whether there is one."""
        ...

    def gradient(self, points_m: Floats) -> Floats:
        """Derivatives of the height above the surface by x, y, z at points on it, shape (n, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere around the Moon's centre."""

    radius_m: float = MEAN_LUNAR_RADIUS_M
    mean_earth: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        bare_fields(self)
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(f"radius_m = {self.radius_m!r} is not a positive number of metres")

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """First points on rays from outside, or the only one on rays from inside."""
        along_m = -vectors.dot(origins_m, directions)  # to the point nearest the centre
        nearest_m = origins_m + along_m[:, None] * directions
        half_m = np.sqrt(np.maximum(self.radius_m**2 - vectors.dot(nearest_m, nearest_m), 0.0))
        hits = vectors.length(nearest_m) <= self.radius_m
        inside = vectors.length(origins_m) < self.radius_m
        distance_m = along_m + np.where(inside, half_m, -half_m)
        return origins_m + distance_m[:, None] * directions, hits & (distance_m >= 0.0)

    def gradient(self, points_m: Floats) -> Floats:
        """Up."""
        return np.asarray(points_m / vectors.length(points_m)[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane through a point, with a normal of any length that shows up."""

    point_m: Floats
    normal: Floats
    mean_earth: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        for name in ("point_m", "normal"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"{name} = {getattr(self, name)!r} is not three finite numbers")
            object.__setattr__(self, name, value)
        size = np.linalg.norm(self.normal)
        if size == 0.0:
            raise InputError("the normal of a plane has no direction")
        object.__setattr__(self, "normal", self.normal / size)

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Points on rays from either side."""
        toward = directions @ self.normal
        parallel = toward == 0.0
        distance_m = ((self.point_m - origins_m) @ self.normal) / np.where(parallel, 1.0, toward)
        return origins_m + distance_m[:, None] * directions, ~parallel & (distance_m >= 0.0)

    def gradient(self, points_m: Floats) -> Floats:
        """The normal."""
        return np.broadcast_to(self.normal, points_m.shape)
