"""Noise that is known beforehand: white errors and first-order processes, each in one observation or in several.

Observation i has the error e_i + sum_k s_ik p_k(t_i): white noise, and processes with signs. A process is stationary
and of first order (Gauss-Markov, with the autocovariance v exp(-|dt| / tau); of a correlation time of zero it is new at
each epoch), or a random walk from when it began; or it holds a value for some time, as of the phase between two counts,
and takes a new one. A Kalman filter whose states are the processes (Kalman 1960; Tapley, Schutz and Born 2004, section
4.9) turns columns of the design matrix into innovations, which over their standard deviations are those of independent
observations: A^T V^-1 A is then exact, at a cost linear in the observations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.observation_noise import ALONE, ObservationNoise, PhaseNoise, RowsOf
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.parameters.rows import networks
from radioloc.vectors import Floats

NONE = -1  # index of no process
_MIN_INNOVATION_FRACTION = 1e-10  # of the variance: below, the observation follows from others
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """An error that changes with time."""

    variance_m2: float = 0.0
    """Of its stationary part."""
    tau_s: float = 0.0
    """Correlation time of that."""
    walk_m2_s: float = 0.0
    """Growth of the variance of a random walk."""
    start_s: float = 0.0
    """When the walk began."""
    hold_s: float = 0.0
    """Time for which a value holds that is taken where the sign is positive; zero of what changes all the time."""


@dataclass(frozen=True, slots=True, eq=False)
class ProcessNoise:
    """Noise of n observations by s processes, of which each observation has up to k."""

    time_s: Floats  # (n,)
    white_m2: Floats  # (n,)
    process: NDArray[np.intp]  # (n, k), index of a process or NONE
    sign: Floats  # (n, k)
    processes: tuple[Process, ...]

    @classmethod
    def stated(cls, noise: ObservationNoise, time_s: Floats) -> ProcessNoise:
        """White noise, what observations of one epoch share, and the phase that contiguous counts share."""
        if noise.phase is not None:
            return cls.stated(replace(noise, phase=None), time_s)._with_phase(noise.phase)
        shared, white_m2 = noise.shared, noise.own_m**2
        if shared is None:
            nothing = np.zeros((len(white_m2), 0))
            return cls(time_s, white_m2, nothing.astype(np.intp), nothing, ())
        mine = shared.group != ALONE
        _, first, group = np.unique(shared.group, return_index=True, return_inverse=True)
        at_s = np.where(mine, time_s[first][group], time_s)  # a group's time tags differ by milliseconds
        process = np.where(mine[:, None] & (shared.effect_m != 0.0), shared.source, NONE)
        count = int(process.max(initial=NONE)) + 1
        return cls(at_s, white_m2, process, shared.effect_m, (Process(1.0),) * count)

    def _with_phase(self, phase: PhaseNoise) -> ProcessNoise:
        """The same with two processes for each run of contiguous counts, which have every other phase between them."""
        rows, first = phase.order, len(self.processes)
        joined = np.append(False, phase.before[rows[1:]] == rows[:-1])
        run = np.cumsum(~joined) - 1
        starts = np.flatnonzero(~joined)
        place = np.arange(len(rows)) - starts[run]
        step_s = np.where(joined, np.diff(self.time_s[rows], prepend=0.0), 0.0)
        hold_s = (1.0 + _ROUNDING) * np.maximum.reduceat(step_s, starts)
        process = np.full((len(self.time_s), 2), NONE)
        sign = np.zeros(process.shape)
        process[:, : self.process.shape[1]], sign[:, : self.sign.shape[1]] = self.process, self.sign
        process[rows] = first + 2 * run[:, None] + (place[:, None] + [0, 1]) % 2
        sign[rows] = [1.0, -1.0]
        variance_m2 = phase.sigma_m[rows[starts]] ** 2
        made = (
            Process(v, hold_s=max(hold, _ROUNDING))
            for v, hold in zip(variance_m2.tolist(), hold_s.tolist(), strict=True)
            for _ in range(2)
        )
        return ProcessNoise(self.time_s, self.white_m2, process, sign, (*self.processes, *made))

    @property
    def sigma_m(self) -> Floats:
        """Standard deviation of each observation, m, shape (n,)."""
        numbers = np.array([(p.variance_m2, p.walk_m2_s, p.start_s) for p in self.processes] or [(0.0,) * 3])
        variance_m2, walk_m2_s, start_s = numbers[self.process].transpose(2, 0, 1)
        of_processes = variance_m2 + walk_m2_s * (self.time_s[:, None] - start_s)
        there = self.process != NONE
        return np.sqrt(self.white_m2 + (self.sign**2 * of_processes * there).sum(axis=1))

    def select(self, rows: NDArray[np.intp]) -> ProcessNoise:
        """Noise of some observations."""
        picked = (self.time_s[rows], self.white_m2[rows], self.process[rows], self.sign[rows])
        return ProcessNoise(*picked, self.processes)

    def among(self, used: NDArray[np.bool_]) -> ProcessWhitening:
        """How those in use are brought to independent ones."""
        return ProcessWhitening(self, used)

    def networks(self) -> NDArray[np.intp]:
        """Number of the network of processes that an observation belongs to, (n,); NONE of those with white noise."""
        if not self.process.shape[1]:
            return np.full(len(self.time_s), NONE)
        first = self.process.max(axis=1)
        pairs = np.stack([np.broadcast_to(first[:, None], self.process.shape), self.process], axis=-1)
        network = networks(pairs[self.process != NONE], len(self.processes))
        return np.where(first == NONE, NONE, network[first])


@dataclass(frozen=True, slots=True, eq=False)
class ProcessWhitening:
    """Some observations, brought to independent ones of unit variance by a filter for each network of processes."""

    noise: ProcessNoise
    used: NDArray[np.bool_]

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Innovations over their standard deviations, part by part."""
        from radioloc.estimation._kernels import filter_processes

        noise, network = self.noise, self.noise.networks()
        order = np.argsort(noise.time_s, kind="stable")
        order = order[self.used[order]]
        sigma_m = noise.sigma_m
        numbers = np.array(
            [(p.variance_m2, p.tau_s, p.walk_m2_s, p.start_s, p.hold_s) for p in noise.processes]
        )
        for which in np.unique(network[order]):
            rows = order[network[order] == which]
            parts = np.split(rows, range(ROWS_AT_ONCE, len(rows), ROWS_AT_ONCE))
            if which == NONE:
                for part in parts:
                    yield rows_of(part) / np.sqrt(noise.white_m2[part])[:, None]
                continue
            mine, local = np.unique(noise.process[rows], return_inverse=True)
            local = local.reshape(len(rows), -1) - (mine[0] == NONE)
            variance_m2, tau_s, walk_m2_s, start_s, hold_s = numbers[mine[mine != NONE]].T.copy()
            last_s = noise.time_s[rows[:1]].copy()
            covariance = np.diag(variance_m2 + walk_m2_s * np.maximum(last_s - start_s, 0.0))
            state, begun_s = None, np.full(len(tau_s), -np.inf)
            for k, part in enumerate(parts):
                columns = np.ascontiguousarray(rows_of(part))
                state = np.zeros((len(tau_s), columns.shape[1])) if state is None else state
                here = slice(k * ROWS_AT_ONCE, k * ROWS_AT_ONCE + len(part))
                least_m2 = _MIN_INNOVATION_FRACTION * sigma_m[part] ** 2
                entries = (noise.time_s[part], local[here], noise.sign[part], noise.white_m2[part], least_m2)
                of_processes = (variance_m2, tau_s, walk_m2_s, hold_s, covariance)
                yield filter_processes(*entries, *of_processes, state, last_s, begun_s, columns)
