"""Camera models from ISIS cubes: the label and the tables of orientation that ``spiceinit`` attached, as an ISD.

Of the Narrow Angle Camera of LRO. ISIS counts lines and samples from 1; a cube that was cut from an image knows
where (``AlphaCube``). The tables are joined and interpolated as those of every ISD.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.imaging.json_keys import Keys
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import head_of

Floats = NDArray[np.float64]

_START = b"Object = IsisCube"
_NAIF_CODES = {"NACL": -85600, "NACR": -85610}
_QUATERNION = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3")
_POSITION, _VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")


def is_isis_cube(path: str | Path) -> bool:
    """Whether a file begins as an ISIS cube."""
    return head_of(path, len(_START)).startswith(_START)


def isd_of_cube(path: str | Path) -> dict[str, Any]:
    """What an ISD would have of the image in a cube.

    Parameters
    ----------
    path : path-like
        A cube of LRO's NACL or NACR, whole or cut out, with ``spiceinit`` done.

    Raises
    ------
    FileFormatError
        Another camera, a map, a cube without tables, or one that is cut.
    """
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
    try:
        with open_dataset(path) as dataset:
            tags = dataset.tags(ns="json:ISIS3")
        # rasterio takes what is before the first colon for a key.
        content = ":".join(next(iter(tags.items()))) if len(tags) == 1 else ""
        return dict(json.loads(content))
    except (rasterio.errors.RasterioError, ValueError) as error:
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
    if not keys.has(about):
        raise FileFormatError(keys.path, f"has no table {name}; run spiceinit on it")
    columns = [key.removeprefix("Field_") for key in keys.get(about) if key.startswith("Field_")]
    rows, start, length = (keys.count(f"{about}.{key}") for key in ("Records", "StartByte", "Bytes"))
    order = ">" if keys.text(f"{about}.ByteOrder").lower() == "msb" else "<"
    with Path(keys.path).open("rb") as file:
        file.seek(start - 1)
        content = file.read(length)
    if len(content) < length or length != 8 * rows * len(columns):
        raise FileFormatError(
            keys.path, f"the table {name} is cut, or is not one of numbers; fetch the cube again"
        )
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
