"""What rays meet: a sphere, or the ground of an elevation map.

A surface says where rays meet it first, and how fast the height above it grows in each direction, from which follows
how a ground point answers to changes of the ray and of the height.
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

_RAYS_AT_ONCE = 100_000
_STATIONS = 5  # points of each ray from which follows what part of the map is needed
_SMALLEST_STEP_CELLS = 0.25
_STEPS = 20_000
_MET_M = 1e-5
_REFINEMENTS = 60
_PASSED, _MET, _LOST = np.int8(0), np.int8(1), np.int8(2)
"""What becomes of a ray: it stays above the ground, meets it, or comes to where the map has none."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere around the Moon's centre."""

    radius_m: float = MEAN_LUNAR_RADIUS_M
    mean_earth: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        convert_fields(self)
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(f"radius_m = {self.radius_m!r} is not a positive number of metres")

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """First points on rays from outside, or the only one on rays from inside."""
        enters_m, leaves_m, hits = _chord(origins_m, directions, self.radius_m)
        distance_m = np.where(vectors.length(origins_m) < self.radius_m, leaves_m, enters_m)
        return origins_m + distance_m[:, None] * directions, hits & (distance_m >= 0.0)

    def gradient(self, points_m: Floats) -> Floats:
        """Up."""
        return vectors.normalized(points_m)


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """The ground of an elevation map, in mean-Earth axes.

    Parameters
    ----------
    model : TerrainModel
        The map.
    raised_m : float
        Height that is added to the map's, such as an error of the map.

    Notes
    -----
    A ray goes down from the height of the highest cell in steps that cannot pass through the terrain: as far as its
    clearance allows by the steepest slope between neighbouring cells (Hart 1996, *sphere tracing*), at least a quarter
    of a cell. Where it is below, the point is found by the Illinois rule, to 0.01 mm.
    """

    model: TerrainModel
    raised_m: float = 0.0
    mean_earth: bool = field(default=True, init=False)

    def intersect(self, origins_m: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return first points on rays, m, shape (n, 3), and whether the map has them without a gap before."""
        points, hits = np.array(origins_m), np.zeros(len(origins_m), dtype=bool)
        lowest, highest = (limit_m + self.raised_m for limit_m in LUNAR_HEIGHT_LIMITS_M)
        for start in range(0, len(origins_m), _RAYS_AT_ONCE):
            part = slice(start, start + _RAYS_AT_ONCE)
            first, last, toward = _between(origins_m[part], directions[part], lowest, highest)
            rows = start + np.flatnonzero(toward)
            spans = origins_m[rows], directions[rows], first[toward], last[toward]
            distance, met = self._in_parts(*spans)
            hits[rows] = met == _MET
            points[rows] += np.where(hits[rows], distance, 0.0)[:, None] * directions[rows]
        return points, hits

    def gradient(self, points_m: Floats) -> Floats:
        """Derivatives of the height above the terrain by x, y, z, shape (n, 3)."""
        longitude, latitude, height_m = cartesian_to_selenographic(points_m)
        _, gradient = height_and_gradient(self.model.height_and_slope, longitude, latitude)
        return vectors.normalized(points_m) - gradient / (MEAN_LUNAR_RADIUS_M + height_m)[:, None]

    def _in_parts(
        self, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Between two distances, by halves of the rays, then of a ray, where that needs too much of the map at once."""
        try:
            return self._intersect(origins, directions, first, last)
        except NoTerrainError:
            return np.zeros(len(origins)), np.full(len(origins), _LOST)
        except LargeWindowError:
            half = len(origins) // 2
            if half:
                parts = [
                    self._in_parts(origins[k], directions[k], first[k], last[k])
                    for k in (slice(half), slice(half, None))
                ]
                return np.concatenate([d for d, _ in parts]), np.concatenate([m for _, m in parts])
            middle = 0.5 * (first + last)
            distance, met = self._in_parts(origins, directions, first, middle)
            return (distance, met) if met[0] != _PASSED else self._in_parts(origins, directions, middle, last)

    def _intersect(
        self, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Distances at which rays meet the ground between two distances, and what becomes of them."""
        distance, met = np.zeros(len(origins)), np.full(len(origins), _PASSED)
        if not len(origins):
            return distance, met
        stations = np.linspace(0.0, 1.0, _STATIONS)[:, None]
        nearby = origins + (first + stations * (last - first))[..., None] * directions
        window = self.model.window(*cartesian_to_selenographic(nearby.reshape(-1, 3))[:2])
        low_m, high_m = window.range_m
        entry, leaving, toward = _between(
            origins, directions, low_m + self.raised_m - 1.0, high_m + self.raised_m + 1.0
        )
        entry, leaving = np.maximum(entry, first), np.minimum(leaving, last)
        rows = np.flatnonzero(toward & (entry < leaving))
        distance[rows], met[rows] = self._march(
            window, origins[rows], directions[rows], entry[rows], leaving[rows]
        )
        return distance, met

    def _clearance(self, window: TerrainWindow, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Heights of points above the terrain, m, and whether the map has terrain there."""
        longitude, latitude, height_m = cartesian_to_selenographic(points)
        terrain_m, known = window.heights(longitude, latitude)
        return height_m - terrain_m - self.raised_m, known

    def _march(
        self, window: TerrainWindow, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.int8]]:
        """Distances at which rays meet the terrain between two distances, and what becomes of them."""
        n = len(origins)
        smallest_m = _SMALLEST_STEP_CELLS * window.metadata.resolution_m
        above, below = first.copy(), np.full(n, np.nan)  # distances on both sides of the ground
        clear_above, clear_below = np.zeros(n), np.zeros(n)
        met = np.full(n, _PASSED)
        active = np.arange(n)
        distance = first.copy()
        for _ in range(_STEPS):
            points = origins[active] + distance[active, None] * directions[active]
            clear, known = self._clearance(window, points)
            under = known & (clear <= 0.0)
            crossing = under & (distance[active] > first[active])
            met[active[~known | under]] = (
                _LOST  # also a ray that begins under the terrain: it comes from nowhere
            )
            crossed = active[crossing]
            met[crossed], below[crossed], clear_below[crossed] = _MET, distance[crossed], clear[crossing]
            going = known & ~under & (distance[active] < last[active])
            rows = active[going]
            above[rows], clear_above[rows] = distance[rows], clear[going]
            down = -vectors.dot(points[going], directions[rows]) / vectors.length(points[going])
            level = np.sqrt(np.maximum(1.0 - down * down, 0.0))
            fall = np.maximum(down + window.steepest * level, 1e-3)
            step = np.maximum(clear[going] / fall, smallest_m)
            distance[rows] = np.minimum(distance[rows] + step, last[rows])
            active = rows
            if not len(active):
                break
        self._refine(window, origins, directions, (above, clear_above), (below, clear_below), met)
        return below, met

    def _refine(
        self,
        window: TerrainWindow,
        origins: Floats,
        directions: Floats,
        over: tuple[Floats, Floats],
        under: tuple[Floats, Floats],
        met: NDArray[np.int8],
    ) -> None:
        """Bring distances under the ground up to it, by regula falsi with the Illinois rule, in place."""
        (above, clear_above), (below, clear_below) = over, under
        found = below.copy()
        active = np.flatnonzero(met == _MET)
        side = np.zeros(len(below))
        for _ in range(_REFINEMENTS):
            span = clear_above[active] - clear_below[active]
            part = np.where(span > 0.0, clear_above[active] / np.where(span > 0.0, span, 1.0), 0.5)
            found[active] = above[active] + part * (below[active] - above[active])
            clear, known = self._clearance(window, origins[active] + found[active, None] * directions[active])
            met[active[~known]] = _LOST
            up = clear > 0.0
            for which, ends, values, others, sign in (
                (up, above, clear_above, clear_below, 1.0),
                (~up, below, clear_below, clear_above, -1.0),
            ):
                rows = active[which]
                again = side[rows] == sign
                others[rows[again]] *= 0.5
                ends[rows], values[rows], side[rows] = found[rows], clear[which], sign
            active = active[known & (np.abs(clear) > _MET_M) & (np.abs(below - above)[active] > 1e-9)]
            if not len(active):
                break
        below[met == _MET] = found[met == _MET]


def _chord(origins: Floats, directions: Floats, radius_m: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Distances at which lines enter and leave a sphere, and whether they do."""
    along_m = -vectors.dot(origins, directions)  # to the point nearest the centre
    nearest_m = origins + along_m[:, None] * directions
    half2_m2 = radius_m**2 - vectors.dot(nearest_m, nearest_m)
    half_m = np.sqrt(np.maximum(half2_m2, 0.0))
    return along_m - half_m, along_m + half_m, half2_m2 >= 0.0


def _between(
    origins: Floats, directions: Floats, low_m: float, high_m: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Distances at which rays come below one height and leave the space above another, and whether they do."""
    low_radius_m = MEAN_LUNAR_RADIUS_M + low_m
    first, last, crosses = _chord(origins, directions, MEAN_LUNAR_RADIUS_M + high_m)
    floor, _, falls = _chord(origins, directions, low_radius_m)
    falls &= (floor >= 0.0) & (vectors.length(origins) >= low_radius_m)
    return np.maximum(first, 0.0), np.where(falls, floor, last), crosses & (last >= 0.0)


Surface = Sphere | Terrain
