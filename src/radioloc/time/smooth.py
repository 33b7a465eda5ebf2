"""Functions that vary over days, at many epochs: interpolated between nodes, or as series of polynomials that ship.

Long series of ERFA ship as Chebyshev polynomials over spans of 32 days, which are evaluated thirty times faster, for
1972-01-01 to 2050-01-22, made by ``kernels/make_series.py`` of the sources. Earlier and later the series themselves are
summed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.time.epochs import Epochs
from radioloc.vectors import Floats, chebyshev_sums

NODES_PER_DAY = 8
_POINTS = 8
_MOST_NODES = 0.5  # interpolating is worth it where there are no more nodes than this part of the epochs
FIRST_JD = 2441317.5
SPAN_D = 32.0
_STEP_D = 0.01  # half the step over which rates are differenced where there is no table


def evaluate_smooth(function: Callable[[Epochs], NDArray[Any]], epochs: Epochs) -> NDArray[Any]:
    """Values of an expensive function, shape (n, ...), in which nothing varies faster than in two days; not in UTC.

    Where epochs are dense, it is evaluated at nodes three hours apart and interpolated by Lagrange's polynomial through
    the eight nearest. Half way between nodes h apart, an oscillation of angular frequency w is missed by (1 3 5 7)^2 /
    (2^8 8!) (w h)^8 of its amplitude: of a period of two days by 6e-7, of four by 2e-9, of thirteen (the main short
    term of nutation, 1e-6 rad) by 2e-13.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.time import Epochs, evaluate_smooth
    >>> tt = Epochs.from_jd(2459184.5, np.arange(1440) / 1440, "TT")
    >>> monthly = evaluate_smooth(lambda at: np.sin(2.0 * np.pi * at.centuries_since_j2000() * 36525.0 / 27.3), tt)
    >>> monthly.shape
    (1440,)
    """
    if not len(epochs):
        return function(epochs)
    place = epochs.fraction * NODES_PER_DAY
    first = np.floor(place)
    # Nodes are counted in whole numbers from the first day.
    day = float(epochs.jd.min())
    before = ((epochs.jd - day) * NODES_PER_DAY + first).astype(np.int64)
    earliest = int(before.min())
    before -= earliest
    there = np.bincount(before) > 0
    needed = np.convolve(there, np.ones(_POINTS)) > 0.5
    nodes = np.flatnonzero(needed) + earliest - (_POINTS // 2 - 1)
    if len(nodes) > _MOST_NODES * len(epochs):
        return function(epochs)
    whole, part = np.divmod(nodes, NODES_PER_DAY)
    values = np.asarray(function(Epochs(day + whole, part / NODES_PER_DAY, epochs.scale)))
    around = (np.cumsum(needed) - 1)[before]  # the first of the nodes of each epoch; the others follow
    weights = lagrange_weights(place - first).T
    # One component after the other in memory
    columns = np.ascontiguousarray(values.reshape(len(nodes), -1).T)
    found = np.zeros((len(columns), len(epochs)), dtype=columns.dtype)
    for k in range(_POINTS):
        for of_nodes, into in zip(columns, found, strict=True):
            into += weights[k] * of_nodes[around + k]
    return found.T.reshape(len(epochs), *values.shape[1:])


def lagrange_weights(u: Floats) -> Floats:
    """Weights of the nodes -3 to 4 for a place u among them, best between 0 and 1, shape (n, 8)."""
    nodes = np.arange(_POINTS) - (_POINTS // 2 - 1.0)
    apart = u - nodes[:, None]
    weights = np.ones_like(apart)
    for k in range(1, _POINTS):
        weights[k] = weights[k - 1] * apart[k - 1]  # the product over the nodes before
    after = np.ones_like(u)
    for k in reversed(range(_POINTS)):
        weights[k] *= after / np.prod(np.delete(nodes[k] - nodes, k))
        after *= apart[k]
    return weights.T


def tabulated(table: Floats, epochs: Epochs, series: Callable[[Epochs], ArrayLike]) -> tuple[Floats, Floats]:
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
def table_of(package: str, name: str, text_columns: int = 0) -> Floats:
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
