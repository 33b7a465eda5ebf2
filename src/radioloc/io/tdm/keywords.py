"""Keywords of a Tracking Data Message: what metadata may say, which data there are, what observations are held as.

Source: CCSDS 503.0-B-2 (2020), tables 3-3 and 3-5.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from radioloc.errors import InputError
from radioloc.io.frequencies import LONGEST_S
from radioloc.time import epochs_from_strings

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TIME_SYSTEMS = ("UTC", "TAI", "TT", "TDB", "GPS")
# Value as the file gives it to value in the standard's spelling; ValueError says what is wrong.
_Rule = Callable[[str], str]


def _each(prefix: str) -> tuple[str, ...]:
    """Keywords that have the number of a participant at their end."""
    return tuple(f"{prefix}_{n}" for n in range(1, 6))


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


COLON_FRACTION = r"^(.*T\d\d:\d\d:\d\d):(\d+Z?)$"
"""A date of which a colon stands before the parts of a second, as some write it; groups are what a point joins."""


def date(value: str) -> str:
    """Rule of a date."""
    value = re.sub(COLON_FRACTION, r"\1.\2", value)
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
    "START_TIME": date,
    "STOP_TIME": date,
    **dict.fromkeys(_each("PARTICIPANT"), _text),
    "MODE": _one_of("SEQUENTIAL", "SINGLE_DIFF"),
    **dict.fromkeys(("PATH", "PATH_1", "PATH_2"), _path),
    # Figure E-17 of the standard itself writes it without a number.
    **dict.fromkeys(("EPHEMERIS_NAME", *_each("EPHEMERIS_NAME"), "TRANSMIT_BAND", "RECEIVE_BAND"), _text),
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
RECEIVED = ("RECEIVE_FREQ", *_each("RECEIVE_FREQ"))
SENT, SENT_RATE = _each("TRANSMIT_FREQ"), _each("TRANSMIT_FREQ_RATE")
NOT_MODELLED = ("DOPPLER_COUNT", *_each("RECEIVE_PHASE_CT"), *_each("TRANSMIT_PHASE_CT"))
"""Measurements of the path that no observation can be made of."""
RANGE_RATES = ("DOPPLER_INTEGRATED", "DOPPLER_INSTANTANEOUS")
MEASURED = ("RANGE", *RANGE_RATES, *RECEIVED, "VLBI_DELAY", "DOR", *NOT_MODELLED)
"""Measurements of the path."""
ORDERED = (*MEASURED[: -len(NOT_MODELLED)], *SENT, *SENT_RATE, *CLOCKS, *WEATHER)
"""Data that are used, and so must be in order of time."""
_PASSED_OVER = (
    *("ANGLE_1", "ANGLE_2", "CARRIER_POWER", "MAG", "PC_N0"),
    *("PR_N0", "RCS", "STEC", "TROPO_DRY", "TROPO_WET"),
)
DATA = (*ORDERED, *NOT_MODELLED, *_PASSED_OVER)
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

Of delay rates the standard knows nothing. TIMETAG_REF is RECEIVE of all but RANGE.
"""


def exponent_of(keyword: str, range_units: str) -> int:
    """Power of ten from the standard's unit to ours: km and km/s to m and m/s, percent to parts of one."""
    if keyword == "RANGE":
        return 3 if range_units == "km" else 0
    return {"DOPPLER_INTEGRATED": 3, "DOPPLER_INSTANTANEOUS": 3, "RHUMIDITY": -2}.get(keyword, 0)
