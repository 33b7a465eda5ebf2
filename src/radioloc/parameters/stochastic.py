"""Stochastic accelerations of an orbit: how observations depend on accelerations that change by intervals.

The accelerations are constant over batch intervals, counted from the epoch of the orbit, outward both ways. What those
of intervals nearer to the epoch have done to an orbit is a deviation d of its state, mapped to the epoch by the state
transition matrix (the pseudo-epoch state of Bierman 1977, chapter VII): observations have the same partials by it as
by the state at the epoch, and d_(k+1) = d_k + G_k u_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Chains = tuple[Floats, Floats]
"""Numbers by interval, behind the epoch and before it; both outward, from the epoch on."""

AFTER, BEFORE, ACROSS = range(3)
"""Where an observation's intervals are; across the epoch there is one on either side."""


@dataclass(frozen=True, slots=True, eq=False)
class StochasticAccelerations:
    """What accelerations u (s components, in their sigmas) do to n observations.

    Each observation depends on the deviation d with which its interval begins, on u of that interval (near) and of the
    next one outward (far). Across the epoch d is zero, near is the interval behind it, far the one before it.

    Parameters
    ----------
    chain, step : ndarray of int, shape (n,)
        The interval.
    by_state : ndarray, shape (n, 6)
        Partials by the state at the epoch, m and m/m/s.
    near, far : ndarray, shape (n, s)
        Partials by u.
    moved : two of ndarray, shape (K, 6, s)
        G, what u does to the state mapped to the epoch.
    persistence : float
        Correlation of an interval's u with that of the next, exp(-interval / correlation time).
    reference : two of ndarray, shape (K + 1, s)
        The u of the orbit that was integrated.
    """

    chain: NDArray[np.int8]
    step: NDArray[np.intp]
    by_state: Floats
    near: Floats
    far: Floats
    moved: Chains
    persistence: float
    reference: Chains

    def deviations(self, values: Chains) -> Chains:
        """The d with which intervals begin, shapes (K + 1, 6), by u, shapes (K + 1, s)."""
        after, before = (
            np.concatenate([np.zeros((1, 6)), np.cumsum((moved @ u[:-1, :, None])[:, :, 0], axis=0)])
            for moved, u in zip(self.moved, values, strict=True)
        )
        return after, before

    def effects_m(self, values: Chains) -> Floats:
        """What u does to the observations, m, shape (n,)."""
        out = np.zeros(len(self.step))
        for chain, (d, u) in enumerate(zip(self.deviations(values), values, strict=True)):
            mine = self.chain == chain
            k = self.step[mine]
            for partials, by in ((self.by_state, d[k]), (self.near, u[k]), (self.far, u[k + 1])):
                out[mine] += (partials[mine] * by).sum(axis=1)
        mine = self.chain == ACROSS
        out[mine] = self.near[mine] @ values[AFTER][0] + self.far[mine] @ values[BEFORE][0]
        return out
