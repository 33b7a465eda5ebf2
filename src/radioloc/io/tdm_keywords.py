"""Keywords of the CCSDS Tracking Data Message: which there are, in which unit, and what they may say.

Source: CCSDS 503.0-B-2 (2020), tables 3-2, 3-3 and 3-5.
"""

from __future__ import annotations

from itertools import chain

PARTICIPANTS = (1, 2, 3, 4, 5)


def _each(prefix: str) -> list[str]:
    return [f"{prefix}_{n}" for n in PARTICIPANTS]


METADATA = (
    "TRACK_ID",
    "DATA_TYPES",
    "TIME_SYSTEM",
    "START_TIME",
    "STOP_TIME",
    *_each("PARTICIPANT"),
    "MODE",
    "PATH",
    "PATH_1",
    "PATH_2",
    # Figure E-17 of the standard itself writes it without a number.
    "EPHEMERIS_NAME",
    *_each("EPHEMERIS_NAME"),
    "TRANSMIT_BAND",
    "RECEIVE_BAND",
    "TURNAROUND_NUMERATOR",
    "TURNAROUND_DENOMINATOR",
    "TIMETAG_REF",
    "INTEGRATION_INTERVAL",
    "INTEGRATION_REF",
    "FREQ_OFFSET",
    "RANGE_MODE",
    "RANGE_MODULUS",
    "RANGE_UNITS",
    "ANGLE_TYPE",
    "REFERENCE_FRAME",
    "INTERPOLATION",
    "INTERPOLATION_DEGREE",
    "DOPPLER_COUNT_BIAS",
    "DOPPLER_COUNT_SCALE",
    "DOPPLER_COUNT_ROLLOVER",
    *chain.from_iterable((f"TRANSMIT_DELAY_{n}", f"RECEIVE_DELAY_{n}") for n in PARTICIPANTS),
    "DATA_QUALITY",
    "CORRECTION_ANGLE_1",
    "CORRECTION_ANGLE_2",
    "CORRECTION_DOPPLER",
    "CORRECTION_MAG",
    "CORRECTION_RANGE",
    "CORRECTION_RCS",
    "CORRECTION_RECEIVE",
    "CORRECTION_TRANSMIT",
    "CORRECTION_ABERRATION_YEARLY",
    "CORRECTION_ABERRATION_DIURNAL",
    "CORRECTIONS_APPLIED",
)
"""Keywords of a metadata section, in the standard's order."""

CHOICES = {
    "MODE": ("SEQUENTIAL", "SINGLE_DIFF"),
    "TIMETAG_REF": ("TRANSMIT", "RECEIVE"),
    "INTEGRATION_REF": ("START", "MIDDLE", "END"),
    "RANGE_MODE": ("COHERENT", "CONSTANT", "ONE_WAY"),
    "RANGE_UNITS": ("km", "s", "RU"),
    "DOPPLER_COUNT_ROLLOVER": ("YES", "NO"),
    "DATA_QUALITY": ("RAW", "VALIDATED", "DEGRADED"),
    "CORRECTIONS_APPLIED": ("YES", "NO"),
}
"""Metadata that say one of a few words."""

ABOVE_ZERO = frozenset(["INTEGRATION_INTERVAL", "TURNAROUND_NUMERATOR", "TURNAROUND_DENOMINATOR"])
NOT_NEGATIVE = frozenset(["RANGE_MODULUS", *_each("TRANSMIT_DELAY"), *_each("RECEIVE_DELAY")])
LONGEST_S = 86400.0
"""Longest delay, count interval, light time or clock difference that is believed, s."""

AT_MOST_A_DAY = frozenset(["INTEGRATION_INTERVAL", *_each("TRANSMIT_DELAY"), *_each("RECEIVE_DELAY")])
NUMBERS = frozenset(
    [*ABOVE_ZERO, *NOT_NEGATIVE, "FREQ_OFFSET", *(k for k in METADATA if k.startswith("CORRECTION_"))]
)
"""Metadata that are numbers."""

WHOLE_NUMBERS = frozenset(["TURNAROUND_NUMERATOR", "TURNAROUND_DENOMINATOR"])

PATHS = ("PATH", "PATH_1", "PATH_2")

TIME_SYSTEMS = ("UTC", "TAI", "TT", "TDB", "GPS")
"""Time systems that can be turned into UTC without Earth orientation or a spacecraft's clock."""

WEATHER = ("TEMPERATURE", "PRESSURE", "RHUMIDITY")
CLOCKS = ("CLOCK_BIAS", "CLOCK_DRIFT")
DELAYS = ("VLBI_DELAY", "DOR")
RANGE_RATES = ("DOPPLER_INTEGRATED", "DOPPLER_INSTANTANEOUS")
RECEIVED = ("RECEIVE_FREQ", *_each("RECEIVE_FREQ"))
SENT = tuple(_each("TRANSMIT_FREQ"))
SENT_RATE = tuple(_each("TRANSMIT_FREQ_RATE"))
NOT_MODELLED = ("DOPPLER_COUNT", *_each("RECEIVE_PHASE_CT"), *_each("TRANSMIT_PHASE_CT"))
"""Measurements of the path that no observation can be made of."""

MEASURED = ("RANGE", *RANGE_RATES, *RECEIVED, *DELAYS, *NOT_MODELLED)
"""Measurements of the path."""

ORDERED = ("RANGE", *RANGE_RATES, *DELAYS, *RECEIVED, *SENT, *SENT_RATE, *CLOCKS, *WEATHER)
"""Data that observations are made of or need: their epochs must be in order, each once."""

IGNORED = (
    "ANGLE_1",
    "ANGLE_2",
    "CARRIER_POWER",
    "MAG",
    "PC_N0",
    "PR_N0",
    "RCS",
    "STEC",
    "TROPO_DRY",
    "TROPO_WET",
)
"""Data that say nothing which the models use."""

DATA = (*ORDERED, *NOT_MODELLED, *IGNORED)
"""Keywords of a data section; :attr:`radioloc.io.tdm_file.TdmSegment.keyword` holds indices into this."""

CODE = {keyword: code for code, keyword in enumerate(DATA)}
"""Index of each data keyword in :data:`DATA`."""

EXPONENTS = {"DOPPLER_INTEGRATED": 3, "DOPPLER_INSTANTANEOUS": 3, "RHUMIDITY": -2}
"""Power of ten from the standard's unit to the one used here: km/s to m/s, percent to parts of one."""


def exponent_of(keyword: str, range_units: str) -> int:
    """Power of ten that turns a data value into the unit used here; a range in km becomes metres."""
    if keyword == "RANGE":
        return 3 if range_units == "km" else 0
    return EXPONENTS.get(keyword, 0)
