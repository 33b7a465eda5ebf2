"""Surfaces that rays intersect: a sphere, or the ground of an elevation map.

A surface gives the first intersection of each ray, and the gradient of the height above it. The gradient determines the
derivatives of a ground point by the ray and by the height.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.lunar import TerrainModel, cartesian_to_selenographic
from radioloc.lunar.terrain import LargeWindowError, NoTerrainError, TerrainWindow, height_and_gradient
from radioloc.quantities import convert_fields
from radioloc.vectors import Floats

_BLOCK_RAYS = 100_000
_STATION_COUNT = 5  # points of each ray that determine the window of the map
_MIN_STEP_CELLS = 0.25
_MAX_STEPS = 20_000
_HEIGHT_TOLERANCE_M = 1e-5
_MAX_REFINEMENTS = 60
# State of a ray: above the ground everywhere, intersecting it, or reaching an area without heights.
_PASSED, _HIT, _OFF_MAP = np.int8(0), np.int8(1), np.int8(2)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere around the Moon's centre."""

    radius_m: float = MEAN_LUNAR_RADIUS_M
    mean_earth: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        convert_fields(self)
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(f"radius_m: expected a positive number, got {self.radius_m!r}")

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the first intersections, m, shape (n, 3), and whether each ray has one."""
        enters_m, leaves_m, hits = _chord(origins_m, directions, self.radius_m)
        distance_m = np.where(vectors.length(origins_m) < self.radius_m, leaves_m, enters_m)
        return origins_m + distance_m[:, None] * directions, hits & (distance_m >= 0.0)

    def gradient(self, points_m: Floats) -> Floats:
        """Return the gradient of the height above the sphere, shape (n, 3)."""
        return vectors.normalized(points_m)


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Ground of an elevation map, in mean-Earth axes.

    Notes
    -----
    A ray descends from the height of the highest cell in steps that cannot pass through the terrain: as far as its
    clearance allows by the steepest slope between neighbouring cells (Hart 1996, *sphere tracing*), at least a quarter
    of a cell. The intersection is refined by the Illinois rule, to 0.01 mm.
    """

    model: TerrainModel  #: elevation map
    raised_m: float = 0.0  #: height added to the map's, such as an error of the map
    mean_earth: bool = field(default=True, init=False)

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return first intersections, m, shape (n, 3), and whether each ray has one, with heights all along the ray."""
        distance, state = self._traced(origins_m, directions, np.full(len(origins_m), np.inf))
        return origins_m + np.where(state == _HIT, distance, 0.0)[:, None] * directions, state == _HIT

    def is_clear(self, origins_m: Floats, directions: Floats, reach_m: Floats) -> NDArray[np.bool_]:
        """Return whether rays of some lengths, shape (n,), pass above the ground, with heights all along the ray."""
        return self._traced(origins_m, directions, reach_m)[1] == _PASSED

    def _traced(
        self, origins_m: Floats, directions: Floats, reach_m: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Return distances of first intersections, m, and states of rays of some lengths."""
        distance, state = np.zeros(len(origins_m)), np.full(len(origins_m), _PASSED)
        lowest, highest = (limit_m + self.raised_m for limit_m in LUNAR_HEIGHT_LIMITS_M)
        for start in range(0, len(origins_m), _BLOCK_RAYS):
            part = slice(start, start + _BLOCK_RAYS)
            first, last, descends = _between(origins_m[part], directions[part], lowest, highest)
            last = np.minimum(last, reach_m[part])
            descends &= first < last
            rows = start + np.flatnonzero(descends)
            spans = origins_m[rows], directions[rows], first[descends], last[descends]
            distance[rows], state[rows] = self._intersect_in_parts(*spans)
        return distance, state

    def gradient(self, points_m: Floats) -> Floats:
        """Return the gradient of the height above the terrain, shape (n, 3)."""
        longitude, latitude, height_m = cartesian_to_selenographic(points_m)
        _, gradient = height_and_gradient(self.model.height_and_slope, longitude, latitude)
        return vectors.normalized(points_m) - gradient / (MEAN_LUNAR_RADIUS_M + height_m)[:, None]

    def _intersect_in_parts(
        self, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Return distances and states; rays, then a single ray, are halved if their window of the map is too large."""
        try:
            return self._intersect(origins, directions, first, last)
        except NoTerrainError:
            return np.zeros(len(origins)), np.full(len(origins), _OFF_MAP)
        except LargeWindowError:
            half = len(origins) // 2
            if half:
                parts = [
                    self._intersect_in_parts(origins[k], directions[k], first[k], last[k])
                    for k in (slice(half), slice(half, None))
                ]
                return np.concatenate([d for d, _ in parts]), np.concatenate([m for _, m in parts])
            middle = 0.5 * (first + last)
            distance, state = self._intersect_in_parts(origins, directions, first, middle)
            if state[0] != _PASSED:
                return distance, state
            return self._intersect_in_parts(origins, directions, middle, last)

    def _intersect(
        self, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Return distances of intersections between two distances, and states of the rays."""
        distance, state = np.zeros(len(origins)), np.full(len(origins), _PASSED)
        if not len(origins):
            return distance, state
        stations = np.linspace(0.0, 1.0, _STATION_COUNT)[:, None]
        points = origins + (first + stations * (last - first))[..., None] * directions
        window = self.model.window(*cartesian_to_selenographic(points.reshape(-1, 3))[:2])
        low_m, high_m = window.range_m
        entry, leaving, descends = _between(
            origins, directions, low_m + self.raised_m - 1.0, high_m + self.raised_m + 1.0
        )
        entry, leaving = np.maximum(entry, first), np.minimum(leaving, last)
        rows = np.flatnonzero(descends & (entry < leaving))
        distance[rows], state[rows] = self._march(
            window, origins[rows], directions[rows], entry[rows], leaving[rows]
        )
        return distance, state

    def _clearance(self, window: TerrainWindow, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return heights of points above the terrain, m, and whether the map has heights there."""
        longitude, latitude, height_m = cartesian_to_selenographic(points)
        terrain_m, mapped = window.heights(longitude, latitude)
        return height_m - terrain_m - self.raised_m, mapped

    def _march(
        self, window: TerrainWindow, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Return distances of intersections between two distances, and states, by steps along the rays."""
        n = len(origins)
        min_step_m = _MIN_STEP_CELLS * window.metadata.resolution_m
        upper, lower = first.copy(), np.full(n, np.nan)  # distances on both sides of the ground
        upper_clearance, lower_clearance = np.zeros(n), np.zeros(n)
        state = np.full(n, _PASSED)
        active = np.arange(n)
        distance = first.copy()
        for _ in range(_MAX_STEPS):
            points = origins[active] + distance[active, None] * directions[active]
            clearance, mapped = self._clearance(window, points)
            under = mapped & (clearance <= 0.0)
            crossing = under & (distance[active] > first[active])
            state[active[~mapped | under]] = _OFF_MAP  # also for rays that begin under the terrain
            crossed = active[crossing]
            state[crossed] = _HIT
            lower[crossed], lower_clearance[crossed] = distance[crossed], clearance[crossing]
            going = mapped & ~under & (distance[active] < last[active])
            rows = active[going]
            upper[rows], upper_clearance[rows] = distance[rows], clearance[going]
            down = -vectors.dot(points[going], directions[rows]) / vectors.length(points[going])
            level = np.sqrt(np.maximum(1.0 - down * down, 0.0))
            fall = np.maximum(down + window.max_slope * level, 1e-3)
            step = np.maximum(clearance[going] / fall, min_step_m)
            distance[rows] = np.minimum(distance[rows] + step, last[rows])
            active = rows
            if not len(active):
                break
        hit = np.flatnonzero(state == _HIT)
        upper_end, lower_end = (upper[hit], upper_clearance[hit]), (lower[hit], lower_clearance[hit])
        lower[hit], mapped = self._refined(window, origins[hit], directions[hit], upper_end, lower_end)
        state[hit[~mapped]] = _OFF_MAP
        return lower, state

    def _refined(
        self,
        window: TerrainWindow,
        origins: Floats,
        directions: Floats,
        upper_end: tuple[Floats, Floats],
        lower_end: tuple[Floats, Floats],
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return distances of intersections by the Illinois rule, from distances and clearances on both sides."""
        (start, start_m), (end, end_m) = upper_end, lower_end
        mapped = np.ones(len(end), bool)
        for _ in range(_MAX_REFINEMENTS):
            active = mapped & (np.abs(end_m) > _HEIGHT_TOLERANCE_M) & (np.abs(end - start) > 1e-9)
            if not active.any():
                break
            change = np.where(active, start_m - end_m, 1.0)
            following = end + np.where(active, end_m * (end - start) / change, 0.0)
            clearance, mapped = self._clearance(window, origins + following[:, None] * directions)
            crossed = clearance * end_m < 0.0
            start, start_m = np.where(crossed, end, start), np.where(crossed, end_m, 0.5 * start_m)
            end, end_m = following, clearance
        return end, mapped


def _chord(origins: Floats, directions: Floats, radius_m: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return distances at which lines enter and leave a sphere, and whether they intersect it."""
    along_m = -vectors.dot(origins, directions)  # to the point nearest the centre
    nearest_m = origins + along_m[:, None] * directions
    half2_m2 = radius_m**2 - vectors.dot(nearest_m, nearest_m)
    half_m = np.sqrt(np.maximum(half2_m2, 0.0))
    return along_m - half_m, along_m + half_m, half2_m2 >= 0.0


def _between(
    origins: Floats, directions: Floats, low_m: float, high_m: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return distances at which rays enter and leave the shell between two heights, and whether they enter it."""
    low_radius_m = MEAN_LUNAR_RADIUS_M + low_m
    first, last, crosses = _chord(origins, directions, MEAN_LUNAR_RADIUS_M + high_m)
    floor, _, falls = _chord(origins, directions, low_radius_m)
    falls &= (floor >= 0.0) & (vectors.length(origins) >= low_radius_m)
    return np.maximum(first, 0.0), np.where(falls, floor, last), crosses & (last >= 0.0)


Surface = Sphere | Terrain
