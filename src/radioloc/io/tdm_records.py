"""Data records of a Tracking Data Message in bulk: columns of text to epochs and numbers.

A record is a keyword, an epoch and a value. Columns of text are turned into arrays without a Python object
staying behind per record; the first record that cannot be read is found only once it is known that there is
one, so that a million good records take a second or two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import FileFormatError
from radioloc.io.checks import YEARS
from radioloc.io.dates import day_fraction, day_lengths_s
from radioloc.io.tdm_keywords import CODE, DATA, exponent_of
from radioloc.time import Epochs
from radioloc.time.scales import utc_of

GPS_MINUS_TAI_S = -19.0
"""GPS time less TAI, s; exact (IS-GPS-200)."""

# A year after UTC began: a time tag that is corrected stays in it.
_FIRST_YEAR, _LAST_YEAR = YEARS[0] + 1, YEARS[1]
_JD_1970 = 2440587.5
_MOST_DECIMALS = 18
_LONGEST_DATE = len("2020-12-31T23:59:60.") + _MOST_DECIMALS + len("Z")
_ZERO = ord("0")


class Records(NamedTuple):
    """Columns of records: keyword codes, epochs (UTC) and values in the units of ``TdmSegment``."""

    keyword: NDArray[np.int8]
    epoch: Epochs
    value: NDArray[np.float64]
    line: NDArray[np.int32]

    @staticmethod
    def join(parts: Sequence[Records]) -> Records:
        """All records, in order."""
        return Records(
            np.concatenate([part.keyword for part in parts]),
            Epochs.concatenate([part.epoch for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.line for part in parts]),
        )


class _RecordError(Exception):
    """What is wrong with the record of an index."""

    def __init__(self, index: int, problem: str) -> None:
        super().__init__(problem)
        self.index = index


def read_records(
    path: str,
    keywords: Sequence[str],
    epochs: Sequence[str],
    values: Sequence[str],
    line: NDArray[np.int32],
    *,
    time_system: str,
    range_units: str,
) -> Records:
    """Turn columns of ASCII text into columns of numbers.

    Parameters
    ----------
    path : str
        The file, for messages.
    keywords, epochs, values : sequence of str
        Fields of the records, without blanks at their ends.
    line : ndarray of int32, shape (n,)
        Line of each record.
    time_system : str
        One of :data:`radioloc.io.tdm_keywords.TIME_SYSTEMS`.
    range_units : {"km", "s", "RU"}
        Unit of RANGE.

    Raises
    ------
    FileFormatError
        A keyword is unknown, a date is not in one of the standard's two forms or does not exist, or a value is
        not a finite number. Names the line.
    """
    try:
        return Records(
            _codes(keywords), _utc(epochs, time_system), _numbers(keywords, values, range_units), line
        )
    except _RecordError as error:
        raise FileFormatError(path, str(error), int(line[error.index])) from None


def _codes(keywords: Sequence[str]) -> NDArray[np.int8]:
    try:
        return np.fromiter(map(CODE.__getitem__, keywords), dtype=np.int8, count=len(keywords))
    except KeyError:
        index, wrong = next((i, k) for i, k in enumerate(keywords) if k not in CODE)
        problem = f"{wrong!r} is not a data keyword of the standard; correct or remove it"
        raise _RecordError(index, problem) from None


def _numbers(keywords: Sequence[str], values: Sequence[str], range_units: str) -> NDArray[np.float64]:
    """Values, each the float nearest to its decimal number times the power of ten of its keyword."""
    suffix = {keyword: _suffix(exponent_of(keyword, range_units)) for keyword in DATA}
    try:
        texts = [value + suffix[keyword] for keyword, value in zip(keywords, values, strict=True)]
        numbers = np.fromiter(map(float, texts), dtype=np.float64, count=len(texts))
    except ValueError:
        numbers = np.fromiter(
            (_number(value, suffix[keyword]) for keyword, value in zip(keywords, values, strict=True)),
            dtype=np.float64,
            count=len(values),
        )
    # float() takes underscores between digits, which no other program would read alike.
    if not np.isfinite(numbers).all() or "_" in "".join(values):
        index = next(i for i, v in enumerate(values) if not np.isfinite(numbers[i]) or "_" in v)
        problem = f"{values[index]!r} is not a finite number; correct it or leave the record out"
        raise _RecordError(index, problem)
    return numbers


def _suffix(exponent: int) -> str:
    return f"e{exponent}" if exponent else ""


def _number(text: str, suffix: str) -> float:
    """Number of a text that may have an exponent of its own; NaN where it is none."""
    mantissa, mark, exponent = text.lower().partition("e")
    try:
        return (
            float(f"{mantissa}e{int(exponent or 0) + int(suffix[1:] or 0)}") if mark else float(text + suffix)
        )
    except ValueError:
        return math.nan


def _utc(texts: Sequence[str], time_system: str) -> Epochs:
    """Epochs of dates in either of the standard's two forms (4.3.9), in UTC."""
    longest = max(map(len, texts))
    if longest > _LONGEST_DATE:
        index = next(i for i, text in enumerate(texts) if len(text) == longest)
        raise _RecordError(index, f"{texts[index]!r} is not a date with up to {_MOST_DECIMALS} decimals")
    # One zero more than needed ends every text, so that looking one place past its end is safe.
    width = longest + 1
    characters = np.array(texts, dtype=f"S{width}").view(np.uint8).reshape(len(texts), width)
    dates = _Dates.empty(len(texts))
    by_day_of_year = characters[:, 8] == ord("T") if width > 8 else np.zeros(len(texts), dtype=bool)
    for which, day_of_year in ((~by_day_of_year, False), (by_day_of_year, True)):
        if which.all():
            dates = _read_dates(characters, day_of_year)
        elif which.any():
            for column, part in zip(dates, _read_dates(characters[which], day_of_year), strict=True):
                column[which] = part
    if dates.wrong.any():
        index = int(np.argmax(dates.wrong))
        problem = (
            f"{texts[index]!r} is not a date that exists in the years {_FIRST_YEAR} to {_LAST_YEAR}, "
            f"written as yyyy-mm-ddThh:mm:ss.sss or yyyy-dddThh:mm:ss.sss with up to {_MOST_DECIMALS} decimals"
        )
        raise _RecordError(index, problem)
    if time_system != "UTC" and dates.zulu.any():
        index = int(np.argmax(dates.zulu))
        problem = f"{texts[index]!r} ends in Z, which says UTC, but TIME_SYSTEM is {time_system}"
        raise _RecordError(index, problem)
    length_s = day_lengths_s(dates.jd) if time_system == "UTC" else np.full(len(texts), SECONDS_PER_DAY)
    # Only a day that is longer has a second 86400: any other second 60 is wrong.
    wrong = dates.leap & ~((dates.whole_s == SECONDS_PER_DAY) & (length_s > SECONDS_PER_DAY))
    if wrong.any():
        index = int(np.argmax(wrong))
        raise _RecordError(index, f"{texts[index]!r}: there is no leap second then in {time_system}")
    fraction = day_fraction(dates.whole_s, dates.part_s, length_s)
    if time_system == "GPS":
        return utc_of(Epochs.from_jd(dates.jd, fraction, "TAI").shifted(-GPS_MINUS_TAI_S))
    return utc_of(Epochs.from_jd(dates.jd, fraction, time_system))


