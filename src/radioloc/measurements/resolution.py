"""Resolution of recorded numbers: single precision cannot carry a range or an epoch.

A float32 has 24 bits: a range to the Moon of 8e8 m is rounded to 64 m, a modified Julian date to 5.6 minutes. The type
of a column shows single precision. Where the values were converted since, their bits show it: a double that a float32
can represent occurs once in 5e8 by chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.vectors import Floats

RELATIVE_STEP = 2.0**-23  # largest spacing of single-precision numbers, as a fraction of them

_SINGLE_TYPES = ("float16", "float32", "halffloat", "float")  # of NumPy and pandas, and of Arrow
_CONVERSION_TOLERANCE = 2.0**-50  # relative: what a conversion of units, there and back, leaves of a double
_MIN_DIFFERENT_VALUES = 3  # of a link: round numbers written by hand are representable, too
_SAMPLE_ROWS = 1000  # that exclude most links at once
# Binary places of a modified Julian date in a float32, of a Julian date in a double.
_DATE_FRACTION_BITS = (8, 31)
_MAX_UNUSED_BITS = 4  # the last places that a rounded date leaves empty: evenly divided days leave more
_WHOLE_SECOND_BITS = 7  # 86400 s are 675 times 2^7 s: further binary places of a day make no whole seconds
MIN_RANGE_RATE_M_S = 400.0  # rate of a range by the Earth's rotation, by which an error of its epoch counts


def is_single_precision(column: Any) -> bool:
    """Whether the type of a column of NumPy, pandas, Arrow or astropy is single or half precision."""
    if isinstance(column, list | tuple):
        column = np.asarray(column[:1])
    kind = getattr(column, "type", None) or getattr(column, "dtype", None)
    return str(kind).lower() in _SINGLE_TYPES


def single_precision_step_m(value_m: Floats, unit_m: Floats | float) -> Floats:
    """Spacing in metres of the single-precision numbers near values that are counted in a unit."""
    with np.errstate(over="ignore"):
        return np.spacing(np.abs(value_m / unit_m).astype(np.float32)).astype(np.float64) * unit_m


def single_precision_groups(
    value_m: Floats, sigma_m: Floats, count_s: Floats, group: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """Rows of groups whose values are all rounded by float32 to steps above their sigma, shape (n,)."""
    columns = value_m, sigma_m, count_s
    sampled = slice(None, None, max(1, len(group) // _SAMPLE_ROWS))
    in_any_unit = np.any(
        [single for single, _ in _single_by_unit(*(one[sampled] for one in columns))], axis=0
    )
    candidate = np.ones(int(group.max(initial=-1)) + 1, dtype=bool)
    candidate[group[sampled][~in_any_unit]] = False
    rows = np.flatnonzero(candidate[group])
    found = np.zeros(len(group), dtype=bool)
    for single, decimal in _single_by_unit(*(one[rows] for one in columns)) if len(rows) else ():
        counted_m = np.where(single & ~decimal, value_m[rows], 0.0)
        found[rows] |= _complete(single, group[rows], counted_m)
    return found


def _single_by_unit(
    value_m: Floats, sigma_m: Floats, count_s: Floats
) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Values that float32 represents in steps above sigma, by unit; and which values are round decimal numbers."""
    light_m = (C_M_S * unit_s for unit_s in (1.0, 1e-3, 1e-6, 1e-9))
    units_m: list[Floats | float] = [1.0, 1.0e3, *light_m, count_s]
    for unit_m in units_m:
        value = value_m / unit_m
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            step_m = single_precision_step_m(value_m, unit_m)
            exact = np.abs(value - value.astype(np.float32)) <= _CONVERSION_TOLERANCE * np.abs(value)
            count = value / 10.0 ** np.ceil(np.log10(1.001 * step_m / unit_m))
            round_number = np.abs(count - np.rint(count)) <= _CONVERSION_TOLERANCE * np.abs(count)
        yield exact & (step_m > sigma_m), round_number


def _complete(rounded: NDArray[np.bool_], group: NDArray[np.integer], value_m: Floats) -> NDArray[np.bool_]:
    """Rows of the groups of which all rows are rounded and some values but zero differ."""
    counts = np.bincount(group)
    complete = (np.bincount(group, weights=rounded) == counts) & (counts >= _MIN_DIFFERENT_VALUES)
    for code in np.flatnonzero(complete):
        different = np.unique(value_m[group == code])
        complete[code] = np.count_nonzero(different) >= _MIN_DIFFERENT_VALUES
    return complete[group]


def epoch_step_s(fraction: Floats) -> float:
    """Spacing of the Julian dates of one number to which fractions of a day are all rounded, s, or zero."""
    for bits in _DATE_FRACTION_BITS:
        samples = (np.ldexp(rows, bits) for rows in (fraction[:_SAMPLE_ROWS], fraction))
        if all((sample == np.rint(sample)).all() for sample in samples):
            unused_bits = max(_WHOLE_SECOND_BITS, bits - _MAX_UNUSED_BITS)
            different = np.unique(np.ldexp(fraction, unused_bits))
            if np.count_nonzero(different != np.rint(different)) >= _MIN_DIFFERENT_VALUES:
                return float(SECONDS_PER_DAY * 2.0**-bits)
    return 0.0
