"""What files say of an image: values by their keys, checked; the label and tables of an ISIS cube as an ISD.

Tables of orientation are those that ``spiceinit`` attached. Cubes are of the Narrow Angle Camera of LRO. ISIS counts
lines and samples from 1; a cube that was cut from an image knows where (``AlphaCube``). The tables are joined and
interpolated as those of every ISD.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import head_of
from radioloc.vectors import Floats

# Number in a file: in seconds or kilometres it is out of this world.
_LARGEST = 1e15
_ABSENT = object()
_START = b"Object = IsisCube"
_NAIF_CODES = {"NACL": -85600, "NACR": -85610}
_QUATERNION = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3")
_POSITION, _VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")


class Keys:
    """Values of a file by their path, with errors that name file and key."""

    def __init__(self, path: str | Path, content: Any, holder: str = "an ISD of a sensor model") -> None:
        self.path = path
        self.content = content
        self.holder = holder

    def get(self, name: str, default: Any = None) -> Any:
        """The value of a key such as ``detector_center.line``; without a default the key has to be there."""
        value = self.content
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                if default is not None:
                    return default
                raise FileFormatError(self.path, f"the key {name} is missing; {self.holder} has it")
            value = value[part]
        return value

    def has(self, name: str) -> bool:
        """Whether there is such a key."""
        return isinstance(self.content, dict) and self.get(name, _ABSENT) is not _ABSENT

    def text(self, name: str, default: str | None = None) -> str:
        """A text."""
        return str(self.get(name, default))

    def numbers(self, name: str, shape: tuple[int | None, ...], default: Any = None) -> Floats:
        """An array of finite numbers; of lengths that are None there may be any number."""
        value = self.get(name, default)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError, RecursionError):
            array = np.array(np.nan)
        fits = array.ndim == len(shape) and all(
            want in (None, got) for want, got in zip(shape, array.shape, strict=True)
        )
        if not fits or not (np.abs(array) < _LARGEST).all():
            size = " by ".join("n" if one is None else str(one) for one in shape)
            what = f"{size} finite numbers" if shape else "a finite number"
            raise FileFormatError(self.path, f"{name} is not {what}, as a camera has")
        return array

    def number(self, name: str, default: float | None = None) -> float:
        """One finite number."""
        return float(self.numbers(name, (), default))

    def count(self, name: str) -> int:
        """A positive whole number."""
        value = self.number(name)
        if value < 1.0 or value != int(value):
            raise FileFormatError(self.path, f"{name} = {value:g} is not a positive whole number")
        return int(value)


def is_isis_cube(path: str | Path) -> bool:
    """Whether a file begins as an ISIS cube."""
    return head_of(path, len(_START)).startswith(_START)


def isd_of_cube(path: str | Path) -> dict[str, Any]:
    """Return the keys of an ISD for the image in a cube of LRO's NACL or NACR, whole or cut out, with ``spiceinit``."""
    path = Path(path)
    keys = Keys(path, _label(path), "the label of a cube with spiceinit done")
    camera = keys.text("IsisCube.Instrument.InstrumentId")
    if camera not in _NAIF_CODES or keys.has("IsisCube.Mapping"):
        what = "a map" if keys.has("IsisCube.Mapping") else f"an image of {camera!r}"
        raise FileFormatError(
            path,
            f"is {what}; cubes of LRO's NACL and NACR are read, and ISDs (ALE's isd_generate) of other cameras",
        )
    naif = f"NaifKeywords.INS{_NAIF_CODES[camera]}_"
    lines, samples = (keys.count(f"IsisCube.Core.Dimensions.{name}") for name in ("Lines", "Samples"))
    # Edges of the cube in the image that it was cut from, and how many of its pixels are one here.
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
    pointing, body = _rotation(keys, "InstrumentPointing"), _rotation(keys, "BodyRotation")
    positions, sun = _table(keys, "InstrumentPosition"), _table(keys, "SunPosition")
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
        "instrument_pointing": pointing,
        "body_rotation": body,
        "instrument_position": _states(positions),
        "sun_position": _states(sun),
    }


