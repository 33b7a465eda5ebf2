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

Records 12, 21, 30, 40-42, 60, 9x, C1-C7, H5 and comments (00) are not used.

Source: R. L. Ricklefs and C. J. Moore, Consolidated Laser Ranging Data Format, versions 1.01 (2009) and
2.01 (2019).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io.checks import normal_points, read_utc, weather_at
from radioloc.measurements.link import REFLECTORS, Link, canonical_target
from radioloc.measurements.observations import WEATHER_LIMITS, Observations
from radioloc.measurements.registry import TIME_TAGS
from radioloc.text_files import read_lines
from radioloc.vectors import Floats, Mask

_IGNORED_RECORDS = frozenset(
    ["00", "12", "21", "30", "40", "41", "42", "60", "H5"]
    + [f"C{k}" for k in range(1, 8)]
    + [f"9{k}" for k in range(10)]
)
# Minimum number of fields in versions 1 and 2 of the records that are read.
_MIN_FIELD_COUNTS = {
    "H1": (3, 3), "H2": (1, 1), "H3": (6, 8), "H4": (22, 22), "H8": (1, 1), "H9": (1, 1),
    "C0": (4, 4), "11": (12, 13), "20": (5, 5), "50": (3, 3),
}  # fmt: skip
_PASS_RECORDS = ("C0", "11", "20", "50", "H8")
_WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity")
_EVENT_TAGS = {0: TIME_TAGS.index("receive"), 1: TIME_TAGS.index("bounce"), 2: TIME_TAGS.index("transmit")}
_UTC_TIME_SCALES = (3, 4, 7)
_TRANSPONDERS = (3, 4)
_H2 = re.compile(r"H2\s+(\S.*?)\s+(\d{4})\s+(\S+)\s+(\S+)\s+(\d{1,3})(\s.*)?", re.ASCII | re.IGNORECASE)
# Fields of H4 by their places, with the values of two-way normal points in the CRD manual.
_H4_FIELDS = {
    1: ("data type", 1),
    15: ("refraction corrected", 0),
    16: ("centre of mass corrected", 0),
    18: ("system delay applied", 1),
    20: ("range type", 2),
}
# ILRS numbers of reflectors, in the second and third field of H3.
_TARGET_NUMBERS = {"apollo11": 100, "luna17": 101, "apollo14": 102, "apollo15": 103, "luna21": 104}
_MAX_PASS_S = 22.0 * 3600.0  # In a longer pass the day of a second of day is ambiguous
_MAX_DIGIT_COUNT = 10
_PASS_MARGIN_S = 3600.0  # of normal points outside the first and the last range, which H4 states
# Points in order of time this far outside have one possible date: on the day before or after they are 16 h outside.
_MAX_PASS_EXCESS_S = 8.0 * 3600.0


def read_crd(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Observations:
    """Read a CRD file of normal points, plain or gzip; without a catalogue stations keep their pad numbers."""
    return parse_crd(path, read_lines(path), catalogue)


def parse_crd(path: str | Path, lines: Iterable[str], catalogue: StationCatalogue | None) -> Observations:
    """Parse the lines of a CRD file (:func:`read_crd`)."""
    file = _File(catalogue)
    number = 0
    for number, text in enumerate(lines, start=1):
        if text.strip() and text[:2].upper() not in _IGNORED_RECORDS:
            file.take(_Record(path, number, text))
    if not file.ended:
        problem = "the file ends without its end record (H9): it was cut; fetch it again"
        raise FileFormatError(path, problem, number)
    if not file.columns:
        raise FileFormatError(path, "has no pass; fetch it again")
    # Columns are released once they are joined.
    columns = {
        name: np.concatenate([part.pop(name) for part in file.columns]) for name in list(file.columns[0])
    }
    return normal_points(path, file.links, columns)


class _Record:
    """Line of a CRD file, ASCII only."""

    __slots__ = ("fields", "line", "path", "text")

    def __init__(self, path: str | Path, line: int, text: str) -> None:
        self.path, self.line, self.text = path, line, text
        self.fields = text.split()
        if not text.isascii():
            self.fail("expected ASCII characters, as in all records but comments (00)")

    def fail(self, problem: str) -> NoReturn:
        """Raise :class:`FileFormatError` about this record."""
        code = repr(self.text[:2].upper())[1:-1]  # control characters as escapes
        raise FileFormatError(self.path, f"record {code}: {problem}", self.line)

    def number(self, place: int, name: str) -> float:
        """Return the finite number in a field."""
        text = self.fields[place]
        try:
            # float() accepts digits grouped by underscores.
            value = float(text.replace("_", "?"))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.fail(f"{name} is {text!r}, not a number")
        return value

    def optional(self, place: int, name: str) -> float:
        """Return the number in a field, NaN if it is missing (``na`` or -1)."""
        if self.fields[place].lower() == "na":
            return math.nan
        value = self.number(place, name)
        return math.nan if value == -1.0 else value

    def integer(self, place: int, name: str) -> int:
        """Return the whole number in a field."""
        value = self.number(place, name)
        if value != int(value):
            self.fail(f"{name} is {self.fields[place]!r}, not a whole number")
        return int(value)

    def second_of_day(self) -> float:
        """Return the second of day of a data record, which may go on counting after midnight."""
        second = self.number(1, "second of day")
        if not 0.0 <= second < 2.0 * SECONDS_PER_DAY:
            self.fail(f"second of day: expected 0 to 86400, or to 172800 after midnight, got {second:g}")
        return second

    def date(self, place: int) -> tuple[float, float]:
        """Return the Julian date of midnight and seconds since, by six fields from year to second."""
        year, month, day, hour, minute, second = (self.integer(place + k, "date") for k in range(6))
        text = f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}"
        utc = read_utc(self.path, [text], [self.line])
        return float(utc.jd[0]), 3600.0 * hour + 60.0 * minute + second


