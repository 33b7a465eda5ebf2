"""Height and slope of the lunar terrain, from an elevation map or a part of one in memory.

Heights are above the sphere of 1737.4 km, at longitude and latitude in mean-Earth (ME) axes, the axes of lunar maps.
Positions in principal axes have to be rotated first (:func:`radioloc.lunar.rot_pa_to_me`): the axes differ by up to
875 m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc import vectors
from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.lunar.map_grid import STENCIL_CELLS, MapGrid, Stencil
from radioloc.lunar.selenographic import (
    cartesian_to_selenographic,
    checked,
    east_north_up,
    selenographic_to_cartesian,
)
from radioloc.lunar.terrain_source import TerrainMetadata, block_heights_m, heights_m, implausible, open_map
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.units import as_metres
from radioloc.vectors import Floats, Mask

_MAX_WINDOW_CELLS = 20_000_000  # 160 MB, and twice that while it is read
_OVERSHOOT = {"bilinear": 1.0, "bicubic": 1.5}  # of slopes, between cells
_SCALE_POINTS = 9  # along each side, at which the size of cells on the ground is looked up
_MAX_ROUGHNESS_RADIUS_M = 1.0e5
_MAX_CELL_INDEX = 2.0**31
_MAX_RADIUS_POINTS = 16  # on a radius, at which roughness samples cells
_MIN_POLE_DISTANCE_RAD = 1e-7  # 0.2 m; at smaller distances rounding spoils derivatives by longitude


@dataclass(frozen=True, slots=True, eq=False)
class TerrainModel:
    """The terrain of one map; build with :meth:`TerrainModel.open`."""

    #: Files with checksums, reference system, bounds, resolution, quantity and unit.
    metadata: TerrainMetadata
    #: ``"bilinear"`` (continuous; the slope jumps from cell to cell) or ``"bicubic"`` (the slope is continuous).
    interpolation: str
    _grid: MapGrid = field(repr=False)

    def __repr__(self) -> str:
        metadata = self.metadata
        cells = f"cells of {metadata.resolution_m:.4g} m, {self.interpolation}"
        return f"<TerrainModel {metadata.path.name}: {metadata.coverage}; {cells}>"

    @classmethod
    @accepts_quantities
    def open(
        cls,
        path: str | Path,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        radius_m: FloatLike | None = None,
        unit: Literal["m", "km"] | None = None,
    ) -> TerrainModel:
        """Open an elevation map: PDS3 or PDS4 label, ISIS cube, GeoTIFF, any format and projection that GDAL reads.

        Parameters
        ----------
        path : path-like
            The map; of an image with its label in another file, the label.
        interpolation : str
            ``"bilinear"`` or ``"bicubic"`` (cubic convolution, Keys 1981, a = -1/2).
        radius_m : float, optional
            Radius of the sphere to which the map's heights refer, m; without it, that of the map's reference system.
        unit : str, optional
            ``"m"`` or ``"km"``, where the file has no unit or a wrong one.

        Raises
        ------
        FileFormatError
            The file is missing, cut, or GDAL does not read it as one band of numbers with a map projection.
        InputError
            rasterio is not installed; another body's map, axes that are not mean-Earth, longitudes that count west,
            an ellipsoid; an ambiguous unit; values out of the range of lunar heights and radii.

        Notes
        -----
        Heights and radii are distinguished by their size, which differs by 1737 km.
        """
        if interpolation not in STENCIL_CELLS:
            raise InputError(f"interpolation = {interpolation!r} is not known; use 'bilinear' or 'bicubic'")
        metadata, grid = open_map(path, radius_m=radius_m, unit=unit)
        return cls(metadata, interpolation, grid)

    @accepts_quantities
    def height_m(self, longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> Floats:
        """Height of the terrain above the sphere of 1737.4 km, m, shape (...,); see :meth:`height_and_slope`."""
        longitude, latitude = _checked(longitude_rad, latitude_rad)
        place = longitude.ravel(), latitude.ravel()
        stencil, cells = self._stencil(*self._grid.cells(*place), *place)
        return stencil.value(cells).reshape(longitude.shape)[()]

    @accepts_quantities
    def window(self, longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> TerrainWindow:
        """Read the rectangle of cells around points into memory, for very many heights near each other.

        Raises
        ------
        InputError
            As :meth:`height_and_slope` for coordinates; no point is on the map, or the rectangle has more than 20
            million cells.
        """
        longitude, latitude = _checked(longitude_rad, latitude_rad)
        place = longitude.ravel(), latitude.ravel()
        return TerrainWindow.read(self.metadata, self._grid, self.interpolation, *place)

    @accepts_quantities
    def height_and_slope(
        self, longitude_rad: ArrayLike, latitude_rad: ArrayLike
    ) -> tuple[Floats, Floats, Floats]:
        """Height of the terrain above the sphere of 1737.4 km, m, and its derivatives by longitude and latitude, m/rad.

        The slope toward the east is the derivative by longitude divided by radius times cosine of latitude.

        Parameters
        ----------
        longitude_rad, latitude_rad : array_like, shape (...,)
            East longitude (-2 pi to 2 pi) and latitude in mean-Earth axes, rad.

        Raises
        ------
        InputError
            A coordinate is not finite or out of range; a point is outside the map, at a void, or at a value
            that no lunar terrain has.

        Notes
        -----
        The derivative by row and column is that of the interpolation polynomial; that of row and column by
        longitude and latitude is a difference over 2e-6 rad of the map projection, good to a part in 1e8.
        At a pole the longitude names the direction, as in :func:`radioloc.lunar.east_north_up`; a cylindrical
        map has a height there for each longitude.
        """
        longitude, latitude = _checked(longitude_rad, latitude_rad)
        place = longitude.ravel(), latitude.ravel()
        row, column, by_angle = self._grid.cells_and_derivatives(*place)
        stencil, cells = self._stencil(row, column, *place)
        height, by_longitude, by_latitude = (
            values.reshape(longitude.shape)[()] for values in stencil.value_and_slopes(cells, by_angle)
        )
        return height, by_longitude, by_latitude

    @accepts_quantities
    def roughness_m(
        self, longitude_rad: ArrayLike, latitude_rad: ArrayLike, radius_m: FloatLike | None = None
    ) -> Floats:
        """Scatter of the map's heights about the plane that fits them best around a point, m, shape (...,).

        Parameters
        ----------
        longitude_rad, latitude_rad : array_like, shape (...,)
            As :meth:`height_and_slope`.
        radius_m : float, optional
            Radius of the neighbourhood on the ground, m, up to 100 km; at least (and by default) one and a half cells
            of the map, which hold nine cells.

        Notes
        -----
        Root of the sum of squared residuals divided by n - 3, from at most some 800 cells spread evenly.
        """
        radius_m = as_metres(radius_m, "radius_m")
        if radius_m is not None and not 0.0 < radius_m <= _MAX_ROUGHNESS_RADIUS_M:
            raise InputError(f"radius_m = {radius_m!r} is not between 0 and {_MAX_ROUGHNESS_RADIUS_M:.0f} m")
        longitude, latitude = _checked(longitude_rad, latitude_rad)
        least_m = 1.5 * self.metadata.resolution_m
        reach_m = least_m if radius_m is None else max(radius_m, least_m)
        points = zip(longitude.ravel(), latitude.ravel(), strict=True)
        return np.array([self._scatter_m(*point, reach_m) for point in points]).reshape(longitude.shape)[()]

    @accepts_quantities
    def sigma_m(
        self,
        longitude_rad: ArrayLike,
        latitude_rad: ArrayLike,
        own_sigma_m: FloatLike,
        radius_m: FloatLike | None = None,
    ) -> Floats:
        """Return the sigma of a height prior, sqrt(own^2 + roughness^2), m; `own_sigma_m` is that of the map."""
        own_sigma_m = as_metres(own_sigma_m, "own_sigma_m")
        if not 0.0 < own_sigma_m < math.inf:
            raise InputError(f"own_sigma_m = {own_sigma_m!r} is not a positive number of metres")
        return np.hypot(own_sigma_m, self.roughness_m(longitude_rad, latitude_rad, radius_m))

    def _stencil(
        self, row: Floats, column: Floats, longitude: Floats, latitude: Floats
    ) -> tuple[Stencil, Floats]:
        """Cells around points, and their heights, shape (n, size, size)."""
        # Also false for NaN.
        on_map = (np.abs(row) < _MAX_CELL_INDEX) & (np.abs(column) < _MAX_CELL_INDEX)
        self._require(on_map, longitude, latitude)
        stencil = Stencil.around(row, column, (self._grid.rows, self._grid.columns), self.interpolation)
        return stencil, self._heights(stencil.rows, stencil.columns, longitude, latitude)

    def _heights(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64], longitude: Floats, latitude: Floats
    ) -> Floats:
        """Heights of the cells of each point (first axis); a missing or implausible one is an error."""
        rows, columns, on_map = self._grid.wrapped(rows, columns)
        cell_axes = tuple(range(1, rows.ndim))
        self._require(np.asarray(on_map.all(axis=cell_axes)), longitude, latitude)
        heights = heights_m(self.metadata, rows, columns)
        void = np.asarray(np.isnan(heights).any(axis=cell_axes))
        if void.any():
            raise InputError(
                f"{self.metadata.path} has a void in the cells around {_named(longitude, latitude, void)}; "
                "fill the map, use another, or take the position without a terrain prior"
            )
        wrong = np.asarray(implausible(heights).any(axis=cell_axes))
        if wrong.any():
            low_m, high_m = LUNAR_HEIGHT_LIMITS_M
            worst_m = heights[wrong].flat[np.argmax(np.abs(heights[wrong]))]
            raise InputError(
                f"{self.metadata.path} has a height of {worst_m:.6g} m around {_named(longitude, latitude, wrong)}, "
                f"which the Moon has nowhere ({low_m:.0f} to {high_m:.0f} m): a void value or a scale that "
                "the file does not declare?"
            )
        return heights

    def _require(self, on_map: Mask, longitude: Floats, latitude: Floats) -> None:
        if not on_map.all():
            raise InputError(
                f"{_named(longitude, latitude, ~on_map)} is outside {self.metadata.path} or too near its edge for the "
                f"cells that are needed around it; the map covers {self.metadata.coverage}"
            )

    def _scatter_m(self, longitude: float, latitude: float, reach_m: float) -> float:
        axes = east_north_up(longitude, latitude)
        spacing_m = max(self.metadata.resolution_m, reach_m / _MAX_RADIUS_POINTS)
        count = int(reach_m / spacing_m)
        offsets_m = spacing_m * np.arange(-count, count + 1)
        east_m, north_m = (grid.ravel() for grid in np.meshgrid(offsets_m, offsets_m))
        used = np.hypot(east_m, north_m) <= reach_m
        tangent_m = np.stack([east_m[used], north_m[used], np.full(used.sum(), MEAN_LUNAR_RADIUS_M)], axis=-1)
        longitudes, latitudes, _ = cartesian_to_selenographic(tangent_m @ axes)
        row, column = self._grid.cells(longitudes, latitudes)
        point = np.array([longitude]), np.array([latitude])
        self._require(np.array([np.isfinite(row).all() and np.isfinite(column).all()]), *point)
        rows, columns, _ = self._grid.wrapped(np.rint(row).astype(np.int64), np.rint(column).astype(np.int64))
        cells = np.unique(np.stack([rows, columns]), axis=1)
        heights_m = self._heights(cells[0][None], cells[1][None], *point)[0]
        centres = self._grid.longitude_latitude(cells[0].astype(np.float64), cells[1].astype(np.float64))
        local_m = selenographic_to_cartesian(*centres, 0.0) @ axes.T
        design = np.column_stack([np.ones(heights_m.size), local_m[:, :2] / reach_m])
        if np.linalg.matrix_rank(design) < 3 or heights_m.size < 4:
            raise InputError(
                f"{heights_m.size} cells within {reach_m:.6g} m of {_named(*point, np.array([True]))} do not make a "
                "plane with scatter; give a larger radius_m"
            )
        residuals_m = heights_m - design @ np.linalg.lstsq(design, heights_m, rcond=None)[0]
        return math.sqrt(float(residuals_m @ residuals_m) / (heights_m.size - 3))


def height_and_gradient(
    height_and_slope: Callable[[Floats, Floats], tuple[Floats, Floats, Floats]],
    longitude_rad: Floats,
    latitude_rad: Floats,
) -> tuple[Floats, Floats]:
    """Heights, m, (...,), and gradients along the unit sphere, m/rad, ME axes, (..., 3), by a `height_and_slope`."""
    pole_rad = np.copysign(0.5 * math.pi, latitude_rad)
    at_pole = np.abs(pole_rad - latitude_rad) < _MIN_POLE_DISTANCE_RAD
    latitude = np.where(at_pole, pole_rad * (1.0 - _MIN_POLE_DISTANCE_RAD), latitude_rad)
    height_m, by_longitude, by_latitude = height_and_slope(longitude_rad, latitude)
    east, north, _ = np.moveaxis(vectors.east_north_up(longitude_rad, latitude), -2, 0)
    by_east = by_longitude / np.cos(latitude)
    gradient = by_east[..., np.newaxis] * east + by_latitude[..., np.newaxis] * north
    return height_m + by_latitude * (latitude_rad - latitude), gradient


def _checked(longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> tuple[Floats, Floats]:
    longitude, latitude, _ = checked(longitude_rad, latitude_rad, 0.0)
    if (np.abs(longitude) > 2.0 * math.pi).any():
        raise InputError("a longitude is beyond 2 pi; is it in degrees instead of radians?")
    return longitude, latitude


def _named(longitude: Floats, latitude: Floats, selected: Mask) -> str:
    """Describe the first of the selected points, in degrees, and count the others."""
    first = int(np.flatnonzero(selected)[0])
    n_others = int(selected.sum()) - 1
    text = f"longitude {np.degrees(longitude[first]):.6f}, latitude {np.degrees(latitude[first]):.6f} degrees"
    return f"{text} (and {n_others} more points)" if n_others else text


class LargeWindowError(InputError):
    """Error of a window with more cells than are read at once."""


class NoTerrainError(InputError):
    """Error of points that all lie outside the terrain of a map."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainWindow:
    """Heights of a rectangle of cells; :meth:`radioloc.lunar.TerrainModel.window` reads one."""

    metadata: TerrainMetadata
    interpolation: str
    grid: MapGrid
    heights_m: Floats  # (rows, columns), NaN where the map is void
    first_row: int
    first_column: int
    max_slope: float  # bound, as a tangent

    @classmethod
    def read(
        cls,
        metadata: TerrainMetadata,
        grid: MapGrid,
        interpolation: str,
        longitude_rad: Floats,
        latitude_rad: Floats,
    ) -> TerrainWindow:
        """Read the rectangle of cells around points, clipped to the map."""
        row, column = grid.cells(longitude_rad, latitude_rad)
        shown = np.isfinite(row) & np.isfinite(column)
        if not shown.any():
            raise NoTerrainError(f"{metadata.path} does not show the points; it covers {metadata.coverage}")
        row, column = row[shown], column[shown]
        margin = STENCIL_CELLS[interpolation]
        rows = max(int(row.min()) - margin, 0), min(int(row.max()) + margin + 1, grid.rows)
        around = grid.columns_around if grid.closed else None
        if around is not None:  # columns relative to the middle of the points, across the map's seam
            middle = _circular_middle(column, around)
            column = middle + (column - middle + 0.5 * around) % around - 0.5 * around
        columns = int(np.floor(column.min())) - margin, int(np.floor(column.max())) + margin + 1
        if around is None:
            columns = max(columns[0], 0), min(columns[1], grid.columns)
        elif columns[1] - columns[0] > around:
            columns = columns[0], columns[0] + round(around)
        count = (rows[1] - rows[0]) * (columns[1] - columns[0])
        if rows[0] >= rows[1] or columns[0] >= columns[1]:
            raise NoTerrainError(
                f"{metadata.path} does not contain the points; it covers {metadata.coverage}"
            )
        if count > _MAX_WINDOW_CELLS:
            raise LargeWindowError(
                f"{metadata.path}: expected up to {_MAX_WINDOW_CELLS} cells at once, got {count}; take fewer points "
                "or a coarser map"
            )
        heights = block_heights_m(metadata, rows, columns, None if around is None else round(around))
        if not np.isfinite(heights).any():
            raise NoTerrainError(f"{metadata.path} is void at all of the points")
        max_slope = _OVERSHOOT[interpolation] * _max_slope(grid, heights, rows[0], columns[0])
        return cls(metadata, interpolation, grid, heights, rows[0], columns[0], max_slope)

    @property
    def range_m(self) -> tuple[float, float]:
        """Bounds of the surface; bicubic ones exceed the cells by up to an eighth of their difference."""
        low, high = float(np.nanmin(self.heights_m)), float(np.nanmax(self.heights_m))
        beyond_m = 0.125 * (high - low) if self.interpolation == "bicubic" else 0.0
        return low - beyond_m, high + beyond_m

    def heights(self, longitude_rad: Floats, latitude_rad: Floats) -> tuple[Floats, Mask]:
        """Return heights above the sphere of 1737.4 km, m, shape (n,), and whether the window has them."""
        stencil, cells, has_terrain = self._stencil(*self.grid.cells(longitude_rad, latitude_rad))
        return stencil.value(cells), has_terrain

    def heights_and_slopes(
        self, longitude_rad: Floats, latitude_rad: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Heights, m, and derivatives by longitude and latitude, m/rad, at points that the window has."""
        row, column, by_angle = self.grid.cells_and_derivatives(longitude_rad, latitude_rad)
        stencil, cells, _ = self._stencil(row, column)
        return stencil.value_and_slopes(cells, by_angle)

    def _stencil(self, row: Floats, column: Floats) -> tuple[Stencil, Floats, Mask]:
        """Cells around points, their heights, shape (n, size, size), and whether all of them are known."""
        rows, columns = self.heights_m.shape
        with np.errstate(invalid="ignore"):
            row, column = row - self.first_row, column - self.first_column
            if self.grid.closed and self.grid.columns_around is not None:
                column = column % self.grid.columns_around
            half = STENCIL_CELLS[self.interpolation] // 2
            has_terrain = (
                (row >= half - 1) & (row <= rows - half) & (column >= half - 1) & (column <= columns - half)
            )
        row, column = np.where(has_terrain, row, half - 1.0), np.where(has_terrain, column, half - 1.0)
        stencil = Stencil.around(row, column, self.heights_m.shape, self.interpolation)
        cells = self.heights_m[stencil.rows, stencil.columns]
        return stencil, cells, has_terrain & np.isfinite(cells).all(axis=(1, 2))


def _circular_middle(column: Floats, around: float) -> float:
    """Middle of columns of a global map, opposite to the widest gap between them."""
    ordered = np.sort(column)
    gaps = np.diff(ordered, append=ordered[0] + around)
    widest = int(np.argmax(gaps))
    return float((ordered[(widest + 1) % len(ordered)] + 0.5 * (around - gaps[widest])) % around)


def _max_slope(grid: MapGrid, heights: Floats, first_row: int, first_column: int) -> float:
    """Upper bound of the slope: largest differences of adjacent cells over the smallest size of a cell."""
    rows, columns = (
        np.linspace(first, first + count - 1, _SCALE_POINTS)
        for first, count in zip((first_row, first_column), heights.shape, strict=True)
    )
    grid_rows, grid_columns = (index.ravel() for index in np.meshgrid(rows, columns))
    longitude, latitude = grid.longitude_latitude(grid_rows, grid_columns)
    usable = np.isfinite(longitude) & (np.abs(latitude) < np.pi / 2 - 1e-4)
    if not usable.any():
        return np.inf
    _, _, by_angle = grid.cells_and_derivatives(longitude[usable], latitude[usable])
    by_angle = by_angle[:, :, np.isfinite(by_angle).all(axis=(0, 1))]
    east = by_angle[0] / np.cos(latitude[usable])[: by_angle.shape[2]]
    cells_per_m = np.hypot(east, by_angle[1]).max(axis=-1) / MEAN_LUNAR_RADIUS_M  # of rows, of columns
    steps = [np.abs(np.diff(heights, axis=axis)) for axis in (0, 1)]
    largest = [float(np.nanmax(step)) if np.isfinite(step).any() else 0.0 for step in steps]
    return float(np.hypot(*(cells_per_m * largest)))
