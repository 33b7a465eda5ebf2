"""RANGE of a Tracking Data Message: units, modulus, and whether it is the whole light path or half of it.

The value is taken at its time tag; INTEGRATION_INTERVAL is the count interval of Doppler data and says nothing
of it.

Source: CCSDS 503.0-B-2 (2020), table 3-3 and 3.5.2.7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError
from radioloc.io.checks import FLIGHT_TIME_LIMITS_S, require_lunar_flight_time
from radioloc.io.tdm_agreement import TdmAgreement
from radioloc.io.tdm_file import TdmSegment
from radioloc.io.tdm_frequencies import SentFrequency
from radioloc.io.tdm_keywords import exponent_of

# A light time that is off by more than this part of the modulus does not settle the number of cycles.
_CLEAR_PART = 0.25


class RangeScale(NamedTuple):
    """Metres of whole light path in one unit of a segment's RANGE, and in its modulus and correction."""

    value_m: float
    modulus_m: float
    correction_m: float


def range_scale(
    path: str, segment: TdmSegment, agreement: TdmAgreement, sent: SentFrequency | None
) -> RangeScale:
    """What one unit of RANGE is in a segment.

    Raises
    ------
    FileFormatError
        The unit is RU and its length was not given, or the uplink changes, and with it the unit; or the range is
        said to be one-way.
    """
    if segment.metadata.get("RANGE_MODE") == "ONE_WAY":
        problem = "RANGE_MODE is ONE_WAY, but PATH goes to the target and back; correct one of them"
        raise FileFormatError(path, problem, segment.line_of("RANGE_MODE"))
    units = segment.metadata.get("RANGE_UNITS", "km")
    line = segment.line_of("RANGE_UNITS")
    if units == "RU" and agreement.range_unit_s is None:
        problem = (
            "RANGE_UNITS is RU, whose length is an agreement between the agencies; "
            "give range_unit_s (in a study file tdm_range_unit_s)"
        )
        raise FileFormatError(path, problem, line)
    if units == "RU" and sent is not None and not sent.constant:
        problem = (
            "RANGE_UNITS is RU and the transmitted frequency changes, so that the unit has no one length"
        )
        raise FileFormatError(path, f"{problem}; convert the ranges to km or s", line)
    halves = 2.0 if agreement.range_convention == "half" else 1.0
    unit_m = halves * {"km": 1.0, "s": C_M_S, "RU": C_M_S * (agreement.range_unit_s or 0.0)}[units]
    power = 10.0 ** exponent_of("RANGE", units)
    applied = segment.metadata.get("CORRECTIONS_APPLIED") != "NO"
    correction = 0.0 if applied else segment.number("CORRECTION_RANGE")
    return RangeScale(unit_m, segment.number("RANGE_MODULUS") * power * unit_m, correction * power * unit_m)


def without_ambiguity(
    path: str,
    line: NDArray[np.int32],
    value_m: NDArray[np.float64],
    modulus_m: float,
    light_time_s: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Whole light path from what is known of it but for multiples of the modulus, m, shape (n,).

    Where the modulus is longer than any path between Earth and Moon, the value stands. Else the multiple is the
    one that comes nearest to the light time known beforehand, which must be good to a quarter of the modulus.

    Raises
    ------
    FileFormatError
        No light time was given, or one that does not settle the multiple.
    """
    if modulus_m == 0.0:
        return value_m
    if light_time_s is None:
        longest_m = C_M_S * FLIGHT_TIME_LIMITS_S[1]
        if modulus_m >= longest_m:
            return value_m
        problem = (
            f"RANGE_MODULUS is {modulus_m:.6g} m of light path, so that the range is known but for multiples of it; "
            f"give light_time_s, good to {_CLEAR_PART * modulus_m / C_M_S:.3g} s"
        )
        raise FileFormatError(path, problem, int(line[0]))
    known_m = C_M_S * light_time_s
    whole_m = value_m + modulus_m * np.rint((known_m - value_m) / modulus_m)
    off = np.abs(whole_m - known_m) > _CLEAR_PART * modulus_m
    if off.any():
        row = int(np.argmax(off))
        problem = (
            f"the light time given is {abs(whole_m[row] - known_m[row]):.6g} m from the nearest range "
            f"that RANGE_MODULUS allows, more than a quarter of the modulus ({modulus_m:.6g} m); give a better one"
        )
        raise FileFormatError(path, problem, int(line[row]))
    return whole_m


def require_convention(
    path: str, line: NDArray[np.int32], value_m: NDArray[np.float64], convention: str
) -> None:
    """Recognize, by its factor of two, that ranges are of the other convention than was said.

    Raises
    ------
    FileFormatError
        A range cannot be one between Earth and Moon, but can with the other convention.
    """
    low_m, high_m = (C_M_S * limit for limit in FLIGHT_TIME_LIMITS_S)
    factor, other = (2.0, "half") if convention == "round_trip" else (0.5, "round_trip")
    fits = (value_m > low_m) & (value_m < high_m)
    other_fits = (factor * value_m > low_m) & (factor * value_m < high_m)
    wrong = other_fits & ~fits
    if wrong.any():
        row = int(np.argmax(wrong))
        problem = (
            f"RANGE gives a light path of {value_m[row] / 1000.0:.6g} km, taken as {convention!r}; between Earth "
            f"and Moon there and back it is {low_m / 1000.0:.6g} to {high_m / 1000.0:.6g} km, off by a factor of two: "
            f'set tdm_range = "{other}"'
        )
        raise FileFormatError(path, problem, int(line[row]))


def require_lunar(path: str, line: NDArray[np.int32], value_m: NDArray[np.float64]) -> None:
    """Raise :class:`FileFormatError` for a light path that is none between Earth and Moon and back."""
    low_m, high_m = (C_M_S * limit for limit in FLIGHT_TIME_LIMITS_S)
    wrong = ~((value_m > low_m) & (value_m < high_m))
    if wrong.any():
        row = int(np.argmax(wrong))
        require_lunar_flight_time(path, int(line[row]), float(value_m[row]) / C_M_S)
