"""Elevation maps as files: their metadata, and their cells as heights above 1737.4 km.

Cells are read on demand in tiles, which are cached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.errors import FileFormatError, InputError
from radioloc.lunar.map_files import LUNAR_SPHERES_M, SourceFile, label_values, open_dataset, open_map_file
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.vectors import Floats, Mask

_UNITS_M = {"m": 1.0, "km": 1.0e3}
_UNIT_NAMES = {
    **dict.fromkeys(["m", "meter", "meters", "metre", "metres"], "m"),
    **dict.fromkeys(["km", "kilometer", "kilometers", "kilometre", "kilometres"], "km"),
}
_TILE_CELLS = 256
_MAX_TILES, _MAX_TILES_OF_BLOCK = 64, 16
_SAMPLE_CELLS = 32  # along each side
# Of 16 and 32 bits and those of geographic software, before scale and offset.
_USUAL_VOIDS = (*range(-32768, -32763), -9999, -99999, -999999, 32767, 65535, -(2**31), 2**31 - 1)
_MAX_SLOPE = 2.0  # from cell to cell; few slopes of the Moon exceed 45 deg
# From so many adjacent cells of one number on, the ground is level and its edge differs by few numbers.
_MIN_LEVEL_CELLS = 4
_MAX_LEVEL_STEP = 20


@dataclass(frozen=True, slots=True)
class TerrainMetadata:
    """Properties of a map."""

    path: Path  # the file opened
    driver: str  # GDAL's name of its format
    files: tuple[SourceFile, ...]  # all files of the map
    crs: str  # its reference system, WKT
    coordinate_system: str | None  # axes that the label names; without one, mean-Earth
    bounds: tuple[float, float, float, float]  # left, bottom, right, top in the map's coordinates
    coverage: str  # the same in words, in degrees
    resolution_m: float  # of a cell where the projection is true to scale
    quantity: str  # height or radius
    unit: str  # m or km
    reference_radius_m: float  # of the sphere that heights are above; zero for radii
    scale: float  # value = number in the file * scale + offset
    offset: float
    nodata: float | None  # the number in the file that marks a void


def heights_m(metadata: TerrainMetadata, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Floats:
    """Heights of cells of the map, m, in the shape of ``rows``; NaN where the map is void."""
    heights = np.empty(rows.shape, dtype=np.float64)
    tile_rows, tile_columns = rows // _TILE_CELLS, columns // _TILE_CELLS
    across = int(tile_columns.max(initial=0)) + 1
    tiles = tile_rows * across + tile_columns
    for tile in np.unique(tiles).tolist():
        i, j = divmod(tile, across)
        in_tile = tiles == tile
        heights[in_tile] = _tile(metadata, i, j)[
            rows[in_tile] - i * _TILE_CELLS, columns[in_tile] - j * _TILE_CELLS
        ]
    return heights


def block_heights_m(
    metadata: TerrainMetadata, rows: tuple[int, int], columns: tuple[int, int], around: int | None
) -> Floats:
    """Heights of a rectangle of cells, m, NaN for voids and implausible values; columns may cross the seam."""
    if around is None:
        parts = [columns]
    else:
        first = columns[0] % around
        last = first + columns[1] - columns[0]
        parts = [(first, min(last, around)), (0, last - around)][: 1 + (last > around)]
    heights = np.concatenate([_rectangle(metadata, rows, part) for part in parts], axis=1)
    heights[implausible(heights)] = np.nan
    return heights


@lru_cache(maxsize=_MAX_TILES)
def _tile(metadata: TerrainMetadata, i: int, j: int) -> Floats:
    """Heights in a tile of the map, whose files' checksums are part of the cache's key."""
    rows, columns = ((k * _TILE_CELLS, (k + 1) * _TILE_CELLS) for k in (i, j))
    return _block(metadata, rows, columns)


def _rectangle(metadata: TerrainMetadata, rows: tuple[int, int], columns: tuple[int, int]) -> Floats:
    """Heights of a rectangle of cells, by tiles if they are few."""
    i, j = (range(first // _TILE_CELLS, -(-last // _TILE_CELLS)) for first, last in (rows, columns))
    if len(i) * len(j) > _MAX_TILES_OF_BLOCK:
        return _block(metadata, rows, columns)
    tiles = np.block([[_tile(metadata, row, column) for column in j] for row in i])
    first_row, first_column = i.start * _TILE_CELLS, j.start * _TILE_CELLS
    return tiles[
        rows[0] - first_row : rows[1] - first_row, columns[0] - first_column : columns[1] - first_column
    ]


def _block(metadata: TerrainMetadata, rows: tuple[int, int], columns: tuple[int, int]) -> Floats:
    """Heights of a rectangle of cells, clipped to the file."""
    rasterio = load_rasterio()
    try:
        with open_dataset(metadata.path) as dataset:
            ends = (min(last, size) for (_, last), size in zip((rows, columns), dataset.shape, strict=True))
            window = tuple(zip((rows[0], columns[0]), ends, strict=True))
            numbers = dataset.read(1, window=window, masked=True)
    except rasterio.errors.RasterioError as error:
        raise FileFormatError(metadata.path, f"cells could not be read: {error}") from error
    raw = _filled(numbers)
    heights = _heights_m(raw * metadata.scale + metadata.offset, metadata.unit, metadata.reference_radius_m)
    _mark_undeclared_voids(metadata, raw, heights)
    return heights


def _mark_undeclared_voids(metadata: TerrainMetadata, raw: Floats, heights: Floats) -> None:
    """Set cells to NaN whose void value becomes a lunar height by scale and offset."""
    # Terrain of this height is continuous with adjacent cells; a void is bounded by a cliff.
    suspect = np.isin(raw, _USUAL_VOIDS) & ~implausible(heights)
    if not suspect.any():
        return
    from scipy import ndimage

    around = np.ones((3, 3))
    regions, _ = ndimage.label(suspect, around)
    terrain = np.isfinite(heights) & ~implausible(heights) & ~suspect
    quantum_m = abs(metadata.scale) * _UNITS_M[metadata.unit]
    for number, box in enumerate(ndimage.find_objects(regions), 1):
        window = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in box)
        in_region = regions[window] == number
        steps_m = np.abs(
            heights[window][ndimage.binary_dilation(in_region, around) & terrain[window]]
            - heights[window][in_region][0]
        )
        level = in_region.sum() >= _MIN_LEVEL_CELLS
        largest_m = _MAX_LEVEL_STEP * quantum_m if level else _MAX_SLOPE * metadata.resolution_m
        if not steps_m.size or np.median(steps_m) > largest_m:
            heights[window][in_region] = np.nan


def open_map(
    path: str | Path, *, radius_m: float | None, unit: str | None
) -> tuple[TerrainMetadata, MapGrid]:
    """Open an elevation map and determine quantity and unit of its values; see :meth:`TerrainModel.open`."""
    if unit is not None and unit not in _UNITS_M:
        raise InputError(f"unit = {unit!r} is not known; use 'm' or 'km'")
    if radius_m is not None and not LUNAR_SPHERES_M[0] <= radius_m <= LUNAR_SPHERES_M[1]:
        raise InputError(
            f"radius_m: expected a lunar radius of 1735e3 to 1739e3 m, got {radius_m!r}; lunar maps use 1737400"
        )
    path = Path(path)
    with open_map_file(
        path, "i2 u2 i4 u4 i8 u8 f4 f8", "an elevation map of one band of 16 bits or more"
    ) as file:
        dataset, grid = file.dataset, file.grid
        quantity, unit, reference_m = _meaning(path, dataset, file.label, radius_m, unit, file.sphere_m)
        metadata = TerrainMetadata(
            path=path,
            driver=dataset.driver,
            files=file.files(),
            crs=dataset.crs.to_wkt(),
            coordinate_system=file.coordinate_system,
            bounds=grid.bounds(),
            coverage=grid.coverage(),
            resolution_m=grid.resolution_m,
            quantity=quantity,
            unit=unit,
            reference_radius_m=reference_m,
            scale=float(dataset.scales[0]),
            offset=float(dataset.offsets[0]),
            nodata=dataset.nodata,
        )
    return metadata, grid


def _meaning(
    path: Path, dataset: Any, label: str, radius_m: float | None, unit: str | None, sphere_m: float
) -> tuple[str, str, float]:
    """Return the quantity, unit and reference radius that make a sample of the values lunar terrain."""
    declared = {dataset.units[0]} if dataset.units[0] else label_values(label, "UNIT")
    if unit is not None:
        units = [unit]
    elif declared:
        units = sorted({_UNIT_NAMES.get(name.lower(), "") for name in declared})
        if len(units) != 1 or not units[0]:
            raise InputError(
                f"{path} gives its values in {sorted(declared)}, not in metres or kilometres; if it is an elevation "
                "map, set its unit (gdal_edit.py -units m), or say unit='m' or unit='km' in Python"
            )
    else:
        units = list(_UNITS_M)
    scale, offset = float(dataset.scales[0]), float(dataset.offsets[0])
    if not (math.isfinite(scale) and scale != 0.0 and math.isfinite(offset)):
        raise FileFormatError(
            path, f"its values are {scale:g} times a number and {offset:g}; correct the label"
        )
    shape = (min(dataset.height, _SAMPLE_CELLS), min(dataset.width, _SAMPLE_CELLS))
    sample = _filled(dataset.read(1, out_shape=shape, masked=True))
    values = sample[np.isfinite(sample)] * scale + offset
    if values.size == 0:
        raise InputError(f"{path} is void: none of {sample.size} sampled cells has a value")
    reference_m = sphere_m if radius_m is None else radius_m
    meanings = [
        (quantity, name, reference)
        for name in units
        for quantity, reference in (("height", reference_m), ("radius", 0.0))
        if not implausible(_heights_m(values, name, reference)).any()
    ]
    sampled = f"{path}: sampled values go from {values.min():.6g} to {values.max():.6g}"
    if not meanings:
        low_height_m, high_height_m = LUNAR_HEIGHT_LIMITS_M
        raise InputError(
            f"{sampled}, which in {' or '.join(units)} are neither heights ({low_height_m:.0f} to {high_height_m:.0f} "
            "m) nor radii of the Moon; an undeclared scale, unit or void value (set them with gdal_translate -a_scale "
            "-a_offset -a_nodata, or gdal_edit.py -units)?"
        )
    if len(meanings) > 1:
        raise InputError(
            f"{sampled} without a unit, metres or kilometres; set it (gdal_edit.py -units m), or say "
            "unit='m' or 'km' in Python"
        )
    low_m, high_m = LUNAR_SPHERES_M
    if units == ["m"] and low_m <= 1e3 * abs(offset) <= high_m:
        raise InputError(
            f"{path} adds {offset:g} m to its values, which is the Moon's radius in kilometres; give the offset in the "
            "unit of the values"
        )
    if meanings[0][0] == "radius" and radius_m is not None:
        raise InputError(f"{sampled}: these are radii, so radius_m has no meaning for this map; leave it out")
    return meanings[0]


def _filled(numbers: Any) -> Floats:
    """Masked numbers of the file as floats with NaN for voids."""
    return np.ma.filled(numbers.astype(np.float64), np.nan)


def _heights_m(values: Floats, unit: str, reference_m: float) -> Floats:
    return values * _UNITS_M[unit] + (reference_m - MEAN_LUNAR_RADIUS_M)


def implausible(heights_m: Floats) -> Mask:
    """Return which heights are out of the range of lunar terrain."""
    low_m, high_m = LUNAR_HEIGHT_LIMITS_M
    return (heights_m < low_m) | (heights_m > high_m)
