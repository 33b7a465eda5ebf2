"""Process noise: a square-root information filter and smoother.

Stochastic accelerations (:mod:`~radioloc.dynamics.stochastic`) are a process of first order, u_(k+1) = m u_k + w. The
filter goes from both ends of the arc inward, interval by interval: the triangle of what lies outside, the process and
the interval's observations stand above each other, and Householder reflections eliminate the outer u (Bierman 1977,
chapters V and VII; Tapley, Schutz and Born 2004, section 5.10). What no unknown of the process is in any more are
independent combinations of the observations, those of a batch fit with the process among its noise; eliminated rows
are kept for the smoother, which goes outward from the epoch, where the deviation is zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.stochastic import ACROSS, AFTER, BEFORE, Chains, StochasticAccelerations
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import RowsOf, Whitener
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Estimates of stochastic accelerations, with their covariance."""

    residual_m: Floats  # (n,), without what they do
    values: Chains  # (K + 1, s), u in its sigmas
    covariance: Chains  # (K + 1, c + 6 + s, c + 6 + s), of the errors of c others, d and u together
    absorbed: float  # degrees of freedom of the observations that they take


@dataclass(frozen=True, slots=True, eq=False)
class InformationFilter:
    """Used observations, brought to independent ones of unit variance with a process among their noise."""

    process: StochasticAccelerations
    used: NDArray[np.intp]
    noise: dict[tuple[int, int], Whitener]  # of the observations of an interval, by chain and step

    @classmethod
    def of(
        cls, process: StochasticAccelerations, noise: ObservationCovariance, used: NDArray[np.bool_]
    ) -> InformationFilter:
        """The filter of some observations; those that share errors are of one interval."""
        found = np.unique(np.stack([process.chain[used], process.step[used]]), axis=1).T
        of_interval: dict[tuple[int, int], Whitener] = {
            (int(chain), int(step)): noise.whitener(used & (process.chain == chain) & (process.step == step))
            for chain, step in found
        }
        return cls(process, np.flatnonzero(used), of_interval)

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations part by part; as many squares as rows, but not as many rows."""
        return iter(self._swept(rows_of)[0])

    def _swept(self, rows_of: RowsOf) -> tuple[list[Floats], list[list[Floats]], Floats]:
        """Independent combinations; rows eliminated by chain and step (s, 6 + 2s + c); at the epoch (2s, 2s + c)."""
        process, m = self.process, self.process.persistence
        s, lasting = process.near.shape[1], np.sqrt(1.0 - m**2)
        columns = rows_of(self.used)
        c = columns.shape[1]
        table = np.zeros((len(process.step), 2 * s + 6 + c))  # far, state, near, columns
        structure = (process.far[self.used], process.by_state[self.used], process.near[self.used], columns)
        table[self.used] = np.hstack(structure)

        def observed(chain: int, step: int) -> list[Floats]:
            noise = self.noise.get((chain, step))
            return [] if noise is None else list(noise.whitened(lambda rows: table[rows]))

        of_process = np.hstack([np.eye(s), np.zeros((s, 6)), -m * np.eye(s), np.zeros((s, c))]) / lasting
        thrown, kept, inner = [], [], []
        for chain, moved in enumerate(process.moved):
            carried, eliminated = np.zeros((0, 6 + s + c)), []
            for step in range(len(moved) - 1, -1, -1):
                d, u, rest = np.split(carried, [6, 6 + s], axis=1)
                outside = np.hstack([u, d, d @ moved[step], rest])
                triangle = _triangle([outside, of_process, *observed(chain, step)])
                eliminated.append(triangle[:s])
                carried = triangle[s : 6 + 2 * s, s:]
                thrown.append(triangle[6 + 2 * s :, 6 + 2 * s :])
            kept.append(eliminated[::-1])
            inner.append(carried[:, 6:])
        # At the epoch: the first interval before it, the first behind it, columns.
        nothing = [np.zeros((len(rows), s)) for rows in inner]
        rows = [
            np.delete(of_process, np.s_[s : s + 6], axis=1),
            np.hstack([np.zeros((s, s)), np.eye(s), np.zeros((s, c))]),
            np.hstack([nothing[AFTER], inner[AFTER]]),
            np.hstack([inner[BEFORE][:, :s], nothing[BEFORE], inner[BEFORE][:, s:]]),
            *(np.delete(one, np.s_[s : s + 6], axis=1) for one in observed(ACROSS, 0)),
        ]
        triangle = _triangle(rows)
        thrown.append(triangle[2 * s :, 2 * s :])
        return [one for one in thrown if len(one)], kept, triangle[: 2 * s]

    def smoothed(self, rows_of: RowsOf, residual_m: Floats, covariance: Floats) -> Smoothed:
        """Estimates from residuals (n,), m; what else acts by columns (m, c) has errors with a covariance (c, c)."""
        process, m = self.process, self.process.persistence
        s, c, lasting = process.near.shape[1], len(covariance), np.sqrt(1.0 - m**2)
        _, kept, at_epoch = self._swept(lambda rows: np.column_stack([rows_of(rows), residual_m[rows]]))
        # The state of the smoother: the others, minus one (of which the residuals are the partials), then d and u.
        unit = np.eye(c + 1)
        of_both = np.linalg.solve(at_epoch[:, : 2 * s], -at_epoch[:, 2 * s :])
        spread = np.linalg.inv(at_epoch[:, : 2 * s])
        begun = np.zeros((c + 1, c + 1))
        begun[:c, :c] = covariance
        there = of_both @ begun @ of_both.T + spread @ spread.T
        new = (
            np.hstack([np.eye(s), -m * np.eye(s)]) / lasting
        )  # what the process has new, one way and the other
        absorbed = 2 * s - np.trace(new @ there @ new.T) - np.trace(there[s:, s:])
        values, covariances = [], []
        for chain, moved in enumerate(process.moved):
            mine = slice(s, 2 * s) if chain == AFTER else slice(s)
            onward = np.vstack([unit, np.zeros((6, c + 1)), of_both[mine]])
            mean = -onward[:, c]
            p = onward @ begun @ onward.T
            p[-s:, -s:] += (spread @ spread.T)[mine, mine]
            means, ps = [mean], [p]
            for step, eliminated in enumerate(kept[chain]):
                u, d, near, others = np.split(eliminated, [s, s + 6, 2 * s + 6], axis=1)
                own = np.linalg.inv(u)
                onward = np.eye(c + 7 + s)
                onward[c + 1 : -s, -s:] = moved[step]
                onward[-s:] = -own @ np.hstack([others, d, near])
                fresh = onward[-s:].copy()
                fresh[:, -s:] -= m * np.eye(s)
                absorbed += s - (np.trace(fresh @ p @ fresh.T) + np.trace(own @ own.T)) / lasting**2
                mean, p = onward @ mean, onward @ p @ onward.T
                p[-s:, -s:] += own @ own.T
                means.append(mean)
                ps.append(p)
            values.append(np.array(means)[:, -s:])
            covariances.append(np.delete(np.delete(np.array(ps), c, axis=1), c, axis=2))
        found = (values[0], values[1])
        left_m = residual_m - process.effects_m(found)
        return Smoothed(left_m, found, (covariances[0], covariances[1]), float(absorbed))


def _triangle(rows: list[Floats]) -> Floats:
    return np.asarray(np.linalg.qr(np.vstack(rows), mode="r"))
