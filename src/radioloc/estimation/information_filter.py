"""Process noise: a square-root information filter and smoother.

Stochastic accelerations (:mod:`~radioloc.dynamics.stochastic`) are a process of first order, u_(k+1) = m u_k + w. The
filter runs inward from both ends of the arc, interval by interval. The triangle of the outer intervals, the equation
of the process and the interval's observations are stacked, and Householder reflections eliminate the outer u (Bierman
1977, chapters V and VII; Tapley, Schutz and Born 2004, section 5.10). The remaining rows are free of the process:
independent combinations of the observations, equal to those of a batch fit with the process in its noise. Eliminated
rows are kept for the smoother, which runs outward from the epoch, where the deviation is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from radioloc.dynamics.stochastic import ACROSS, AFTER, BEFORE, Chains, StochasticAccelerations
from radioloc.errors import InputError
from radioloc.noise.covariance import ALONE, ObservationCovariance, SharedAtEpoch
from radioloc.noise.whitening import RowsOf, Whitener
from radioloc.vectors import Floats, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Smoothed stochastic accelerations with their covariance."""

    effects_m: Floats  # (n,), of the accelerations on the observations
    values: Chains  # (K + 1, s), u in its a-priori sigmas
    covariance: Chains  # (K + 1, c + 6 + s, c + 6 + s), of c other parameters, d and u together
    absorbed: float  # degrees of freedom of the observations that the accelerations take


