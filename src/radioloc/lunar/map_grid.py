"""Cells of a map of the Moon by longitude and latitude, and interpolation among them.

A position in the grid is two floats, row and column, counted so that the centre of a cell has whole numbers:
the cell (0, 0) reaches from -0.5 to 0.5. GDAL's transform counts from a cell's corner; only this module
adds the half cell between the two. Maps of all longitudes are closed: column -1 is the last one,
and the row beyond the pole is the first row half a turn away.

Interpolation is bilinear, or cubic convolution (Keys 1981, a = -1/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.lazy import optional
from radioloc.vectors import Floats, Mask

Indices = NDArray[np.int64]

STENCIL_CELLS = {"bilinear": 2, "bicubic": 4}
"""Cells along each side of those that a point needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Stencil:
    """The cells around points of a grid, shape (n, size, size), and how values follow from theirs."""

    rows: Indices
    columns: Indices
    row_weights: tuple[Floats, Floats]  # and their derivatives, by row, shape (n, size)
    column_weights: tuple[Floats, Floats]

    @classmethod
    def around(cls, row: Floats, column: Floats, shape: tuple[int, ...], interpolation: str) -> Stencil:
        """Find the cells around points at rows and columns, (n,), whose whole numbers are the cells' centres."""
        size = STENCIL_CELLS[interpolation]
        (first_row, in_row), (first_column, in_column) = (
            _first_cell(place, count, size) for place, count in zip((row, column), shape, strict=True)
        )
        steps = np.arange(size)
        rows, columns = np.broadcast_arrays(
            (first_row[:, None] + steps)[:, :, None], (first_column[:, None] + steps)[:, None, :]
        )
        return cls(rows, columns, _weights(interpolation, in_row), _weights(interpolation, in_column))

    def value(self, cells: Floats) -> Floats:
        """Values at the points, shape (n,), of those of the cells, shape (n, size, size)."""
        return np.asarray(np.einsum("nij,ni,nj->n", cells, self.row_weights[0], self.column_weights[0]))

    def value_and_slopes(self, cells: Floats, by_angle: Floats) -> tuple[Floats, Floats, Floats]:
        """Values and their derivatives by two angles; `by_angles` are those of row and column, shape (2, 2, n)."""
        by_row = np.einsum("nij,ni,nj->n", cells, self.row_weights[1], self.column_weights[0])
        by_column = np.einsum("nij,ni,nj->n", cells, self.row_weights[0], self.column_weights[1])
        first, second = by_row * by_angle[:, 0] + by_column * by_angle[:, 1]
        return self.value(cells), first, second


def _first_cell(position: Floats, cells: int, size: int) -> tuple[Indices, Floats]:
    """First cell of the stencil along one axis, and the place from 0 to 1 between its two middle cells."""
    half = size // 2
    # a point on the centre of the last cell that can be a middle one needs no cell beyond it
    lower = np.where(position == cells - half, cells - half - 1.0, np.floor(position))
    return lower.astype(np.int64) - (half - 1), position - lower


def _weights(interpolation: str, t: Floats) -> tuple[Floats, Floats]:
    """Weights of the cells along one axis at place t, and their derivatives by t, shape (n, size)."""
    unit = np.ones_like(t)
    if interpolation == "bilinear":
        return np.stack([1.0 - t, t], axis=-1), np.stack([-unit, unit], axis=-1)
    t2, t3 = t * t, t * t * t
    values = [-t3 + 2.0 * t2 - t, 3.0 * t3 - 5.0 * t2 + 2.0, -3.0 * t3 + 4.0 * t2 + t, t3 - t2]
    slopes = [-3.0 * t2 + 4.0 * t - 1.0, 9.0 * t2 - 10.0 * t, -9.0 * t2 + 8.0 * t + 1.0, 3.0 * t2 - 2.0 * t]
    return 0.5 * np.stack(values, axis=-1), 0.5 * np.stack(slopes, axis=-1)


