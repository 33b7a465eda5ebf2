"""Tie points that somebody else has measured: ground control files of ASP and QGIS, and tables.

Pixels in memory are (sample, line) with the centre of the first pixel at (0, 0). So are those of ASP's files and of
tables here; QGIS counts from the corner of the image, lines upward from there, so that its lines are negative.

Tables have a heading and a line for each measurement: ``point`` (the same name for the same point), ``image``,
``sample``, ``line``, ``sigma_px``, and ``longitude_deg``, ``latitude_deg``, ``sigma_m`` of points whose place is known,
else empty.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.errors import FileFormatError, InputError
from radioloc.imaging.maps import Map
from radioloc.text_files import numbers_of, read_text, write_text

_COLUMNS = ("point", "image", "sample", "line", "sigma_px", "longitude_deg", "latitude_deg", "sigma_m")
_QGIS = ("mapX", "mapY", "sourceX", "sourceY", "enable")
_DEFAULT_SIGMA_PX = 1.0  # of points clicked by hand
_GCP_FIELDS, _MEASURE_FIELDS = 7, 5


@dataclass(frozen=True, slots=True)
class Measurement:
    """Where a point is in one image."""

    image: str
    sample: float
    line: float
    sigma_px: float = _DEFAULT_SIGMA_PX


@dataclass(frozen=True, slots=True)
class TiePoint:
    """A point measured in images, with its place on the Moon where that is known (mean-Earth axes)."""

    name: str
    measurements: tuple[Measurement, ...]
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    sigma_m: float | None = None
    height_m: float = 0.0


def read_tie_points(path: str | Path, *, image: str | None = None, base: Map | None = None) -> list[TiePoint]:
    r"""Read tie points; the format follows from the name: ``.gcp`` (ASP), ``.points`` (QGIS), or a table (``.csv``).

    Parameters
    ----------
    path : path-like
        The file.
    image : str, optional
        Of a file of QGIS: the name of the image that it belongs to, by default the file's without ``.points``.
    base : Map, optional
        Of a file of QGIS: the map whose projection its places are in; without it they are degrees.

    Raises
    ------
    FileFormatError
        A line that is not of the format, with its number.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.imaging import read_tie_points
    >>> path = pathlib.Path(tempfile.mkdtemp(), "a.gcp")
    >>> _ = path.write_text("5 44.12 -19.51 -2640 25 25 10 1801.png 174.0 173.5 0.5 0.5\n")
    >>> point = read_tie_points(path)[0]
    >>> point.longitude_deg, point.measurements[0].sample
    (-19.51, 174.0)
    """
    path = Path(path)
    lines = read_text(path).split("\n")
    if path.suffix.lower() == ".gcp":
        points = _read_gcp(path, lines)
    elif path.suffix.lower() == ".points":
        points = _read_qgis(path, lines, image or path.stem, base)
    else:
        points = _read_table(path, lines)
    if not points:
        raise FileFormatError(path, "has no tie points")
    return points


def write_tie_points(
    path: str | Path, points: Sequence[TiePoint], *, image: str | None = None, base: Map | None = None
) -> None:
    """Write tie points in the format of the name; see :func:`read_tie_points`.

    Files of ASP and QGIS hold points whose place is known, those of QGIS of one image; others are an error.

    Raises
    ------
    InputError
        Points that the format cannot hold.
    FileFormatError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.imaging import Measurement, TiePoint, read_tie_points, write_tie_points
    >>> path = pathlib.Path(tempfile.mkdtemp(), "points.gcp")
    >>> point = TiePoint("5", (Measurement("1801.png", 174.0, 173.5),), -19.51, 44.12, 25.0, -2640.0)
    >>> write_tie_points(path, [point])
    >>> read_tie_points(path)[0].measurements[0].image
    '1801.png'
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".gcp", ".points"):
        for point in points:
            if point.longitude_deg is None:
                raise InputError(
                    f"{point.name} has no place on the Moon, which {path.name} needs; write a table (.csv)"
                )
    if suffix == ".gcp":
        text = "".join(_gcp_line(point) for point in points)
    elif suffix == ".points":
        text = _qgis_text(points, image or path.stem, base)
    else:
        text = _table_text(points)
    write_text(path, text)


def _read_gcp(path: Path, lines: list[str]) -> list[TiePoint]:
    points = []
    for number, line in enumerate(lines, start=1):
        fields = line.partition("#")[0].replace(",", " ").split()
        if not fields:
            continue
        if len(fields) < _GCP_FIELDS or (len(fields) - _GCP_FIELDS) % _MEASURE_FIELDS:
            raise FileFormatError(
                path,
                f"{len(fields)} fields; a point has an identifier, latitude, longitude, height, three sigmas, and for "
                "each image its name, column, row and two sigmas",
                number,
            )
        about = numbers_of(path, number, fields[1:_GCP_FIELDS], "a place with its sigmas")
        latitude, longitude, height_m, *sigmas_m = about
        measurements = []
        for k in range(_GCP_FIELDS, len(fields), _MEASURE_FIELDS):
            words = fields[k + 1 : k + _MEASURE_FIELDS]
            sample, row, *sigmas = numbers_of(path, number, words, "a pixel with its sigmas")
            measurements.append(Measurement(Path(fields[k]).name, sample, row, _mean(path, sigmas, number)))
        place = _place(path, longitude, latitude, number)
        points.append(
            TiePoint(fields[0], tuple(measurements), *place, _mean(path, sigmas_m[:2], number), height_m)
        )
    return points


