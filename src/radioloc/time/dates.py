"""UTC dates in bulk and to the last bit: text to epochs and back, seconds of day to epochs.

A UTC epoch is a fraction of a day that lasts 86401 s where a leap second ends it. Whole seconds and parts
of a second are kept apart on the way, so that text with picoseconds gives the nearest epoch that two floats
can hold. Timestamps of NumPy and Arrow know no leap second, and in picoseconds no more than 106 days around 1970:
here they stand for dates and for times of day.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY, UNIX_JD, UTC_JD
from radioloc.errors import InputError
from radioloc.time.epochs import Epochs
from radioloc.time.scales import epochs_from_strings, utc_to_tai

_FULL_DATE = r"^\d{4}-\d\d-\d\d[T ](?:[01]\d|2[0-3]):[0-5]\d:(?:[0-5]\d|60)(?:\.\d{0,18})?Z?$"
_JD_9999 = 5373119.5
# Half of a double's bits: a fraction cut here and a whole number of seconds multiply without rounding.
_SPLIT = float(2**26)
_PICOSECONDS = 10**12


def day_lengths_s(jd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Length of UTC days from 1972 to 9998, s, by the Julian dates of the midnights that begin them."""
    days, inverse = np.unique(jd, return_inverse=True)
    if len(days) and days[0] < UTC_JD:
        early = Epochs.from_jd(days[0], 0.0, "UTC").day_strings()[0]
        raise InputError(f"{early} is before 1972, when UTC had another rate than TAI; leave such data out")
    if len(days) and days[-1] >= _JD_9999:
        raise InputError(f"a date {days[-1] - UNIX_JD:.0f} days after 1970 is none of a measurement")
    start = utc_to_tai(Epochs.from_jd(days, 0.0, "UTC"))
    end = utc_to_tai(Epochs.from_jd(days + 1.0, 0.0, "UTC"))
    return np.round(end.seconds_since(start))[inverse]


def utc_from_seconds_of_day(jd: NDArray[np.float64], seconds: NDArray[np.float64]) -> Epochs:
    """Epochs from midnights and seconds of day; seconds past the day's end belong to the next day."""
    length_s = day_lengths_s(jd)
    over = seconds >= length_s
    jd = jd + over
    return Epochs.from_jd(jd, (seconds - np.where(over, length_s, 0.0)) / day_lengths_s(jd), "UTC")


def utc_from_text(texts: Sequence[str] | Any) -> Epochs:
    """Read dates such as ``2020-12-01T15:11:00.250000000001`` of any number of decimals, listed or in an Arrow array.

    Any other form that :func:`radioloc.time.epochs_from_strings` takes is read too, but more slowly.
    """
    import pyarrow
    from pyarrow import compute

    array = texts if isinstance(texts, pyarrow.Array) else pyarrow.array(texts, pyarrow.string())
    if len(array) and np.all(compute.match_substring_regex(array, _FULL_DATE)):
        found = read_dates(array, "UTC")
        if found.exists.all() and not found.no_leap_second.any():
            return found.epoch
    utc = epochs_from_strings(array.to_pylist(), "UTC")
    day_lengths_s(utc.jd)
    return utc


class ReadDates(NamedTuple):
    """Which dates exist, which have a second 60 that there is not, and the epochs of those that are right."""

    exists: NDArray[np.bool_]
    no_leap_second: NDArray[np.bool_]
    epoch: Epochs


