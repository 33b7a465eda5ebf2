"""Data records of a Tracking Data Message in bulk: columns of text to epochs and numbers, a million in a second.

Source: CCSDS 503.0-B-2 (2020), 3.4 and 4.3.9.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import FileFormatError
from radioloc.io.dates import day_fraction, day_lengths_s
from radioloc.io.tdm.message import DATA, NUMBER, Records, exponent_of
from radioloc.time import Epochs, to_scale

_GPS_MINUS_TAI_S = -19.0  # exact (IS-GPS-200)
# A time tag that is corrected stays in the years that are known: UTC began in 1972.
_EPOCH = (
    r"^(?:19(?:7[3-9]|[89]\d)|20\d\d|2100)-(?:(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01])|\d{3})"
    r"T(?:[01]\d|2[0-3]):[0-5]\d:(?:[0-5]\d|60)(?:\.\d{1,18})?Z?$"
)
_JD_1970 = 2440587.5


class _RecordError(Exception):
    """What is wrong with the record of an index."""

    def __init__(self, wrong: NDArray[np.bool_], problem: Callable[[int], str]) -> None:
        self.index = int(np.argmax(wrong))
        super().__init__(problem(self.index))


def read_records(
    path: str,
    keywords: Any,
    epochs: Any,
    values: Any,
    line: NDArray[np.int32],
    *,
    time_system: str,
    range_units: str,
) -> Records:
    """Turn columns of ASCII text (Arrow arrays or sequences of str) from some lines of a file into columns of numbers.

    :class:`FileFormatError` names the line where a keyword is unknown, a date is not in one of the standard's two forms
    or does not exist, or a value is not a finite number.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = [pa.array(column, pa.string()) for column in (keywords, epochs, values)]
    code = pc.index_in(texts[0], value_set=pa.array(DATA))
    try:
        if code.null_count:
            wrong = code.is_null().to_numpy(zero_copy_only=False)
            rule = "is not a data keyword of the standard; correct or remove it"
            raise _RecordError(wrong, lambda k: f"{texts[0][k].as_py()!r} {rule}")
        codes = code.to_numpy().astype(np.int8)
        return Records(codes, _utc(texts[1], time_system), _numbers(codes, texts[2], range_units), line)
    except _RecordError as error:
        raise FileFormatError(path, str(error), int(line[error.index])) from None


def _numbers(code: NDArray[np.int8], texts: Any, range_units: str) -> NDArray[np.float64]:
    """Values, each the float nearest to its decimal number times the power of ten of its keyword."""
    import pyarrow as pa
    import pyarrow.compute as pc

    are_numbers = pc.match_substring_regex(texts, f"^{NUMBER}$").to_numpy(zero_copy_only=False)
    scaled = texts
    if are_numbers.all():
        exponent = np.array([exponent_of(keyword, range_units) for keyword in DATA])[code]
        own = pc.match_substring_regex(texts, "[eE]").to_numpy(zero_copy_only=False)
        if (own & (exponent != 0)).any():
            parts = (text.upper().partition("E") for text in texts.to_pylist())
            scaled = pa.array(
                [f"{m}E{int(e or 0) + k}" for (m, _, e), k in zip(parts, exponent.tolist(), strict=True)]
            )
        elif exponent.any():
            suffixes = pa.array([f"E{k}" if k else "" for k in range(-2, 4)])
            scaled = pc.binary_join_element_wise(texts, suffixes.take(pa.array(exponent + 2)), "")
        numbers: NDArray[np.float64] = pc.cast(scaled, pa.float64()).to_numpy()
        are_numbers = np.isfinite(numbers)
    if not are_numbers.all():
        rule = "is not a finite number; correct it or leave the record out"
        raise _RecordError(~are_numbers, lambda k: f"{texts[k].as_py()!r} {rule}")
    return numbers


def _utc(texts: Any, time_system: str) -> Epochs:
    """Epochs of dates yyyy-mm-ddThh:mm:ss.sss or yyyy-dddThh:mm:ss.sss, in UTC."""
    import pyarrow.compute as pc

    def refuse(wrong: NDArray[np.bool_], problem: str) -> None:
        if wrong.any():
            raise _RecordError(wrong, lambda k: f"{texts[k].as_py()!r}{problem}")

    form = "written as yyyy-mm-ddThh:mm:ss.sss or yyyy-dddThh:mm:ss.sss with up to 18 decimals"
    none_such = f" is not a date that exists in the years 1973 to 2100, {form}"
    refuse(~pc.match_substring_regex(texts, _EPOCH).to_numpy(zero_copy_only=False), none_such)
    # Two characters more than needed, for dates by day of year.
    dates = np.array(texts.to_numpy(zero_copy_only=False), dtype=np.bytes_)
    dates = dates.astype(f"S{dates.itemsize + 2}")
    characters = dates.view(np.uint8).reshape(len(dates), -1)

    def number(*places: int) -> NDArray[np.int64]:
        out = np.zeros(len(dates), dtype=np.int64)
        for place in places:
            out = 10 * out + (characters[:, place] - np.uint8(ord("0")))
        return out

    by_day = characters[:, 8] == ord("T")
    month = (number(0, 1, 2, 3) - 1970).astype("datetime64[Y]").astype("datetime64[M]")
    if by_day.any():
        month = np.where(by_day, month, month + number(5, 6) - 1)
        midnight = month.astype("datetime64[D]") + np.where(by_day, number(5, 6, 7), number(8, 9)) - 1
        characters[by_day, 11:] = characters[by_day, 9:-2]
    else:
        month += number(5, 6) - 1
        midnight = month.astype("datetime64[D]") + number(8, 9) - 1
    same = np.where(
        by_day,
        midnight.astype("datetime64[Y]") == month.astype("datetime64[Y]"),
        midnight.astype("datetime64[M]") == month,
    )
    refuse(~same, none_such)
    whole_s = 3600 * number(11, 12) + 60 * number(14, 15) + number(17, 18)
    decimals, scale = np.zeros(len(dates), dtype=np.int64), np.ones(len(dates))
    zulu = (characters[:, 19:] == ord("Z")).any(axis=1)
    for column in characters[:, 20:].T:
        inside = (column >= ord("0")) & (column <= ord("9"))
        decimals = np.where(inside, 10 * decimals + (column - np.uint8(ord("0"))), decimals)
        scale = np.where(inside, 10.0 * scale, scale)
    if time_system != "UTC":
        refuse(zulu, f" ends in Z, which says UTC, but TIME_SYSTEM is {time_system}")
    jd = _JD_1970 + midnight.astype(np.float64)
    length_s = day_lengths_s(jd) if time_system == "UTC" else np.full(len(jd), SECONDS_PER_DAY)
    # Only a day that is longer has a second 86400: any other second 60 is wrong.
    late = (number(17, 18) == 60) & ((whole_s != SECONDS_PER_DAY) | (length_s == SECONDS_PER_DAY))
    refuse(late, f": there is no leap second then in {time_system}")
    # Up to 15 digits decimals and scale are whole numbers that a float holds: the quotient is the nearest float.
    fraction = day_fraction(whole_s, decimals / scale, length_s)
    if time_system == "GPS":
        return to_scale(Epochs.from_jd(jd, fraction, "TAI").shifted(-_GPS_MINUS_TAI_S), "UTC")
    return to_scale(Epochs.from_jd(jd, fraction, time_system), "UTC")