@dataclass(frozen=True, slots=True, eq=False)
class InformationFilter:
    """Whitener of observations with stochastic accelerations among their noise."""

    process: StochasticAccelerations
    used: Indices  # rows of the used observations
    noise: dict[tuple[int, int], Whitener]  # of the observations of each interval, by chain and step

    @classmethod
    def from_observations(
        cls, process: StochasticAccelerations, noise: ObservationCovariance, used: Mask
    ) -> InformationFilter:
        """Filter of used observations; those that share errors belong to one interval."""
        intervals = set(zip(process.chain[used].tolist(), process.step[used].tolist(), strict=True))
        noise_of_interval: dict[tuple[int, int], Whitener] = {
            (chain, step): noise.whitener(used & (process.chain == chain) & (process.step == step))
            for chain, step in intervals
        }
        return cls(process, np.flatnonzero(used), noise_of_interval)

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Yield independent combinations of unit variance, part by part; their number is not that of the rows."""
        return iter(self._swept(rows_of)[0])

    def _swept(self, rows_of: RowsOf) -> tuple[list[Floats], list[list[Floats]], Floats]:
        """Independent combinations; rows eliminated by chain and step (s, 6 + 2s + c); at the epoch (2s, 2s + c)."""
        process, m = self.process, self.process.persistence
        s, growth = process.near.shape[1], np.sqrt(1.0 - m**2)
        columns = rows_of(self.used)
        c = columns.shape[1]
        table = np.zeros((len(process.step), 2 * s + 6 + c))  # far, state, near, columns
        structure = (process.far[self.used], process.by_state[self.used], process.near[self.used], columns)
        table[self.used] = np.hstack(structure)

        def observed(chain: int, step: int) -> list[Floats]:
            noise = self.noise.get((chain, step))
            return [] if noise is None else list(noise.whitened(lambda rows: table[rows]))

        of_process = np.hstack([np.eye(s), np.zeros((s, 6)), -m * np.eye(s), np.zeros((s, c))]) / growth
        combinations, eliminated_rows, epoch_rows = [], [], []
        for chain, transitions in enumerate(process.moved):
            carried, eliminated = np.zeros((0, 6 + s + c)), []
            for step in range(len(transitions) - 1, -1, -1):
                d, u, outer_columns = np.split(carried, [6, 6 + s], axis=1)
                outer_rows = np.hstack([u, d, d @ transitions[step], outer_columns])
                triangle = _triangle([outer_rows, of_process, *observed(chain, step)])
                eliminated.append(triangle[:s])
                carried = triangle[s : 6 + 2 * s, s:]
                combinations.append(triangle[6 + 2 * s :, 6 + 2 * s :])
            eliminated_rows.append(eliminated[::-1])
            epoch_rows.append(carried[:, 6:])
        # At the epoch: the first interval before it, the first behind it, columns.
        zeros = [np.zeros((len(rows), s)) for rows in epoch_rows]
        rows = [
            np.delete(of_process, np.s_[s : s + 6], axis=1),
            np.hstack([np.zeros((s, s)), np.eye(s), np.zeros((s, c))]),
            np.hstack([zeros[AFTER], epoch_rows[AFTER]]),
            np.hstack([epoch_rows[BEFORE][:, :s], zeros[BEFORE], epoch_rows[BEFORE][:, s:]]),
            *(np.delete(block, np.s_[s : s + 6], axis=1) for block in observed(ACROSS, 0)),
        ]
        triangle = _triangle(rows)
        combinations.append(triangle[2 * s :, 2 * s :])
        return [block for block in combinations if len(block)], eliminated_rows, triangle[: 2 * s]

    def smoothed(self, rows_of: RowsOf, residual_m: Floats, covariance: Floats) -> Smoothed:
        """Smooth accelerations from residuals (n,), m, and columns (m, c) of parameters with covariance (c, c)."""
        process, m = self.process, self.process.persistence
        s, c, growth = process.near.shape[1], len(covariance), np.sqrt(1.0 - m**2)
        _, eliminated_rows, at_epoch = self._swept(
            lambda rows: np.column_stack([rows_of(rows), residual_m[rows]])
        )
        # State of the smoother: the other parameters, -1 (whose partials are the residuals), then d and u.
        unit = np.eye(c + 1)
        gain = np.linalg.solve(at_epoch[:, : 2 * s], -at_epoch[:, 2 * s :])
        epoch_root = np.linalg.inv(at_epoch[:, : 2 * s])
        columns_covariance = np.zeros((c + 1, c + 1))
        columns_covariance[:c, :c] = covariance
        epoch_covariance = gain @ columns_covariance @ gain.T + epoch_root @ epoch_root.T
        # Increments w of the process in both directions.
        increment = np.hstack([np.eye(s), -m * np.eye(s)]) / growth
        absorbed = (
            2 * s - np.trace(increment @ epoch_covariance @ increment.T) - np.trace(epoch_covariance[s:, s:])
        )
        values, covariances = [], []
        for chain, transitions in enumerate(process.moved):
            state = slice(s, 2 * s) if chain == AFTER else slice(s)
            transition = np.vstack([unit, np.zeros((6, c + 1)), gain[state]])
            mean = -transition[:, c]
            p = transition @ columns_covariance @ transition.T
            p[-s:, -s:] += (epoch_root @ epoch_root.T)[state, state]
            means, ps = [mean], [p]
            for step, eliminated in enumerate(eliminated_rows[chain]):
                u, d, near_state, columns = np.split(eliminated, [s, s + 6, 2 * s + 6], axis=1)
                own_root = np.linalg.inv(u)
                transition = np.eye(c + 7 + s)
                transition[c + 1 : -s, -s:] = transitions[step]
                transition[-s:] = -own_root @ np.hstack([columns, d, near_state])
                noise_row = transition[-s:].copy()
                noise_row[:, -s:] -= m * np.eye(s)
                absorbed += (
                    s - (np.trace(noise_row @ p @ noise_row.T) + np.trace(own_root @ own_root.T)) / growth**2
                )
                mean, p = transition @ mean, transition @ p @ transition.T
                p[-s:, -s:] += own_root @ own_root.T
                means.append(mean)
                ps.append(p)
            values.append(np.array(means)[:, -s:])
            covariances.append(np.delete(np.delete(np.array(ps), c, axis=1), c, axis=2))
        chains = (values[0], values[1])
        return Smoothed(process.effects_m(chains), chains, (covariances[0], covariances[1]), float(absorbed))


@dataclass(frozen=True, slots=True, eq=False)
class InformationFilters:
    """Whitener of observations of orbits whose stochastic accelerations are independent of each other."""

    filters: tuple[InformationFilter, ...]

    @classmethod
    def from_observations(
        cls, processes: Sequence[StochasticAccelerations], noise: ObservationCovariance, used: Mask
    ) -> InformationFilters:
        """Return filters of each orbit's observations; those of no orbit belong to the first filter."""
        orbit = np.argmax([process.by_state.any(axis=1) for process in processes], axis=0)
        for term in noise.of_type(SharedAtEpoch):
            shared = used & (term.group != ALONE)
            pairs = np.unique(np.stack([term.group, orbit])[:, shared], axis=1)
            if len(np.unique(pairs[0])) < pairs.shape[1]:
                raise InputError(
                    "[estimate.orbit] process_noise: expected observations of one orbit with shared errors at each "
                    "epoch, got several orbits; leave vlbi_station_sigma_m and vlbi_station_rate_sigma_m out"
                )
        masks = (used & (orbit == k) for k in range(len(processes)))
        items = zip(processes, masks, strict=True)
        return cls(
            tuple(InformationFilter.from_observations(process, noise, mask) for process, mask in items)
        )

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Yield independent combinations of unit variance, orbit by orbit."""
        for item in self.filters:
            yield from item.whitened(rows_of)

    def smoothed(self, rows_of: RowsOf, residual_m: Floats, covariance: Floats) -> tuple[Smoothed, ...]:
        """Smooth the accelerations of each orbit; given the parameters, they depend on its observations alone."""
        return tuple(item.smoothed(rows_of, residual_m, covariance) for item in self.filters)


def _triangle(rows: list[Floats]) -> Floats:
    return np.asarray(np.linalg.qr(np.vstack(rows), mode="r"))
