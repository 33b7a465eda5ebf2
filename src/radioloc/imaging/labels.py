"""Image labels: checked values by key, and the label and tables of an ISIS cube as an ISD.

``spiceinit`` attaches tables of orientation to cubes of LRO's Narrow Angle Camera. ISIS counts lines and samples
from 1; a cube that was cut from an image states its position in it (``AlphaCube``).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import read_head
from radioloc.vectors import Floats

_MAX_MAGNITUDE = 1e15  # of numbers in a file, in seconds or kilometres
_ABSENT = object()
_START = b"Object = IsisCube"
_NAIF_CODES = {"NACL": -85600, "NACR": -85610}
_QUATERNION = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3")
_POSITION, _VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")


class Keys:
    """Values of a file by key, with errors that name file and key."""

    def __init__(self, path: str | Path, content: Any, holder: str = "an ISD of a sensor model") -> None:
        self.path = path
        self.content = content
        self.holder = holder

    def get(self, name: str, default: Any = None) -> Any:
        """Return the value of a key such as ``detector_center.line``; without a default the key is required."""
        value = self.content
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                if default is not None:
                    return default
                raise FileFormatError(self.path, f"the key {name} is missing; expected {self.holder}")
            value = value[part]
        return value

    def has(self, name: str) -> bool:
        """Return True if the key exists."""
        return isinstance(self.content, dict) and self.get(name, _ABSENT) is not _ABSENT

    def text(self, name: str, default: str | None = None) -> str:
        """Return a value as text."""
        return str(self.get(name, default))

    def numbers(self, name: str, shape: tuple[int | None, ...], default: Any = None) -> Floats:
        """Return an array of finite numbers; None in the shape allows any length."""
        value = self.get(name, default)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError, RecursionError):
            array = np.array(np.nan)
        matches = array.ndim == len(shape) and all(
            expected in (None, size) for expected, size in zip(shape, array.shape, strict=True)
        )
        if not matches or not (np.abs(array) < _MAX_MAGNITUDE).all():
            size = " by ".join("n" if length is None else str(length) for length in shape)
            expected = f"{size} finite numbers" if shape else "a finite number"
            raise FileFormatError(self.path, f"{name}: expected {expected}")
        return array

    def number(self, name: str, default: float | None = None) -> float:
        """Return a finite number."""
        return float(self.numbers(name, (), default))

    def count(self, name: str) -> int:
        """Return a positive whole number."""
        value = self.number(name)
        if value < 1.0 or value != int(value):
            raise FileFormatError(self.path, f"{name}: expected a positive whole number, got {value:g}")
        return int(value)


def is_isis_cube(path: str | Path) -> bool:
    """Return True for a file that begins as an ISIS cube."""
    return read_head(path, len(_START)).startswith(_START)


def isd_of_cube(path: str | Path) -> dict[str, Any]:
    """Return the keys of an ISD for a cube of LRO's NACL or NACR, whole or cut out, after ``spiceinit``."""
    path = Path(path)
    keys = Keys(path, _label(path), "the label of a cube after spiceinit")
    camera = keys.text("IsisCube.Instrument.InstrumentId")
    if camera not in _NAIF_CODES or keys.has("IsisCube.Mapping"):
        content = "a map" if keys.has("IsisCube.Mapping") else f"an image of {camera!r}"
        raise FileFormatError(
            path, f"expected a cube of LRO's NACL or NACR, got {content}; make an ISD by ALE's isd_generate"
        )
    naif = f"NaifKeywords.INS{_NAIF_CODES[camera]}_"
    lines, samples = (keys.count(f"IsisCube.Core.Dimensions.{name}") for name in ("Lines", "Samples"))
    # Edges of the cube in the original image, and pixels of that image per pixel of the cube.
    (first_line, by_line), (first_sample, by_sample) = (
        _part_of_image(keys, name, count) for name, count in (("Line", lines), ("Sample", samples))
    )
    summing = keys.number("IsisCube.Instrument.SpatialSumming")
    line_s = 1e-3 * keys.number("IsisCube.Instrument.LineExposureDuration.value")
    line_s *= 1.0 + keys.number(f"{naif}MULTIPLI_LINE_ERROR")
    line_s += keys.number(f"{naif}ADDITIVE_LINE_ERROR")
    start_s = _preroll(keys) + keys.number(f"{naif}CONSTANT_TIME_OFFSET")
    start_s += (keys.number(f"{naif}ADDITIONAL_PREROLL") + first_line) * line_s
    line_s *= by_line
    epoch = start_s + 0.5 * lines * line_s
    radii = keys.numbers("NaifKeywords.BODY301_RADII", (3,))
    return {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "name_platform": keys.text("IsisCube.Instrument.SpacecraftName"),
        "name_sensor": camera,
        "image_lines": lines,
        "image_samples": samples,
        "center_ephemeris_time": epoch,
        "starting_ephemeris_time": start_s,
        "line_scan_rate": [[0.5, start_s - epoch, line_s]],
        "radii": {"semimajor": radii[0], "semiminor": radii[2], "unit": "km"},
        "focal_length_model": {"focal_length": keys.number(f"{naif}FOCAL_LENGTH")},
        "focal2pixel_samples": keys.numbers(f"{naif}ITRANSS", (3,)),
        "focal2pixel_lines": keys.numbers(f"{naif}ITRANSL", (3,)),
        "detector_center": {
            "sample": keys.number(f"{naif}BORESIGHT_SAMPLE") - 0.5,
            "line": keys.number(f"{naif}BORESIGHT_LINE"),
        },
        "detector_sample_summing": summing * by_sample,
        "detector_line_summing": summing * by_line,
        "starting_detector_sample": keys.number("IsisCube.Instrument.SampleFirstPixel")
        + summing * first_sample,
        "starting_detector_line": 0.0,
        "optical_distortion": {"lrolrocnac": {"coefficients": [keys.number(f"{naif}OD_K")]}},
        "instrument_pointing": _rotation(keys, "InstrumentPointing"),
        "body_rotation": _rotation(keys, "BodyRotation"),
        "instrument_position": _states(_table(keys, "InstrumentPosition")),
        "sun_position": _states(_table(keys, "SunPosition")),
    }


