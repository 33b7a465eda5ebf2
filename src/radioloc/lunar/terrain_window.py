"""A part of an elevation map in memory: heights at a million points in a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.lunar.interpolation import STENCIL_CELLS, Stencil
from radioloc.lunar.map_grid import MapGrid
from radioloc.lunar.terrain_source import TerrainMetadata, block_heights_m

Floats = NDArray[np.float64]

_LARGEST_CELLS = 20_000_000  # 160 MB, and twice that for a moment
_OVERSHOOT = {"bilinear": 1.0, "bicubic": 1.5}  # of slopes, between cells
_SCALE_POINTS = 9  # along each side, at which the size of cells on the ground is looked up


class LargeWindowError(InputError):
    """A window has more cells than are read at once."""


class NoTerrainError(InputError):
    """None of the points has terrain on the map."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainWindow:
    """Heights of a rectangle of cells; :meth:`radioloc.lunar.TerrainModel.window` reads one."""

    metadata: TerrainMetadata
    interpolation: str
    grid: MapGrid
    heights_m: Floats  # (rows, columns), NaN where the map is void
    first_row: int
    first_column: int
    steepest: float  # slope, at most, as a tangent

    @classmethod
    def read(
        cls,
        metadata: TerrainMetadata,
        grid: MapGrid,
        interpolation: str,
        longitude_rad: Floats,
        latitude_rad: Floats,
    ) -> TerrainWindow:
        """Read the rectangle of cells around points, as far as the map has them.

        Raises
        ------
        InputError
            No point is on the map, or the rectangle has more than 20 million cells.
        """
        row, column = grid.cells(longitude_rad, latitude_rad)
        shown = np.isfinite(row) & np.isfinite(column)
        if not shown.any():
            raise NoTerrainError(f"{metadata.path} shows none of the points; it covers {metadata.coverage}")
        row, column = row[shown], column[shown]
        margin = STENCIL_CELLS[interpolation]
        rows = max(int(row.min()) - margin, 0), min(int(row.max()) + margin + 1, grid.rows)
        around = grid.columns_around if grid.closed else None
        if around is not None:  # columns are counted from the middle of the points, across the map's seam
            middle = _circular_middle(column, around)
            column = middle + (column - middle + 0.5 * around) % around - 0.5 * around
        columns = int(np.floor(column.min())) - margin, int(np.floor(column.max())) + margin + 1
        if around is None:
            columns = max(columns[0], 0), min(columns[1], grid.columns)
        elif columns[1] - columns[0] > around:
            columns = columns[0], columns[0] + round(around)
        count = (rows[1] - rows[0]) * (columns[1] - columns[0])
        if rows[0] >= rows[1] or columns[0] >= columns[1]:
            raise NoTerrainError(f"{metadata.path} has none of the points; it covers {metadata.coverage}")
        if count > _LARGEST_CELLS:
            raise LargeWindowError(
                f"{metadata.path}: {count} cells are asked for at once, more than {_LARGEST_CELLS}; take fewer points, "
                "or a coarser map"
            )
        heights = block_heights_m(metadata, rows, columns, None if around is None else round(around))
        if not np.isfinite(heights).any():
            raise NoTerrainError(f"{metadata.path} is void at all of the points")
        steepest = _OVERSHOOT[interpolation] * _steepest(grid, heights, rows[0], columns[0])
        return cls(metadata, interpolation, grid, heights, rows[0], columns[0], steepest)

    @property
    def range_m(self) -> tuple[float, float]:
        """Lowest and highest cell; between bicubic ones the surface may be an eighth of the difference beyond."""
        low, high = float(np.nanmin(self.heights_m)), float(np.nanmax(self.heights_m))
        beyond_m = 0.125 * (high - low) if self.interpolation == "bicubic" else 0.0
        return low - beyond_m, high + beyond_m

    def heights(self, longitude_rad: Floats, latitude_rad: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Heights above the sphere of 1737.4 km, m, shape (n,), and whether the window has them."""
        stencil, cells, known = self._stencil(*self.grid.cells(longitude_rad, latitude_rad))
        return stencil.value(cells), known

    def heights_and_slopes(
        self, longitude_rad: Floats, latitude_rad: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Heights, m, and derivatives by longitude and latitude, m/rad, at points that the window has."""
        row, column, by_angle = self.grid.cells_and_derivatives(longitude_rad, latitude_rad)
        stencil, cells, _ = self._stencil(row, column)
        return stencil.value_and_slopes(cells, by_angle)

    def _stencil(self, row: Floats, column: Floats) -> tuple[Stencil, Floats, NDArray[np.bool_]]:
        """Cells around points, their heights, shape (n, size, size), and whether all of them are known."""
        rows, columns = self.heights_m.shape
        with np.errstate(invalid="ignore"):
            row, column = row - self.first_row, column - self.first_column
            if self.grid.closed and self.grid.columns_around is not None:
                column = column % self.grid.columns_around
            half = STENCIL_CELLS[self.interpolation] // 2
            known = (
                (row >= half - 1) & (row <= rows - half) & (column >= half - 1) & (column <= columns - half)
            )
        row, column = np.where(known, row, half - 1.0), np.where(known, column, half - 1.0)
        stencil = Stencil.around(row, column, self.heights_m.shape, self.interpolation)
        cells = self.heights_m[stencil.rows, stencil.columns]
        return stencil, cells, known & np.isfinite(cells).all(axis=(1, 2))


def _circular_middle(column: Floats, around: float) -> float:
    """Middle of columns that are counted around the Moon: opposite to the widest gap between them."""
    ordered = np.sort(column)
    gaps = np.diff(ordered, append=ordered[0] + around)
    widest = int(np.argmax(gaps))
    return float((ordered[(widest + 1) % len(ordered)] + 0.5 * (around - gaps[widest])) % around)


def _steepest(grid: MapGrid, heights: Floats, first_row: int, first_column: int) -> float:
    """Bound of the slope: the largest differences of neighbours over the smallest size of a cell on the ground."""
    rows, columns = (
        np.linspace(first, first + count - 1, _SCALE_POINTS)
        for first, count in zip((first_row, first_column), heights.shape, strict=True)
    )
    grid_rows, grid_columns = (one.ravel() for one in np.meshgrid(rows, columns))
    longitude, latitude = grid.longitude_latitude(grid_rows, grid_columns)
    there = np.isfinite(longitude) & (np.abs(latitude) < np.pi / 2 - 1e-4)
    if not there.any():
        return np.inf
    _, _, by_angle = grid.cells_and_derivatives(longitude[there], latitude[there])
    by_angle = by_angle[:, :, np.isfinite(by_angle).all(axis=(0, 1))]
    east = by_angle[0] / np.cos(latitude[there])[: by_angle.shape[2]]
    cells_per_m = np.hypot(east, by_angle[1]).max(axis=-1) / MEAN_LUNAR_RADIUS_M  # of rows, of columns
    steps = [np.abs(np.diff(heights, axis=axis)) for axis in (0, 1)]
    largest = [float(np.nanmax(one)) if np.isfinite(one).any() else 0.0 for one in steps]
    return float(np.hypot(*(cells_per_m * largest)))
