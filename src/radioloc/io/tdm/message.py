"""Content of a Tracking Data Message: keywords, header, and segments of metadata and columns of data.

The rules of the standard are checked, and columns of text become numbers, a million in a second. The interpretation
of the data for the model is in :mod:`radioloc.io.tdm.meaning`.

Source: CCSDS 503.0-B-2 (2020), sections 3.2 to 3.4 and 4.3.9, tables 3-3 and 3-5.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.io.frequencies import MAX_DURATION_S
from radioloc.time import Epochs, epochs_from_strings, to_scale, utc_to_tai
from radioloc.time.dates import DateError, read_dates
from radioloc.vectors import Floats, Indices

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# Functions from a value of the file to the standard's spelling; ValueError for one that is not allowed.
_Rule = Callable[[str], str]


def _numbered(prefix: str) -> tuple[str, ...]:
    """Return keywords with the number of a participant at their end."""
    return tuple(f"{prefix}_{n}" for n in range(1, 6))


def _text(value: str) -> str:
    return " ".join(value.split())


def _one_of(*words: str) -> _Rule:
    def rule(value: str) -> str:
        spelled = {word.upper(): word for word in words}
        word = value.upper().replace(" ", "_")
        if word not in spelled:
            raise ValueError(f"expected one of {', '.join(words)}, got {value!r}")
        return spelled[word]

    return rule


def _number(allowed: Callable[[float], bool] = math.isfinite, rule: str = "a finite number") -> _Rule:
    def check(value: str) -> str:
        if re.fullmatch(NUMBER, value, re.ASCII) is None or not allowed(float(value)):
            raise ValueError(f"expected {rule}, got {value!r}")
        return value

    return check


def _path(value: str) -> str:
    path = value.replace(" ", "")
    if re.fullmatch(r"[1-5](,[1-5])+", path) is None:
        raise ValueError(f"expected numbers of participants such as 1,2,1, got {value!r}")
    return path


def date(value: str) -> str:
    """Return a text that is a date."""
    epochs_from_strings(value, "UTC")
    return _text(value)


_RATIO = _number(lambda ratio: ratio > 0.0 and ratio.is_integer(), "a whole number above zero")
_DELAY = _number(lambda delay_s: 0.0 <= delay_s <= MAX_DURATION_S, "a number from zero to a day, in seconds")
_COUNT = _number(
    lambda count_s: 0.0 < count_s <= MAX_DURATION_S, "a number above zero, up to a day, in seconds"
)
METADATA: Mapping[str, _Rule] = {
    "TRACK_ID": _text,
    "DATA_TYPES": _text,
    "TIME_SYSTEM": _one_of("UTC", "TAI", "TT", "TDB", "GPS"),
    "START_TIME": date,
    "STOP_TIME": date,
    **dict.fromkeys(_numbered("PARTICIPANT"), _text),
    "MODE": _one_of("SEQUENTIAL", "SINGLE_DIFF"),
    **dict.fromkeys(("PATH", "PATH_1", "PATH_2"), _path),
    # Figure E-17 of the standard itself writes it without a number.
    **dict.fromkeys(("EPHEMERIS_NAME", *_numbered("EPHEMERIS_NAME"), "TRANSMIT_BAND", "RECEIVE_BAND"), _text),
    "TURNAROUND_NUMERATOR": _RATIO,
    "TURNAROUND_DENOMINATOR": _RATIO,
    "TIMETAG_REF": _one_of("TRANSMIT", "RECEIVE"),
    "INTEGRATION_INTERVAL": _COUNT,
    "INTEGRATION_REF": _one_of("START", "MIDDLE", "END"),
    "FREQ_OFFSET": _number(),
    "RANGE_MODE": _one_of("COHERENT", "CONSTANT", "ONE_WAY"),
    "RANGE_MODULUS": _number(lambda modulus: 0.0 <= modulus < math.inf, "zero or a number above it"),
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
"""Rules of the keywords of a metadata section, in the standard's order."""