def _label(path: Path) -> dict[str, Any]:
    """Return the label in GDAL's JSON form."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    try:
        with open_dataset(path) as dataset:
            tags = dataset.tags(ns="json:ISIS3")
        # rasterio splits the text at the first colon into key and value.
        content = ":".join(next(iter(tags.items()))) if len(tags) == 1 else ""
        return dict(json.loads(content))
    except (rasterio.errors.RasterioError, CPLE_BaseError, TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(path, f"GDAL cannot read the label of an ISIS cube: {error}") from error


def _part_of_image(keys: Keys, axis: str, count: int) -> tuple[float, float]:
    """Return the first edge of a cube in the original image, and the size of its pixels in pixels of that image."""
    name = "IsisCube.AlphaCube"
    if not keys.has(name):
        return 0.0, 1.0
    edges = [keys.number(f"{name}.Alpha{end}{axis}") - 0.5 for end in ("Starting", "Ending")]
    return edges[0], (edges[1] - edges[0]) / count


def _preroll(keys: Keys) -> float:
    """Return the start of the image, without additional preroll, TDB seconds since J2000, keyed by spacecraft clock."""
    clock = keys.text("IsisCube.Instrument.SpacecraftClockPrerollCount")
    # GDAL replaces the slash of the clock count.
    text = keys.text(f"NaifKeywords.CLOCK_ET_-85_{clock.replace('/', '.')}_COMPUTED")
    try:
        return float(np.frombuffer(bytes.fromhex(text), "<f8")[0])
    except (ValueError, IndexError):
        raise FileFormatError(
            keys.path, f"CLOCK_ET_-85_{clock}_COMPUTED: expected an epoch in hexadecimal, got {text!r}"
        ) from None


def _table(keys: Keys, name: str) -> dict[str, Floats]:
    """Return the columns of a table of numbers by name."""
    group = f"Table_{name}"
    if not isinstance(keys.get(group, ""), dict):
        raise FileFormatError(keys.path, f"the table {name} is missing; run spiceinit on the cube")
    columns = [key.removeprefix("Field_") for key in keys.content[group] if key.startswith("Field_")]
    rows, start, length = (keys.count(f"{group}.{key}") for key in ("Records", "StartByte", "Bytes"))
    order = ">" if keys.text(f"{group}.ByteOrder").lower() == "msb" else "<"
    complete = start - 1 + length <= Path(keys.path).stat().st_size
    if not complete or length != 8 * rows * len(columns) or "ET" not in columns:
        raise FileFormatError(
            keys.path, f"the table {name} is cut, or has other columns than numbers; fetch the cube again"
        )
    with Path(keys.path).open("rb") as file:
        file.seek(start - 1)
        content = file.read(length)
    values = np.frombuffer(content, f"{order}f8").reshape(rows, len(columns))
    return dict(zip(columns, values.T, strict=True))


def _rotation(keys: Keys, name: str) -> dict[str, Any]:
    """Return a table of rotations from J2000, with the constant rotation that follows them."""
    group, table = f"Table_{name}", _table(keys, name)
    if not {*_QUATERNION, "ET"} <= set(table):
        raise FileFormatError(keys.path, f"the table {name} lacks quaternions; run spiceinit on the cube")
    content: dict[str, Any] = {
        "ephemeris_times": table["ET"],
        "quaternions": np.column_stack([table[axis] for axis in _QUATERNION]),
        "time_dependent_frames": keys.get(f"{group}.TimeDependentFrames"),
    }
    if keys.has(f"{group}.ConstantRotation"):
        content["constant_rotation"] = keys.get(f"{group}.ConstantRotation")
        content["constant_frames"] = keys.get(f"{group}.ConstantFrames")
    return content


def _states(table: dict[str, Floats]) -> dict[str, Any]:
    """Return a table of positions and velocities, km and s."""
    content = {"ephemeris_times": table["ET"], "unit": "km"}
    for name, axes in (("positions", _POSITION), ("velocities", _VELOCITY)):
        if set(axes) <= set(table):
            content[name] = np.column_stack([table[axis] for axis in axes])
    return content
