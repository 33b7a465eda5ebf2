"""ILRS Consolidated Laser Ranging Data (CRD), versions 1 and 2: normal points to the Moon.

What is measured: the two-way time of flight (record 11); the epoch is UTC of the event that the record
names: reception, bounce or transmission at the station's reference point. Refraction must not have been
corrected, the station's own delay must have been (record H4): anything else is refused.

The standard deviation of a normal point is its bin's RMS divided by the square root of the number of its
ranges, both from record 11, of the two-way time; where the bin's RMS is missing, the session's (record 50)
stands in. It is 0.6 to 1.6 times (median 0.94) the total uncertainty that APOLLO states in comments in its
files of spring 2024.

Weather (record 20) is interpolated linearly in time between the records of the same pass, and held before
the first and after the last; where the nearest record is more than two hours away it counts as not
recorded.

Records 12, 21, 30, 40-42, 60, 9x, C1-C7, H5 and comments (00) say nothing that the model uses and are
passed over.

Source: R. L. Ricklefs and C. J. Moore, Consolidated Laser Ranging Data Format, versions 1.01 (2009) and
2.01 (2019).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.errors import FileFormatError
from radioloc.io.checks import Catalogue, refuse_duplicates
from radioloc.io.crd_records import (
    LONGEST_PASS_S,
    NormalPoint,
    PassDates,
    Record,
    Weather,
    parse_normal_point,
    parse_pass,
    parse_session_rms,
    parse_station,
    parse_target,
    parse_version,
    parse_wavelength,
    parse_weather,
)
from radioloc.io.dates import utc_from_seconds_of_day
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_lines

_PASSED_OVER = frozenset(
    ["00", "12", "21", "30", "40", "41", "42", "60", "H5"]
    + [f"C{k}" for k in range(1, 8)]
    + [f"9{k}" for k in range(10)]
)
_HEADERS = ("H1", "H2", "H3", "H4", "C0", "H9")
_DATA = ("11", "20", "50", "H8")
# A normal point may lie this far outside the first and the last range, from which H4 is made.
_PASS_MARGIN_S = 3600.0
_WEATHER_REACH_S = 7200.0


@dataclass(slots=True)
class _Pass:
    """What lies between H4 and H8, and what the headers before it say."""

    line: int
    link: int
    dates: PassDates
    wavelengths_um: dict[str, float]
    points: list[NormalPoint] = field(default_factory=list)
    weather: list[Weather] = field(default_factory=list)
    rms_ps: dict[str, float] = field(default_factory=dict)

    @property
    def latest_s(self) -> float:
        """Latest end of the pass, s since its first midnight."""
        return self.dates.start_s + LONGEST_PASS_S if self.dates.end_s is None else self.dates.end_s

    def day_of(self, second_of_day: NDArray[np.float64]) -> NDArray[np.float64]:
        """Days from the first midnight to the one that puts a second of day nearest the pass's middle."""
        middle_s = 0.5 * (self.dates.start_s + self.latest_s)
        return np.rint((middle_s - second_of_day) / SECONDS_PER_DAY)


def looks_like_crd(lines: list[str]) -> bool:
    """Whether the first record that is not a comment is a CRD format header."""
    first = next((line for line in lines if line.strip() and not line.startswith("00")), "")
    return re.match(r"h1\s+crd\b", first, re.IGNORECASE) is not None


def read_crd(path: str | Path, *, catalogue: Catalogue | None = None) -> Observations:
    """Read a CRD file of normal points, plain or gzip.

    Parameters
    ----------
    path : path-like
        The file; one or more passes, of one or more stations and targets.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; without it they keep their pad numbers, such as ``7045``.

    Raises
    ------
    FileFormatError
        The file was cut, a record is unknown, damaged or impossible, or says that the data are of a kind that
        is not modelled (full rate, one-way, refraction already corrected, ...). Names the line.
    InputError
        The same observation is there twice.

    Warns
    -----
    DataQualityWarning
        A pass is marked by its station as suspect or poor.
    """
    return parse_crd(path, read_lines(path), catalogue)


def parse_crd(path: str | Path, lines: Iterable[str], catalogue: Catalogue | None) -> Observations:
    """As :func:`read_crd`, from the file's lines."""
    links: dict[Link, int] = {}
    columns: list[list[NDArray[np.float64]]] = []
    version = 0
    station = target = ""
    wavelengths_um: dict[str, float] = {}
    current: _Pass | None = None
    ended = False
    number = 0
    for number, text in enumerate(lines, start=1):
        code = text[:2].upper()
        if code in _PASSED_OVER or not text.strip():
            continue
        record = Record(path, number, text)
        if code not in (*_HEADERS, *_DATA):
            full_rate = "full-rate ranges are not read; give normal points"
            record.fail(full_rate if code == "10" else "is not known in CRD; correct or remove it")
        if code != "H1" and (version == 0 or ended):
            record.fail("stands outside the file's header (H1) and end (H9)")
        if code in _DATA and current is None:
            record.fail("stands outside a pass (H4 to H8)")
        if code in _HEADERS and code != "C0" and current is not None:
            record.fail(f"the pass that starts at line {current.line} has no end (H8): the file was cut")
        match code:
            case "H1":
                version, ended = parse_version(record), False
                station = target = ""
                wavelengths_um = {}
            case "H2":
                station = parse_station(record, catalogue)
            case "H3":
                target = parse_target(record, version)
            case "H4":
                if not station or not target:
                    record.fail("comes before the station (H2) and the target (H3) are named")
                link = links.setdefault(Link(station, target, station), len(links))
                current = _Pass(number, link, parse_pass(record), wavelengths_um)
            case "C0":
                configuration, wavelength_um = parse_wavelength(record)
                wavelengths_um[configuration] = wavelength_um
            case "H9":
                ended = True
        if current is None:
            continue
        match code:
            case "11":
                current.points.append(parse_normal_point(record, version))
            case "20":
                current.weather.append(parse_weather(record))
            case "50":
                configuration, rms_ps = parse_session_rms(record)
                current.rms_ps[configuration] = rms_ps
            case "H8":
                columns.append(_pass_columns(path, current))
                current = None
    if not ended:
        problem = "the file ends without its end record (H9): it was cut; fetch it again"
        raise FileFormatError(path, problem, number)
    if not columns:
        raise FileFormatError(path, "has no pass; fetch it again")
    return _observations(path, columns, tuple(links))


