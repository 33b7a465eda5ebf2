"""Content of a Tracking Data Message: header, and segments of metadata and columns of data.

Nothing here says what the data mean for a model; it is the content of a file, KVN or XML, with what the standard
demands of it checked.

Source: CCSDS 503.0-B-2 (2020), sections 3.2 to 3.4, tables 3-2, 3-3 and 3-5.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.time import Epochs, epochs_from_strings

LONGEST_S = 86400.0
"""Longest delay, count interval, light time or clock difference that is believed, s."""
_VERSIONS = ("1.0", "2.0")
_TIME_SYSTEMS = ("UTC", "TAI", "TT", "TDB", "GPS")
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


def each(prefix: str) -> tuple[str, ...]:
    """Keywords that have the number of a participant at their end."""
    return tuple(f"{prefix}_{n}" for n in range(1, 6))


# Rules of metadata: value as the file gives it to value in the standard's spelling; ValueError says what is wrong.
_Rule = Callable[[str], str]


def _text(value: str) -> str:
    return " ".join(value.split())


def _one_of(*words: str) -> _Rule:
    def rule(value: str) -> str:
        spelled = {word.upper(): word for word in words}
        word = value.upper().replace(" ", "_")
        if word not in spelled:
            raise ValueError(f"{value!r} is not one of {', '.join(words)}")
        return spelled[word]

    return rule


def _number(
    *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf, whole: bool = False
) -> _Rule:
    def rule(value: str) -> str:
        if re.fullmatch(NUMBER, value, re.ASCII) is None or not math.isfinite(float(value)):
            raise ValueError(f"{value!r} is not a finite number")
        number = float(value)
        if whole and not number.is_integer():
            raise ValueError(f"{value!r} is not a whole number")
        if not number > above:
            raise ValueError(f"{value} must be above zero")
        if number < least:
            raise ValueError(f"{value} must not be negative")
        if number > most:
            raise ValueError(f"{value} must not be longer than a day, in seconds")
        return value

    return rule


def _path(value: str) -> str:
    path = value.replace(" ", "")
    if re.fullmatch(r"[1-5](,[1-5])+", path) is None:
        raise ValueError(f"{value!r} is not a list of participants' numbers such as 1,2,1")
    return path


def _time_system(value: str) -> str:
    if value.upper() not in _TIME_SYSTEMS:
        raise ValueError(f"{value!r} cannot be read; use one of {', '.join(_TIME_SYSTEMS)}")
    return value.upper()


def _date(value: str) -> str:
    try:
        epochs_from_strings(value)
    except InputError as error:
        raise ValueError(str(error)) from None
    return _text(value)


_RATIO = _number(above=0.0, whole=True)
_DELAY = _number(least=0.0, most=LONGEST_S)
METADATA: Mapping[str, _Rule] = {
    "TRACK_ID": _text,
    "DATA_TYPES": _text,
    "TIME_SYSTEM": _time_system,
    "START_TIME": _date,
    "STOP_TIME": _date,
    **dict.fromkeys(each("PARTICIPANT"), _text),
    "MODE": _one_of("SEQUENTIAL", "SINGLE_DIFF"),
    **dict.fromkeys(("PATH", "PATH_1", "PATH_2"), _path),
    # Figure E-17 of the standard itself writes it without a number.
    **dict.fromkeys(("EPHEMERIS_NAME", *each("EPHEMERIS_NAME"), "TRANSMIT_BAND", "RECEIVE_BAND"), _text),
    "TURNAROUND_NUMERATOR": _RATIO,
    "TURNAROUND_DENOMINATOR": _RATIO,
    "TIMETAG_REF": _one_of("TRANSMIT", "RECEIVE"),
    "INTEGRATION_INTERVAL": _number(above=0.0, most=LONGEST_S),
    "INTEGRATION_REF": _one_of("START", "MIDDLE", "END"),
    "FREQ_OFFSET": _number(),
    "RANGE_MODE": _one_of("COHERENT", "CONSTANT", "ONE_WAY"),
    "RANGE_MODULUS": _number(least=0.0),
    "RANGE_UNITS": _one_of("km", "s", "RU"),
    **dict.fromkeys(("ANGLE_TYPE", "REFERENCE_FRAME", "INTERPOLATION", "INTERPOLATION_DEGREE"), _text),
    **dict.fromkeys(("DOPPLER_COUNT_BIAS", "DOPPLER_COUNT_SCALE"), _text),
    "DOPPLER_COUNT_ROLLOVER": _one_of("YES", "NO"),
    **{f"{way}_DELAY_{n}": _DELAY for n in range(1, 6) for way in ("TRANSMIT", "RECEIVE")},
    "DATA_QUALITY": _one_of("RAW", "VALIDATED", "DEGRADED"),
    **{
        f"CORRECTION_{of}": _number()
        for of in (
            *("ANGLE_1", "ANGLE_2", "DOPPLER", "MAG", "RANGE", "RCS", "RECEIVE", "TRANSMIT"),
            *("ABERRATION_YEARLY", "ABERRATION_DIURNAL"),
        )
    },
    "CORRECTIONS_APPLIED": _one_of("YES", "NO"),
}
"""What each keyword of a metadata section may say, in the standard's order."""

