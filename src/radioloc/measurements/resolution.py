"""Resolution of recorded numbers: columns of single precision, and epochs of a single number.

A float32 has 24 bits: a range to the Moon of 8e8 m is rounded to 64 m, a modified Julian date to 5.6 minutes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.vectors import Floats

RELATIVE_STEP = 2.0**-23  # largest relative spacing of single-precision numbers

_SINGLE_TYPES = ("float16", "float32", "halffloat", "float")  # of NumPy and pandas, and of Arrow
_MIN_DIFFERENT_COUNT = 3  # round epochs written by hand are representable, too
_SAMPLE_SIZE = 1000  # epochs that exclude most tables at once
_DATE_FRACTION_BITS = (8, 31)  # of a modified Julian date in a float32, and of a Julian date in a double
_MAX_UNUSED_BITS = 4  # last bits that are zero in rounded dates; even divisions of days leave more
_WHOLE_SECOND_BITS = 7  # 86400 s are 675 times 2^7 s: further bits of a day are fractions of seconds
MIN_RANGE_RATE_M_S = 400.0  # by the Earth's rotation; converts errors of epochs to errors of ranges


def is_single_precision(column: Any) -> bool:
    """Return whether a column of NumPy, pandas, Arrow or astropy has single or half precision."""
    if isinstance(column, list | tuple):
        column = np.asarray(column[:1])
    kind = getattr(column, "type", None) or getattr(column, "dtype", None)
    return str(kind).lower() in _SINGLE_TYPES


def single_precision_step_m(value_m: Floats, unit_m: Floats | float) -> Floats:
    """Return the spacing of single-precision numbers near values in a unit, m."""
    with np.errstate(over="ignore"):
        return np.spacing(np.abs(value_m / unit_m).astype(np.float32)).astype(np.float64) * unit_m


def epoch_step_s(fraction: Floats) -> float:
    """Return the spacing of Julian dates of a single number, s, if all fractions of a day are its multiples, or 0."""
    for bits in _DATE_FRACTION_BITS:
        samples = (np.ldexp(rows, bits) for rows in (fraction[:_SAMPLE_SIZE], fraction))
        if all((sample == np.rint(sample)).all() for sample in samples):
            unused_bits = max(_WHOLE_SECOND_BITS, bits - _MAX_UNUSED_BITS)
            different = np.unique(np.ldexp(fraction, unused_bits))
            if np.count_nonzero(different != np.rint(different)) >= _MIN_DIFFERENT_COUNT:
                return float(SECONDS_PER_DAY * 2.0**-bits)
    return 0.0
