"""Effects of stochastic accelerations on an orbit and its observations; radial, along, across, constant in intervals.

Intervals are numbered from the epoch of the orbit, in both directions. The effect of all intervals nearer to the epoch
is a deviation d of the state, mapped to the epoch by the state transition matrix (pseudo-epoch state, Bierman 1977,
chapter VII). Observations have equal partials with respect to d and to the state at the epoch, and
d_(k+1) = d_k + G_k u_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.forces import Acceleration
from radioloc.dynamics.gravity_errors import Perturbations
from radioloc.dynamics.orbit import Orbit
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices, rtn_axes

Chains = tuple[Floats, Floats]
"""Values by interval, after the epoch and before it; both numbered from the epoch."""

_MIN_INTERVAL_S = 600.0  # a twelfth of the period of a low orbit
_MAX_INTERVAL_COUNT = 24  # bounds time and memory for long arcs
_SIGMA_M_S2 = 1e-8  # usual error of the modelled accelerations of a low orbit
COLOURS = 3
"""Number of groups of columns; intervals with the same remainder by it share columns, neighbours do not."""

AFTER, BEFORE, ACROSS = range(3)
"""Chain of an observation's intervals; ACROSS the epoch it has an interval of each."""


class StochasticEffects:
    """Effects of accelerations of one sigma, by interval from the orbit's epoch in both directions."""

    def __init__(self, orbit: Orbit, sigma_m_s2: Floats, interval_s: float) -> None:
        # The orbit needs partials with respect to its state; sigmas are radial, along, across.
        self.orbit, self.interval_s = orbit, interval_s
        self.perturbations = Perturbations(
            orbit, lambda tdb: np.swapaxes(rtn_axes(*orbit.states(tdb)), 1, 2) * sigma_m_s2
        )
        first_s, last_s = orbit.span_s
        edges = []
        for end_s in (last_s, first_s):
            edges_s = np.append(np.sign(end_s) * np.arange(0.0, abs(end_s), interval_s), end_s)
            edges.append(self.perturbations.mapped_to_epoch(orbit.epoch.shifted(edges_s)))
        self._edges = edges
        # Effects of one sigma on the state mapped to the epoch, shape (K, 6, 3), by interval after and before it.
        self.moved = (np.diff(edges[0], axis=0), np.diff(edges[1], axis=0))

    def intervals(self, tdb: Epochs) -> tuple[Indices, Indices, Floats]:
        """Return chain (0 after, 1 before the epoch), step and effect of the interval of each epoch, (n, 6, 3)."""
        times_s = tdb.seconds_since(self.orbit.epoch)
        chain = (times_s < 0.0).astype(np.intp)
        last = np.array([len(effects) for effects in self.moved]) - 1
        step = np.minimum((abs(times_s) / self.interval_s).astype(np.intp), last[chain])
        begun = np.empty((len(step), 6, 3))
        for k, edges in enumerate(self._edges):
            begun[chain == k] = edges[step[chain == k]]
        effect = self.orbit.partials(tdb)[:, :, :6] @ (self.perturbations.mapped_to_epoch(tdb) - begun)
        return chain, step, effect

    def state_partials(self, tdb: Epochs) -> Floats:
        """Return partials of states with respect to the state at the epoch and near accelerations, (n, 6, 15)."""
        # An interval and the preceding one have the columns of their remainders by three; the others are zero.
        chain, step, effect = self.intervals(tdb)
        transition = self.orbit.partials(tdb)[:, :, :6]
        out = np.zeros((len(step), 6, COLOURS, 3))
        colour, rows = colours(chain, step), np.arange(len(step))
        out[rows, :, colour] = effect
        for k, moved in enumerate(self.moved):
            rows = np.flatnonzero((chain == k) & (step > 0))
            out[rows, :, colours(chain[rows], step[rows] - 1)] = transition[rows] @ moved[step[rows] - 1]
        return np.concatenate([transition, out.reshape(len(step), 6, -1)], axis=2)


def colours(chain: Indices, step: Indices) -> Indices:
    """Return the index of the group of columns of an interval, 0 to 2."""
    return np.where(chain == 0, step, -1 - step) % COLOURS


def stochastic_forces(epoch: Epochs, values_m_s2: Chains, interval_s: float) -> tuple[Acceleration, ...]:
    """Return accelerations (K, 3) of intervals after and before the epoch as forces."""
    later, earlier = values_m_s2
    return tuple(
        Acceleration(
            f"process_{k:+d}",
            constant_m_s2=(float(value[0]), float(value[1]), float(value[2])),
            start=epoch.shifted(k * interval_s),
            stop=epoch.shifted((k + 1) * interval_s),
        )
        for k, value in enumerate([*earlier[::-1], *later], -len(earlier))
    )


@dataclass(frozen=True, slots=True, eq=False)
class StochasticAccelerations:
    """Effects of accelerations u (s components, in their sigmas) on n observations."""

    # Each observation depends on the deviation d at the start of its interval, on u of that interval (near) and of the
    # next interval (far). Across the epoch d is zero, near is the interval after it, far the interval before it.

    chain: NDArray[np.int8]  # AFTER, BEFORE or ACROSS, shape (n,)
    step: Indices  # interval in its chain, shape (n,)
    by_state: Floats  # partials with respect to the state at the epoch, m and m/m/s, shape (n, 6)
    near: Floats  # partials with respect to u, shape (n, s)
    far: Floats
    moved: Chains  # G, effects of u on the state mapped to the epoch, shapes (K, 6, s)
    persistence: float  # correlation of u in successive intervals, exp(-interval / correlation time)
    reference: Chains  # u of the integrated orbit, shapes (K + 1, s)

    def deviations(self, values: Chains) -> Chains:
        """Return d at the start of intervals, shapes (K + 1, 6), by u, shapes (K + 1, s)."""
        later, earlier = (
            np.concatenate([np.zeros((1, 6)), np.cumsum((moved @ u[:-1, :, None])[:, :, 0], axis=0)])
            for moved, u in zip(self.moved, values, strict=True)
        )
        return later, earlier

    def effects_m(self, values: Chains) -> Floats:
        """Return the effects of u on the observations, m, shape (n,)."""
        out = np.zeros(len(self.step))
        for chain, (d, u) in enumerate(zip(self.deviations(values), values, strict=True)):
            rows = self.chain == chain
            k = self.step[rows]
            for partials, by in ((self.by_state, d[k]), (self.near, u[k]), (self.far, u[k + 1])):
                out[rows] += (partials[rows] * by).sum(axis=1)
        rows = self.chain == ACROSS
        out[rows] = self.near[rows] @ values[AFTER][0] + self.far[rows] @ values[BEFORE][0]
        return out


def interval_accelerations(orbit: Orbit) -> Perturbations:
    """Return the perturbations of an orbit by accelerations of a usual size, constant in intervals of its span."""
    first_s, last_s = orbit.flight_s
    count = min(max(int((last_s - first_s) / _MIN_INTERVAL_S), 1), _MAX_INTERVAL_COUNT)
    edges_s = np.linspace(first_s, last_s, count + 1)[1:-1]

    def accelerations(tdb: Epochs) -> Floats:
        interval = np.searchsorted(edges_s, tdb.seconds_since(orbit.epoch))
        out = np.zeros((len(interval), count, 3, 3))
        out[np.arange(len(interval)), interval] = rtn_axes(*orbit.states(tdb)) * _SIGMA_M_S2
        return np.swapaxes(out.reshape(len(interval), -1, 3), 1, 2)

    return Perturbations(orbit, accelerations)