WEATHER = {"TEMPERATURE": "temperature_k", "PRESSURE": "pressure_hpa", "RHUMIDITY": "relative_humidity"}
"""Columns of observations by the keyword that fills them."""
CLOCKS = ("CLOCK_BIAS", "CLOCK_DRIFT")
RECEIVED = ("RECEIVE_FREQ", *each("RECEIVE_FREQ"))
SENT, SENT_RATE = each("TRANSMIT_FREQ"), each("TRANSMIT_FREQ_RATE")
NOT_MODELLED = ("DOPPLER_COUNT", *each("RECEIVE_PHASE_CT"), *each("TRANSMIT_PHASE_CT"))
"""Measurements of the path that no observation can be made of."""
RANGE_RATES = ("DOPPLER_INTEGRATED", "DOPPLER_INSTANTANEOUS")
MEASURED = ("RANGE", *RANGE_RATES, *RECEIVED, "VLBI_DELAY", "DOR", *NOT_MODELLED)
"""Measurements of the path."""
_ORDERED = (*MEASURED[: -len(NOT_MODELLED)], *SENT, *SENT_RATE, *CLOCKS, *WEATHER)
_PASSED_OVER = (
    *("ANGLE_1", "ANGLE_2", "CARRIER_POWER", "MAG", "PC_N0"),
    *("PR_N0", "RCS", "STEC", "TROPO_DRY", "TROPO_WET"),
)
DATA = (*_ORDERED, *NOT_MODELLED, *_PASSED_OVER)
"""Keywords of a data section; :attr:`TdmSegment.keyword` holds indices into this."""
CODE = {keyword: code for code, keyword in enumerate(DATA)}


class TdmType(NamedTuple):
    """How a message holds observations of one type, on a path of that type's form.

    ``keywords`` are the data keywords that are read as this type, of which the first is written; ``tags`` are the
    events that TIMETAG_REF may name.
    """

    keywords: tuple[str, ...]
    tags: tuple[str, ...] = ("receive",)


TYPES: Mapping[str, TdmType] = {
    "range": TdmType(("RANGE",), ("transmit", "receive")),
    "doppler": TdmType((*RANGE_RATES, *RECEIVED)),
    "vlbi_delay": TdmType(("VLBI_DELAY", "DOR")),
    "one_way_range": TdmType(("RANGE",), ("transmit", "receive")),
    "one_way_doppler": TdmType((*RANGE_RATES, *RECEIVED)),
}
"""Types of measurement that a message can hold, by name: of delay rates the standard knows nothing."""


