"""Interpolation of data of files: bilinear on maps, linear between epochs, never over an edge or a gap.

The four points around a place are needed one by one, unlike in SciPy's interpolators: each is reduced to the height of
the station before the mean is taken, or may be missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MJD_ZERO_JD
from radioloc.errors import CoverageError, InputError
from radioloc.time import Epochs
from radioloc.vectors import Floats, Mask

_TURN_DEG = 360.0
_ROUNDING_DEG = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class LatLonGrid:
    """Points of a map in equal steps of either sign, degrees; `source` names it in errors."""

    latitudes_deg: Floats
    longitudes_deg: Floats
    source: str

    def __post_init__(self) -> None:
        for field in ("latitudes_deg", "longitudes_deg"):
            steps = np.diff(getattr(self, field))
            if not len(steps) or steps[0] == 0.0 or (np.abs(steps - steps[0]) > _ROUNDING_DEG).any():
                raise InputError(f"{self.source}: {field}: expected two or more values in equal steps")
        if np.abs(self.latitudes_deg).max() > 90.0:
            raise InputError(f"{self.source}: latitudes reach {np.abs(self.latitudes_deg).max():g} degrees")
        if np.ptp(self.longitudes_deg) > _TURN_DEG + _ROUNDING_DEG:
            raise InputError(f"{self.source}: longitudes extend over more than 360 degrees")

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return len(self.latitudes_deg), len(self.longitudes_deg)

    def corners(
        self, latitude_rad: ArrayLike, longitude_rad: ArrayLike
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Return rows, columns and weights of the four points around each place (rad), shape (..., 4)."""
        latitude_deg, longitude_deg = np.broadcast_arrays(np.rad2deg(latitude_rad), np.rad2deg(longitude_rad))
        north, on_rows = _axis_steps(self.latitudes_deg, latitude_deg, np.inf)
        east, on_columns = _axis_steps(self.longitudes_deg, longitude_deg, _TURN_DEG)
        off_grid = ~(on_rows & on_columns)
        if off_grid.any():
            latitude, longitude = latitude_deg[off_grid][0], longitude_deg[off_grid][0]
            raise InputError(
                f"{self.source}: expected a latitude of {self.latitudes_deg.min():g} to {self.latitudes_deg.max():g} "
                f"and a longitude of {self.longitudes_deg.min():g} to {self.longitudes_deg.max():g} degrees, got "
                f"{latitude:.6g}, {longitude:.6g}"
            )
        row = np.minimum(np.floor(north).astype(np.int64), self.shape[0] - 2)
        column = np.floor(east).astype(np.int64)
        next_column = (column + 1) % self.shape[1]
        north, east = north - row, east - column
        rows = np.stack([row, row, row + 1, row + 1], axis=-1)
        columns = np.stack([column, next_column, column, next_column], axis=-1)
        weights = np.stack([1.0 - north, 1.0 - north, north, north], axis=-1)
        return rows, columns, weights * np.stack([1.0 - east, east, 1.0 - east, east], axis=-1)


def _axis_steps(axis_deg: Floats, place_deg: Floats, turn_deg: float) -> tuple[Floats, Mask]:
    """Return steps from the first point of an axis to each place, 0 to a turn, and whether it is on the axis."""
    # A closed axis, with or without the first point at its end, has every place on it.
    step, last = axis_deg[1] - axis_deg[0], len(axis_deg) - 1.0
    slack, turn = _ROUNDING_DEG / abs(step), turn_deg / abs(step)
    steps = (place_deg - axis_deg[0]) / step
    if np.isfinite(turn):
        steps = np.mod(steps + slack, turn) - slack
    if last + 1.0 >= turn - slack:
        return np.maximum(steps, 0.0), np.isfinite(steps)
    # Places within rounding of an end count as on it.
    return np.clip(steps, 0.0, last), (steps >= -slack) & (steps <= last + slack)


def sort_into_grid(
    latitude_deg: Floats, longitude_deg: Floats, source: str
) -> tuple[LatLonGrid, NDArray[np.int64]]:
    """Return the grid of points in any order, longitudes 0 to 360, and their order, shape (rows, columns)."""
    longitude_deg = longitude_deg % _TURN_DEG
    latitudes, longitudes = np.unique(latitude_deg), np.unique(longitude_deg)
    order = np.lexsort((longitude_deg, latitude_deg))
    points = np.stack([latitude_deg[order], longitude_deg[order]], axis=-1)
    expected = np.stack(np.meshgrid(latitudes, longitudes, indexing="ij"), axis=-1).reshape(-1, 2)
    if points.shape != expected.shape or (points != expected).any():
        raise InputError(
            f"{source}: expected a full grid of {len(latitudes)} latitudes and {len(longitudes)} longitudes, got "
            f"{len(points)} points"
        )
    grid = LatLonGrid(latitudes, longitudes, source)
    return grid, order.reshape(grid.shape)


def enclosing_epochs(
    file_mjd_utc: Floats, mjd_utc: Floats, max_gap_d: float, source: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return indices of a file's (rising) epochs on both sides of each epoch, and its fraction of the interval."""
    last = len(file_mjd_utc) - 1
    out_of_span = (mjd_utc < file_mjd_utc[0]) | (mjd_utc > file_mjd_utc[-1])
    if out_of_span.any():
        wrong = mjd_utc[out_of_span]
        raise CoverageError(
            source,
            (_hour(file_mjd_utc[0]), _hour(file_mjd_utc[-1])),
            (_hour(wrong.min()), _hour(wrong.max())),
            "read the files of the neighbouring days, too",
        )
    earlier = np.clip(np.searchsorted(file_mjd_utc, mjd_utc, side="right") - 1, 0, max(last - 1, 0))
    later = np.minimum(earlier + 1, last)
    gap = file_mjd_utc[later] - file_mjd_utc[earlier]
    # An epoch of the file itself needs no neighbour.
    between = (mjd_utc != file_mjd_utc[earlier]) & (mjd_utc != file_mjd_utc[later])
    in_gaps = np.flatnonzero((gap > max_gap_d) & between)
    if len(in_gaps):
        k = in_gaps[0]
        edges = _hour(file_mjd_utc[earlier[k]]), _hour(file_mjd_utc[later[k]])
        raise CoverageError(
            f"{source}, which has a gap,",
            (_hour(file_mjd_utc[0]), f"{edges[0]} and from {edges[1]}"),
            (_hour(mjd_utc[k]),) * 2,
            "read the files of the gap, too",
        )
    return earlier, later, (mjd_utc - file_mjd_utc[earlier]) / np.where(gap > 0.0, gap, 1.0)


def _hour(mjd_utc: float) -> str:
    epoch = Epochs.from_jd(MJD_ZERO_JD, mjd_utc, "UTC")
    return f"{epoch.day_strings()[0]} {24.0 * epoch.fraction[0]:04.1f} h UTC"
