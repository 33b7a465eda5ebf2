"""Numbers out of fields of text, in bulk: each is the float nearest to the text, as Python's own ``float``.

The digits make an integer m, and the number is m / 10**k. Where m is below 2**53 and k at most 22 both are floats,
and one division rounds once (Clinger 1990). A longer m is the sum of two floats, its quotient a float and a
correction whose error is far below what rounding could ask, but for rare numbers half way between two floats.
Those, and all other forms, are left to ``float``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.io.fields import MOST_DIGITS, POWERS, Fields, Places, Words

_MOST_SIGNIFICANT = 19
_EXACT_POWERS = np.array([10.0**k for k in range(23)])
_EXACT_INTEGER = np.uint64(2**53)
# Splits a float into halves whose products are exact (Dekker 1971).
_SPLITTER = 2.0**27 + 1.0
# More than the relative error of the correction, 4 roundings.
_DOUBT = 2.0**-48

_MINUS, _PLUS = ord("-"), ord("+")


def floats(fields: Fields, index: int, *, optional: bool = False) -> NDArray[np.float64]:
    """Numbers of a column, shape (n,).

    Parameters
    ----------
    fields : Fields
    index : int
        The column.
    optional : bool
        Empty fields are NaN.

    Raises
    ------
    ValueError
        A field is not a number.
    """
    start, end = fields.column(index)
    value, known = _decimals(fields, start, end)
    empty = start == end
    if optional and empty.any():
        value[empty] = np.nan
        known |= empty
    if not known.all():
        rest = np.flatnonzero(~known)
        value[rest], known[rest] = _with_exponents(fields, start[rest], end[rest])
        rest = rest[~known[rest]]
        places = zip(start[rest].tolist(), end[rest].tolist(), strict=True)
        value[rest] = [as_float(fields.field(first, last).decode()) for first, last in places]
    return value


def as_float(text: str) -> float:
    """Number that a text is; :class:`ValueError` also for what no other program would read alike."""
    if "_" in text or not text.isascii():
        raise ValueError(f"could not convert {text!r}")
    return float(text)


def _decimals(
    fields: Fields, start: Places, end: Places, power: Places | int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Numbers of digits with a point somewhere, times powers of ten, and which of them are surely right."""
    negative = fields.characters[start] == _MINUS
    point = fields.first(".", start, end)
    whole_digits = point - start - negative
    part_digits = np.maximum(end - point - 1, 0)
    known = np.minimum(whole_digits, part_digits) >= 0
    known &= (np.maximum(whole_digits, part_digits) <= MOST_DIGITS) & (whole_digits + part_digits > 0)
    if not known.all():
        whole_digits, part_digits = np.where(known, whole_digits, 0), np.where(known, part_digits, 0)
    whole, plain = fields.unsigned(point, whole_digits)
    known &= plain
    part, plain = fields.unsigned(end, part_digits)
    known &= plain & ((whole == 0) | (whole_digits + part_digits <= _MOST_SIGNIFICANT))
    integer = whole * POWERS[np.minimum(part_digits, _MOST_SIGNIFICANT)] + part
    value, sure = _scaled(integer, power - part_digits)
    np.negative(value, out=value, where=negative)
    return value, known & sure


def _with_exponents(
    fields: Fields, start: Places, end: Places
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """As :func:`_decimals`, of numbers with an ``e``; others are not known."""
    at = np.minimum(fields.first("e", start, end), fields.first("E", start, end))
    sign = fields.characters[np.minimum(at + 1, end)]
    digits = end - at - 1 - ((sign == _MINUS) | (sign == _PLUS))
    known = (at < end) & (digits > 0) & (digits <= 3)
    size, plain = fields.unsigned(end, np.where(known, digits, 0))
    power = np.where(sign == _MINUS, -1, 1) * size.astype(np.int64)
    value, sure = _decimals(fields, start, at, power)
    return value, known & plain & sure


def _scaled(integer: Words, power: Places) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Float nearest to integer times a power of ten, and which are surely that."""
    scale = _EXACT_POWERS[np.minimum(np.abs(power), len(_EXACT_POWERS) - 1)]
    high = integer.astype(np.float64)
    quotient = high / scale
    value = np.where(power > 0, high * scale, quotient)
    long = integer > _EXACT_INTEGER
    sure = (np.abs(power) < len(_EXACT_POWERS)) & ~(long & (power > 0))
    divided = np.flatnonzero(long & sure & (power < 0))
    if len(divided):
        high, scale, quotient = high[divided], scale[divided], quotient[divided]
        # Wraps around where the float is above the integer, as it must.
        low = (integer[divided] - high.astype(np.uint64)).view(np.int64).astype(np.float64)
        product, error = _exact_product(quotient, scale)
        correction = (((high - product) - error) + low) / scale
        value[divided] = quotient + correction
        least = quotient + correction * (1.0 - _DOUBT)
        most = quotient + correction * (1.0 + _DOUBT)
        sure[divided] = least == most
    return value, sure


def _exact_product(
    a: NDArray[np.float64], b: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Product as the nearest float and what is missing (Dekker 1971)."""
    product = a * b
    a_high, b_high = (x * _SPLITTER - (x * _SPLITTER - x) for x in (a, b))
    a_low, b_low = a - a_high, b - b_high
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