@dataclass(slots=True)
class _Pass:
    """Content of a pass (H4 to H8) and its headers; times in s since the midnight before its start."""

    line: int
    link: int
    wavelengths_um: dict[str, float]
    jd: float
    start_s: float
    latest_s: float
    # Line, second of day, flight time (s), time tag, number of ranges and RMS (ps), NaN if missing, of records 11.
    points: list[tuple[float, ...]] = field(default_factory=list)
    configurations: list[str] = field(default_factory=list)  # of the points
    # Second of day, pressure, temperature and humidity, NaN if missing, of records 20.
    weather: list[tuple[float, ...]] = field(default_factory=list)
    rms_ps: dict[str, float] = field(default_factory=dict)  # of the whole pass, by configuration

    def day_of(self, second_of_day: Floats) -> Floats:
        """Return the day, counted from the first midnight, whose second of day is nearest the middle of the pass."""
        return np.rint((0.5 * (self.start_s + self.latest_s) - second_of_day) / SECONDS_PER_DAY)

    def columns(self, path: str | Path) -> dict[str, Floats]:
        """Return the columns of the pass, completed by sigma, wavelength and weather from its other records."""
        if not self.points:
            raise FileFormatError(
                path, "the pass that starts here has no normal points (record 11)", self.line
            )
        line, second, flight_s, tag, ranges, rms_ps = np.array(self.points).T
        days = self.day_of(second)
        since_start_s = days * SECONDS_PER_DAY + second

        def refuse(wrong: Mask, problem: str, values: Sequence[object]) -> None:
            if wrong.any():
                first = int(np.argmax(wrong))
                raise FileFormatError(path, f"record 11: {problem.format(values[first])}", int(line[first]))

        excess_s = np.maximum(self.start_s - since_start_s, since_start_s - self.latest_s)
        wrong = excess_s > _PASS_MARGIN_S
        dated = (days >= 0.0) & (days <= self.latest_s // SECONDS_PER_DAY) & (excess_s < _MAX_PASS_EXCESS_S)
        if wrong.any() and dated.all() and (np.diff(since_start_s) >= 0.0).all():
            warnings.warn(
                f"{path}, line {self.line}: points lie up to {excess_s.max() / 3600.0:.1f} h outside the times of H4; "
                "they get the only date that agrees with that of H4 and with their order",
                DataQualityWarning,
                stacklevel=2,
            )
        else:
            problem = f"second of day {{:.3f}} is outside the pass dated by H4 in line {self.line}; correct one of them"
            refuse(wrong, problem, second.tolist())
        session_ps = np.array([self.rms_ps.get(name, math.nan) for name in self.configurations])
        rms_ps = np.where(rms_ps > 0.0, rms_ps, session_ps)
        missing = "no RMS above zero, nor in a record 50 for {!r}; leave the point out"
        refuse(~(rms_ps > 0.0), missing, self.configurations)
        wavelength_um = np.array([self.wavelengths_um.get(name, math.nan) for name in self.configurations])
        missing = "no record C0 gives the wavelength of system configuration {!r}; add it"
        refuse(np.isnan(wavelength_um), missing, self.configurations)
        records = np.array(self.weather, dtype=np.float64).reshape(-1, 1 + len(_WEATHER))
        time_s = records[:, 0] + self.day_of(records[:, 0]) * SECONDS_PER_DAY
        weather = (weather_at(time_s, column, since_start_s) for column in records.T[1:])
        return {
            "line": line,
            "link": np.full(len(line), self.link, dtype=np.float64),
            "jd": self.jd + days,
            "second_of_day": second,
            "flight_s": flight_s,
            "tag": tag,
            "sigma_s": rms_ps * 1e-12 / np.sqrt(ranges),
            "wavelength_um": wavelength_um,
        } | dict(zip(_WEATHER, weather, strict=True))


class _File:
    """State of the parser: headers, current pass and columns of complete passes."""

    def __init__(self, catalogue: StationCatalogue | None) -> None:
        self.links: dict[Link, int] = {}
        self.columns: list[dict[str, Floats]] = []
        self.ended = False
        self._catalogue = catalogue
        self._version = 0
        self._station = self._target = ""
        self._wavelengths_um: dict[str, float] = {}
        self._configured: set[str] = set()  # configurations since the last H4
        self._pass: _Pass | None = None

    def take(self, record: _Record) -> None:
        code, current = record.text[:2].upper(), self._pass
        self._check(record, code, current)
        match code:
            case "H1":
                self._begin(record)
            case "H2":
                self._station = self._station_of(record)
            case "H3":
                self._target = self._target_of(record)
            case "H4":
                self._pass = self._pass_of(record)
            case "C0":
                self._take_wavelength(record)
            case "H9":
                self.ended = True
            case _ if current is None:
                record.fail("stands outside a pass (H4 to H8)")
            case "11":
                self._take_point(record, current)
            case "20":
                self._take_weather(record, current)
            case "50":
                current.rms_ps[record.fields[1]] = record.optional(2, "session RMS (ps)")
            case "H8":
                self.columns.append(current.columns(record.path))
                self._pass = None

    def _check(self, record: _Record, code: str, current: _Pass | None) -> None:
        """Refuse unknown, cut or misplaced records."""
        if code not in _MIN_FIELD_COUNTS:
            full_rate = "full-rate ranges are not read; give normal points"
            record.fail(full_rate if code == "10" else "is not known in CRD; correct or remove it")
        if code != "H1" and (self._version == 0 or self.ended):
            record.fail("stands outside the file's header (H1) and end (H9)")
        if code not in _PASS_RECORDS and current is not None:
            record.fail(f"the pass that starts at line {current.line} has no end (H8): the file was cut")
        min_count, count = _MIN_FIELD_COUNTS[code][self._version == 2], len(record.fields)
        if count < min_count:
            record.fail(f"has {count} of at least {min_count} fields: it was cut; fetch the file again")

    def _begin(self, record: _Record) -> None:
        version = record.integer(2, "format version")
        if record.fields[1].upper() != "CRD" or version not in (1, 2):
            record.fail(f"{' '.join(record.fields[1:3])!r} is not CRD version 1 or 2")
        self._version, self.ended = version, False
        self._station = self._target = ""
        self._wavelengths_um, self._configured = {}, set()

    def _station_of(self, record: _Record) -> str:
        """Return the catalogue name, or the pad number if the catalogue lacks it."""
        match = _H2.fullmatch(record.text)
        if match is None:
            record.fail("expected name, four-digit pad number, system, occupancy, time scale")
        if int(match[5]) not in _UTC_TIME_SCALES:
            allowed = ", ".join(map(str, _UTC_TIME_SCALES))
            record.fail(f"epoch time scale {int(match[5])} is not UTC ({allowed}); convert the epochs to UTC")
        name, pad = match[1], match[2]
        by_name, by_pad = (
            self._catalogue.get(key) if self._catalogue is not None and key in self._catalogue else None
            for key in (name, pad)
        )
        if by_name is not None and by_pad is not None and by_name is not by_pad:
            record.fail(
                f"the name {name!r} belongs to {by_name.name}, the pad number {pad} to {by_pad.name}; correct one of "
                "them"
            )
        if by_name is not None and by_pad is None:
            warnings.warn(
                f"{record.path}, line {record.line}: the catalogue of stations lacks the pad number {pad}; "
                f"the station is {by_name.name} by the name {name!r}",
                DataQualityWarning,
                stacklevel=2,
            )
        return station_name(self._catalogue, pad, name)

    def _target_of(self, record: _Record) -> str:
        # Reflectors have no NORAD number; version 1 leaves its columns blank.
        place = 5 if self._version == 1 and len(record.fields) == 6 else 6
        if record.integer(place, "target class") in _TRANSPONDERS:
            record.fail("the target is a transponder; only reflectors are modelled")
        name = canonical_target(record.fields[1])
        if name not in REFLECTORS:
            record.fail(f"expected a reflector ({', '.join(REFLECTORS)}), got {name!r}")
        for text in record.fields[2:4]:
            number = int(text) if text.isdecimal() and len(text) < _MAX_DIGIT_COUNT else 0
            if number and number != _TARGET_NUMBERS.get(name, number):
                expected = _TARGET_NUMBERS[name]
                record.fail(
                    f"expected the number {expected} of {name}, got {text}; correct the name or the number"
                )
        return name

    def _pass_of(self, record: _Record) -> _Pass:
        """Return the pass that starts with H4."""
        if not self._station or not self._target:
            record.fail("expected station (H2) and target (H3) first")
        for place, (name, expected) in _H4_FIELDS.items():
            if (value := record.integer(place, name)) != expected:
                record.fail(f"expected {name!r} {expected} of normal points, got {value}; leave the pass out")
        if (alert := record.integer(21, "data quality alert")) != 0:
            warnings.warn(
                f"{record.path}, line {record.line}: the station marks this pass as "
                f"{'suspect' if alert == 1 else 'poor'} (data quality alert {alert}); its points are kept",
                DataQualityWarning,
                stacklevel=2,
            )
        jd, start_s = record.date(2)
        latest_s = start_s + _MAX_PASS_S
        if not all(text.lower() in ("na", "0", "00", "0000", "-1") for text in record.fields[8:14]):
            end_jd, end_s = record.date(8)
            lasts_s = end_s + (end_jd - jd) * SECONDS_PER_DAY - start_s
            if end_jd == jd and lasts_s < 0.0:
                warnings.warn(
                    f"{record.path}, line {record.line}: the pass ends {-lasts_s:.0f} s before it begins; its end is "
                    "not used",
                    DataQualityWarning,
                    stacklevel=2,
                )
                lasts_s = 0.0
            if not 0.0 <= lasts_s <= _MAX_PASS_S:
                hours = lasts_s / 3600.0
                record.fail(f"the pass lasts {hours:.2f} h; allowed are 0 to {_MAX_PASS_S / 3600.0:g} h")
            # Equal start and end date the first point only.
            latest_s = start_s + (lasts_s or _MAX_PASS_S)
        self._configured = set()
        link = Link(self._station, self._target, self._station)
        number = self.links.setdefault(link, len(self.links))
        return _Pass(record.line, number, self._wavelengths_um, jd, start_s, latest_s)

    def _take_wavelength(self, record: _Record) -> None:
        wavelength_nm = record.number(2, "wavelength (nm)")
        if not 200.0 <= wavelength_nm <= 20000.0:
            record.fail(f"the wavelength is {wavelength_nm:g} nm, which is not that of a laser")
        name = record.fields[3]
        other_um = self._wavelengths_um[name] if name in self._configured else wavelength_nm / 1000.0
        if wavelength_nm / 1000.0 != other_um:
            record.fail(
                f"system configuration {name!r} has two wavelengths in one pass; give each its own name"
            )
        self._configured.add(name)
        self._wavelengths_um[name] = wavelength_nm / 1000.0

    def _take_point(self, record: _Record, current: _Pass) -> None:
        second = record.second_of_day()
        flight_s = record.number(2, "time of flight (s)")
        event = record.integer(4, "epoch event")
        if event not in _EVENT_TAGS:
            record.fail(f"epoch event {event} is not modelled; 0 (receive), 1 (bounce) and 2 (transmit) are")
        count = record.number(6, "number of ranges")
        if count < 1.0:
            record.fail(f"the number of ranges is {count:g}, but the uncertainty needs at least 1")
        rms_ps = record.optional(7, "bin RMS (ps)")
        current.points.append((record.line, second, flight_s, _EVENT_TAGS[event], count, rms_ps))
        current.configurations.append(record.fields[3])

    def _take_weather(self, record: _Record, current: _Pass) -> None:
        second = record.second_of_day()
        pressure, temperature, percent = (record.optional(2 + k, name) for k, name in enumerate(_WEATHER))
        weather = (pressure, temperature, percent / 100.0)
        for name, value in zip(_WEATHER, weather, strict=True):
            low, high = WEATHER_LIMITS[name]
            if not (math.isnan(value) or low <= value <= high):
                record.fail(f"{name}: expected {low:g} to {high:g}, got {value:g}; correct it or write na")
        current.weather.append((second, *weather))
