"""Elevation maps as files: what they say about themselves, and their cells as heights above 1737.4 km.

Read through rasterio (GDAL): PDS3 and PDS4 images by their label, ISIS cubes, GeoTIFF and whatever else GDAL
knows. Only the cells that are needed are read, in tiles that the reader keeps.
"""

from __future__ import annotations

import hashlib
import math
import re
import struct
import sys
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import FileFormatError, InputError, RadiolocError
from radioloc.lunar.terrain_grid import MapGrid, load_rasterio
from radioloc.text_files import require_file

LOWEST_M, HIGHEST_M = -10.0e3, 11.0e3
"""Heights above 1737.4 km that are taken for lunar; LOLA has -9.1 to 10.8 km (Smith et al. 2010)."""

# maps have used spheres from 1735.97 (polar) to 1738.14 km (equatorial)
_LUNAR_SPHERES_M = (1.735e6, 1.739e6)
_UNITS_M = {"m": 1.0, "km": 1.0e3}
_UNIT_NAMES = {
    **dict.fromkeys(["m", "meter", "meters", "metre", "metres"], "m"),
    **dict.fromkeys(["km", "kilometer", "kilometers", "kilometre", "kilometres"], "km"),
}
_DIGEST_LIMIT_BYTES = 256 * 1024 * 1024
_LABEL_BYTES = 262144
_TILE_CELLS = 256
_TILES_KEPT = 64
_SAMPLES = 32
_TIFF_BYTES = dict(
    zip((*range(1, 14), 16, 17, 18), (1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 8, 8, 8), strict=True)
)
"""Bytes of a value of each type of TIFF 6.0 and BigTIFF."""


@dataclass(frozen=True, slots=True)
class TerrainFile:
    """One file of a map, for the record; ``sha256`` is None for files over 256 MiB."""

    path: Path
    size_bytes: int
    sha256: str | None


@dataclass(frozen=True, slots=True)
class TerrainMetadata:
    """What is known of a map."""

    path: Path  # the file opened
    driver: str  # GDAL's name of its format
    files: tuple[TerrainFile, ...]  # all that the map consists of
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