def read_dates(texts: Any, scale: str) -> ReadDates:
    """Read dates yyyy-mm-dd or yyyy-ddd with time hh:mm:ss and up to 18 decimals, a million in a second."""
    # Two characters more than needed, for dates by day of year.
    dates = np.array(texts.to_numpy(zero_copy_only=False), dtype=np.bytes_)
    dates = dates.astype(f"S{max(dates.itemsize, 20) + 2}")
    characters = dates.view(np.uint8).reshape(len(dates), -1)

    def number(*places: int) -> NDArray[np.int64]:
        out = np.zeros(len(dates), dtype=np.int64)
        for place in places:
            out = 10 * out + (characters[:, place] - np.uint8(ord("0")))
        return out

    by_day = characters[:, 8] == ord("T")
    year = (number(0, 1, 2, 3) - 1970).astype("datetime64[Y]")
    in_year = number(5, 6)
    month = year.astype("datetime64[M]") + np.where(by_day, 0, in_year - 1).astype("timedelta64[M]")
    day = np.where(by_day, number(5, 6, 7), number(8, 9))
    midnight = month.astype("datetime64[D]") + (day - 1).astype("timedelta64[D]")
    exists = np.where(
        by_day,
        midnight.astype("datetime64[Y]") == year,
        (midnight.astype("datetime64[M]") == month) & (in_year >= 1) & (in_year <= 12),
    )
    # From the hour on both forms are alike.
    if by_day.any():
        characters[by_day, 11:] = characters[by_day, 9:-2]
    decimals, power = np.zeros(len(dates), dtype=np.int64), np.ones(len(dates))
    for column in characters[:, 20:].T:
        inside = (column >= ord("0")) & (column <= ord("9"))
        decimals = np.where(inside, 10 * decimals + (column - np.uint8(ord("0"))), decimals)
        power = np.where(inside, 10.0 * power, power)
    second = number(17, 18)
    whole_s = 3600 * number(11, 12) + 60 * number(14, 15) + second
    jd = np.where(exists, UNIX_JD + midnight.astype(np.float64), UTC_JD)
    length_s = day_lengths_s(jd) if scale == "UTC" else np.full(len(jd), SECONDS_PER_DAY)
    # Only a day that is longer has a second 86400.
    no_leap_second = (second == 60) & ((whole_s != SECONDS_PER_DAY) | (length_s == SECONDS_PER_DAY))
    # Up to 15 digits decimals and power are whole numbers that a float holds: the quotient is the nearest float.
    epoch = Epochs.from_jd(jd, day_fraction(whole_s, decimals / power, length_s), scale)
    return ReadDates(exists, no_leap_second, epoch)


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


def utc_to_text(utc: Epochs) -> NDArray[np.str_]:
    """Dates as ``yyyy-mm-ddThh:mm:ss.ssssssssssss``, a leap second as second 60, shape (n,).

    Reading them gives back the epoch to 1e-12 s or to the last bit, whichever is more; epochs that were
    read from text with up to 12 decimals come back to the last bit.
    """
    days, picoseconds = utc_to_picoseconds(utc)
    leap = picoseconds >= int(SECONDS_PER_DAY) * _PICOSECONDS
    time_of_day = (picoseconds - _PICOSECONDS * leap).astype("datetime64[ps]")
    texts = np.datetime_as_string(time_of_day).astype("U32")
    characters = texts.view("U1").reshape(len(texts), 32)
    different, which = np.unique(days, return_inverse=True)
    dates = np.datetime_as_string(different.astype("datetime64[D]")).astype("U10")
    characters[:, :10] = dates.view("U1").reshape(-1, 10)[which]
    characters[leap, 17:19] = ["6", "0"]
    return texts


def utc_to_picoseconds(utc: Epochs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Days since 1970-01-01 and picoseconds of UTC since midnight, each shape (n,); precise as :func:`utc_to_text`."""
    utc.require("UTC")
    length_s = day_lengths_s(utc.jd)
    high = np.floor(utc.fraction * _SPLIT) / _SPLIT
    high_s = high * length_s
    whole_s = np.floor(high_s)
    rest_s = (high_s - whole_s) + (utc.fraction - high) * length_s
    # Late in the day a float of the fraction is 1e-11 s wide: of the decimals it holds, take the shorter.
    short_s = np.rint(rest_s * 1e10) / 1e10
    is_short = day_fraction(whole_s, short_s, length_s) == utc.fraction
    part = np.rint(np.where(is_short, short_s, rest_s) * 1e12).astype(np.int64)
    picoseconds = whole_s.astype(np.int64) * _PICOSECONDS + part
    new_day = picoseconds >= length_s.astype(np.int64) * _PICOSECONDS
    days = (utc.jd - UNIX_JD).astype(np.int64) + new_day
    return days, np.where(new_day, picoseconds % _PICOSECONDS, picoseconds)


def utc_datetimes(utc: Epochs) -> NDArray[np.datetime64]:
    """Dates of NumPy to the nanosecond, shape (n,); :class:`InputError` for a leap second, which they do not have."""
    days, picoseconds = utc_to_picoseconds(utc)
    nanoseconds = (picoseconds + 500) // 1000
    leap = np.flatnonzero(picoseconds >= int(SECONDS_PER_DAY) * _PICOSECONDS)
    if len(leap):
        raise InputError(
            f"{utc_to_text(utc[leap[:1]])[0][:-9]} is in a leap second, which dates of NumPy do not have"
        )
    return np.asarray(days.astype("datetime64[D]") + nanoseconds.astype("timedelta64[ns]"))


def utc_from_picoseconds(days: NDArray[np.int64], picoseconds: NDArray[np.int64]) -> Epochs:
    """Epochs from days since 1970-01-01 and picoseconds since their midnights, back from :func:`utc_to_picoseconds`."""
    jd = UNIX_JD + days.astype(np.float64)
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
