"""UTC dates in bulk and to the last bit: text to epochs and back, seconds of day to epochs.

A UTC epoch is a fraction of a day that lasts 86401 s where a leap second ends it. Whole seconds and parts
of a second are kept apart on the way, so that text with picoseconds gives the nearest epoch that two floats
can hold.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import InputError
from radioloc.io.csv_columns import Cells, digits, two_digits
from radioloc.io.fields import POWERS, Fields, NotPlainError
from radioloc.time import Epochs, epochs_from_strings, utc_to_tai

_FULL_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d):(\d\d):(\d\d)(\.\d*)?Z?", re.ASCII)
_JD_1972 = 2441317.5
_JD_1970 = 2440587.5
# Half of a double's bits: a fraction cut here and a whole number of seconds multiply without rounding.
_SPLIT = float(2**26)
_PICOSECONDS = 10**12
# Characters of yyyy-mm-ddThh:mm:ss, and those between its numbers.
_TIME_OF_DAY_END = 19
_MARKS = {4: "-", 7: "-", 10: "T", 13: ":", 16: ":"}
_DIGITS = [k for k in range(_TIME_OF_DAY_END) if k not in _MARKS]
_DATE = np.dtype(
    [
        ("day", "S10"),
        ("T", "u1"),
        ("hour", "u2"),
        (":", "u1"),
        ("minute", "u2"),
        ("::", "u1"),
        ("second", "u2"),
        (".", "u1"),
        ("part", "u4", (3,)),
    ]
)
# Decimals whose integer is a float, so that dividing rounds once.
_EXACT_DECIMALS = 15


def day_lengths_s(jd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Length of UTC days, s.

    Parameters
    ----------
    jd : ndarray, shape (n,)
        Julian dates of the midnights that begin them.

    Raises
    ------
    InputError
        A day lies before 1972, when UTC had another rate.
    """
    days, inverse = np.unique(jd, return_inverse=True)
    if len(days) and days[0] < _JD_1972:
        early = Epochs.from_jd(days[0], 0.0, "UTC").day_strings()[0]
        raise InputError(f"{early} is before 1972, when UTC had another rate than TAI; leave such data out")
    start = utc_to_tai(Epochs.from_jd(days, 0.0, "UTC"))
    end = utc_to_tai(Epochs.from_jd(days + 1.0, 0.0, "UTC"))
    return np.round(end.seconds_since(start))[inverse]


def utc_from_seconds_of_day(jd: NDArray[np.float64], seconds: NDArray[np.float64]) -> Epochs:
    """Epochs from midnights and seconds of day; seconds past the day's end belong to the next day.

    Parameters
    ----------
    jd : ndarray, shape (n,)
        Julian dates of the midnights.
    seconds : ndarray, shape (n,)
        UTC seconds since then, from 0 to less than two days.
    """
    length_s = day_lengths_s(jd)
    over = seconds >= length_s
    jd = jd + over
    return Epochs.from_jd(jd, (seconds - np.where(over, length_s, 0.0)) / day_lengths_s(jd), "UTC")


def utc_from_text(texts: list[str]) -> Epochs:
    """Read dates such as ``2020-12-01T15:11:00.250000000001``.

    Parameters
    ----------
    texts : list of str
        Dates with time of day; any other form that :func:`radioloc.time.epochs_from_strings` takes is read
        too, but more slowly.

    Raises
    ------
    InputError
        A date is not of such a form, does not exist or lies before 1972.
    """
    matches = [_FULL_DATE.fullmatch(text) for text in texts]
    dates, hours, minutes, seconds, parts = (
        zip(*[m.groups("0") for m in matches if m], strict=True) if any(matches) else ((),) * 5
    )
    try:
        midnight = np.array(dates, dtype="datetime64[D]")
    except ValueError:
        midnight = np.empty(0, dtype="datetime64[D]")
    if len(midnight) < len(texts):
        return _slowly(texts)
    jd = _JD_1970 + midnight.astype(np.float64)
    hour, minute, second = (np.array(x, dtype=np.int64) for x in (hours, minutes, seconds))
    length_s = day_lengths_s(jd)
    if not _times_exist(hour, minute, second, length_s).all():
        return _slowly(texts)
    part = np.array([float("0" + p) for p in parts])
    return Epochs.from_jd(jd, day_fraction(3600 * hour + 60 * minute + second, part, length_s), "UTC")


