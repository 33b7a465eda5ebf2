"""Interpolation in what files give: bilinear on maps, linear between epochs, never over an edge or a gap.

SciPy's interpolators give values only; here the four points around a place are needed one by one, as each is taken to
the height of the station before they are blended, or may be missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MJD_ZERO_JD
from radioloc.errors import CoverageError, InputError
from radioloc.time import Epochs
from radioloc.vectors import Floats

_TURN_DEG = 360.0
_ROUNDING_DEG = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class LatLonGrid:
    """Points of a map in equal steps of either sign, degrees; `source` names it in errors. A full turn closes it."""

    latitudes_deg: Floats
    longitudes_deg: Floats
    source: str

    def __post_init__(self) -> None:
        for field in ("latitudes_deg", "longitudes_deg"):
            values = np.array(getattr(self, field), dtype=np.float64)
            object.__setattr__(self, field, values)
            steps = np.diff(values)
            if not len(steps) or steps[0] == 0.0:
                raise InputError(f"{self.source}: {field} must be two or more, in steps")
            if (np.abs(steps - steps[0]) > _ROUNDING_DEG).any():
                raise InputError(f"{self.source}: {field} do not go in equal steps")
        if np.abs(self.latitudes_deg).max() > 90.0:
            raise InputError(f"{self.source}: latitudes reach {np.abs(self.latitudes_deg).max():g} degrees")
        if np.ptp(self.longitudes_deg) > _TURN_DEG + _ROUNDING_DEG:
            raise InputError(f"{self.source}: longitudes go more than once round")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.latitudes_deg), len(self.longitudes_deg)

    def corners(
        self, latitude_rad: ArrayLike, longitude_rad: ArrayLike
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Find rows, columns and weights of the four points around each place (rad), shape (..., 4)."""
        latitude_deg, longitude_deg = np.broadcast_arrays(np.rad2deg(latitude_rad), np.rad2deg(longitude_rad))
        north, on_rows = _steps_along(self.latitudes_deg, latitude_deg, np.inf)
        east, on_columns = _steps_along(self.longitudes_deg, longitude_deg, _TURN_DEG)
        outside = ~(on_rows & on_columns)
        if outside.any():
            latitude, longitude = latitude_deg[outside][0], longitude_deg[outside][0]
            raise InputError(
                f"{self.source} reaches from latitude {self.latitudes_deg.min():g} to "
                f"{self.latitudes_deg.max():g} and longitude {self.longitudes_deg.min():g} to "
                f"{self.longitudes_deg.max():g} degrees, but {latitude:.6g}, {longitude:.6g} was asked for"
            )
        row = np.minimum(np.floor(north).astype(np.int64), self.shape[0] - 2)
        column = np.floor(east).astype(np.int64)
        next_column = (column + 1) % self.shape[1]
        north, east = north - row, east - column
        rows = np.stack([row, row, row + 1, row + 1], axis=-1)
        columns = np.stack([column, next_column, column, next_column], axis=-1)
        weights = np.stack([1.0 - north, 1.0 - north, north, north], axis=-1)
        return rows, columns, weights * np.stack([1.0 - east, east, 1.0 - east, east], axis=-1)


def _steps_along(axis_deg: Floats, where_deg: Floats, turn_deg: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Count steps from an axis' first point to each place, 0 to a turn, and tell whether it is on the axis."""
    # An axis that goes all the way round, with or without the first point at its end, has every place on it.
    step, last = axis_deg[1] - axis_deg[0], len(axis_deg) - 1.0
    slack, turn = _ROUNDING_DEG / abs(step), turn_deg / abs(step)
    steps = (where_deg - axis_deg[0]) / step
    if np.isfinite(turn):
        steps = np.mod(steps + slack, turn) - slack
    if last + 1.0 >= turn - slack:
        return np.maximum(steps, 0.0), np.isfinite(steps)
    # Within rounding of an end is on it.
    return np.clip(steps, 0.0, last), (steps >= -slack) & (steps <= last + slack)


def sort_into_grid(
    latitude_deg: Floats, longitude_deg: Floats, source: str
) -> tuple[LatLonGrid, NDArray[np.int64]]:
    """Make a grid of points in any order, each once, and give their order, (rows, columns); longitudes 0 to 360."""
    longitude_deg = longitude_deg % _TURN_DEG
    latitudes, longitudes = np.unique(latitude_deg), np.unique(longitude_deg)
    order = np.lexsort((longitude_deg, latitude_deg))
    points = np.stack([latitude_deg[order], longitude_deg[order]], axis=-1)
    whole = np.stack(np.meshgrid(latitudes, longitudes, indexing="ij"), axis=-1).reshape(-1, 2)
    if points.shape != whole.shape or (points != whole).any():
        raise InputError(
            f"{source} has {len(points)} points, which do not fill a grid of {len(latitudes)} latitudes and "
            f"{len(longitudes)} longitudes once"
        )
    grid = LatLonGrid(latitudes, longitudes, source)
    return grid, order.reshape(grid.shape)


def epochs_around(
    file_mjd_utc: Floats, mjd_utc: Floats, longest_gap_d: float, source: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Find a file's (rising) epochs before and after each epoch, and the fraction of the way between them."""
    last = len(file_mjd_utc) - 1
    outside = (mjd_utc < file_mjd_utc[0]) | (mjd_utc > file_mjd_utc[-1])
    if outside.any():
        wrong = mjd_utc[outside]
        raise CoverageError(
            source,
            (_hour(file_mjd_utc[0]), _hour(file_mjd_utc[-1])),
            (_hour(wrong.min()), _hour(wrong.max())),
            "read the files of the days before and after too",
        )
    before = np.clip(np.searchsorted(file_mjd_utc, mjd_utc, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    gap = file_mjd_utc[after] - file_mjd_utc[before]
    # On an epoch of the file no neighbour is needed.
    between = (mjd_utc != file_mjd_utc[before]) & (mjd_utc != file_mjd_utc[after])
    wide = np.flatnonzero((gap > longest_gap_d) & between)
    if len(wide):
        k = wide[0]
        edges = _hour(file_mjd_utc[before[k]]), _hour(file_mjd_utc[after[k]])
        raise CoverageError(
            f"{source}, which lacks epochs,",
            (_hour(file_mjd_utc[0]), f"{edges[0]} and from {edges[1]}"),
            (_hour(mjd_utc[k]),) * 2,
            "read the files between too",
        )
    return before, after, (mjd_utc - file_mjd_utc[before]) / np.where(gap > 0.0, gap, 1.0)


def _hour(mjd_utc: float) -> str:
    epoch = Epochs.from_jd(MJD_ZERO_JD, mjd_utc, "UTC")
    return f"{epoch.day_strings()[0]} {24.0 * epoch.fraction[0]:04.1f} h UTC"