WEATHER = {"TEMPERATURE": "temperature_k", "PRESSURE": "pressure_hpa", "RHUMIDITY": "relative_humidity"}
"""Columns of observations by the keyword that fills them."""
CLOCKS = ("CLOCK_BIAS", "CLOCK_DRIFT")
RECEIVED = ("RECEIVE_FREQ", *_numbered("RECEIVE_FREQ"))
SENT, SENT_RATE = _numbered("TRANSMIT_FREQ"), _numbered("TRANSMIT_FREQ_RATE")
NOT_MODELLED = ("DOPPLER_COUNT", *_numbered("RECEIVE_PHASE_CT"), *_numbered("TRANSMIT_PHASE_CT"))
"""Measurements of the path that are not modelled."""
RANGE_RATES = ("DOPPLER_INTEGRATED", "DOPPLER_INSTANTANEOUS")
MEASURED = ("RANGE", *RANGE_RATES, *RECEIVED, "VLBI_DELAY", "DOR", *NOT_MODELLED)
"""Measurements of the path."""
ORDERED = (*MEASURED[: -len(NOT_MODELLED)], *SENT, *SENT_RATE, *CLOCKS, *WEATHER)
"""Data that are used and must be in order of time."""
_IGNORED = (
    *("ANGLE_1", "ANGLE_2", "CARRIER_POWER", "MAG", "PC_N0"),
    *("PR_N0", "RCS", "STEC", "TROPO_DRY", "TROPO_WET"),
)
DATA = (*ORDERED, *NOT_MODELLED, *_IGNORED)
"""Keywords of a data section; :attr:`TdmSegment.keyword` holds indices into this."""
CODE = {keyword: code for code, keyword in enumerate(DATA)}


_DOPPLER = (*RANGE_RATES, *RECEIVED)
TYPES: Mapping[str, tuple[str, ...]] = {
    "range": ("RANGE",),
    "doppler": _DOPPLER,
    "vlbi_delay": ("VLBI_DELAY", "DOR"),
    "one_way_range": ("RANGE",),
    "one_way_doppler": _DOPPLER,
    "differenced_range": ("RANGE",),
    "differenced_doppler": (*RANGE_RATES, "RECEIVE_FREQ"),
}
"""Data keywords that are read as a type of measurement on a path of its form; the first of them is written.

The standard lacks delay rates. TIMETAG_REF is RECEIVE of all but RANGE.
"""


def unit_exponent(keyword: str, range_units: str) -> int:
    """Return the power of ten from the standard's unit to SI: km and km/s to m and m/s, percent to parts of one."""
    if keyword == "RANGE":
        return 3 if range_units == "km" else 0
    return {"DOPPLER_INTEGRATED": 3, "DOPPLER_INSTANTANEOUS": 3, "RHUMIDITY": -2}.get(keyword, 0)


_VERSIONS = ("1.0", "2.0")
_SPAN_SLACK_S = 1.0
_GPS_MINUS_TAI_S = -19.0  # exact (IS-GPS-200)
_YEARS_JD = (2441683.5, 2488434.5)  # 1973 to 2100: corrected time tags stay in the years of UTC


@dataclass(frozen=True, slots=True)
class TdmHeader:
    """Creation date (UTC) and originating agency of a message."""

    creation_date: str
    originator: str
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TdmSegment:
    """Metadata section with its data."""

    path: str
    metadata: Mapping[str, str]  # in the spelling of the standard
    keyword: NDArray[np.int8]  # indices into DATA
    epoch: Epochs  # UTC, whatever the file's time system
    # In the standard's units, but m for km (RANGE, DOPPLER_*) and parts of one for percent: the nearest float.
    value: Floats
    lines: Mapping[str, int]  # of the file, of metadata keywords; "" is the section's start
    line: NDArray[np.int32]  # of the records
    comments: tuple[str, ...] = ()
    data_comments: tuple[str, ...] = ()

    def rows(self, keyword: str) -> Indices:
        """Return the rows of a keyword."""
        return np.flatnonzero(self.keyword == CODE[keyword])

    def values(self, keyword: str) -> Floats:
        """Return the values of a keyword's records."""
        return self.value[self.rows(keyword)]

    def epochs(self, keyword: str) -> Epochs:
        """Return the time tags of a keyword's records."""
        return self.epoch[self.rows(keyword)]

    def counts(self) -> dict[str, int]:
        """Return the number of records by data keyword, in the order of :data:`DATA`."""
        counts = np.bincount(self.keyword, minlength=len(DATA)).tolist()
        return {keyword: count for keyword, count in zip(DATA, counts, strict=True) if count}

    def participant(self, number: int) -> str:
        """Return the name of a participant in the file."""
        return self.metadata[f"PARTICIPANT_{number}"]

    def legs(self, keyword: str = "PATH") -> list[int]:
        """Return the participants of a path in order; empty for a missing path."""
        return [int(number) for number in self.metadata.get(keyword, "").split(",") if number]

    def number(self, keyword: str) -> float:
        """Return the number of a metadata keyword, zero where it is missing."""
        return float(self.metadata.get(keyword, 0.0))

    def correction(self, of: str) -> float:
        """Return the correction that is not applied to the data."""
        applied = self.metadata.get("CORRECTIONS_APPLIED") != "NO"
        return 0.0 if applied else self.number(f"CORRECTION_{of}")

    def line_of(self, keyword: str, row: int = 0) -> int:
        """Return the line of one of a data keyword's records, or of a metadata keyword, or of the section."""
        if keyword in CODE and len(rows := self.rows(keyword)):
            return int(self.line[rows[row]])
        return self.lines.get(keyword, self.lines.get("", 1))

    def fail(self, keyword: str, problem: str, row: int = 0) -> FileFormatError:
        """Return the error at the line of :meth:`line_of`."""
        return FileFormatError(self.path, problem, self.line_of(keyword, row))


