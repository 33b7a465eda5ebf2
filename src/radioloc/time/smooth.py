"""Functions that vary over days, at many epochs: evaluated at nodes between which they are interpolated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.time.epochs import Epochs

NODES_PER_DAY = 8
_POINTS = 8
_MOST_NODES = 0.5
"""Interpolating is worth it where there are no more nodes than this part of the epochs."""


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


def lagrange_weights(u: NDArray[np.float64]) -> NDArray[np.float64]:
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
