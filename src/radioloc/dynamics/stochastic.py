"""Stochastic accelerations, constant over intervals, radial, along and across: effects on an orbit and its data.

Intervals are counted from the epoch of the orbit, outward both ways. What those of intervals nearer to the epoch have
done to an orbit is a deviation d of its state, mapped to the epoch by the state transition matrix (the pseudo-epoch
state of Bierman 1977, chapter VII): observations have the same partials by it as by the state at the epoch, and
d_(k+1) = d_k + G_k u_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.forces import Acceleration
from radioloc.dynamics.orbit import Orbit
from radioloc.dynamics.perturbations import Perturbations
from radioloc.time import Epochs
from radioloc.vectors import Floats, rtn_axes

Chains = tuple[Floats, Floats]
"""Numbers by interval, behind the epoch and before it; both outward, from the epoch on."""

COLOURS = 3
"""An interval and its two neighbours; those of the same remainder share columns."""

AFTER, BEFORE, ACROSS = range(3)
"""Place of an observation's intervals; across the epoch there is one on either side."""


class StochasticEffects:
    """Effects of accelerations of one sigma in intervals that count from the orbit's epoch, outward both ways."""

    def __init__(self, orbit: Orbit, sigma_m_s2: Floats, interval_s: float) -> None:
        # The orbit has partials by its state; sigmas are radial, along, across.
        self.orbit, self.interval_s = orbit, interval_s
        self.perturbations = Perturbations(
            orbit, lambda moments: np.swapaxes(rtn_axes(*orbit.states(moments)), 1, 2) * sigma_m_s2
        )
        first_s, last_s = orbit.span_s
        edges = []
        for end_s in (last_s, first_s):
            edges_s = np.append(np.sign(end_s) * np.arange(0.0, abs(end_s), interval_s), end_s)
            edges.append(self.perturbations.mapped_to_epoch(orbit.epoch.shifted(edges_s)))
        self._edges = edges
        # Effects of one sigma on the state mapped to the epoch, shape (K, 6, 3), by interval behind it and before it.
        self.moved = (np.diff(edges[0], axis=0), np.diff(edges[1], axis=0))

    def place(self, tdb: Epochs) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
        """Chain (0 behind the epoch, 1 before it), step and effect of the interval that epochs are in, (n, 6, 3)."""
        times_s = tdb.seconds_since(self.orbit.epoch)
        chain = (times_s < 0.0).astype(np.intp)
        last = np.array([len(one) for one in self.moved]) - 1
        step = np.minimum((abs(times_s) / self.interval_s).astype(np.intp), last[chain])
        begun = np.empty((len(step), 6, 3))
        for which, edges in enumerate(self._edges):
            begun[chain == which] = edges[step[chain == which]]
        near = self.orbit.partials(tdb)[:, :, :6] @ (self.perturbations.mapped_to_epoch(tdb) - begun)
        return chain, step, near

    def at(self, tdb: Epochs) -> Floats:
        """Return partials of states by the state at the epoch and by accelerations of near intervals, (n, 6, 15)."""
        # The interval of an epoch and the one inward have the columns of their remainders by three; the third are zero.
        chain, step, near = self.place(tdb)
        transition = self.orbit.partials(tdb)[:, :, :6]
        out = np.zeros((len(step), 6, COLOURS, 3))
        colour, rows = colours(chain, step), np.arange(len(step))
        out[rows, :, colour] = near
        for which, moved in enumerate(self.moved):
            mine = np.flatnonzero((chain == which) & (step > 0))
            out[mine, :, colours(chain[mine], step[mine] - 1)] = transition[mine] @ moved[step[mine] - 1]
        return np.concatenate([transition, out.reshape(len(step), 6, -1)], axis=2)


def colours(chain: NDArray[np.intp], step: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the index of the group of columns of an interval, 0 to 2."""
    return np.where(chain == 0, step, -1 - step) % COLOURS


def stochastic_forces(epoch: Epochs, values_m_s2: Chains, interval_s: float) -> tuple[Acceleration, ...]:
    """Accelerations (K, 3) of intervals behind the epoch and before it, as forces."""
    after, before = values_m_s2
    return tuple(
        Acceleration(
            f"process_{k:+d}",
            constant_m_s2=(float(value[0]), float(value[1]), float(value[2])),
            start=epoch.shifted(k * interval_s),
            stop=epoch.shifted((k + 1) * interval_s),
        )
        for k, value in enumerate([*before[::-1], *after], -len(before))
    )


@dataclass(frozen=True, slots=True, eq=False)
class StochasticAccelerations:
    """Effects of accelerations u (s components, in their sigmas) on n observations."""

    # Each observation depends on the deviation d with which its interval begins, on u of that interval (near) and of
    # the next one outward (far). Across the epoch d is zero, near is the interval behind it, far the one before it.

    chain: NDArray[np.int8]  # AFTER, BEFORE or ACROSS, shape (n,)
    step: NDArray[np.intp]  # interval in its chain, shape (n,)
    by_state: Floats  # partials by the state at the epoch, m and m/m/s, shape (n, 6)
    near: Floats  # partials by u, shape (n, s)
    far: Floats
    moved: Chains  # G, effects of u on the state mapped to the epoch, shapes (K, 6, s)
    persistence: float  # correlation of u in successive intervals, exp(-interval / correlation time)
    reference: Chains  # u of the orbit that was integrated, shapes (K + 1, s)

    def deviations(self, values: Chains) -> Chains:
        """Return the d with which intervals begin, shapes (K + 1, 6), by u, shapes (K + 1, s)."""
        after, before = (
            np.concatenate([np.zeros((1, 6)), np.cumsum((moved @ u[:-1, :, None])[:, :, 0], axis=0)])
            for moved, u in zip(self.moved, values, strict=True)
        )
        return after, before

    def effects_m(self, values: Chains) -> Floats:
        """Return the effects of u on the observations, m, shape (n,)."""
        out = np.zeros(len(self.step))
        for chain, (d, u) in enumerate(zip(self.deviations(values), values, strict=True)):
            mine = self.chain == chain
            k = self.step[mine]
            for partials, by in ((self.by_state, d[k]), (self.near, u[k]), (self.far, u[k + 1])):
                out[mine] += (partials[mine] * by).sum(axis=1)
        mine = self.chain == ACROSS
        out[mine] = self.near[mine] @ values[AFTER][0] + self.far[mine] @ values[BEFORE][0]
        return out
