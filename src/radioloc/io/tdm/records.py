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
from radioloc.io.dates import civil_times, day_fraction, day_lengths_s
from radioloc.io.tdm.message import DATA, NUMBER, Records, exponent_of
from radioloc.time import Epochs, to_scale

_GPS_MINUS_TAI_S = -19.0  # exact (IS-GPS-200)
# A time tag that is corrected stays in the years that are known: UTC began in 1972.
_EPOCH = (
    r"^(?:19(?:7[3-9]|[89]\d)|20\d\d|2100)-(?:(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01])|\d{3})"
    r"T(?:[01]\d|2[0-3]):[0-5]\d:(?:[0-5]\d|60)(?:\.\d{1,18})?Z?$"
)


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
    found = civil_times(texts)
    refuse(~found.exists, none_such)
    if time_system != "UTC":
        zulu = pc.ends_with(texts, "Z").to_numpy(zero_copy_only=False)
        refuse(zulu, f" ends in Z, which says UTC, but TIME_SYSTEM is {time_system}")
    jd = found.jd
    length_s = day_lengths_s(jd) if time_system == "UTC" else np.full(len(jd), SECONDS_PER_DAY)
    refuse(found.no_leap_second(length_s), f": there is no leap second then in {time_system}")
    fraction = day_fraction(found.whole_s, found.part_s, length_s)
    if time_system == "GPS":
        return to_scale(Epochs.from_jd(jd, fraction, "TAI").shifted(-_GPS_MINUS_TAI_S), "UTC")
    return to_scale(Epochs.from_jd(jd, fraction, time_system), "UTC")