def exponent_of(keyword: str, range_units: str) -> int:
    """Power of ten from the standard's unit to ours: km and km/s to m and m/s, percent to parts of one."""
    if keyword == "RANGE":
        return 3 if range_units == "km" else 0
    return {"DOPPLER_INTEGRATED": 3, "DOPPLER_INSTANTANEOUS": 3, "RHUMIDITY": -2}.get(keyword, 0)


@dataclass(frozen=True, slots=True)
class TdmHeader:
    """Who made the message, and when (UTC); ``message_id`` is empty where there is none."""

    creation_date: str
    originator: str
    message_id: str = ""
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TdmSegment:
    """One metadata section and the data it describes.

    Words of the metadata that the standard lists are in its spelling; ``keyword``, shape (n,), holds indices into
    :data:`DATA`. Time tags are UTC, whatever the file's time system. Values are in the standard's units, except that
    kilometres are metres here (RANGE where its unit is km, DOPPLER_*), percent are parts of one: the float nearest
    to the file's decimal number. Lines are those of the file, counted from 1, of metadata keywords by name (``""`` is
    the section's start) and of the records.
    """

    metadata: Mapping[str, str]
    keyword: NDArray[np.int8]
    epoch: Epochs
    value: NDArray[np.float64]
    lines: Mapping[str, int]
    line: NDArray[np.int32]
    comments: tuple[str, ...] = ()
    data_comments: tuple[str, ...] = ()

    def rows(self, keyword: str) -> NDArray[np.intp]:
        """Rows that hold a keyword's data."""
        return np.flatnonzero(self.keyword == CODE[keyword])

    def counts(self) -> dict[str, int]:
        """How many records of each data keyword there are, in the order of :data:`DATA`."""
        counts = np.bincount(self.keyword, minlength=len(DATA)).tolist()
        return {keyword: count for keyword, count in zip(DATA, counts, strict=True) if count}

    def number(self, keyword: str) -> float:
        """Number that a metadata keyword gives, zero where it is not there."""
        return float(self.metadata.get(keyword, 0.0))

    def correction(self, of: str) -> float:
        """Correction of data that is still to be added to them."""
        applied = self.metadata.get("CORRECTIONS_APPLIED") != "NO"
        return 0.0 if applied else self.number(f"CORRECTION_{of}")

    def line_of(self, keyword: str, row: int = 0) -> int:
        """Line of one of a data keyword's records, or of a metadata keyword, or of the section."""
        if keyword in CODE and len(rows := self.rows(keyword)):
            return int(self.line[rows[row]])
        return self.lines.get(keyword, self.lines.get("", 1))


@dataclass(frozen=True, slots=True, eq=False)
class TdmFile:
    """A whole message: the file it came from, its header and its segments in the file's order."""

    path: str
    header: TdmHeader
    segments: tuple[TdmSegment, ...]

    def __len__(self) -> int:
        return sum(len(segment.line) for segment in self.segments)

    def __repr__(self) -> str:
        return f"<TdmFile {self.path}: {len(self.segments)} segment(s), {len(self)} records>"


class Records(NamedTuple):
    """Columns of records, as in :class:`TdmSegment`."""

    keyword: NDArray[np.int8]
    epoch: Epochs
    value: NDArray[np.float64]
    line: NDArray[np.int32]


def checked_header(path: str, version: str, fields: Mapping[str, str], comments: Sequence[str]) -> TdmHeader:
    """Header from its fields; :class:`FileFormatError` where one is missing or wrong."""
    if version not in _VERSIONS:
        known = " and ".join(_VERSIONS)
        raise FileFormatError(path, f"CCSDS_TDM_VERS is {version!r}; versions {known} are read", 1)
    for keyword in ("CREATION_DATE", "ORIGINATOR"):
        if not fields.get(keyword):
            raise FileFormatError(path, f"the header has no {keyword}; add it", 1)
    try:
        _date(fields["CREATION_DATE"])
    except ValueError as error:
        raise FileFormatError(path, f"CREATION_DATE: {error}", 1) from None
    return TdmHeader(
        fields["CREATION_DATE"], fields["ORIGINATOR"], fields.get("MESSAGE_ID", ""), tuple(comments)
    )


