"""Bilinear interpolation on maps with regular steps of latitude and longitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError

_TURN_DEG = 360.0
_ROUNDING_DEG = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class LatLonGrid:
    """Points of a map: rows along latitude, columns along longitude.

    Parameters
    ----------
    latitudes_deg, longitudes_deg : array_like, shape (rows,), (columns,)
        Of the rows and columns, degrees, in equal steps of either sign, at least two. Longitudes that go all the way
        round, with or without the first repeated at the end, make a map that closes on itself.
    source : str
        What the map is, for errors.

    Raises
    ------
    InputError
        The steps are not equal, or go over a pole or more than once round.
    """

    latitudes_deg: NDArray[np.float64]
    longitudes_deg: NDArray[np.float64]
    source: str

    def __post_init__(self) -> None:
        for field in ("latitudes_deg", "longitudes_deg"):
            values = np.array(getattr(self, field), dtype=np.float64)
            values.setflags(write=False)
            steps = np.diff(values)
            if values.ndim != 1 or not len(steps) or steps[0] == 0.0:
                raise InputError(f"{self.source}: {field} must be two or more, in steps")
            if (np.abs(steps - steps[0]) > _ROUNDING_DEG).any():
                raise InputError(f"{self.source}: {field} do not go in equal steps")
            object.__setattr__(self, field, values)
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
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Rows, columns and weights of the four points around each place, shape (..., 4).

        Parameters
        ----------
        latitude_rad, longitude_rad : array_like
            Latitude and east longitude, rad.

        Raises
        ------
        InputError
            A place is outside the map, or not finite.
        """
        latitude, longitude = np.broadcast_arrays(
            np.rad2deg(np.asarray(latitude_rad, dtype=np.float64)),
            np.rad2deg(np.asarray(longitude_rad, dtype=np.float64)),
        )
        row, row_weight, row_inside = self._along_latitude(latitude)
        column, next_column, column_weight, column_inside = self._along_longitude(longitude)
        inside = row_inside & column_inside
        if not inside.all():
            k = np.argmin(np.ravel(inside))
            raise InputError(
                f"{self.source} reaches from latitude {self.latitudes_deg.min():g} to "
                f"{self.latitudes_deg.max():g} and longitude {self.longitudes_deg.min():g} to "
                f"{self.longitudes_deg.max():g} degrees, but {np.ravel(latitude)[k]:.6g}, "
                f"{np.ravel(longitude)[k]:.6g} was asked for"
            )
        rows = np.stack([row, row, row + 1, row + 1], axis=-1)
        columns = np.stack([column, next_column, column, next_column], axis=-1)
        weights = np.stack(
            [
                (1.0 - row_weight) * (1.0 - column_weight),
                (1.0 - row_weight) * column_weight,
                row_weight * (1.0 - column_weight),
                row_weight * column_weight,
            ],
            axis=-1,
        )
        return rows, columns, weights

    def _along_latitude(
        self, latitude_deg: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        step = self.latitudes_deg[1] - self.latitudes_deg[0]
        steps = (latitude_deg - self.latitudes_deg[0]) / step
        last = len(self.latitudes_deg) - 1
        slack = _ROUNDING_DEG / abs(step)
        inside = (steps >= -slack) & (steps <= last + slack)
        # Within rounding of the edge is on it; the rest of what is outside is refused.
        steps = np.clip(np.where(inside, steps, 0.0), 0.0, last)
        index = np.minimum(np.floor(steps).astype(np.int64), last - 1)
        return index, steps - index, inside

    def _along_longitude(
        self, longitude_deg: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        step = self.longitudes_deg[1] - self.longitudes_deg[0]
        finite = np.isfinite(longitude_deg)
        east = np.where(finite, longitude_deg, 0.0) - self.longitudes_deg[0]
        steps = (east * np.sign(step)) % _TURN_DEG / abs(step)
        n = len(self.longitudes_deg)
        slack = _ROUNDING_DEG / abs(step)
        closed = n * abs(step) >= _TURN_DEG - _ROUNDING_DEG
        # Just west of the first column, by rounding, is on it.
        steps = np.where(steps > _TURN_DEG / abs(step) - slack, 0.0, steps)
        inside = finite & (closed | (steps <= n - 1 + slack))
        steps = np.where(inside, steps, 0.0) if closed else np.minimum(np.where(inside, steps, 0.0), n - 1)
        index = np.floor(steps).astype(np.int64)
        if not closed:
            index = np.minimum(index, n - 2)
        return index, (index + 1) % n, steps - index, inside


def sort_into_grid(
    latitude_deg: NDArray[np.float64], longitude_deg: NDArray[np.float64], source: str
) -> tuple[LatLonGrid, NDArray[np.int64]]:
    """Grid that a list of points makes, and the order of the points in it, shape (rows, columns).

    Parameters
    ----------
    latitude_deg, longitude_deg : ndarray, shape (n,)
        Of the points in any order, degrees; longitudes are counted from 0 to 360.
    source : str
        What the map is, for errors.

    Raises
    ------
    InputError
        The points are not those of a grid, each once.
    """
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