@dataclass(frozen=True, slots=True, eq=False)
class TdmFile:
    """Message with the path of its file, its header and its segments in the order of the file."""

    path: str
    header: TdmHeader
    segments: tuple[TdmSegment, ...]

    def __len__(self) -> int:
        return sum(len(segment.line) for segment in self.segments)

    def __repr__(self) -> str:
        return f"<TdmFile {self.path}: {len(self.segments)} segment(s), {len(self)} records>"


def read_header(path: str, fields: dict[str, str], comments: Sequence[str]) -> TdmHeader:
    """Return the header of its keywords, among them the version."""
    version = fields.pop("CCSDS_TDM_VERS", "")
    if version not in _VERSIONS:
        raise FileFormatError(path, f"expected CCSDS_TDM_VERS {' or '.join(_VERSIONS)}, got {version!r}", 1)
    for keyword in ("CREATION_DATE", "ORIGINATOR"):
        if not fields.get(keyword):
            raise FileFormatError(path, f"{keyword} is missing in the header; add it", 1)
    try:
        date(fields["CREATION_DATE"])
    except ValueError as error:
        raise FileFormatError(path, f"CREATION_DATE: {error}", 1) from None
    return TdmHeader(fields["CREATION_DATE"], fields["ORIGINATOR"], tuple(comments))


def read_metadata(
    path: str, fields: Mapping[str, str], lines: Mapping[str, int], segments: Sequence[TdmSegment]
) -> dict[str, str]:
    """Return the metadata of a segment after others in the spelling of the standard."""

    def fail(problem: str, keyword: str = "") -> FileFormatError:
        return FileFormatError(path, problem, lines[keyword])

    metadata: dict[str, str] = {}
    for keyword, value in fields.items():
        if keyword not in METADATA:
            raise fail(
                f"expected a metadata keyword of the standard, got {keyword}; correct or remove it", keyword
            )
        if not value:
            raise fail(f"{keyword}: expected a value, got none; give one or leave the line out", keyword)
        try:
            metadata[keyword] = METADATA[keyword](value)
        except ValueError as error:
            raise fail(f"{keyword}: {error}", keyword) from None
    participants = [keyword for keyword in metadata if keyword.startswith("PARTICIPANT_")]
    if "TIME_SYSTEM" not in metadata or not participants:
        needed = "PARTICIPANT_1" if "TIME_SYSTEM" in metadata else "TIME_SYSTEM"
        raise fail(f"{needed} is missing in the metadata; add it")
    first = segments[0].metadata["TIME_SYSTEM"] if segments else metadata["TIME_SYSTEM"]
    if metadata["TIME_SYSTEM"] != first:
        problem = f"expected TIME_SYSTEM {first} of the first segment, got {metadata['TIME_SYSTEM']}"
        raise fail(f"{problem}; use one time system", "TIME_SYSTEM")
    for keyword in ("PATH", "PATH_1", "PATH_2"):
        for index in metadata[keyword].split(",") if keyword in metadata else ():
            if f"PARTICIPANT_{index}" not in metadata:
                problem = f"{keyword} = {metadata[keyword]}: expected {', '.join(participants)}"
                raise fail(f"{problem}, got participant {index}; correct it or add the participant", keyword)
    corrections = [keyword for keyword in metadata if keyword.startswith("CORRECTION_")]
    if corrections and "CORRECTIONS_APPLIED" not in metadata:
        raise fail(f"{corrections[0]} needs CORRECTIONS_APPLIED = YES or NO; add it", corrections[0])
    return metadata


def require_sound(segment: TdmSegment) -> None:
    """Refuse used data that are not in order of time, each epoch once (3.4.10, 3.4.11), or outside their span."""
    for name in segment.counts():
        if name in ORDERED:
            _require_order(segment, name)
        if name in MEASURED:
            _require_span(segment, name)