def _observations(
    path: str | Path, columns: list[list[NDArray[np.float64]]], links: tuple[Link, ...]
) -> Observations:
    parts = [list(of_passes) for of_passes in zip(*columns, strict=True)]
    # A column that is joined is let go.
    columns.clear()
    joined = [np.concatenate(parts.pop(0)) for _ in range(len(parts))]
    line, link, jd, second, flight_s, tag, sigma_s, wavelength_um, pressure, temperature, humidity = joined
    observations = Observations.from_columns(
        epoch=utc_from_seconds_of_day(jd, second),
        links=links,
        link=link,
        tag=tag,
        value_m=C_M_S * flight_s,
        sigma_m=C_M_S * sigma_s,
        pressure_hpa=pressure,
        temperature_k=temperature,
        relative_humidity=humidity,
        wavelength_um=wavelength_um,
        files=(str(path),),
        line=line,
    )
    refuse_duplicates(observations)
    return observations


def _pass_columns(path: str | Path, done: _Pass) -> list[NDArray[np.float64]]:
    """Columns of one pass; what hangs on several of its records, in whatever order, is settled here."""
    if not done.points:
        raise FileFormatError(path, "the pass that starts here has no normal points (record 11)", done.line)
    n = len(done.points)
    second_of_day = np.array([point.second_of_day for point in done.points])
    days = done.day_of(second_of_day)
    since_start_s = days * SECONDS_PER_DAY + second_of_day
    early = since_start_s < done.dates.start_s - _PASS_MARGIN_S
    outside = early | (since_start_s > done.latest_s + _PASS_MARGIN_S)
    if outside.any():
        point = done.points[int(np.argmax(outside))]
        problem = (
            f"second of day {point.second_of_day:.3f} is outside the pass dated by H4 in line {done.line}"
        )
        raise FileFormatError(path, f"record 11: {problem}; correct one of them", point.line)
    return [
        np.array([point.line for point in done.points], dtype=np.float64),
        np.full(n, done.link, dtype=np.float64),
        done.dates.jd + days,
        second_of_day,
        np.array([point.flight_time_s for point in done.points]),
        np.array([point.tag for point in done.points], dtype=np.float64),
        np.array([_sigma_s(path, point, done) for point in done.points]),
        np.array([_wavelength_um(path, point, done) for point in done.points]),
        *_weather_at(done, since_start_s),
    ]


def _sigma_s(path: str | Path, point: NormalPoint, done: _Pass) -> float:
    for rms_ps in (point.rms_ps, done.rms_ps.get(point.configuration, math.nan)):
        if rms_ps > 0.0:
            return rms_ps * 1e-12 / math.sqrt(point.ranges)
    problem = f"no RMS above zero, nor in a record 50 for {point.configuration!r}; leave the point out"
    raise FileFormatError(path, f"record 11: {problem}", point.line)


def _wavelength_um(path: str | Path, point: NormalPoint, done: _Pass) -> float:
    if point.configuration in done.wavelengths_um:
        return done.wavelengths_um[point.configuration]
    problem = f"no record C0 gives the wavelength of system configuration {point.configuration!r}; add it"
    raise FileFormatError(path, f"record 11: {problem}", point.line)


def _weather_at(done: _Pass, since_start_s: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Pressure, temperature and humidity at the normal points; NaN where none was recorded nearby."""
    records = np.array(done.weather, dtype=np.float64).reshape(-1, len(Weather._fields))
    time_s = records[:, 0] + done.day_of(records[:, 0]) * SECONDS_PER_DAY
    order = np.argsort(time_s, kind="stable")
    out = []
    for column in records.T[1:]:
        use = order[~np.isnan(column[order])]
        times = time_s[use]
        if len(use) == 0:
            out.append(np.full(len(since_start_s), np.nan))
            continue
        after = np.minimum(np.searchsorted(times, since_start_s), len(times) - 1)
        before = np.maximum(after - 1, 0)
        away_s = np.minimum(abs(times[after] - since_start_s), abs(times[before] - since_start_s))
        value = np.interp(since_start_s, times, column[use])
        out.append(np.where(away_s <= _WEATHER_REACH_S, value, np.nan))
    return out
