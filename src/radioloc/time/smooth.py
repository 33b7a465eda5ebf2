"""Functions that vary over days, at many epochs: interpolated between nodes, or as series of polynomials that ship.

Long series of ERFA ship as Chebyshev polynomials over spans of 32 days, which are evaluated thirty times faster, for
1972-01-01 to 2050-01-22 (``kernels/make_series.py`` of the sources makes them). At other epochs the series themselves
are summed.
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
_MAX_NODE_RATIO = 0.5  # of nodes to epochs, above which interpolation is slower
FIRST_JD = 2441317.5
SPAN_D = 32.0
_STEP_D = 0.01  # half the step over which rates are differenced where there is no table


def evaluate_smooth(function: Callable[[Epochs], NDArray[Any]], epochs: Epochs) -> NDArray[Any]:
    """Evaluate an expensive function, shape (n, ...), without variations faster than in two days; not in UTC.

    For dense epochs it is evaluated at nodes every three hours and interpolated by Lagrange's polynomial through the
    nearest eight. Half way between nodes at distance h, the error of an oscillation of angular frequency w is
    (1 3 5 7)^2 / (2^8 8!) (w h)^8 of its amplitude: 6e-7 for a period of two days, 2e-9 for four, 2e-13 for thirteen
    (the main short term of nutation, 1e-6 rad).
    """
    if not len(epochs):
        return function(epochs)
    place = epochs.fraction * NODES_PER_DAY
    first = np.floor(place)
    # Nodes are counted in whole numbers from the first day.
    day = float(epochs.jd.min())
    first_node = ((epochs.jd - day) * NODES_PER_DAY + first).astype(np.int64)
    earliest = int(first_node.min())
    first_node -= earliest
    occupied = np.bincount(first_node) > 0
    needed = np.convolve(occupied, np.ones(_POINTS)) > 0.5
    nodes = np.flatnonzero(needed) + earliest - (_POINTS // 2 - 1)
    if len(nodes) > _MAX_NODE_RATIO * len(epochs):
        return function(epochs)
    node_days, part = np.divmod(nodes, NODES_PER_DAY)
    values = np.asarray(function(Epochs(day + node_days, part / NODES_PER_DAY, epochs.scale)))
    around = (np.cumsum(needed) - 1)[first_node]  # first of the eight nodes of each epoch
    weights = lagrange_weights(place - first).T
    # One component after the other in memory
    columns = np.ascontiguousarray(values.reshape(len(nodes), -1).T)
    interpolated = np.zeros((len(columns), len(epochs)), dtype=columns.dtype)
    for k in range(_POINTS):
        for of_nodes, into in zip(columns, interpolated, strict=True):
            into += weights[k] * of_nodes[around + k]
    return interpolated.T.reshape(len(epochs), *values.shape[1:])


def lagrange_weights(u: Floats) -> Floats:
    """Weights of the nodes -3 to 4 for a place u among them, best between 0 and 1, shape (n, 8)."""
    nodes = np.arange(_POINTS) - (_POINTS // 2 - 1.0)
    distances = u - nodes[:, None]
    weights = np.ones_like(distances)
    for k in range(1, _POINTS):
        weights[k] = weights[k - 1] * distances[k - 1]  # product over the previous nodes
    product = np.ones_like(u)
    for k in reversed(range(_POINTS)):
        weights[k] *= product / np.prod(np.delete(nodes[k] - nodes, k))
        product *= distances[k]
    return weights.T


def tabulated(table: Floats, epochs: Epochs, series: Callable[[Epochs], ArrayLike]) -> tuple[Floats, Floats]:
    """Return values and rates, 1/s, (k, n), of k functions of time from their table; outside it from their `series`."""
    span, day = np.divmod(epochs.jd - FIRST_JD, SPAN_D)
    in_table = (span >= 0.0) & (span < len(table))
    present, indices = np.unique(np.where(in_table, span, 0.0).astype(np.int64), return_inverse=True)
    coefficients = np.take(table[present].transpose(2, 1, 0), indices.reshape(-1), axis=2)
    values, rates = chebyshev_sums(coefficients, 2.0 * (day + epochs.fraction) / SPAN_D - 1.0)
    rates *= 2.0 / (SPAN_D * SECONDS_PER_DAY)
    if not in_table.all():
        beyond = epochs[~in_table]
        step_s = _STEP_D * SECONDS_PER_DAY
        values[:, ~in_table] = series(beyond)
        later, earlier = (np.asarray(series(beyond.shifted(move_s))) for move_s in (step_s, -step_s))
        rates[:, ~in_table] = (later - earlier) / (2.0 * step_s)
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
