"""Files of maps of the Moon: complete, with a projection and in mean-Earth axes, or refused.

Formats of rasterio (GDAL): PDS3 and PDS4 images by their label, ISIS cubes, GeoTIFF and others.
"""

from __future__ import annotations

import hashlib
import logging
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import FileFormatError, InputError, RadiolocError
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.text_files import require_file

# maps have used spheres from 1735.97 (polar) to 1738.14 km (equatorial)
LUNAR_SPHERES_M = (1.735e6, 1.739e6)
BLOCK_CELLS = 512
_FILTER_LOCK = threading.Lock()  # filters of warnings belong to all threads, and products are written by two
_DIGEST_LIMIT_BYTES = 256 * 1024 * 1024
_LABEL_BYTES = 262144
_END_BYTES = 1024  # A PNG file ends with the chunk IEND, of 12 bytes; editors append little


@dataclass(frozen=True, slots=True)
class SourceFile:
    """Record of a file of a map; ``sha256`` is None for files over 256 MiB."""

    path: Path
    size_bytes: int
    sha256: str | None


@dataclass(frozen=True, slots=True, eq=False)
class MapFile:
    """Open map: rasterio's dataset of one band with the metadata of the file."""

    dataset: Any
    label: str  # text of a planetary label, empty for other formats
    coordinate_system: str | None  # axes that the label names; without one, mean-Earth
    sphere_m: float  # radius of the sphere of its reference system
    grid: MapGrid

    def files(self) -> tuple[SourceFile, ...]:
        """All files that the map consists of."""
        return tuple(_fingerprint(Path(name)) for name in self.dataset.files if Path(name).is_file())


@contextmanager
def open_map_file(path: Path, kinds: str, description: str) -> Iterator[MapFile]:
    """Open a map of one band of one of NumPy's types `kinds`; the `description` of the data is used in errors."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    require_file(path)
    try:
        with open_dataset(path) as dataset, np.errstate(over="raise", divide="raise", invalid="raise"):
            kind = np.dtype(dataset.dtypes[0])
            if dataset.count != 1 or f"{kind.kind}{kind.itemsize}" not in kinds.split():
                raise FileFormatError(
                    path, f"expected {description}, got {dataset.count} band(s) of type {kind}"
                )
            label = _label(path, dataset.driver)
            sphere_m = _checked_sphere(path, dataset)
            coordinate_system = _checked_body(path, dataset, label)
            grid = MapGrid.of_map(dataset.crs, dataset.transform, dataset.height, dataset.width, sphere_m)
            if not (0.0 < grid.resolution_m < sphere_m and np.isfinite(grid.bounds()).all()):
                problem = (
                    f"its cells of {grid.resolution_m:g} m do not lie on the Moon; correct the projection"
                )
                raise FileFormatError(path, problem)
            yield MapFile(dataset, label, coordinate_system, sphere_m, grid)
    except RadiolocError:
        raise
    # Of a damaged label or projection GDAL, PROJ and arithmetic make many kinds of error.
    except (rasterio.errors.RasterioError, CPLE_BaseError, ArithmeticError, ValueError) as error:
        raise FileFormatError(
            path,
            f"GDAL does not read it as a map ({error}); if its label is a file of its own (.LBL, .xml), "
            "give that one",
        ) from error


def open_dataset(path: Path | str, **options: Any) -> Any:
    """Open a file, or GDAL's text of a virtual one, by rasterio without its warnings; a cut file is an error."""
    rasterio = load_rasterio()
    messages = _Messages()
    logger = logging.getLogger("rasterio")
    with _FILTER_LOCK, warnings.catch_warnings():
        # a map without georeferencing is refused below, with the remedy
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        # GDAL's messages repeat a label, and where it is not UTF-8 Python would show a traceback
        hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
        logger.addHandler(messages)
        try:
            dataset = rasterio.open(path, **options)
        finally:
            logger.removeHandler(messages)
            sys.unraisablehook = hook
    if "IO error" in messages.text or (isinstance(path, Path) and _is_cut(path, dataset)):
        dataset.close()
        raise FileFormatError(path, "was cut: its end is missing; fetch it again")
    return dataset


class _Messages(logging.Handler):
    """Collect messages of GDAL, which reads a TIFF file without the scale and unit that its lost end had."""

    text = ""

    def emit(self, record: logging.LogRecord) -> None:
        """Append a message."""
        self.text += record.getMessage()


def _is_cut(path: Path, dataset: Any) -> bool:
    """Return True for a raw or PNG image of which GDAL reads zeros in place of the missing end."""
    with path.open("rb") as stream:
        if dataset.driver == "PNG":
            stream.seek(max(0, path.stat().st_size - _END_BYTES))
            return b"IEND" not in stream.read()
        if dataset.driver != "ENVI" or stream.read(2) == b"\x1f\x8b":  # compressed
            return False
    cells = dataset.width * dataset.height * np.dtype(dataset.dtypes[0]).itemsize
    return path.stat().st_size < cells + int(dataset.tags(ns="ENVI").get("header_offset", 0))


