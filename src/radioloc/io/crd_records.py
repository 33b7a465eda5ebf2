"""The records of a CRD file, one line each: their fields taken by place and checked.

Source of the fields and codes: R. L. Ricklefs and C. J. Moore, Consolidated Laser Ranging Data Format,
versions 1.01 (2009) and 2.01 (2019).
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import NamedTuple, NoReturn

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io.checks import Catalogue, require_lunar_flight_time, require_year, station_name
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import WEATHER_LIMITS
from radioloc.measurements.targets import REFLECTORS, canonical_target
from radioloc.time.scales import calendar_to_jd

LONGEST_PASS_S = 22.0 * 3600.0
"""A longer pass would leave open which day a second of day belongs to."""

_WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity")
_EVENT_TAGS = {0: TIME_TAGS.index("receive"), 1: TIME_TAGS.index("bounce"), 2: TIME_TAGS.index("transmit")}
_UTC_TIME_SCALES = (3, 4, 7)
_TRANSPONDERS = (3, 4)
_H2 = re.compile(r"H2\s+(\S.*?)\s+(\d{4})\s+(\S+)\s+(\S+)\s+(\d+)(\s.*)?", re.ASCII | re.IGNORECASE)
_H4_FLAGS = (
    "refraction corrected",
    "centre of mass corrected",
    "receive amplitude corrected",
    "system delay applied",
    "spacecraft delay applied",
    "range type",
    "data quality alert",
)
# The CRD manual requires these of normal points.
_H4_WANTED = {"refraction corrected": 0, "centre of mass corrected": 0, "system delay applied": 1}


class Record:
    """One line of a CRD file.

    Raises
    ------
    FileFormatError
        The line holds anything but ASCII.
    """

    __slots__ = ("fields", "line", "path", "text")

    def __init__(self, path: str | Path, line: int, text: str) -> None:
        self.path, self.line, self.text = path, line, text
        self.fields = text.split()
        if not text.isascii():
            self.fail("holds characters that are not ASCII; only comments (00) may")

    def fail(self, problem: str) -> NoReturn:
        """Raise :class:`FileFormatError` about this record."""
        raise FileFormatError(self.path, f"record {self.text[:2].upper()}: {problem}", self.line)

    def need(self, count: int) -> None:
        """Raise unless the record has so many fields."""
        if len(self.fields) < count:
            self.fail(f"has {len(self.fields)} of at least {count} fields: it was cut; fetch the file again")

    def number(self, place: int, what: str) -> float:
        """Finite number in a field."""
        text = self.fields[place]
        try:
            # float() would take digits grouped by underscores.
            value = float(text.replace("_", "?"))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.fail(f"{what} is {text!r}, not a number")
        return value

    def optional(self, place: int, what: str) -> float:
        """Get a number that may be missing, written ``na`` or -1; NaN then."""
        if self.fields[place].lower() == "na":
            return math.nan
        value = self.number(place, what)
        return math.nan if value == -1.0 else value

    def integer(self, place: int, what: str) -> int:
        """Whole number in a field."""
        value = self.number(place, what)
        if value != int(value):
            self.fail(f"{what} is {self.fields[place]!r}, not a whole number")
        return int(value)

    def second_of_day(self) -> float:
        """Second of day that data records start with; after midnight it may go on counting."""
        second = self.number(1, "second of day")
        if not 0.0 <= second < 2.0 * SECONDS_PER_DAY:
            self.fail(f"the second of day is {second:g}, but must be 0 to 86400, or to 172800 after midnight")
        return second

    def date(self, place: int) -> tuple[float, float]:
        """Julian date of midnight and seconds since, of six fields from year to second."""
        year, month, day, hour, minute, second = (self.integer(place + k, "date") for k in range(6))
        require_year(self.path, self.line, year)
        try:
            jd, _ = calendar_to_jd(year, month, day, hour, minute, second)
        except InputError as error:
            self.fail(str(error))
        return jd, 3600.0 * hour + 60.0 * minute + second


class PassDates(NamedTuple):
    """When a pass began and ended (None where it is not said), s since the midnight before it began."""

    jd: float
    start_s: float
    end_s: float | None


class NormalPoint(NamedTuple):
    """Record 11; the RMS is NaN where the record has none."""

    line: int
    second_of_day: float
    flight_time_s: float
    configuration: str
    tag: int
    ranges: float
    rms_ps: float


class Weather(NamedTuple):
    """Record 20; NaN where it says nothing."""

    second_of_day: float
    pressure_hpa: float
    temperature_k: float
    relative_humidity: float


def parse_version(record: Record) -> int:
    """Version, 1 or 2, from H1."""
    record.need(3)
    version = record.integer(2, "format version")
    if record.fields[1].upper() != "CRD" or version not in (1, 2):
        record.fail(f"{' '.join(record.fields[1:3])!r} is not CRD version 1 or 2")
    return version


def parse_station(record: Record, catalogue: Catalogue | None) -> str:
    """Station from H2: its catalogue name, or its pad number where the catalogue does not know it."""
    match = _H2.fullmatch(record.text)
    if match is None:
        record.fail("is not: name, four-digit pad number, system, occupancy, time scale")
    name, pad, time_scale = match[1], match[2], int(match[5])
    if time_scale not in _UTC_TIME_SCALES:
        allowed = ", ".join(map(str, _UTC_TIME_SCALES))
        record.fail(f"epoch time scale {time_scale} is not UTC ({allowed}); convert the epochs to UTC")
    return station_name((pad, name), catalogue)


def parse_target(record: Record, version: int) -> str:
    """Target's canonical name from H3."""
    record.need(7 if version == 1 else 8)
    if record.integer(6, "target class") in _TRANSPONDERS:
        record.fail("the target is a transponder; only reflectors are modelled")
    name = canonical_target(record.fields[1])
    if name not in REFLECTORS:
        record.fail(f"{name!r} is no reflector on the Moon that is known; those are {', '.join(REFLECTORS)}")
    return name


