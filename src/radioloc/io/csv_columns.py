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
Packed = NDArray[np.unsignedinteger[Any]]
"""Characters of two or four digits as one unsigned integer, in the order of the memory."""

# So many that array functions cost little beside their work, so few that a block stays in the processor's cache.
_ROWS_AT_ONCE = 16384
_MINUS = ord("-")
_POWERS = np.array([1000, 100, 10, 1])
_NUMBERS = np.arange(10000)[:, np.newaxis]
_DIGITS = (_NUMBERS // _POWERS % 10 + ord("0")).astype(np.uint8)


def _packed(shown: ArrayLike) -> Packed:
    """Of 0 to 9999, those of the four digits that are shown, zero bytes for the others."""
    return np.where(shown, _DIGITS, np.uint8(0)).view(np.uint32)[:, 0]


_LAST_DIGITS = [_packed(np.arange(4) >= 4 - count) for count in range(5)]
# With zeros in front; without; and zero as nothing, where digits follow.
_FILLED, _UNPADDED, _OR_NOTHING = 0, 10000, 20000
_FOUR_DIGITS = np.concatenate(
    [_LAST_DIGITS[4], _packed(_POWERS // 10 * 10 <= _NUMBERS), _packed(_POWERS <= _NUMBERS)]
)
_TWO_DIGITS: Packed = np.ascontiguousarray(_DIGITS[:100, 2:]).view(np.uint16)[:, 0]
# Above, the whole part and its decimals do not both fit in a float.
_LARGEST_WHOLE = 1e15
# In units of the last decimal: nearer to half way than what the scaling may have rounded.
_DOUBT = 1e-5


def lines_of(
    columns: Sequence[Callable[[slice], Cells]], count: int, separator: bytes = b","
) -> Iterator[bytes]:
    """Lines of text with a separator between their columns, some thousand lines at a time.

    Parameters
    ----------
    columns : sequence of callable
        Gives the texts of some rows of a column.
    count : int
        Rows.
    separator : bytes
        One character; a zero byte is none.
    """
    for start in range(0, count, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, count))
        parts = [column(rows) for column in columns]
        fields: list[tuple[str, Any]] = []
        for k, part in enumerate(parts):
            fields += [(f"cell {k}", part.dtype), (f"end {k}", "S1")]
        table = np.empty(rows.stop - rows.start, dtype=fields)
        for k, part in enumerate(parts):
            table[f"cell {k}"] = part
            table[f"end {k}"] = separator if k + 1 < len(parts) else b"\n"
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


def fixed_cells(values: NDArray[np.float64], decimals: int) -> Cells:
    """Numbers with so many decimals, 1 to 8, the last one rounded as ``%.7f`` does.

    Notes
    -----
    A float less its whole part is exact. Scaled it is rounded by far less than ``_DOUBT`` of the last decimal; what is
    nearer to half way between two texts than that is left to Python.
    """
    size = np.abs(values)
    large = ~(size < _LARGEST_WHOLE)
    size[large] = 0.0
    whole = np.floor(size)
    scaled = (size - whole) * 10.0**decimals
    part = np.rint(scaled)
    doubtful = np.flatnonzero(large | (np.abs(scaled - part) > 0.5 - _DOUBT))
    carry = part >= 10.0**decimals
    whole[carry] += 1.0
    part[carry] = 0.0
    groups = -(-len(f"{whole.max(initial=0.0):.0f}") // 4)
    form = [("sign", "u1"), ("whole", "u4", (groups,)), ("point", "u1"), ("part", "u4", (-(-decimals // 4),))]
    characters = np.empty(len(values), dtype=form)
    characters["sign"] = np.where(np.signbit(values), np.uint8(_MINUS), np.uint8(0))
    characters["whole"] = unpadded_digits(whole, groups)
    characters["point"] = ord(".")
    characters["part"] = digits(part, decimals)
    cells: Cells = characters.view(f"S{characters.itemsize}")
    if len(doubtful):
        exact = np.array([f"{value:.{decimals}f}" for value in values[doubtful].tolist()], dtype=np.bytes_)
        cells = cells.astype(np.result_type(cells.dtype, exact.dtype))
        cells[doubtful] = exact
    return cells


def two_digits(numbers: NDArray[np.int64]) -> Packed:
    """Characters of numbers below 100, shape (n,)."""
    packed: Packed = _TWO_DIGITS[numbers]
    return packed


def digits(numbers: NDArray[Any], count: int) -> Packed:
    """Characters of whole numbers below 10**count, zeros in front, shape (n, count / 4); behind some zero bytes."""
    groups = _fours(numbers, -(-count // 4))
    first = _LAST_DIGITS[count - 4 * (len(groups) - 1)]
    return np.stack([first[groups[0]], *(_FOUR_DIGITS[group] for group in groups[1:])], axis=-1)


def unpadded_digits(numbers: NDArray[Any], groups: int) -> Packed:
    """Characters of whole numbers below 10000**groups, behind zero bytes, shape (n, groups)."""
    packed, begun = [], np.zeros(len(numbers), dtype=bool)
    for k, four in enumerate(_fours(numbers, groups)):
        if k + 1 < groups:
            packed.append(_FOUR_DIGITS[four + np.where(begun, _FILLED, _OR_NOTHING)])
            begun |= four > 0
        else:
            packed.append(_FOUR_DIGITS[four + np.where(begun, _FILLED, _UNPADDED)])
    return np.stack(packed, axis=-1)


def _fours(numbers: NDArray[Any], groups: int) -> list[NDArray[np.intp]]:
    """Digits of whole numbers by fours, the highest first."""
    # Divisions of short integers are several times as quick.
    whole: NDArray[Any] = numbers.astype(np.uint32 if groups <= 2 else np.int64)
    found = []
    for _ in range(groups - 1):
        rest = whole // 10000
        found.append((whole - 10000 * rest).astype(np.intp))
        whole = rest
    return [whole.astype(np.intp), *reversed(found)]