def heights_m(
    about: TerrainMetadata, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Heights of cells of the map, m, in the shape of ``rows``; NaN where the map is void."""
    heights = np.empty(rows.shape, dtype=np.float64)
    tile_rows, tile_columns = rows // _TILE_CELLS, columns // _TILE_CELLS
    for i, j in np.unique(np.stack([tile_rows.ravel(), tile_columns.ravel()]), axis=1).T.tolist():
        here = (tile_rows == i) & (tile_columns == j)
        heights[here] = _tile(about, i, j)[rows[here] - i * _TILE_CELLS, columns[here] - j * _TILE_CELLS]
    return heights


@lru_cache(maxsize=_TILES_KEPT)
def _tile(about: TerrainMetadata, i: int, j: int) -> NDArray[np.float64]:
    """Heights in a tile of the map, whose files' checksums are part of the cache's key."""
    rasterio = load_rasterio()
    try:
        with _opened(about.path) as dataset:
            window = tuple(
                (k * _TILE_CELLS, min((k + 1) * _TILE_CELLS, size))
                for k, size in zip((i, j), dataset.shape, strict=True)
            )
            numbers = dataset.read(1, window=window, masked=True)
    except rasterio.errors.RasterioError as error:
        raise FileFormatError(about.path, f"cells could not be read: {error}") from error
    return _heights_m(_filled(numbers) * about.scale + about.offset, about.unit, about.reference_radius_m)


def open_map(
    path: str | Path, *, radius_m: float | None, unit: str | None
) -> tuple[TerrainMetadata, MapGrid]:
    """Open an elevation map of the Moon and find out what its numbers mean; see :meth:`TerrainModel.open`."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    if unit is not None and unit not in _UNITS_M:
        raise InputError(f"unit = {unit!r} is not known; use 'm' or 'km'")
    if radius_m is not None and not _LUNAR_SPHERES_M[0] <= radius_m <= _LUNAR_SPHERES_M[1]:
        raise InputError(
            f"radius_m = {radius_m!r} is no radius of the Moon in metres (1735e3 to 1739e3); "
            "lunar maps use 1737400"
        )
    path = Path(path)
    require_file(path)
    try:
        with _opened(path) as dataset, np.errstate(over="raise", divide="raise", invalid="raise"):
            _refuse_cut_map(path, dataset)
            return _described(path, dataset, radius_m, unit)
    except RadiolocError:
        raise
    # Of a damaged label or projection GDAL, PROJ and arithmetic make many kinds of error.
    except (rasterio.errors.RasterioError, CPLE_BaseError, ArithmeticError, ValueError) as error:
        raise FileFormatError(
            path,
            f"GDAL does not read it as a map ({error}); if its label is a file of its own (.LBL, .xml), "
            "give that one",
        ) from error


def _opened(path: Path) -> Any:
    rasterio = load_rasterio()
    with warnings.catch_warnings():
        # a map without georeferencing is refused below, with what to do about it
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        # GDAL's messages repeat a label, and where it is not UTF-8 Python would show a traceback
        hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
        try:
            return rasterio.open(path)
        finally:
            sys.unraisablehook = hook


def _described(
    path: Path, dataset: Any, radius_m: float | None, unit: str | None
) -> tuple[TerrainMetadata, MapGrid]:
    kind = np.dtype(dataset.dtypes[0])
    if dataset.count != 1 or kind.kind not in "iuf" or kind.itemsize == 1:
        raise FileFormatError(
            path,
            f"{dataset.count} band(s) of type {kind} are no elevation map; give one band of 16 bits or more",
        )
    label = _label(path, dataset.driver)
    sphere_m = _checked_sphere(path, dataset)
    coordinate_system = _checked_body(path, dataset, label)
    grid = MapGrid.of_map(dataset.crs, dataset.transform, dataset.height, dataset.width, sphere_m)
    if not (0.0 < grid.resolution_m < sphere_m and np.isfinite(grid.bounds()).all()):
        problem = f"its cells of {grid.resolution_m:g} m do not lie on the Moon; correct the projection"
        raise FileFormatError(path, problem)
    quantity, unit, reference_m = _meaning(path, dataset, label, radius_m, unit, sphere_m)
    metadata = TerrainMetadata(
        path=path,
        driver=dataset.driver,
        files=tuple(_fingerprint(Path(name)) for name in dataset.files if Path(name).is_file()),
        crs=dataset.crs.to_wkt(),
        coordinate_system=coordinate_system,
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


def _refuse_cut_map(path: Path, dataset: Any) -> None:
    """GDAL reads truncated maps without complaint: without their scale, or with zeros for what is missing."""
    with path.open("rb") as stream:
        if dataset.driver == "GTiff":
            needed = _tiff_bytes(stream)
        elif dataset.driver == "ENVI" and stream.read(2) != b"\x1f\x8b":
            cells = dataset.width * dataset.height * np.dtype(dataset.dtypes[0]).itemsize
            needed = cells + int(dataset.tags(ns="ENVI").get("header_offset", 0))
        else:
            return
    held = path.stat().st_size
    if held < needed:
        raise FileFormatError(
            path, f"was cut: it has {held} bytes of at least {needed} that it announces; fetch it again"
        )


def _tiff_bytes(stream: BinaryIO) -> int:
    """How long a TIFF file has to be to hold the values of all its tags.

    Where the last of them are lost, among them GDAL's scale and unit, they are left aside with a warning in a log.
    """
    order = {b"II": "<", b"MM": ">"}.get(stream.read(2), "<")
    big = _numbers(stream, order + "H") == (43,)
    if big:
        stream.seek(8)
    count_format, entry_format, offset_format = ("Q", "HHQ", "Q") if big else ("H", "HHI", "I")
    needed, seen = 0, set[int]()
    (directory,) = _numbers(stream, order + offset_format) or (0,)
    while directory and directory not in seen:
        seen.add(directory)
        stream.seek(directory)
        (count,) = _numbers(stream, order + count_format) or (0,)
        for _ in range(count):
            entry = _numbers(stream, order + entry_format)
            place = _numbers(stream, order + offset_format)
            if not entry or not place:
                return max(needed, stream.tell() + 1)
            length = _TIFF_BYTES.get(entry[1], 1) * entry[2]
            if length > struct.calcsize(offset_format):
                needed = max(needed, place[0] + length)
        (directory,) = _numbers(stream, order + offset_format) or (0,)
    return needed


def _numbers(stream: BinaryIO, form: str) -> tuple[int, ...]:
    """Next numbers of a file, none where it ends."""
    content = stream.read(struct.calcsize(form))
    return struct.unpack(form, content) if len(content) == struct.calcsize(form) else ()


def _label(path: Path, driver: str) -> str:
    """Text of a planetary label, attached or detached; empty for other formats."""
    if not driver.startswith(("PDS", "ISIS")):
        return ""
    with path.open("rb") as stream:
        return stream.read(_LABEL_BYTES).decode("latin-1")


def _label_values(label: str, *names: str) -> set[str]:
    pattern = rf'^\s*(?:{"|".join(names)})\s*=\s*"?([^"<\r\n]*)'
    return {value.strip() for value in re.findall(pattern, label, re.MULTILINE)} - {""}


def _checked_sphere(path: Path, dataset: Any) -> float:
    if dataset.crs is None or dataset.transform.is_identity:
        raise FileFormatError(
            path,
            "the file does not say where its cells lie (no map projection); "
            "assign one, for example with gdal_translate -a_srs -a_ullr",
        )
    found = re.search(
        r'(?:SPHEROID|ELLIPSOID)\["([^"]*)",\s*([\d.eE+]+),\s*([\d.eE+]+)',
        dataset.crs.to_wkt(version="WKT2_2019"),
    )
    if found is None:
        raise FileFormatError(
            path, "its reference system names no sphere; assign a lunar one (R = 1737400 m)"
        )
    name, radius_m, inverse_flattening = found[1], float(found[2]), float(found[3])
    low_m, high_m = _LUNAR_SPHERES_M
    if not low_m <= radius_m <= high_m:
        raise InputError(
            f"{path} is not a map of the Moon: its reference system stands on {name!r} of {radius_m / 1e3:.3f} km, "
            f"a lunar map on {low_m / 1e3:.0f} to {high_m / 1e3:.0f} km"
        )
    if inverse_flattening != 0.0:
        raise InputError(
            f"{path} refers to an ellipsoid ({name!r}), but lunar heights are above a sphere; "
            "warp the map to a spherical reference system (R = 1737400 m)"
        )
    return radius_m


def _checked_body(path: Path, dataset: Any, label: str) -> str | None:
    """The axes that the map names; refuse other bodies, axes and senses of longitude."""
    targets = _label_values(label, "TARGET_NAME", "TargetName")
    targets |= set(re.findall(r"<Target_Identification>\s*<name>([^<]+)</name>", label))
    targets |= {str(v).strip(' "') for k, v in dataset.tags().items() if k.upper() == "TARGET_NAME"}
    for target in targets:
        if target.lower() not in {"moon", "luna", "unknown", "n/a", ""}:
            raise InputError(f"{path} is a map of {target}, not of the Moon")
    senses = _label_values(label, "POSITIVE_LONGITUDE_DIRECTION", "LongitudeDirection")
    if any("WEST" in sense.upper() for sense in senses):
        raise InputError(f"{path} counts longitude west; warp the map to a system that counts east")
    systems = sorted(_label_values(label, "COORDINATE_SYSTEM_NAME"))
    if any("PRINCIPAL" in name.upper() for name in systems):
        raise InputError(
            f"{path} is in principal axes ({systems[0]}); terrain is read in mean-Earth axes, as lunar maps are"
        )
    return systems[0] if systems else None


def _meaning(
    path: Path, dataset: Any, label: str, radius_m: float | None, unit: str | None, sphere_m: float
) -> tuple[str, str, float]:
    """Quantity, unit and reference radius under which a sample of the map's values is lunar terrain."""
    declared = {dataset.units[0]} if dataset.units[0] else _label_values(label, "UNIT")
    if unit is not None:
        units = [unit]
    elif declared:
        units = sorted({_UNIT_NAMES.get(name.lower(), "") for name in declared})
        if len(units) != 1 or not units[0]:
            raise InputError(
                f"{path} gives its values in {sorted(declared)}, not in metres or kilometres; if it is an elevation "
                "map, say unit='m' or unit='km'"
            )
    else:
        units = list(_UNITS_M)
    scale, offset = float(dataset.scales[0]), float(dataset.offsets[0])
    if not (math.isfinite(scale) and scale != 0.0 and math.isfinite(offset)):
        raise FileFormatError(
            path, f"its values are {scale:g} times a number and {offset:g}; correct the label"
        )
    shape = (min(dataset.height, _SAMPLES), min(dataset.width, _SAMPLES))
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
    found = f"{path}: sampled values go from {values.min():.6g} to {values.max():.6g}"
    if not meanings:
        raise InputError(
            f"{found}, which in {' or '.join(units)} are neither heights ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m) nor "
            "radii of the Moon; an undeclared scale, unit or void value (set them with gdal_translate -a_scale "
            "-a_offset -a_nodata, or say unit=)?"
        )
    if len(meanings) > 1:
        raise InputError(
            f"{found} with no unit given, which could be metres or kilometres; say unit='m' or 'km'"
        )
    low_m, high_m = _LUNAR_SPHERES_M
    if units == ["m"] and low_m <= 1e3 * abs(offset) <= high_m:
        raise InputError(
            f"{path} adds {offset:g} m to its values, which is the Moon's radius in kilometres; give the offset in the "
            "unit of the values"
        )
    if meanings[0][0] == "radius" and radius_m is not None:
        raise InputError(f"{found}: these are radii, so radius_m has no meaning for this map; leave it out")
    return meanings[0]


def _filled(numbers: Any) -> NDArray[np.float64]:
    """Masked numbers of the file as floats with NaN for voids."""
    return np.ma.filled(numbers.astype(np.float64), np.nan)


def _heights_m(values: NDArray[np.float64], unit: str, reference_m: float) -> NDArray[np.float64]:
    return values * _UNITS_M[unit] + (reference_m - MEAN_LUNAR_RADIUS_M)


def implausible(heights_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether heights are such as the Moon has nowhere."""
    return (heights_m < LOWEST_M) | (heights_m > HIGHEST_M)


def _fingerprint(path: Path) -> TerrainFile:
    size = path.stat().st_size
    if size > _DIGEST_LIMIT_BYTES:
        return TerrainFile(path, size, None)
    with path.open("rb") as stream:
        return TerrainFile(path, size, hashlib.file_digest(stream, "sha256").hexdigest())