def new_geotiff(
    path: str | Path,
    crs: Any,
    transform: Any,
    shape: tuple[int, int],
    dtype: Any,
    nodata: float | None = None,
    bands: int = 1,
    compress: str | None = "deflate",
) -> Any:
    """Open a GeoTIFF to be written by parts, in blocks of 512 cells."""
    profile = {
        "crs": crs, "transform": transform, "height": shape[0], "width": shape[1], "count": bands, "dtype": dtype,
        "nodata": nodata, "tiled": True, "blockxsize": BLOCK_CELLS, "blockysize": BLOCK_CELLS,
    }  # fmt: skip
    predictor = 3 if np.issubdtype(dtype, np.floating) else 2
    return load_rasterio().open(path, "w", driver="GTiff", compress=compress, predictor=predictor, **profile)


def _label(path: Path, driver: str) -> str:
    """Text of a planetary label, attached or detached; empty for other formats."""
    if not driver.startswith(("PDS", "ISIS")):
        return ""
    with path.open("rb") as stream:
        return stream.read(_LABEL_BYTES).decode("latin-1")


def label_values(label: str, *names: str) -> set[str]:
    """Values of keywords in the text of a planetary label."""
    pattern = rf'^\s*(?:{"|".join(names)})\s*=\s*"?([^"<\r\n]*)'
    return {value.strip() for value in re.findall(pattern, label, re.MULTILINE)} - {""}


def _checked_sphere(path: Path, dataset: Any) -> float:
    if dataset.crs is None or dataset.transform.is_identity:
        raise FileFormatError(
            path,
            "the file does not say where its cells lie (no map projection); "
            "assign one, for example with gdal_translate -a_srs -a_ullr",
        )
    spheroid = re.search(
        r'(?:SPHEROID|ELLIPSOID)\["([^"]*)",\s*([\d.eE+]+),\s*([\d.eE+]+)',
        dataset.crs.to_wkt(version="WKT2_2019"),
    )
    if spheroid is None:
        raise FileFormatError(
            path, "its reference system names no sphere; assign a lunar one (R = 1737400 m)"
        )
    name, radius_m, inverse_flattening = spheroid[1], float(spheroid[2]), float(spheroid[3])
    low_m, high_m = LUNAR_SPHERES_M
    if not low_m <= radius_m <= high_m:
        raise InputError(
            f"{path} is not a map of the Moon: its reference system stands on {name!r} of {radius_m / 1e3:.3f} km, "
            f"a lunar map on {low_m / 1e3:.0f} to {high_m / 1e3:.0f} km"
        )
    if inverse_flattening != 0.0:
        raise InputError(
            f"{path} refers to an ellipsoid ({name!r}), but lunar maps refer to a sphere; "
            "warp the map to a spherical reference system (R = 1737400 m)"
        )
    return radius_m


def _checked_body(path: Path, dataset: Any, label: str) -> str | None:
    """Return the axes that the map names; refuse other bodies, axes and senses of longitude."""
    targets = label_values(label, "TARGET_NAME", "TargetName")
    targets |= set(re.findall(r"<Target_Identification>\s*<name>([^<]+)</name>", label))
    targets |= {str(v).strip(' "') for k, v in dataset.tags().items() if k.upper() == "TARGET_NAME"}
    for target in targets:
        if target.lower() not in {"moon", "luna", "unknown", "n/a", ""}:
            raise InputError(f"{path} is a map of {target}, not of the Moon")
    senses = label_values(label, "POSITIVE_LONGITUDE_DIRECTION", "LongitudeDirection")
    if any("WEST" in sense.upper() for sense in senses):
        raise InputError(f"{path} counts longitude west; warp the map to a system that counts east")
    systems = sorted(label_values(label, "COORDINATE_SYSTEM_NAME"))
    systems += re.findall(r'"([^"]*principal ax[^"]*)"', dataset.crs.to_wkt(), re.IGNORECASE)
    if any("PRINCIPAL" in name.upper() for name in systems):
        raise InputError(
            f"{path} is in principal axes ({systems[0]}); lunar maps are read in mean-Earth axes"
        )
    return systems[0] if systems else None


def _fingerprint(path: Path) -> SourceFile:
    size = path.stat().st_size
    if size > _DIGEST_LIMIT_BYTES:
        return SourceFile(path, size, None)
    with path.open("rb") as stream:
        return SourceFile(path, size, hashlib.file_digest(stream, "sha256").hexdigest())