def utc_from_fields(fields: Fields, index: int) -> Epochs:
    """As :func:`utc_from_text`, of a column of dates with time of day, all in calendar form.

    Raises
    ------
    NotPlainError
        A date is of another form, does not exist, has more than 15 decimals or lies before 1972:
        :func:`utc_from_text` reads it or says what is wrong.
    """
    start, end = fields.column(index)
    end = end - (fields.characters[end - 1] == ord("Z"))
    form = np.ascontiguousarray(fields.window(start, _TIME_OF_DAY_END).T)
    decimals = end - start - _TIME_OF_DAY_END - 1
    plain = (decimals == -1) | (fields.characters[start + _TIME_OF_DAY_END] == ord("."))
    plain &= (decimals >= -1) & (decimals <= _EXACT_DECIMALS)
    for place, mark in _MARKS.items():
        plain &= form[place] == ord(mark)
    digits = form[_DIGITS] - np.uint8(ord("0"))
    plain &= (digits <= 9).all(axis=0)
    century, year, month, day, hour, minute, second = (10 * digits[::2] + digits[1::2]).astype(np.int64)
    decimals = np.maximum(decimals, 0)
    part, are_digits = fields.unsigned(end, decimals)
    plain &= are_digits & (month >= 1) & (month <= 12) & (day >= 1)
    if not plain.all():
        raise NotPlainError("dates")
    year += 100 * century
    month_begin = (12 * (year - 1970) + month - 1).astype("datetime64[M]")
    midnight = month_begin.astype("datetime64[D]") + (day - 1)
    jd = _JD_1970 + midnight.astype(np.float64)
    if (midnight.astype("datetime64[M]") != month_begin).any() or (jd < _JD_1972).any():
        raise NotPlainError("dates")
    length_s = day_lengths_s(jd)
    if not _times_exist(hour, minute, second, length_s).all():
        raise NotPlainError("times of day")
    part_s = part.astype(np.float64) / POWERS[decimals].astype(np.float64)
    return Epochs.from_jd(jd, day_fraction(3600 * hour + 60 * minute + second, part_s, length_s), "UTC")


