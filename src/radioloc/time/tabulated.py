"""Long series of ERFA as Chebyshev polynomials over spans of 32 days, which are evaluated thirty times faster.

They ship for 1972-01-01 to 2050-01-22, made by ``kernels/make_series.py`` of the sources. Earlier and later the series
themselves are summed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.chebyshev import chebyshev_sums
from radioloc.constants import SECONDS_PER_DAY
from radioloc.time.epochs import Epochs

FIRST_JD = 2441317.5
SPAN_D = 32.0


_STEP_D = 0.01
"""Half the step over which rates are differenced where there is no table."""


def tabulated(
    table: NDArray[np.float64], epochs: Epochs, series: Callable[[Epochs], ArrayLike]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and rates, 1/s, shapes (k, n), of k functions of time from their table; outside it from their `series`."""
    span, day = np.divmod(epochs.jd - FIRST_JD, SPAN_D)
    inside = (span >= 0.0) & (span < len(table))
    present, which = np.unique(np.where(inside, span, 0.0).astype(np.int64), return_inverse=True)
    coefficients = np.take(table[present].transpose(2, 1, 0), which.reshape(-1), axis=2)
    values, rates = chebyshev_sums(coefficients, 2.0 * (day + epochs.fraction) / SPAN_D - 1.0)
    rates *= 2.0 / (SPAN_D * SECONDS_PER_DAY)
    if not inside.all():
        beyond = epochs[~inside]
        step_s = _STEP_D * SECONDS_PER_DAY
        values[:, ~inside] = series(beyond)
        later, earlier = (np.asarray(series(beyond.shifted(move_s))) for move_s in (step_s, -step_s))
        rates[:, ~inside] = (later - earlier) / (2.0 * step_s)
    return values, rates


@cache
def table_of(package: str, name: str, text_columns: int = 0) -> NDArray[np.float64]:
    """Return a table that ships: ``.npy`` (spans, functions, degrees from the lowest) or rows of ``.csv``."""
    with (files(package) / "data" / name).open("rb") as file:
        if name.endswith(".npy"):
            table = np.load(file)
        else:
            lines = [line for line in file.read().decode().splitlines() if not line.startswith("#")]
            columns = range(text_columns, lines[0].count(",") + 1)
            table = np.loadtxt(lines[1:], delimiter=",", usecols=columns, ndmin=2)
    table.setflags(write=False)
    return np.asarray(table, dtype=np.float64)