def _label(path: Path) -> dict[str, Any]:
    """The label, as GDAL has it in JSON."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    try:
        with open_dataset(path) as dataset:
            tags = dataset.tags(ns="json:ISIS3")
        # rasterio takes what is before the first colon for a key.
        content = ":".join(next(iter(tags.items()))) if len(tags) == 1 else ""
        return dict(json.loads(content))
    except (rasterio.errors.RasterioError, CPLE_BaseError, TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(
            path, f"GDAL does not read its label as that of an ISIS cube: {error}"
        ) from error


def _part_of_image(keys: Keys, axis: str, count: int) -> tuple[float, float]:
    """The first edge of a cube in the whole image, and how many of the image's pixels one of its pixels is wide."""
    name = "IsisCube.AlphaCube"
    if not keys.has(name):
        return 0.0, 1.0
    edges = [keys.number(f"{name}.Alpha{end}{axis}") - 0.5 for end in ("Starting", "Ending")]
    return edges[0], (edges[1] - edges[0]) / count


def _preroll(keys: Keys) -> float:
    """When the image began, before further preroll, TDB seconds since J2000; ISIS has it by the spacecraft's clock."""
    clock = keys.text("IsisCube.Instrument.SpacecraftClockPrerollCount")
    # GDAL makes a group of what is before a slash.
    text = keys.text(f"NaifKeywords.CLOCK_ET_-85_{clock.replace('/', '.')}_COMPUTED")
    try:
        return float(np.frombuffer(bytes.fromhex(text), "<f8")[0])
    except (ValueError, IndexError):
        raise FileFormatError(
            keys.path, f"CLOCK_ET_-85_{clock}_COMPUTED is {text!r}, no epoch of ISIS"
        ) from None


def _table(keys: Keys, name: str) -> dict[str, Floats]:
    """Columns of a table of numbers by their names."""
    about = f"Table_{name}"
    if not isinstance(keys.get(about, ""), dict):
        raise FileFormatError(keys.path, f"has no table {name}; run spiceinit on it")
    columns = [key.removeprefix("Field_") for key in keys.content[about] if key.startswith("Field_")]
    rows, start, length = (keys.count(f"{about}.{key}") for key in ("Records", "StartByte", "Bytes"))
    order = ">" if keys.text(f"{about}.ByteOrder").lower() == "msb" else "<"
    whole = start - 1 + length <= Path(keys.path).stat().st_size
    if not whole or length != 8 * rows * len(columns) or "ET" not in columns:
        raise FileFormatError(
            keys.path, f"the table {name} is cut, or is not one of numbers at times; fetch the cube again"
        )
    with Path(keys.path).open("rb") as file:
        file.seek(start - 1)
        content = file.read(length)
    values = np.frombuffer(content, f"{order}f8").reshape(rows, len(columns))
    return dict(zip(columns, values.T, strict=True))


def _rotation(keys: Keys, name: str) -> dict[str, Any]:
    """A table of rotations from J2000, with the constant one that follows them."""
    about, table = f"Table_{name}", _table(keys, name)
    if not {*_QUATERNION, "ET"} <= set(table):
        raise FileFormatError(keys.path, f"the table {name} has no quaternions; run spiceinit on the cube")
    content: dict[str, Any] = {
        "ephemeris_times": table["ET"],
        "quaternions": np.column_stack([table[axis] for axis in _QUATERNION]),
        "time_dependent_frames": keys.get(f"{about}.TimeDependentFrames"),
    }
    if keys.has(f"{about}.ConstantRotation"):
        content["constant_rotation"] = keys.get(f"{about}.ConstantRotation")
        content["constant_frames"] = keys.get(f"{about}.ConstantFrames")
    return content


def _states(table: dict[str, Floats]) -> dict[str, Any]:
    """A table of positions and velocities, km and s."""
    content = {"ephemeris_times": table["ET"], "unit": "km"}
    for name, axes in (("positions", _POSITION), ("velocities", _VELOCITY)):
        if set(axes) <= set(table):
            content[name] = np.column_stack([table[axis] for axis in axes])
    return content