def _read_qgis(path: Path, lines: list[str], image: str, base: Map | None) -> list[TiePoint]:
    rows = [(k, line) for k, line in enumerate(lines, start=1) if line.strip() and line[:4] != "#CRS"]
    if not rows or not re.match(r"mapX,mapY,(sourceX,sourceY|pixelX,pixelY)\b", rows[0][1]):
        raise FileFormatError(path, f"has no heading {','.join(_QGIS)}, with which files of QGIS begin", 1)
    points = []
    for number, line in rows[1:]:
        fields = line.split(",")
        if len(fields) < len(_QGIS):
            raise FileFormatError(path, f"{len(fields)} fields; a point of QGIS has five or more", number)
        x, y, source_x, source_y, enabled = numbers_of(path, number, fields[: len(_QGIS)], "a coordinate")
        if not enabled:
            continue
        if base is not None:
            x, y = base.longitude_latitude_deg(base.from_xy_m([[x, y]]))[0].tolist()
        measured = Measurement(image, source_x - 0.5, -source_y - 0.5)
        points.append(TiePoint(str(number), (measured,), *_place(path, x, y, number), None))
    return points


def _read_table(path: Path, lines: list[str]) -> list[TiePoint]:
    rows = list(csv.reader(lines))
    if not rows or any(name not in rows[0] for name in _COLUMNS[:4]):
        raise FileFormatError(path, f"has no heading with {', '.join(_COLUMNS[:4])}", 1)
    unknown = sorted(set(rows[0]) - set(_COLUMNS))
    if unknown:
        raise FileFormatError(
            path, f"has columns {unknown}, which are not known; use {', '.join(_COLUMNS)}", 1
        )
    measured: dict[str, list[Measurement]] = {}
    places: dict[str, tuple[float | None, float | None, float | None]] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not any(row):
            continue
        if len(row) != len(rows[0]):
            raise FileFormatError(path, f"{len(row)} fields where the heading has {len(rows[0])}", number)
        cells = dict.fromkeys(_COLUMNS, "") | dict(zip(rows[0], row, strict=True))
        point = cells["point"]
        words = [cells["sample"], cells["line"], cells["sigma_px"] or str(_DEFAULT_SIGMA_PX)]
        sample, line, sigma_px = numbers_of(path, number, words, "a pixel with its sigma")
        here = Measurement(cells["image"], sample, line, _mean(path, [sigma_px], number))
        measured.setdefault(point, []).append(here)
        degrees = [word for word in (cells["longitude_deg"], cells["latitude_deg"]) if word]
        if len(degrees) == 1:
            raise FileFormatError(path, "longitude_deg or latitude_deg is empty, but not both", number)
        if degrees:
            degrees += [cells["sigma_m"]] if cells["sigma_m"] else []
            longitude, latitude, *sigma_m = numbers_of(path, number, degrees, "a place with its sigma")
            at = _place(path, longitude, latitude, number)
            place = (*at, _mean(path, sigma_m, number) if sigma_m else None)
            if places.setdefault(point, place) != place:
                raise FileFormatError(path, f"point {point!r} has two places", number)
    nowhere = (None, None, None)
    return [TiePoint(name, tuple(m), *places.get(name, nowhere)) for name, m in measured.items()]


def _gcp_line(point: TiePoint) -> str:
    sigma_m = 1.0 if point.sigma_m is None else point.sigma_m
    place = f"{point.name} {point.latitude_deg:.9f} {point.longitude_deg:.9f} {point.height_m:.4f}"
    pixels = (
        f"{m.image} {m.sample:.4f} {m.line:.4f} {m.sigma_px:g} {m.sigma_px:g}" for m in point.measurements
    )
    return f"{place} {sigma_m:g} {sigma_m:g} {sigma_m:g} {' '.join(pixels)}\n"


def _qgis_text(points: Sequence[TiePoint], image: str, base: Map | None) -> str:
    lines = ["mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"]
    for point in points:
        at = np.array([[point.longitude_deg, point.latitude_deg]], dtype=np.float64)
        x, y = at[0] if base is None else base.xy_m(base.pixels(at))[0]
        lines += [
            f"{x:.9f},{y:.9f},{m.sample + 0.5:.4f},{-m.line - 0.5:.4f},1,0,0,0"
            for m in point.measurements
            if m.image == image
        ]
    if len(lines) == 1:
        raise InputError(f"no point is measured in {image!r}; name the image")
    return "\n".join(lines) + "\n"


def _table_text(points: Sequence[TiePoint]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for point in points:
        place = [
            "" if v is None else f"{v:.{d}f}"
            for v, d in ((point.longitude_deg, 9), (point.latitude_deg, 9), (point.sigma_m, 4))
        ]
        for m in point.measurements:
            writer.writerow(
                [point.name, m.image, f"{m.sample:.4f}", f"{m.line:.4f}", f"{m.sigma_px:g}", *place]
            )
    return stream.getvalue()


def _mean(path: Path, sigmas: Iterable[float], line: int) -> float:
    """One sigma of two coordinates, their root mean square."""
    values = list(sigmas)
    if not all(v > 0.0 for v in values):
        raise FileFormatError(path, f"a sigma is {min(values):g}, not positive", line)
    return math.sqrt(sum(v * v for v in values) / len(values))


def _place(path: Path, longitude: float, latitude: float, line: int) -> tuple[float, float]:
    if not (abs(longitude) <= 360.0 and abs(latitude) <= 90.0):
        raise FileFormatError(
            path,
            f"longitude {longitude:g}, latitude {latitude:g} are no degrees; are they metres of a projection?",
            line,
        )
    return longitude - 360.0 * round(longitude / 360.0), latitude