def _times_exist(
    hour: NDArray[np.int64],
    minute: NDArray[np.int64],
    second: NDArray[np.int64],
    length_s: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Whether these are times of day; the last minute of a day may have a leap second."""
    last = np.where((hour == 23) & (minute == 59), length_s - SECONDS_PER_DAY + 59.0, 59.0)
    return (hour <= 23) & (minute <= 59) & (second <= last)


def _slowly(texts: list[str]) -> Epochs:
    utc = epochs_from_strings(texts, "UTC")
    day_lengths_s(utc.jd)
    return utc


def day_fraction(
    whole_s: NDArray[np.integer] | NDArray[np.float64],
    part_s: NDArray[np.float64],
    length_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Nearest float to (whole + part) / length."""
    quotient = whole_s / length_s
    high = np.floor(quotient * _SPLIT) / _SPLIT
    remainder_s = (whole_s - high * length_s) - (quotient - high) * length_s
    return quotient + (remainder_s + part_s) / length_s


def utc_to_text(utc: Epochs) -> list[str]:
    """Write dates as ``yyyy-mm-ddThh:mm:ss.ssssssssssss``; as :func:`utc_cells`."""
    return [text.decode() for text in utc_cells(utc).tolist()]


def utc_cells(utc: Epochs) -> Cells:
    """Dates as ``yyyy-mm-ddThh:mm:ss.ssssssssssss``, a leap second as second 60, shape (n,).

    Reading them gives back the epoch to 1e-12 s or to the last bit, whichever is more; epochs that were
    read from text with up to 12 decimals come back to the last bit.

    Parameters
    ----------
    utc : Epochs
        Epochs in UTC.
    """
    # Observations of one instant stand one after another in dense data.
    new = np.ones(len(utc), dtype=bool)
    new[1:] = (utc.jd[1:] != utc.jd[:-1]) | (utc.fraction[1:] != utc.fraction[:-1])
    if not new.all():
        return utc_cells(utc[new])[np.cumsum(new) - 1]
    midnight, second, picoseconds = _whole_picoseconds(utc)
    leap = (second >= SECONDS_PER_DAY).astype(np.int64)
    minute, second = np.divmod(second - leap, 60)
    hour, minute = np.divmod(minute, 60)
    different, day = np.unique(midnight, return_inverse=True)
    days = Epochs(different, np.zeros(len(different)), "UTC").day_strings().astype("S10")
    characters = np.empty(len(utc), dtype=_DATE)
    characters["day"] = days[day]
    characters["hour"] = two_digits(hour)
    characters["minute"] = two_digits(minute)
    characters["second"] = two_digits(second + leap)
    characters["part"] = digits(picoseconds, 12)
    for name, mark in (("T", "T"), (":", ":"), ("::", ":"), (".", ".")):
        characters[name] = ord(mark)
    cells: Cells = characters.view(f"S{_DATE.itemsize}")
    return cells


def utc_to_picoseconds(utc: Epochs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Days since 1970-01-01 and picoseconds of UTC since midnight, each shape (n,); precise as :func:`utc_cells`."""
    midnight, second, picoseconds = _whole_picoseconds(utc)
    return (midnight - _JD_1970).astype(np.int64), second * _PICOSECONDS + picoseconds


def utc_from_picoseconds(days: NDArray[np.int64], picoseconds: NDArray[np.int64]) -> Epochs:
    """Epochs from days since 1970-01-01 and picoseconds since their midnights, back from :func:`utc_to_picoseconds`.

    Raises
    ------
    InputError
        A day lies before 1972, or has not so many picoseconds.
    """
    jd = _JD_1970 + days.astype(np.float64)
    length_s = day_lengths_s(jd)
    second, rest = np.divmod(picoseconds, _PICOSECONDS)
    wrong = np.flatnonzero((second < 0) | (second >= length_s))
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"{picoseconds[row]} ps is no time of a day of {length_s[row]:.0f} s; give 0 to less than "
            f"{length_s[row]:.0f}e12"
        )
    return Epochs.from_jd(jd, day_fraction(second, rest / float(_PICOSECONDS), length_s), "UTC")


def _whole_picoseconds(utc: Epochs) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Julian dates of midnight, whole seconds since and picoseconds of the second, each shape (n,)."""
    utc.require("UTC")
    length_s = day_lengths_s(utc.jd)
    high = np.floor(utc.fraction * _SPLIT) / _SPLIT
    high_s = high * length_s
    whole_s = np.floor(high_s)
    rest_s = (high_s - whole_s) + (utc.fraction - high) * length_s
    # Late in the day a float of the fraction is 1e-11 s wide: of the decimals it holds, show the shorter.
    short_s = np.rint(rest_s * 1e10) / 1e10
    is_short = day_fraction(whole_s, short_s, length_s) == utc.fraction
    carry, picoseconds = np.divmod(np.rint(np.where(is_short, short_s, rest_s) * 1e12), 1e12)
    second = (whole_s + carry).astype(np.int64)
    new_day = second >= length_s
    return utc.jd + new_day, np.where(new_day, 0, second), picoseconds.astype(np.int64)