_STEP_RAD = 1e-6  # 1.7 m on the ground: rounding of map coordinates leaves a part in 1e9 of a derivative
_AROUND_TOLERANCE_CELLS = 0.1  # a label's rounded map scale leaves a global map open by less than this
_CYLINDRICAL = {"longlat", "latlong", "eqc", "cea", "merc", "mill"}
_ROWS_EVEN_IN_LATITUDE = {"longlat", "latlong", "eqc"}


def load_rasterio() -> ModuleType:
    """Import the module ``rasterio`` when the first map is opened."""
    need = "maps are read through rasterio, which is not installed;"
    optional("rasterio.warp", need, "terrain")
    return optional("rasterio", need, "terrain")


@dataclass(frozen=True, slots=True)
class MapGrid:
    """The cells of a map and its projection."""

    crs: Any  # of rasterio, the map's
    geographic: Any  # longitude and latitude in degrees on the same sphere
    rows: int
    columns: int
    transform: Any  # from column and row, counted from the map's corner, to x and y
    resolution_m: float  # size of a cell where the projection is true to scale
    columns_around: float | None = None  # in a full turn of longitude, where there is such a number
    closed: bool = False  # the map covers all longitudes by a whole number of columns
    fold_north: int | None = None  # row r beyond the pole is fold - r, half a turn away
    fold_south: int | None = None
    # Central longitude, x there and its derivative by longitude, y at zero and its derivative by latitude, if linear
    linear: tuple[float, float, float, float, float] | None = None

    @classmethod
    def of_map(cls, crs: Any, transform: Any, rows: int, columns: int, sphere_m: float) -> MapGrid:
        """Build from the map's reference system (rasterio), transform, size and sphere radius."""
        # A global cylindrical map whose width misses a full turn by less than a tenth of a cell is taken to close:
        # labels round their map scale (LDEM_4 by 3 m in 10916 km).
        rasterio = load_rasterio()
        geographic = rasterio.crs.CRS.from_proj4(f"+proj=longlat +R={sphere_m!r} +no_defs")
        scale_m = math.radians(1.0) * sphere_m if crs.is_geographic else crs.linear_units_factor[1]
        resolution_m = math.sqrt(abs(transform.determinant)) * scale_m
        grid = cls(crs, geographic, rows, columns, transform, resolution_m)
        definition = crs.to_dict()
        name = definition.get("proj")
        if name not in _CYLINDRICAL or transform.b != 0.0 or transform.d != 0.0:
            return grid
        centre_rad = math.radians(float(definition.get("lon_0", 0.0)))
        quarter = np.array([centre_rad - math.pi / 4, centre_rad + math.pi / 4])
        x, _ = grid._project(quarter, np.zeros(2))
        around = 4.0 * abs(float(x[1] - x[0]) / transform.a)
        if abs(around - columns) < _AROUND_TOLERANCE_CELLS:
            stretch = around / columns
            a, _, c, _, e, f = transform[:6]
            stretch_y = stretch if abs(a) == abs(e) else 1.0
            transform = type(transform)(a * stretch, 0.0, c * stretch, 0.0, e * stretch_y, f * stretch_y)
            around = float(columns)
        elif abs(around - round(around)) < 1e-6 * around:
            around = float(round(around))
        closed = around == round(around) and columns >= around
        folds: list[int | None] = [None, None]
        linear = None
        if name in _ROWS_EVEN_IN_LATITUDE:
            _, y = grid._project(np.full(2, centre_rad), np.array([math.pi / 2, -math.pi / 2]))
            by_longitude, by_latitude = float(x[1] - x[0]) / (math.pi / 2), float(y[0] - y[1]) / math.pi
            if "lon_wrap" not in definition:
                linear = centre_rad, float(x.mean()), by_longitude, float(y.mean()), by_latitude
            if closed and round(around) % 2 == 0:
                sums = 2.0 * ((y - transform.f) / transform.e - 0.5)
                folds = [round(float(t)) if abs(t - round(t)) < 0.1 else None for t in sums]
        scale = crs, geographic, rows, columns, transform, resolution_m
        return cls(*scale, around, closed, fold_north=folds[0], fold_south=folds[1], linear=linear)

    def cells(self, longitude_rad: Floats, latitude_rad: Floats) -> tuple[Floats, Floats]:
        """Row and column of points, shape (n,); not finite where the projection does not show the point."""
        x, y = self._project(longitude_rad, latitude_rad)
        with np.errstate(invalid="ignore"):  # infinities make NaN, which the caller refuses as well
            u, v = _applied(~self.transform, x, y)
            row, column = v - 0.5, u - 0.5
            if self.columns_around is not None:
                column = column - self.columns_around * np.floor((column + 0.5) / self.columns_around)
        return row, column

    def cells_and_derivatives(
        self, longitude_rad: Floats, latitude_rad: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Row and column, (n,), and derivatives (2, 2, n), cells/rad: [by longitude or latitude, of row or column]."""
        # Differences over 2e-6 rad, one-sided at a pole.
        north = np.minimum(latitude_rad + _STEP_RAD, math.pi / 2)
        south = np.maximum(latitude_rad - _STEP_RAD, -math.pi / 2)
        east, west = longitude_rad + _STEP_RAD, longitude_rad - _STEP_RAD
        longitudes = np.concatenate([longitude_rad, east, west, longitude_rad, longitude_rad])
        latitudes = np.concatenate([latitude_rad, latitude_rad, latitude_rad, north, south])
        rows, columns = self.cells(longitudes, latitudes)
        row, column = rows.reshape(5, -1), columns.reshape(5, -1)
        steps = np.stack([np.full_like(north, 2.0 * _STEP_RAD), north - south])
        with np.errstate(invalid="ignore"):
            changes = np.stack([row[1::2] - row[2::2], column[1::2] - column[2::2]], axis=1)
            if self.columns_around is not None:
                changes[:, 1] -= self.columns_around * np.round(changes[:, 1] / self.columns_around)
        return row[0], column[0], changes / steps[:, np.newaxis]

    def wrapped(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
        """Return rows and columns of the file, and whether the map has such a cell."""
        if self.closed and self.columns_around is not None:
            around = round(self.columns_around)
            beyond = np.zeros(rows.shape, dtype=bool)
            if self.fold_north is not None:
                beyond |= 2 * rows < self.fold_north
                rows = np.where(2 * rows < self.fold_north, self.fold_north - rows, rows)
            if self.fold_south is not None:
                beyond |= 2 * rows > self.fold_south
                rows = np.where(2 * rows > self.fold_south, self.fold_south - rows, rows)
            columns = np.mod(np.where(beyond, columns + around // 2, columns), around)
        on_map = (rows >= 0) & (rows < self.rows) & (columns >= 0) & (columns < self.columns)
        return rows, columns, on_map

    def longitude_latitude(self, rows: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """Longitude and latitude, rad, of positions in the grid, shape (n,); infinite outside the disk of the Moon."""
        x, y = _applied(self.transform, np.asarray(columns) + 0.5, np.asarray(rows) + 0.5)
        if self.linear is not None:
            centre_rad, x_0, by_longitude, y_0, by_latitude = self.linear
            longitude, latitude = centre_rad + (x - x_0) / by_longitude, (y - y_0) / by_latitude
            longitude = longitude - 2.0 * math.pi * np.rint(longitude / (2.0 * math.pi))
            pole_rad = 0.5 * math.pi
            shown = np.abs(latitude) <= pole_rad + _STEP_RAD
            latitude = np.clip(latitude, -pole_rad, pole_rad)
            return np.where(shown, longitude, np.inf), np.where(shown, latitude, np.inf)
        longitude_deg, latitude_deg = _transform(self.crs, self.geographic, x, y)
        return np.radians(longitude_deg), np.radians(latitude_deg)

    @property
    def sphere_m(self) -> float:
        """Radius of the sphere of the map's reference system."""
        return float(self.geographic.to_dict()["R"])

    def unrolled(self, first_column: float = 0.0) -> tuple[Any, Any]:
        """Return reference system and transform of the columns from a first one, the seam opposite their middle."""
        if self.columns_around is None:
            return self.crs, self.transform
        half = 0.5 * self.columns
        longitudes, latitudes = self.longitude_latitude(
            np.array([0.5 * self.rows]), np.array([first_column + half - 0.5])
        )
        definition, scale = self.crs.to_dict(), 1.0
        if self.crs.is_geographic:
            definition, scale = {"proj": "eqc", "R": self.sphere_m}, math.radians(self.sphere_m)
        crs = type(self.crs).from_dict({**definition, "lon_0": math.degrees(longitudes[0])})
        x, _ = _transform(self.geographic, crs, np.degrees(longitudes), np.degrees(latitudes))
        a, _, _, _, e, f = (scale * number for number in self.transform[:6])
        return crs, type(self.transform)(a, 0.0, float(x[0]) - a * half, 0.0, e, f)

    def bounds(self) -> tuple[float, float, float, float]:
        """Left, bottom, right, top of the map's outer edges, in the map's coordinates."""
        x, y = _applied(
            self.transform, np.array([0, 0, 1, 1]) * self.columns, np.array([0, 1, 0, 1]) * self.rows
        )
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def coverage(self) -> str:
        """Describe the area of the map in degrees, for messages."""
        # Bottom, top, first and last column, centre.
        row, column = 0.5 * (self.rows - 1), 0.5 * (self.columns - 1)
        rows = np.array([self.rows - 0.5, -0.5, row, row, row])
        columns = np.array([column, column, 0.0, self.columns - 1.0, column])
        longitudes, latitudes = map(np.degrees, self.longitude_latitude(rows, columns))
        if self.columns_around is None:
            width_km, height_km = (n * self.resolution_m / 1e3 for n in (self.columns, self.rows))
            return (
                f"about {width_km:.4g} km by {height_km:.4g} km around "
                f"longitude {longitudes[4]:.4f}, latitude {latitudes[4]:.4f} degrees"
            )
        south_north = "latitudes {:.4f} to {:.4f} degrees".format(*sorted(latitudes[:2]))
        if self.closed:
            return f"all longitudes, {south_north}"
        cell = 360.0 / self.columns_around
        west, span = longitudes[2] - 0.5 * cell, (longitudes[3] - longitudes[2]) % 360.0 + cell
        return f"longitudes {west:.4f} to {west + span:.4f}, {south_north}"

    def _project(self, longitude_rad: Floats, latitude_rad: Floats) -> tuple[Floats, Floats]:
        if self.linear is not None:  # 40 times as fast as PROJ
            centre_rad, x, by_longitude, y, by_latitude = self.linear
            angle_rad = longitude_rad - centre_rad
            angle_rad = angle_rad - 2.0 * math.pi * np.rint(angle_rad / (2.0 * math.pi))
            return x + by_longitude * angle_rad, y + by_latitude * latitude_rad
        return _transform(self.geographic, self.crs, np.degrees(longitude_rad), np.degrees(latitude_rad))


def _applied(transform: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Apply an affine transform; its operator has different names in its major versions."""
    a, b, c, d, e, f = transform[:6]
    return a * u + b * v + c, d * u + e * v + f


def _transform(source: Any, target: Any, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    rasterio = load_rasterio()
    try:
        xs, ys = rasterio.warp.transform(source, target, x, y)
    except rasterio._err.CPLE_BaseError:  # one point that the projection cannot show fails them all
        if x.size == 1:
            return np.full(1, np.inf), np.full(1, np.inf)
        pairs = [_transform(source, target, x[i : i + 1], y[i : i + 1]) for i in range(x.size)]
        return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])
    return np.asarray(xs, dtype=np.float64), np.asarray(ys, dtype=np.float64)
