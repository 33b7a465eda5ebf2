"""The ground of an elevation map, and where rays meet it first."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging.surfaces import Sphere
from radioloc.lunar import TerrainModel, cartesian_to_selenographic
from radioloc.lunar.terrain_source import HIGHEST_M, LOWEST_M
from radioloc.lunar.terrain_window import LargeWindowError, TerrainWindow

Floats = NDArray[np.float64]

_RAYS_AT_ONCE = 100_000
_STATIONS = 5  # points of each ray from which follows what part of the map is needed
_SMALLEST_STEP_CELLS = 0.25
_STEPS = 20_000
_MET_M = 1e-5
_REFINEMENTS = 60


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
        """First points on rays, m, shape (n, 3), and whether there is one.

        A ray that leaves the map or comes to a void before it meets the ground does not meet it.

        Raises
        ------
        InputError
            The map shows no ray's ground, or one ray needs more than 60 million cells.
        """
        points, hits = np.array(origins_m), np.zeros(len(origins_m), dtype=bool)
        for start in range(0, len(origins_m), _RAYS_AT_ONCE):
            part = slice(start, start + _RAYS_AT_ONCE)
            points[part], hits[part] = self._in_parts(origins_m[part], directions[part])
        return points, hits

    def gradient(self, points_m: Floats) -> Floats:
        """Derivatives of the height above the terrain by x, y, z, shape (n, 3)."""
        longitude, latitude, height_m = cartesian_to_selenographic(points_m)
        try:
            slopes = self.model.window(longitude, latitude).heights_and_slopes
        except LargeWindowError:
            slopes = self.model.height_and_slope
        _, by_longitude, by_latitude = slopes(longitude, latitude)
        east, north, up = np.moveaxis(vectors.east_north_up(longitude, latitude), -2, 0)
        radius_m = MEAN_LUNAR_RADIUS_M + height_m
        east_slope = by_longitude / (radius_m * np.maximum(np.cos(latitude), 1e-12))
        return np.asarray(up - east_slope[:, None] * east - (by_latitude / radius_m)[:, None] * north)

    def _in_parts(self, origins: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """By halves where all rays together need too much of the map."""
        try:
            return self._intersect(origins, directions)
        except LargeWindowError:
            half = len(origins) // 2
            if not half:
                raise
            parts = [self._in_parts(origins[k], directions[k]) for k in (slice(half), slice(half, None))]
            return np.concatenate([p for p, _ in parts]), np.concatenate([h for _, h in parts])

    def _intersect(self, origins: Floats, directions: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        first, last, toward = _between(
            origins, directions, LOWEST_M + self.raised_m, HIGHEST_M + self.raised_m
        )
        points, hits = origins.copy(), np.zeros(len(origins), dtype=bool)
        if not toward.any():
            return points, hits
        rows = np.flatnonzero(toward)
        stations = np.linspace(0.0, 1.0, _STATIONS)[:, None]
        along = first[rows] + stations * (last[rows] - first[rows])
        nearby = origins[rows] + along[..., None] * directions[rows]
        window = self.model.window(*cartesian_to_selenographic(nearby.reshape(-1, 3))[:2])
        low_m, high_m = window.range_m
        first, last, toward = _between(
            origins[rows], directions[rows], low_m + self.raised_m - 1.0, high_m + self.raised_m + 1.0
        )
        rows, first, last = rows[toward], first[toward], last[toward]
        distance, met = self._march(window, origins[rows], directions[rows], first, last)
        rows, distance = rows[met], distance[met]
        points[rows] = origins[rows] + distance[:, None] * directions[rows]
        hits[rows] = True
        return points, hits

    def _clearance(self, window: TerrainWindow, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Heights of points above the terrain, m, and whether the map has terrain there."""
        longitude, latitude, height_m = cartesian_to_selenographic(points)
        terrain_m, known = window.heights(longitude, latitude)
        return height_m - terrain_m - self.raised_m, known

    def _march(
        self, window: TerrainWindow, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Distances at which rays meet the terrain, and whether they do, between two distances."""
        n = len(origins)
        smallest_m = _SMALLEST_STEP_CELLS * window.metadata.resolution_m
        above, below = first.copy(), np.full(n, np.nan)  # distances on both sides of the ground
        clear_above, clear_below = np.zeros(n), np.zeros(n)
        met = np.zeros(n, dtype=bool)
        active = np.arange(n)
        distance = first.copy()
        for _ in range(_STEPS):
            points = origins[active] + distance[active, None] * directions[active]
            clear, known = self._clearance(window, points)
            under = known & (clear <= 0.0)
            # a ray that begins under the terrain does not come from outside
            crossed = active[under & (distance[active] > first[active])]
            met[crossed], below[crossed] = True, distance[crossed]
            clear_below[crossed] = clear[under & (distance[active] > first[active])]
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
        met: NDArray[np.bool_],
    ) -> None:
        """Bring distances under the ground up to it, by regula falsi with the Illinois rule, in place."""
        (above, clear_above), (below, clear_below) = over, under
        found = below.copy()
        active = np.flatnonzero(met)
        side = np.zeros(len(below))
        for _ in range(_REFINEMENTS):
            span = clear_above[active] - clear_below[active]
            part = np.where(span > 0.0, clear_above[active] / np.where(span > 0.0, span, 1.0), 0.5)
            found[active] = above[active] + part * (below[active] - above[active])
            clear, known = self._clearance(window, origins[active] + found[active, None] * directions[active])
            met[active[~known]] = False
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
        below[met] = found[met]


def _between(
    origins: Floats, directions: Floats, low_m: float, high_m: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Distances at which rays come below one height and leave the space above another, and whether they do."""
    high, low = Sphere(MEAN_LUNAR_RADIUS_M + high_m), Sphere(MEAN_LUNAR_RADIUS_M + low_m)
    inside = vectors.length(origins) < high.radius_m
    entry, enters = high.intersect(origins, directions)
    first = np.where(inside, 0.0, vectors.dot(entry - origins, directions))
    floor, falls = low.intersect(origins, directions)
    last = vectors.dot(floor - origins, directions)
    # those that pass above the lower sphere leave the upper one again, as far behind the middle as it was before
    middle = -vectors.dot(origins, directions)
    through = 2.0 * middle - first
    leaving, _ = high.intersect(origins, directions)
    through = np.where(inside, vectors.dot(leaving - origins, directions), through)
    falls &= vectors.length(origins) >= low.radius_m
    return first, np.where(falls, last, through), (inside | enters)
