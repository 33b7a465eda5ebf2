"""Numbers with as few digits as give back the same float, in bulk: to the letter what Python's ``repr`` writes.

A decimal number of p digits is a whole number m over a power of ten. It gives back a float if it is nearer to it than
half a unit of the float's last place. The nearest m is found for p = 15, 16 and 17; the first that gives back the float
is what ``repr`` chooses, but for zeros at its end: no two numbers of fifteen digits give the same float, of those with
more ``repr`` takes the nearest, and seventeen are always enough. What is too near to a limit is left to Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from radioloc.io.csv_columns import Cells, digits, unpadded_digits

# Python writes 1e16 and 1e-05 with exponents; m and its power of ten fit in 64 bits.
_SMALLEST, _LARGEST = 1e-4, 1e14
_DECADES = np.array([float(f"1e{k}") for k in range(-4, 15)])
_POWERS = np.array([float(f"1e{k}") for k in range(23)])  # exact
_WHOLE_POWERS = 10 ** np.arange(19, dtype=np.int64)
_PRECISIONS = (15, 16, 17)
# Part of a unit of m, and of a float's half unit, within which a limit is too near.
_DOUBT = 1e-6
# Cuts a float in two of 26 bits each, whose products are exact (Dekker 1971).
_SPLIT = 2.0**27 + 1.0


def shortest_cells(
    values: NDArray[np.float64],
    exponent: int = 0,
    one_by_one: Callable[[float], str] = lambda value: "" if math.isnan(value) else repr(value),
) -> Cells:
    """Numbers with as many digits as give back the same float.

    Parameters
    ----------
    values : ndarray, shape (n,)
    exponent : int
        Write the decimal number divided by ten to this power, 0 to 3.
    one_by_one : callable
        Text of a number of an unusual size; ``repr`` by default, and nothing for NaN.

    Returns
    -------
    ndarray of bytes, shape (n,)
    """
    # Weather and sigmas are mostly the same few numbers; told apart by their bits, so that zero keeps its sign.
    different, which = np.unique(np.ascontiguousarray(values).view(np.int64), return_inverse=True)
    numbers = different.view(np.float64)
    size = np.abs(numbers)
    sure = (size >= _SMALLEST) & (size < _LARGEST)
    # The floats below a power of two are twice as near as those above.
    sure[sure] = np.frexp(size[sure])[0] != 0.5
    mantissa, decimals, doubtful = _decimal(size[sure])
    sure[np.flatnonzero(sure)[doubtful]] = False
    written = _written(numbers[sure], mantissa[~doubtful], decimals[~doubtful] + exponent)
    others = np.array([one_by_one(value) for value in numbers[~sure].tolist()], dtype=np.bytes_)
    cells: Cells = np.empty(len(numbers), dtype=np.result_type(written.dtype, others.dtype))
    cells[sure], cells[~sure] = written, others
    return cells[which]


def _decimal(
    size: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Shortest decimal numbers m / 10**decimals of positive floats, and of which it is not sure."""
    before_point = np.searchsorted(_DECADES, size, side="right") - 4
    half_unit = 0.5 * np.spacing(size)
    mantissa, decimals = np.zeros(len(size), dtype=np.int64), np.zeros(len(size), dtype=np.int64)
    open_, doubtful = np.ones(len(size), dtype=bool), np.zeros(len(size), dtype=bool)
    for precision in _PRECISIONS:
        places = precision - before_point
        power = _POWERS[places]
        high, low = _product(size, power)
        rounded = np.rint(high)
        rest = (high - rounded) + low
        more = np.rint(rest)
        # How far the float is from the nearest m, in units of m.
        away, limit = np.abs(rest - more), half_unit * power
        near = (away > 0.5 - _DOUBT) | (np.abs(away - limit) < _DOUBT * limit)
        found = open_ & ((away < limit) | (precision == _PRECISIONS[-1]))
        doubtful |= open_ & near
        mantissa = np.where(found, rounded.astype(np.int64) + more.astype(np.int64), mantissa)
        decimals = np.where(found, places, decimals)
        open_ &= ~found
    return mantissa, decimals, doubtful


def _product(
    a: NDArray[np.float64], b: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Product of floats and what its rounding has lost, exact (Dekker 1971)."""
    product = a * b
    a_high, b_high = _SPLIT * a, _SPLIT * b
    a_high, b_high = a_high - (a_high - a), b_high - (b_high - b)
    a_low, b_low = a - a_high, b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _written(numbers: NDArray[np.float64], mantissa: NDArray[np.int64], decimals: NDArray[np.int64]) -> Cells:
    """Texts of mantissa / 10**decimals with the sign of numbers, without zeros at the end but one behind the point."""
    if not len(numbers):
        return np.zeros(0, dtype="S1")
    power = _WHOLE_POWERS[np.minimum(decimals, len(_WHOLE_POWERS) - 1)]
    whole = np.where(decimals < len(_WHOLE_POWERS), mantissa // power, 0)
    most = 4 * -(-int(decimals.max()) // 4)
    part = digits(mantissa - whole * power, most).view(np.uint8)
    place, first = np.arange(most), most - decimals
    last = most - 1 - np.argmax((part != ord("0"))[:, ::-1], axis=1)
    last = np.where((part == ord("0")).all(axis=1), first, np.maximum(last, first))
    part[(place < first[:, np.newaxis]) | (place > last[:, np.newaxis])] = 0
    begin = int(first.min())
    groups = -(-len(str(int(whole.max()))) // 4)
    characters = np.empty(
        len(numbers),
        dtype=[
            ("sign", "u1"),
            ("whole", "u4", (groups,)),
            ("point", "u1"),
            ("part", "u1", (most - begin,)),
        ],
    )
    characters["sign"] = np.where(np.signbit(numbers), np.uint8(ord("-")), np.uint8(0))
    characters["whole"] = unpadded_digits(whole, groups)
    characters["point"] = ord(".")
    characters["part"] = part[:, begin:]
    cells: Cells = characters.view(f"S{characters.itemsize}")
    return cells
