"""Lunar laser ranging normal points in the old MINI layout, one per line in fixed columns.

What is measured: the round-trip time of flight; the epoch is UTC of transmission. The uncertainty is one
standard deviation of the round trip, in 0.1 ps. That it is the round trip's is seen from the public APOLLO
points of 2006 and 2007: multiplied by the square root of the number of photons it is 0.30 to 0.37 ns (median
by reflector), like the two-way RMS of 0.14 to 0.43 ns that the same station writes to CRD files today; as an
uncertainty of one way it would be twice that. Its median is 5 mm of one-way range.

Columns, counted from 1: 1-2 type 51; 3-23 date and time (blanks are zeros); 24-37 time of flight, 0.1 ps;
38 reflector; 39-43 station; 44-46 photons; 47-52 uncertainty, 0.1 ps; 53-55 signal-to-noise; 56 quality;
57-62 pressure, 0.01 hPa; 63-66 temperature, 0.1 deg C; 67-68 humidity, %; 69-73 wavelength, 0.1 nm; the
rest is not used.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import FileFormatError
from radioloc.io.checks import normal_points, read_utc
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_lines

REFLECTORS = ("apollo11", "luna17", "apollo14", "apollo15", "luna21")
"""Targets by the digit in column 38."""

STATIONS = {"70610": "7045", "01910": "7845", "07941": "7941", "71112": "7080"}
"""Pad numbers of the station codes in columns 39-43."""

_WIDTH = 73
_COLUMNS = (
    *("second_of_day", "flight_s", "sigma_s", "pressure_hpa", "temperature_k", "relative_humidity"),
    *("wavelength_um", "link", "line"),
)
_INTEGER = re.compile(r" *-?\d+", re.ASCII)


def read_mini(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Observations:
    """Read a MINI file, plain or gzip; without a catalogue stations keep their pad numbers."""
    return parse_mini(path, read_lines(path), catalogue)


def parse_mini(path: str | Path, lines: Iterable[str], catalogue: StationCatalogue | None) -> Observations:
    """Parse the lines of a MINI file (:func:`read_mini`)."""
    links: list[Link] = []
    dates: list[str] = []
    row = np.dtype((np.float64, len(_COLUMNS)))
    rows = np.fromiter(_rows(path, lines, catalogue, links, dates), dtype=row)
    if not len(rows):
        raise FileFormatError(path, "has no normal points; fetch it again")
    columns = dict(zip(_COLUMNS, rows.T, strict=True))
    midnights = read_utc(path, dates, columns["line"].astype(int).tolist()).jd
    return normal_points(path, links, columns | {"jd": midnights})


def _rows(
    path: str | Path,
    lines: Iterable[str],
    catalogue: StationCatalogue | None,
    links: list[Link],
    dates: list[str],
) -> Iterator[tuple[float, ...]]:
    """Yield the numbers of each line (:data:`_COLUMNS`); append its date, and its link if it is new."""
    places: dict[str, int] = {}
    for number, line in enumerate(lines, start=1):
        if line.strip():
            date, *columns = _parse_line(path, number, line)
            dates.append(date)
            codes = line[37:43].replace(" ", "0")
            if codes not in places:
                places[codes] = len(links)
                links.append(_link(path, number, codes, catalogue))
            yield (*columns, places[codes], number)


def _link(path: str | Path, number: int, codes: str, catalogue: StationCatalogue | None) -> Link:
    """Return the link from the codes of reflector and station, columns 38-43."""
    if not (codes.isascii() and codes.isdigit()):
        raise FileFormatError(path, f"columns 38-43 (reflector, station) hold {codes!r}, not digits", number)
    reflector, station_code = int(codes[0]), codes[1:]
    if reflector >= len(REFLECTORS):
        codes = ", ".join(f"{i} {name}" for i, name in enumerate(REFLECTORS))
        raise FileFormatError(path, f"expected the code of a reflector ({codes}), got {reflector}", number)
    station = station_name(catalogue, STATIONS.get(station_code, station_code))
    return Link(station, REFLECTORS[reflector], station)


def _parse_line(path: str | Path, number: int, line: str) -> tuple[Any, ...]:
    """Return date, second of day, flight time and sigma (s), weather and wavelength of one line."""
    if not line.startswith("51"):
        raise FileFormatError(path, f"record type {line[:2]!r} is not a MINI normal point (51)", number)
    if len(line) < _WIDTH:
        problem = f"the line has {len(line)} of at least {_WIDTH} columns: it was cut; fetch the file again"
        raise FileFormatError(path, problem, number)

    def integer(first: int, last: int, name: str) -> int:
        text = line[first - 1 : last]
        if _INTEGER.fullmatch(text) is None:
            problem = f"columns {first}-{last} ({name}): expected a number, got {text!r}"
            raise FileFormatError(path, problem, number)
        return int(text)

    def recorded(first: int, last: int, name: str) -> float:
        return float(integer(first, last, name)) if line[first - 1 : last].strip() else np.nan

    stamp = line[2:23].replace(" ", "0")
    if not (stamp.isascii() and stamp.isdigit()):
        raise FileFormatError(path, f"columns 3-23 (date and time) hold {line[2:23]!r}", number)
    year, month, day, hour, minute, second = (stamp[a:b] for a, b in pairwise((0, 4, 6, 8, 10, 12, 14)))
    second_of_day = 3600.0 * int(hour) + 60.0 * int(minute) + int(stamp[12:]) / 1e7
    flight_s = float(f"{integer(24, 37, 'time of flight')}e-13")
    sigma_s = float(f"{integer(47, 52, 'uncertainty')}e-13")
    # Added in whole hundredths, the kelvins are the float nearest to the decimal number.
    temperature_k = (recorded(63, 66, "temperature") * 10.0 + 27315.0) / 100.0
    return (
        f"{year}-{month}-{day}T{hour}:{minute}:{second}",
        second_of_day,
        flight_s,
        sigma_s,
        # A pressure of zero was not recorded.
        recorded(57, 62, "pressure") / 100.0 or np.nan,
        temperature_k,
        recorded(67, 68, "humidity") / 100.0,
        recorded(69, 73, "wavelength") / 10000.0,
    )