def _require_order(segment: TdmSegment, keyword: str) -> None:
    epoch = segment.epochs(keyword)
    day = np.diff(epoch.jd)
    step = np.where(day == 0.0, np.diff(epoch.fraction), day)
    sound = step >= 0.0 if keyword in RECEIVED else step > 0.0
    if sound.all():
        return
    place = int(np.argmin(sound))
    first = segment.line_of(keyword, place)
    if step[place] == 0.0:
        problem = f"repeats the epoch of line {first}; leave one of them out"
    else:
        problem = f"precedes that of line {first}; put the records in order of time"
    raise segment.fail(keyword, f"{keyword} {problem}", place + 1)


def _require_span(segment: TdmSegment, keyword: str) -> None:
    """Refuse measurements outside START_TIME and STOP_TIME, which may be rounded or ends of count intervals."""
    slack_s = _SPAN_SLACK_S + segment.number("INTEGRATION_INTERVAL")
    for limit, sign in (("START_TIME", 1.0), ("STOP_TIME", -1.0)):
        if limit not in segment.metadata:
            continue
        system = segment.metadata["TIME_SYSTEM"]
        try:
            bound = epochs_from_strings(segment.metadata[limit], "TAI" if system == "GPS" else system)
            bound_utc = _utc(bound, system)
        except InputError as error:
            raise segment.fail(limit, f"{limit}: {error}") from None
        inside_s = sign * utc_to_tai(segment.epochs(keyword)).seconds_since(utc_to_tai(bound_utc))
        if (inside_s < -slack_s).any():
            row = int(np.argmax(inside_s < -slack_s))
            problem = f"{keyword} is {-inside_s[row]:.6g} s outside of {limit} = {segment.metadata[limit]}"
            raise segment.fail(keyword, f"{problem}; correct one of them", row)


def _utc(epoch: Epochs, time_system: str) -> Epochs:
    """Return epochs of a message's time system (GPS epochs as TAI) as UTC."""
    return to_scale(epoch.shifted(-_GPS_MINUS_TAI_S) if time_system == "GPS" else epoch, "UTC")


def read_records(
    path: str,
    keywords: Any,
    epochs: Any,
    values: Any,
    line: NDArray[np.int32],
    *,
    time_system: str,
    range_units: str,
) -> tuple[NDArray[np.int8], Epochs, Floats]:
    """Return codes of keywords, epochs (UTC) and values, the floats nearest to the numbers times a power of ten."""
    import pyarrow as pa
    import pyarrow.compute as pc

    def refuse(wrong: Any, texts: Any, problem: str) -> None:
        wrong = np.asarray(wrong)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise FileFormatError(path, f"{texts[row].as_py()!r}{problem}", int(line[row]))

    keywords, epochs, values = (pa.array(column, pa.string()) for column in (keywords, epochs, values))
    code = pc.index_in(keywords, value_set=pa.array(DATA))
    refuse(code.is_null(), keywords, ": expected a data keyword of the standard; correct or remove it")
    codes = code.to_numpy().astype(np.int8)

    try:
        epoch = read_dates(
            epochs.to_numpy(zero_copy_only=False), "TAI" if time_system == "GPS" else time_system
        )
    except DateError as error:
        raise FileFormatError(path, str(error), int(line[error.row])) from None
    refuse(
        (epoch.jd < _YEARS_JD[0]) | (epoch.jd >= _YEARS_JD[1]), epochs, ": expected a year from 1973 to 2100"
    )
    if time_system != "UTC":
        refuse(pc.ends_with(epochs, "Z"), epochs, f" ends in Z (UTC), but TIME_SYSTEM is {time_system}")

    not_finite = ": expected a finite number; correct it or leave the record out"
    refuse(pc.invert(pc.match_substring_regex(values, f"^{NUMBER}$")), values, not_finite)
    exponent = np.array([unit_exponent(keyword, range_units) for keyword in DATA])[codes]
    numbers = _scaled(values, exponent)
    refuse(~np.isfinite(numbers), values, not_finite)
    return codes, _utc(epoch, time_system), numbers


def _scaled(texts: Any, exponent: NDArray[np.int64]) -> Floats:
    """Return decimal numbers times powers of ten."""
    import pyarrow as pa
    import pyarrow.compute as pc

    has_exponent = np.asarray(pc.match_substring_regex(texts, "[eE]"))
    if (has_exponent & (exponent != 0)).any():
        parts = (text.upper().partition("E") for text in texts.to_pylist())
        texts = pa.array(
            [f"{m}E{int(e or 0) + k}" for (m, _, e), k in zip(parts, exponent.tolist(), strict=True)]
        )
    elif exponent.any():
        suffixes = pa.array([f"E{k}" if k else "" for k in range(-2, 4)])
        texts = pc.binary_join_element_wise(texts, suffixes.take(pa.array(exponent + 2)), "")
    numbers: Floats = pc.cast(texts, pa.float64()).to_numpy()
    return numbers
