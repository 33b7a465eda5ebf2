"""Dates as text by one grammar, exact to the last bit, and seconds of day as epochs.

A UTC epoch is a fraction of a day that lasts 86401 s where a leap second ends it. Whole seconds and
parts of a second are converted separately, so that text with picoseconds gives the nearest epoch of two floats.
Timestamps of NumPy and Arrow lack leap seconds, and in picoseconds span only 106 days around 1970: this module
uses them for dates and for times of day.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY, UNIX_JD, UTC_JD
from radioloc.errors import InputError
from radioloc.time.epochs import Epochs
from radioloc.time.scales import to_scale, utc_to_tai
from radioloc.vectors import Floats, Mask

_DATE = re.compile(
    r"(?P<year>\d{4})-(?:(?P<month>\d\d)-(?P<day>\d\d)|(?P<day_of_year>\d{3}))"
    r"(?:[T ](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.:](?P<decimals>\d*))?)?)?Z?",
    re.ASCII,
)
"""Some programs write a colon before the parts of a second."""
_MAX_CHARACTERS = 300  # of a date
_MAX_DECIMALS = 18  # that are read: an int64 holds them
_JD_9999 = 5373119.5
# Half of a double's bits: a fraction cut here and a whole number of seconds multiply without rounding.
_SPLIT = float(2**26)
_PICOSECONDS = 10**12


class DateError(InputError):
    """Error of a text that is not a date; ``row`` is its place among the texts."""

    def __init__(self, text: str, problem: str, row: int) -> None:
        super().__init__(f"{text!r}{problem}")
        self.row = row


def epochs_from_strings(dates: str | Sequence[str], scale: str) -> Epochs:
    """Read dates such as ``2020-12-01T15:11:00.25``, ``2020-336T15:11:00`` or ``2020-12-01``.

    Parameters
    ----------
    dates : str, sequence of str, astropy Time, or sequence of Time
        Calendar or day-of-year dates; a trailing Z is allowed. A second of 60 is allowed at a UTC leap second.
        Times, of any scale, are converted.
    scale : str
        Time scale the dates are in, and that of the result.

    Raises
    ------
    InputError
        A date has another form or does not exist.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, to_scale, utc_strings
    >>> utc = epochs_from_strings("2016-12-31T23:59:60", "UTC")
    >>> utc_strings(to_scale(utc, "TT"), 3).tolist()
    ['2017-01-01T00:01:08.184']
    """
    if hasattr(dates, "jd1"):
        return to_scale(Epochs.from_time(dates), scale)
    texts = [dates] if isinstance(dates, str) else list(dates)
    if any(hasattr(text, "jd1") for text in texts):
        return Epochs.concatenate([to_scale(Epochs.from_time(time), scale) for time in texts])
    return read_dates([str(text).strip() for text in texts], scale)


def read_dates(texts: Sequence[str], scale: str) -> Epochs:
    """Read dates, a million in a second; a :class:`DateError` names the first wrong one."""

    def refuse(wrong: Mask, problem: str) -> None:
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DateError(texts[row], problem, row)

    fields = _date_fields(texts)
    year, month, day, day_of_year = (fields[name] for name in ("year", "month", "day", "day_of_year"))
    by_day = fields["by_day"].astype(bool)
    starts = (year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + np.where(by_day, 0, month - 1)
    midnight = starts.astype("datetime64[D]") + (np.where(by_day, day_of_year, day) - 1)
    exists = np.where(
        by_day,
        midnight.astype("datetime64[Y]") == starts.astype("datetime64[Y]"),
        (midnight.astype("datetime64[M]") == starts) & (month >= 1) & (month <= 12),
    )
    refuse(~exists, " is not a date that exists")
    hour, minute, second = fields["hour"], fields["minute"], fields["second"]
    refuse((hour > 23) | (minute > 59) | (second > 60), " is not a time of day that exists")
    jd, whole_s = UNIX_JD + midnight.astype(np.float64), 3600 * hour + 60 * minute + second
    length_s = np.full(len(jd), SECONDS_PER_DAY)
    if scale == "UTC":
        length_s = day_lengths_s(np.maximum(jd, UTC_JD))
    # Only a day that is longer has a second 86400.
    no_leap_second = (second == 60) & ((whole_s != SECONDS_PER_DAY) | (length_s == SECONDS_PER_DAY))
    refuse(no_leap_second, f" is not a leap second of {scale}")
    # Up to 15 digits decimals and power are whole numbers that a float holds: the quotient is the nearest float.
    part_s = fields["decimals"] / 10.0 ** fields["n_decimals"]
    return Epochs.from_jd(jd, day_fraction(whole_s, part_s, length_s), scale)


def _date_fields(texts: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """Return the numbers of dates by the grammar's groups; zero where a date leaves them out."""
    try:
        if max(map(len, texts), default=0) > _MAX_CHARACTERS:
            raise ValueError
        dates = np.array(texts, dtype=np.bytes_)
    except ValueError:  # that a text is not ASCII is one
        row = next(k for k, text in enumerate(texts) if len(text) > _MAX_CHARACTERS or not text.isascii())
        raise DateError(texts[row], _NOT_A_DATE, row) from None
    characters = dates.view(np.uint8).reshape(len(dates), dates.itemsize)
    digits = characters - np.uint8(ord("0"))
    forms = np.where(digits < 10, np.uint8(ord("0")), characters).view(dates.dtype).ravel()
    fields = {name: np.zeros(len(dates), np.int64) for name in (*_DATE.groupindex, "by_day", "n_decimals")}
    unread = np.arange(len(dates))
    # A form is a text with all digits zero; the grammar gives the place of the numbers in each of the few forms.
    while len(unread):
        form = forms[unread[0]]
        if (match := _DATE.fullmatch(form.decode())) is None:
            raise DateError(texts[unread[0]], _NOT_A_DATE, int(unread[0]))
        alike = forms[unread] == form
        rows, unread = unread[alike], unread[~alike]
        for name in _DATE.groupindex:
            first, end = match.span(name)
            number = np.zeros(len(rows), np.int64)
            for column in digits.T[first : min(end, first + _MAX_DECIMALS)]:
                number = 10 * number + column[rows]
            fields[name][rows] = number
        fields["by_day"][rows] = match["day_of_year"] is not None
        fields["n_decimals"][rows] = min(len(match["decimals"] or ""), _MAX_DECIMALS)
    return fields


