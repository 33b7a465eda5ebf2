"""Columns of texts, numbers and dates as lines of text, in bulk.

A column becomes an array of bytes, each row filled up with zero bytes. Side by side, with the separators between them,
such columns are the lines of a file once the zero bytes are taken out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.labels import Labels

Cells = NDArray[np.bytes_]
"""Texts of a column in UTF-8, filled up with zero bytes, shape (n,)."""
Characters = NDArray[np.uint8]

_ROWS_AT_ONCE = 32768
_MINUS, _ZERO = ord("-"), ord("0")
_FOUR_DIGITS: Characters = (
    np.arange(10000)[:, np.newaxis] // np.array([1000, 100, 10, 1]) % 10 + _ZERO
).astype(np.uint8)
_POWERS = 10 ** np.arange(19, dtype=np.int64)
# Above, the whole part and its decimals do not both fit in a float.
_LARGEST_WHOLE = 1e15
# In units of the last decimal: nearer to half way than what the scaling may have rounded.
_DOUBT = 1e-5


def lines_of(columns: Sequence[Callable[[slice], Cells]], count: int) -> Iterator[bytes]:
    """Lines of comma-separated text, some thousand at a time.

    Parameters
    ----------
    columns : sequence of callable
        Gives the texts of some rows of a column.
    count : int
        Rows.
    """
    for start in range(0, count, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, count))
        parts = [_characters(column(rows)) for column in columns]
        width = sum(part.shape[1] + 1 for part in parts)
        table = np.empty((rows.stop - rows.start, width), dtype=np.uint8)
        at = 0
        for part in parts:
            table[:, at : at + part.shape[1]] = part
            at += part.shape[1] + 1
            table[:, at - 1] = ord(",")
        table[:, -1] = ord("\n")
        yield table.tobytes().translate(None, b"\0")


def text_cells(texts: ArrayLike) -> Cells:
    """Texts as they are.

    Raises
    ------
    InputError
        A text holds half a surrogate pair.
    """
    array = np.asarray(texts, dtype=np.str_)
    try:
        return array.astype(np.bytes_)
    except UnicodeEncodeError:
        pass
    try:
        return np.asarray(np.strings.encode(array, "utf-8"))
    except UnicodeEncodeError as error:
        raise InputError(f"{error.object[error.start : error.end]!r} is not text; leave it out") from error


def label_cells(labels: Labels, rows: Any) -> Cells:
    """Texts of some rows, of which few differ.

    Raises
    ------
    InputError
        A text holds half a surrogate pair.
    """
    cells: Cells = text_cells(labels.texts or ("",))[labels.codes[rows]]
    return cells


def shortest_cells(values: NDArray[np.float64]) -> Cells:
    """Numbers with as many digits as give back the same float; NaN as nothing."""
    # Weather and sigmas are mostly the same few numbers; told apart by their bits, so that zero keeps its sign.
    different, which = np.unique(np.ascontiguousarray(values).view(np.int64), return_inverse=True)
    texts = ["" if value != value else repr(value) for value in different.view(np.float64).tolist()]
    return np.array(texts, dtype=np.bytes_)[which]


def fixed_cells(values: NDArray[np.float64], decimals: int) -> Cells:
    """Numbers with so many decimals, 1 to 8, the last one rounded as ``%.7f`` does.

    Notes
    -----
    A float less its whole part is exact. Scaled it is rounded by far less than ``_DOUBT`` of the last decimal; what is
    nearer to half way between two texts than that is left to Python.
    """
    size = np.abs(values)
    large = ~(size < _LARGEST_WHOLE)
    size = np.where(large, 0.0, size)
    whole = np.floor(size)
    scaled = (size - whole) * 10.0**decimals
    part = np.rint(scaled)
    carry = part >= 10.0**decimals
    number = (whole + carry).astype(np.int64)
    sign = np.where(np.signbit(values), _MINUS, 0).astype(np.uint8)
    cells = joined_cells(
        sign[:, np.newaxis],
        unpadded_digits(number),
        ".",
        digits(np.where(carry, 0.0, part).astype(np.int64), decimals),
    )
    doubtful = np.flatnonzero(large | (np.abs(scaled - np.floor(scaled) - 0.5) < _DOUBT))
    if len(doubtful):
        exact = np.array([f"{value:.{decimals}f}" for value in values[doubtful].tolist()], dtype=np.bytes_)
        cells = cells.astype(np.result_type(cells.dtype, exact.dtype))
        cells[doubtful] = exact
    return cells


def digits(numbers: NDArray[np.int64], count: int) -> Characters:
    """Digits of numbers below 10**count, zeros in front, shape (n, count)."""
    groups = -(-count // 4)
    parts = [_FOUR_DIGITS[numbers // 10000**k % 10000] for k in reversed(range(groups))]
    joined: Characters = np.concatenate(parts, axis=1)[:, 4 * groups - count :]
    return joined


def unpadded_digits(numbers: NDArray[np.int64]) -> Characters:
    """Digits of numbers, filled up in front with zero bytes, shape (n, digits of the largest)."""
    most = len(str(int(numbers.max(initial=0))))
    out = digits(numbers, most)
    # How many digits each has: one more than the powers of ten from 10 on that it reaches.
    count = 1 + np.searchsorted(_POWERS[1:], numbers, side="right")
    out[np.arange(most) < (most - count)[:, np.newaxis]] = 0
    return out


def joined_cells(*parts: Characters | str) -> Cells:
    """Cells of characters of shape (n, m) and of texts that all rows have, side by side."""
    [rows, *_] = [len(part) for part in parts if not isinstance(part, str)]
    sides = [
        np.broadcast_to(np.frombuffer(part.encode(), dtype=np.uint8), (rows, len(part)))
        if isinstance(part, str)
        else part
        for part in parts
    ]
    joined = np.ascontiguousarray(np.concatenate(sides, axis=1))
    return joined.view(f"S{joined.shape[1]}")[:, 0]


def _characters(cells: Any) -> Characters:
    array = np.ascontiguousarray(cells)
    return array.view(np.uint8).reshape(len(array), array.itemsize)