def checked_metadata(
    path: str, metadata: Mapping[str, str], lines: Mapping[str, int], before: Sequence[TdmSegment]
) -> dict[str, str]:
    """Metadata of a file in the standard's spelling, after the segments ``before``.

    A :class:`FileFormatError` where a keyword is unknown or missing, a word or number is none that the standard allows,
    a path names a participant that there is not, or the time system is not one that can be read or not the others'.
    """

    def fail(keyword: str, problem: str) -> FileFormatError:
        return FileFormatError(path, problem, lines[keyword])

    made = {}
    for keyword, value in metadata.items():
        if keyword not in METADATA:
            problem = "is not a metadata keyword of the standard; correct or remove it"
            raise fail(keyword, f"{keyword}: {problem}")
        if not value:
            raise fail(keyword, f"{keyword}: has no value; give one or leave the line out")
        try:
            made[keyword] = METADATA[keyword](value)
        except ValueError as error:
            raise fail(keyword, f"{keyword}: {error}") from None
    participants = [keyword for keyword in made if keyword.startswith("PARTICIPANT_")]
    missing = ["TIME_SYSTEM"] * ("TIME_SYSTEM" not in made) + ["PARTICIPANT_1"] * (not participants)
    if missing:
        raise fail("", f"the metadata have no {missing[0]}; add it")
    if before and made["TIME_SYSTEM"] != (first := before[0].metadata["TIME_SYSTEM"]):
        problem = f"TIME_SYSTEM is {made['TIME_SYSTEM']}, but {first} in the segments before"
        raise fail("TIME_SYSTEM", f"{problem}; mixed time systems are not read: write all of them in one")
    for keyword in ("PATH", "PATH_1", "PATH_2"):
        for index in made[keyword].split(",") if keyword in made else ():
            if f"PARTICIPANT_{index}" not in made:
                problem = f"{keyword} = {made[keyword]} names participant {index}"
                there = f"there are only {', '.join(participants)}"
                raise fail(keyword, f"{problem}, but {there}; correct it or add the participant")
    corrections = [keyword for keyword in made if keyword.startswith("CORRECTION_")]
    if corrections and "CORRECTIONS_APPLIED" not in made:
        raise fail(corrections[0], f"{corrections[0]} without CORRECTIONS_APPLIED: say YES or NO")
    return made


def checked_segment(
    path: str,
    parts: Sequence[Records],
    metadata: Mapping[str, str],
    lines: Mapping[str, int],
    **comments: Any,
) -> TdmSegment:
    """Segment from its records; data that are needed must be in order of time, each epoch once (3.4.10, 3.4.11)."""
    segment = TdmSegment(
        metadata=metadata,
        keyword=np.concatenate([part.keyword for part in parts]),
        epoch=Epochs.concatenate([part.epoch for part in parts]),
        value=np.concatenate([part.value for part in parts]),
        lines=lines,
        line=np.concatenate([part.line for part in parts]),
        **comments,
    )
    for keyword in segment.counts():
        if keyword not in _ORDERED:
            continue
        rows = segment.rows(keyword)
        jd, fraction, line = segment.epoch.jd[rows], segment.epoch.fraction[rows], segment.line[rows]
        day = np.diff(jd)
        step = np.where(day == 0.0, np.diff(fraction), day)
        if (step > 0.0).all():
            continue
        place = int(np.argmin(step > 0.0))
        first, second = int(line[place]), int(line[place + 1])
        if step[place] == 0.0:
            problem = f"is there twice at one epoch, first in line {first}; leave one of them out"
        else:
            problem = f"is earlier than that of line {first}; put the records in order of time"
        raise FileFormatError(path, f"{keyword} {problem}", second)
    return segment