class _Dates(NamedTuple):
    """Dates taken apart: midnight, whole and part second of day, and what is remarkable about them."""

    jd: NDArray[np.float64]
    whole_s: NDArray[np.float64]
    part_s: NDArray[np.float64]
    leap: NDArray[np.bool_]
    zulu: NDArray[np.bool_]
    wrong: NDArray[np.bool_]

    @classmethod
    def empty(cls, n: int) -> _Dates:
        """Columns to be filled."""
        no = np.zeros(n, dtype=bool)
        return cls(np.empty(n), np.empty(n), np.empty(n), no.copy(), no.copy(), no.copy())


def _read_dates(characters: NDArray[np.uint8], day_of_year: bool) -> _Dates:
    """Read dates of one form from a matrix of characters that ends in a column of zeros."""
    n, width = characters.shape
    time = 9 if day_of_year else 11
    if width <= time + len("hh:mm:ss"):
        return _Dates.empty(n)._replace(wrong=np.ones(n, dtype=bool))
    wrong = np.zeros(n, dtype=bool)

    def number(first: int, length: int) -> NDArray[np.int64]:
        out = np.zeros(n, dtype=np.int64)
        for place in range(first, first + length):
            digit = characters[:, place] - np.uint8(_ZERO)
            np.logical_or(wrong, digit > 9, out=wrong)
            out = 10 * out + digit
        return out

    marks = {4: "-", time - 1: "T", time + 2: ":", time + 5: ":"} | ({} if day_of_year else {7: "-"})
    for place, mark in marks.items():
        wrong |= characters[:, place] != ord(mark)
    year = number(0, 4)
    month, day = (np.ones(n, dtype=np.int64), number(5, 3)) if day_of_year else (number(5, 2), number(8, 2))
    hour, minute, second = (number(time + offset, 2) for offset in (0, 3, 6))
    part_s, zulu, wrong_part = _read_decimals(characters[:, time + 8 :])
    wrong |= wrong_part | (hour > 23) | (minute > 59) | (second > 60)
    wrong |= (year < _FIRST_YEAR) | (year > _LAST_YEAR) | (month < 1) | (month > 12) | (day < 1)
    # What is wrong is not looked at again; in its place stands a date that exists.
    year, month = np.where(wrong, _FIRST_YEAR, year), np.where(wrong, 1, month)
    months = (year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (month - 1)
    days = months.astype("datetime64[D]") + (day - 1)
    unit = "datetime64[Y]" if day_of_year else "datetime64[M]"
    wrong |= days.astype(unit) != months.astype(unit)
    return _Dates(
        _JD_1970 + days.astype(np.float64),
        (3600 * hour + 60 * minute + second).astype(np.float64),
        part_s,
        second == 60,
        zulu,
        wrong,
    )


def _read_decimals(
    characters: NDArray[np.uint8],
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Read what follows the whole second: nothing, decimals, a Z; and where it is none of these."""
    n, width = characters.shape
    length = np.count_nonzero(characters, axis=1)
    last = characters[np.arange(n), np.maximum(length - 1, 0)]
    zulu = last == ord("Z")
    end = length - zulu
    wrong = (end == 1) | (end > 1 + _MOST_DECIMALS) | ((end > 0) & (characters[:, 0] != ord(".")))
    digits, scale = np.zeros(n, dtype=np.int64), np.ones(n)
    for place in range(1, width - 1):
        inside = place < end
        if not inside.any():
            break
        digit = characters[:, place] - np.uint8(_ZERO)
        wrong |= inside & (digit > 9)
        digits = np.where(inside, 10 * digits + digit, digits)
        scale = np.where(inside, 10.0 * scale, scale)
    # Up to 15 digits both are whole numbers that a float holds: the quotient is the nearest float.
    return digits / scale, zulu, wrong