_NOT_A_DATE = " is not a date; write it as yyyy-mm-ddThh:mm:ss.sss or yyyy-dddThh:mm:ss.sss"


def day_lengths_s(jd: Floats) -> Floats:
    """Return the lengths of UTC days from 1972 to 9998, s, by the Julian dates of the midnights that begin them."""
    days, inverse = np.unique(jd, return_inverse=True)
    if len(days) and days[0] < UTC_JD:
        early = Epochs.from_jd(days[0], 0.0, "UTC").day_strings()[0]
        raise InputError(f"{early} is before 1972, when UTC had another rate than TAI; remove such data")
    if len(days) and days[-1] >= _JD_9999:
        raise InputError(
            f"expected dates before 9999, got {days[-1] - UNIX_JD:.0f} days after 1970; correct them"
        )
    midnights = utc_to_tai(Epochs.from_jd(np.concatenate([days, days + 1.0]), 0.0, "UTC"))
    return np.round(midnights[len(days) :].seconds_since(midnights[: len(days)]))[inverse]


def utc_from_seconds_of_day(jd: Floats, seconds: Floats) -> Epochs:
    """Return epochs of midnights and seconds of day; seconds past the day's end belong to the next day."""
    length_s = day_lengths_s(jd)
    is_next_day = seconds >= length_s
    jd = jd + is_next_day
    return Epochs.from_jd(jd, (seconds - np.where(is_next_day, length_s, 0.0)) / day_lengths_s(jd), "UTC")


def utc_from_text(texts: Sequence[str]) -> Epochs:
    """Read UTC dates from 1972 on."""
    utc = read_dates(texts, "UTC")
    day_lengths_s(utc.jd)
    return utc


def day_fraction(whole_s: NDArray[np.integer] | Floats, part_s: Floats, length_s: Floats) -> Floats:
    """Return the nearest float to (whole + part) / length."""
    quotient = whole_s / length_s
    high = np.floor(quotient * _SPLIT) / _SPLIT
    remainder_s = (whole_s - high * length_s) - (quotient - high) * length_s
    return quotient + (remainder_s + part_s) / length_s


def utc_to_text(utc: Epochs) -> NDArray[np.str_]:
    """Write dates as ``yyyy-mm-ddThh:mm:ss.ssssssssssss``; read again they give 12 decimals or the last bit."""
    days, picoseconds = utc_to_picoseconds(utc)
    leap = picoseconds >= int(SECONDS_PER_DAY) * _PICOSECONDS
    time_of_day = (picoseconds - _PICOSECONDS * leap).astype("datetime64[ps]")
    texts = np.datetime_as_string(time_of_day).astype("U32")
    characters = texts.view("U1").reshape(len(texts), 32)
    different, indices = np.unique(days, return_inverse=True)
    dates = np.datetime_as_string(different.astype("datetime64[D]")).astype("U10")
    characters[:, :10] = dates.view("U1").reshape(-1, 10)[indices]
    characters[leap, 17:19] = ["6", "0"]
    return texts


def utc_to_picoseconds(utc: Epochs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return days since 1970-01-01 and picoseconds of UTC since midnight; precise as :func:`utc_to_text`."""
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
    """Return dates of NumPy to the nanosecond; a leap second, which they do not have, is an :class:`InputError`."""
    days, picoseconds = utc_to_picoseconds(utc)
    nanoseconds = (picoseconds + 500) // 1000
    leap = np.flatnonzero(picoseconds >= int(SECONDS_PER_DAY) * _PICOSECONDS)
    if len(leap):
        raise InputError(
            f"{utc_to_text(utc[leap[:1]])[0][:-9]} is in a leap second, which dates of NumPy do not have"
        )
    return np.asarray(days.astype("datetime64[D]") + nanoseconds.astype("timedelta64[ns]"))


def utc_from_picoseconds(days: NDArray[np.int64], picoseconds: NDArray[np.int64]) -> Epochs:
    """Return epochs of days since 1970-01-01 and picoseconds since their midnights."""
    jd = UNIX_JD + days.astype(np.float64)
    length_s = day_lengths_s(jd)
    second, remainder = np.divmod(picoseconds, _PICOSECONDS)
    wrong = np.flatnonzero((second < 0) | (second >= length_s))
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"expected a time of day of 0 to less than {length_s[row]:.0f}e12 ps, got {picoseconds[row]}"
        )
    return Epochs.from_jd(jd, day_fraction(second, remainder / float(_PICOSECONDS), length_s), "UTC")