def parse_pass(record: Record) -> PassDates:
    """When the pass was, from H4, once what H4 says of the data has been found usable.

    Warns
    -----
    DataQualityWarning
        The station marks the pass as suspect or poor.
    """
    record.need(22)
    if record.integer(1, "data type") != 1:
        record.fail(f"data type {record.fields[1]} is not normal points (1); give normal points")
    flags = {name: record.integer(15 + k, name) for k, name in enumerate(_H4_FLAGS)}
    for name, wanted in _H4_WANTED.items():
        if flags[name] != wanted:
            record.fail(
                f"{name!r} is {flags[name]}, but normal points must have {wanted}; leave the pass out"
            )
    if flags["range type"] != 2:
        record.fail(f"range type {flags['range type']} is not modelled; only two-way ranges (2) are")
    alert = flags["data quality alert"]
    if alert != 0:
        warnings.warn(
            f"{record.path}, line {record.line}: the station marks this pass as "
            f"{'suspect' if alert == 1 else 'poor'} (data quality alert {alert}); its points are kept",
            DataQualityWarning,
            stacklevel=2,
        )
    jd, start_s = record.date(2)
    if all(text.lower() in ("na", "0", "00", "0000", "-1") for text in record.fields[8:14]):
        return PassDates(jd, start_s, None)
    end_jd, end_s = record.date(8)
    end_s += (end_jd - jd) * SECONDS_PER_DAY
    if not 0.0 <= end_s - start_s <= LONGEST_PASS_S:
        hours = (end_s - start_s) / 3600.0
        record.fail(f"the pass lasts {hours:.2f} h; allowed are 0 to {LONGEST_PASS_S / 3600.0:g} h")
    return PassDates(jd, start_s, end_s)


def parse_wavelength(record: Record) -> tuple[str, float]:
    """System configuration and its wavelength in micrometres, from C0."""
    record.need(4)
    wavelength_nm = record.number(2, "wavelength (nm)")
    low_um, high_um = 0.2, 20.0
    if not low_um <= wavelength_nm / 1000.0 <= high_um:
        record.fail(f"the wavelength is {wavelength_nm:g} nm, which is not that of a laser")
    return record.fields[3], wavelength_nm / 1000.0


def parse_normal_point(record: Record, version: int) -> NormalPoint:
    """Record 11."""
    record.need(12 if version == 1 else 13)
    second = record.second_of_day()
    flight_s = record.number(2, "time of flight (s)")
    require_lunar_flight_time(record.path, record.line, flight_s)
    event = record.integer(4, "epoch event")
    if event not in _EVENT_TAGS:
        record.fail(f"epoch event {event} is not modelled; 0 (receive), 1 (bounce) and 2 (transmit) are")
    count = record.number(6, "number of ranges")
    if count < 1.0:
        record.fail(f"the number of ranges is {count:g}, but the uncertainty needs at least 1")
    rms_ps = record.optional(7, "bin RMS (ps)")
    return NormalPoint(record.line, second, flight_s, record.fields[3], _EVENT_TAGS[event], count, rms_ps)


def parse_weather(record: Record) -> Weather:
    """Record 20."""
    record.need(5)
    second = record.second_of_day()
    pressure, temperature, percent = (record.optional(2 + k, name) for k, name in enumerate(_WEATHER))
    weather = Weather(second, pressure, temperature, percent / 100.0)
    for name, value in zip(_WEATHER, weather[1:], strict=True):
        low, high = WEATHER_LIMITS[name]
        if not (math.isnan(value) or low <= value <= high):
            record.fail(f"{name} is {value:g}, but must be {low:g} to {high:g}; correct it or write na")
    return weather


def parse_session_rms(record: Record) -> tuple[str, float]:
    """System configuration and the RMS of the whole pass in ps, from record 50; NaN where there is none."""
    record.need(3)
    return record.fields[1], record.optional(2, "session RMS (ps)")
