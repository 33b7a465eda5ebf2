"""Covariance R of the observations: a sum of independent terms.

White noise is on the diagonal. The delays of one epoch between four VLBI stations are six numbers, but each station's
error is in three of them: they are not six independent delays, and observations that share errors at an epoch form a
block

    C = diag(white^2) + A A^T,

with a column of A for each shared error, of unit variance, and in its rows the effect on each observation. Counts of
one continuous phase have the error of the phase at their end less that at their start: contiguous counts share one with
opposite signs, white phase noise makes neighbours correlated by -1/2, and the covariance is tri-diagonal. Processes in
time (:mod:`~radioloc.noise.processes`) make R dense; with one of them a Kalman filter whitens all that belongs
together, shared errors and phases as further states.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.labels import changed
from radioloc.noise.processes import NONE, KalmanFilter, Process, transitions
from radioloc.noise.whitening import Banded, Blocks, Diagonal, Filtered, Rows, Structure, StructuredWhitener
from radioloc.parameters.rows import networks
from radioloc.units import set_fields
from radioloc.vectors import Codes, Floats, Indices, Mask

ALONE = -1
"""Group or link of an observation that shares no error with others."""

_MIN_VARIANCE_RATIO = 1e-10  # of combinations in a block: below, rounding shows in the weights
_MIN_INNOVATION_FRACTION = 1e-10  # of the variance: below, the observation follows from others

Term = TypeVar("Term")


class NoiseTerm(Protocol):
    """Errors of n observations that are independent of those of the other terms.

    A term is a dataclass, whose arrays have a row for each observation.
    """

    @property
    def variance_m2(self) -> Floats:
        """Variance of each observation, m^2, shape (n,)."""

    @property
    def states(self) -> tuple[Indices, Floats]:
        """States of a Kalman filter that each observation has, or NONE, and their signs, both (n, k)."""

    def transitions(self, rows: Rows, step_s: Floats, states: Indices) -> tuple[Floats, Floats]:
        """Decay of some states, and the variances that they gain, from row to row of some rows, both (m, s)."""


@dataclass(frozen=True, slots=True, eq=False)
class White:
    """Independent error of each observation."""

    sigma_m: Floats  #: (n,)

    @property
    def variance_m2(self) -> Floats:
        """Variance of each observation, m^2, shape (n,)."""
        return np.square(self.sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class SharedAtEpoch:
    """Errors that observations of an epoch share, such as errors of stations in delays."""

    group: Indices | Codes  #: (n,), number of the epoch; ALONE for observations without shared errors
    source: Indices | Codes  #: (n, k), such as indices of stations
    effect_m: Floats  #: (n, k), signed effect of one standard deviation of each source

    def __post_init__(self) -> None:
        if not np.isfinite(self.effect_m).all():
            raise InputError("an effect of a shared error is not finite; give its standard deviation, m")

    @property
    def variance_m2(self) -> Floats:
        """Variance of each observation, m^2, shape (n,)."""
        rows = np.arange(len(self.group))[:, None]
        return np.where(self.group == ALONE, 0.0, self.covariance_m2(rows)[:, 0, 0])

    def covariance_m2(self, rows: Indices) -> Floats:
        """Covariance of observations (b, k), each of the b in one group, shape (b, k, k)."""
        source, effect_m = self.source[rows], self.effect_m[rows]
        covariance = np.zeros((*rows.shape, rows.shape[1]))
        for i in range(source.shape[2]):
            for j in range(source.shape[2]):
                is_common = source[:, :, None, i] == source[:, None, :, j]
                covariance += is_common * effect_m[:, :, None, i] * effect_m[:, None, :, j]
        return covariance

    @property
    def states(self) -> tuple[Indices, Floats]:
        """Sources as states."""
        shared = (self.group[:, None] != ALONE) & (self.effect_m != 0.0)
        return np.where(shared, self.source, NONE), self.effect_m

    def transitions(self, rows: Rows, step_s: Floats, states: Indices) -> tuple[Floats, Floats]:
        """Transitions to new states at the first row of each group."""
        decay, shared_rows = np.ones((len(rows), len(states))), np.flatnonzero(self.group[rows] != ALONE)
        decay[shared_rows[changed(self.group[rows[shared_rows]])]] = 0.0
        return decay, 1.0 - decay

    def blocks(self, white_m: Floats, rows: Rows) -> Iterator[Blocks]:
        """Yield whiteners of rows (m,) in blocks, one for each size of block."""
        order = rows[np.argsort(self.group[rows], kind="stable")]
        starts = np.flatnonzero(changed(self.group[order]))
        counts = np.diff(starts, append=len(order))
        for size in np.unique(counts):
            block = order[starts[counts == size][:, None] + np.arange(size)]
            new = changed(white_m[block], self.source[block], self.effect_m[block])
            distinct_blocks = block[new]
            covariance = self.covariance_m2(distinct_blocks)
            covariance[:, np.arange(size), np.arange(size)] += white_m[distinct_blocks] ** 2
            variances, axes = np.linalg.eigh(covariance)
            axes_m = np.sqrt(np.maximum(variances, 0.0))
            graded = variances[:, 0] <= _MIN_VARIANCE_RATIO * variances[:, -1]
            if graded.any():
                axes[graded], axes_m[graded] = _graded_axes(covariance[graded])
            flat = np.flatnonzero(axes_m[:, 0] == 0.0)
            if len(flat):
                row = int(distinct_blocks[flat[0], np.argmin(white_m[distinct_blocks[flat[0]]])])
                raise InputError(
                    f"sigma of observation {row} is {white_m[row]:g} m, too small beside the error that it shares "
                    f"with others, {np.abs(self.effect_m[row]).max():g} m; give at least a 10000th of that"
                )
            roots = np.swapaxes(axes / axes_m[:, None, :], 1, 2)
            yield Blocks(block, np.cumsum(new) - 1, roots, axes_m)


def _graded_axes(covariance_m2: Floats) -> tuple[Floats, Floats]:
    """Principal axes (b, k, k) and sigmas (b, k), m, of blocks with sigmas that differ by orders; 0 if singular.

    Eigenvalues of C resolve five orders of the sigmas, singular values of a root of C ten.
    """
    sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
    values, vectors = np.linalg.eigh(covariance_m2 / (sigma_m[:, :, None] * sigma_m[:, None, :]))
    values[values <= _MIN_VARIANCE_RATIO] = 0.0
    axes, axes_m, _ = np.linalg.svd(sigma_m[:, :, None] * vectors * np.sqrt(values)[:, None, :])
    return axes[:, :, ::-1], np.where(values[:, :1] > 0.0, axes_m[:, ::-1], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class DopplerPhase:
    """White noise of the phases whose difference is a Doppler count."""

    sigma_m: Floats  #: (n,), of the phase at either end
    link: Indices  #: (n,), index of the link; ALONE for observations of other types
    start: Indices  #: (n,), number of the phase at the start, in order of time on the link
    end: Indices  #: (n,), number of the phase at the end, which the next count may start with

    @property
    def variance_m2(self) -> Floats:
        """Variance of each observation, m^2, shape (n,)."""
        return np.where(self.link == ALONE, 0.0, 2.0 * self.sigma_m**2)

    def banded(self, white_m: Floats, rows: Rows) -> Banded:
        """Whitener of rows (m,), ordered so that contiguous counts follow each other."""
        from scipy.linalg import cholesky_banded

        start, end = self.start[rows], self.end[rows]
        order = np.lexsort((start, start % (end - start), self.link[rows]))
        rows, start, end = rows[order], start[order], end[order]
        joined = (end[:-1] == start[1:]) & (self.link[rows[:-1]] == self.link[rows[1:]])
        phase_m = self.sigma_m[rows]
        banded = np.zeros((2, len(rows)))
        banded[0] = white_m[rows] ** 2 + 2.0 * phase_m**2
        banded[1, :-1] = np.where(joined, -phase_m[:-1] * phase_m[1:], 0.0)
        return Banded(rows, np.asarray(cholesky_banded(banded, lower=True)))

    @property
    def states(self) -> tuple[Indices, Floats]:
        """Phases as states; the phases of a link reuse a few states in turn."""
        phases = np.stack([self.start, self.end], axis=1)
        turns = int((self.end - self.start)[self.link != ALONE].max(initial=0)) + 1
        states = np.where(self.link[:, None] == ALONE, NONE, self.link[:, None] * turns + phases % turns)
        return states, self.sigma_m[:, None] * [-1.0, 1.0]

    def transitions(self, rows: Rows, step_s: Floats, states: Indices) -> tuple[Floats, Floats]:
        """Transitions to new states at the end of each count, and at starts without an earlier count."""
        decay, phase_rows = np.ones((len(rows), len(states))), np.flatnonzero(self.link[rows] != ALONE)
        columns = np.searchsorted(states, self.states[0][rows[phase_rows]])
        start, end = (
            np.stack([self.link, phase], axis=1)[rows[phase_rows]] for phase in (self.start, self.end)
        )
        _, number = np.unique(np.concatenate([start, end]), axis=0, return_inverse=True)
        start_number, end_number = np.split(number.ravel(), 2)
        first = ~np.isin(start_number, end_number)
        decay[phase_rows[first], columns[first, 0]] = 0.0
        decay[phase_rows, columns[:, 1]] = 0.0
        return decay, 1.0 - decay


@dataclass(frozen=True, slots=True, eq=False)
class GaussMarkov:
    """First-order Gauss-Markov processes, each in one observation or in several, with signs."""

    time_s: Floats  #: (n,)
    process: Indices  #: (n, k), index of a process or NONE
    sign: Floats  #: (n, k)
    processes: tuple[Process, ...]

    def _numbers(self, which: Indices) -> Floats:
        numbers = [(p.variance_m2, p.tau_s, p.walk_m2_s, p.start_s) for p in self.processes]
        return np.moveaxis(np.array(numbers or [(0.0,) * 4])[which], -1, 0)

    @property
    def variance_m2(self) -> Floats:
        """Variance of each observation, m^2, shape (n,)."""
        variance_m2, _, walk_m2_s, start_s = self._numbers(self.process)
        variance_m2 = variance_m2 + walk_m2_s * (self.time_s[:, None] - start_s)
        return np.asarray((self.sign**2 * variance_m2 * (self.process != NONE)).sum(axis=1))

    @property
    def states(self) -> tuple[Indices, Floats]:
        """Processes as states."""
        return self.process, self.sign

    def transitions(self, rows: Rows, step_s: Floats, states: Indices) -> tuple[Floats, Floats]:
        """Decay and growth of the processes."""
        variance_m2, tau_s, walk_m2_s, start_s = self._numbers(states)
        decay, added = transitions(step_s, variance_m2, tau_s)
        walks = walk_m2_s > 0.0
        decay[1:, walks] = 1.0
        added[:, walks] = walk_m2_s[walks] * step_s[:, None]
        added[:1] = variance_m2 + walk_m2_s * np.maximum(self.time_s[rows[:1], None] - start_s, 0.0)
        return decay, added


@dataclass(frozen=True, eq=False)
class ObservationCovariance:
    """Covariance R of n observations; :class:`InputError` if it is not positive definite."""

    terms: tuple[White | NoiseTerm, ...]
    white_m: Floats = field(init=False)  #: (n,), sigma of the white terms together
    sigma_m: Floats = field(init=False)  #: (n,), of all terms together

    def __post_init__(self) -> None:
        white_terms_m = [term.sigma_m for term in self.of_type(White)]
        structured_m2 = [term.variance_m2 for term in self._structured]
        counts = list(map(len, white_terms_m + structured_m2))
        if len(set(counts)) != 1:
            raise InputError(f"terms of the noise: expected equal numbers of observations, got {counts}")
        white_m = np.sqrt(sum(map(np.square, white_terms_m), np.zeros(counts[0])))
        if len(white_terms_m) == 1:  # large arcs have one, whose array is that of the observations
            white_m = white_terms_m[0]
        variance_m2 = sum(structured_m2, np.square(white_m))
        bad = np.flatnonzero(~(np.isfinite(variance_m2) & (variance_m2 > 0.0)))
        if len(bad):
            sigma_m = np.sqrt(variance_m2[bad[0]])
            raise InputError(f"sigma of observation {bad[0]} is {sigma_m} m; give a finite positive number")
        set_fields(self, white_m=white_m, sigma_m=np.sqrt(variance_m2) if structured_m2 else white_m)

    @classmethod
    def from_sigma(cls, noise: ArrayLike | ObservationCovariance, n: int) -> ObservationCovariance:
        """Covariance of n observations from standard deviations (n,) or (), m, or from a covariance."""
        if isinstance(noise, ObservationCovariance):
            if len(noise) != n:
                raise InputError(f"noise: expected {n} observations, got {len(noise)}")
            return noise
        try:
            sigma_m = np.array(np.broadcast_to(np.asarray(noise, dtype=np.float64), (n,)))
        except ValueError:
            raise InputError(f"sigmas of shape {np.shape(noise)} do not belong to {n} observations") from None
        bad = np.flatnonzero(sigma_m < 0.0)
        if len(bad):
            raise InputError(
                f"sigma of observation {bad[0]} is {sigma_m[bad[0]]} m; give a finite positive number"
            )
        return cls((White(sigma_m),))

    def __len__(self) -> int:
        return len(self.sigma_m)

    def of_type(self, kind: type[Term]) -> tuple[Term, ...]:
        """Terms of one type."""
        return tuple(term for term in self.terms if isinstance(term, kind))

    @property
    def _structured(self) -> tuple[NoiseTerm, ...]:
        return tuple(term for term in self.terms if not isinstance(term, White))

    def plus(self, *terms: White | NoiseTerm) -> ObservationCovariance:
        """Covariance with further independent terms."""
        return ObservationCovariance((*self.terms, *terms))

    def select(self, rows: Rows) -> ObservationCovariance:
        """Covariance of some of the observations."""
        return ObservationCovariance(tuple(_selected(term, rows) for term in self.terms))

    def whitener(self, used: Mask | None = None, order: Rows | None = None) -> StructuredWhitener:
        """Whitener of the used observations, by default all; independent ones in a given order of the rows (n,)."""
        used = np.ones(len(self), dtype=bool) if used is None else used
        shared, phases = self.of_type(SharedAtEpoch), self.of_type(DopplerPhase)
        if len(shared) + len(phases) < len(self._structured):
            return StructuredWhitener(len(self), tuple(self._filtered(used)))
        of_shared = [used & (term.group != ALONE) for term in shared]
        of_phases = [used & (term.link != ALONE) for term in phases]
        independent = used & ~np.any([~used, *of_shared, *of_phases], axis=0)
        rows = np.flatnonzero(independent).astype(np.int32) if order is None else order[independent[order]]
        structures: list[Structure] = [Diagonal(rows, self.white_m)] if len(rows) else []
        for term, members in zip(shared, of_shared, strict=True):
            if members.any():
                structures += term.blocks(self.white_m, np.flatnonzero(members))
        for phase, members in zip(phases, of_phases, strict=True):
            if members.any():
                structures.append(phase.banded(self.white_m, np.flatnonzero(members)))
        return StructuredWhitener(len(self), tuple(structures))

    @cached_property
    def _networks(self) -> tuple[Indices, Floats, list[int], Floats, Rows, Indices]:
        """Processes and signs (n, k), first process of each term, epochs in s (n,), order in time, networks (n,)."""
        processes, signs, first = [], [], [0]
        time_s, groups = np.zeros(len(self)), list[Indices | Codes]()
        for term in self._structured:
            process, sign = term.states
            processes.append(np.where(process == NONE, NONE, process + first[-1]))
            signs.append(sign)
            first.append(first[-1] + int(process.max(initial=NONE)) + 1)
            time_s = getattr(term, "time_s", time_s)
        for shared in self.of_type(SharedAtEpoch):
            _, of_group, group_index = np.unique(shared.group, return_index=True, return_inverse=True)
            # Time tags of a group differ by milliseconds.
            time_s = np.where(shared.group == ALONE, time_s, time_s[of_group][group_index])
            groups.append(shared.group)
        process, sign = np.hstack(processes), np.hstack(signs)
        largest = process.max(axis=1, initial=NONE)
        pairs = np.stack([np.broadcast_to(largest[:, None], process.shape), process], axis=-1)
        network = np.where(largest == NONE, NONE, networks(pairs[process != NONE], first[-1])[largest])
        return process, sign, first, time_s, np.lexsort((*groups, time_s)), network

    def _filtered(self, used: Mask) -> Iterator[Structure]:
        """Yield a Kalman filter for each network of observations that share processes, and a diagonal."""
        process, sign, first, time_s, order, network = self._networks
        order = order[used[order]]
        for number in np.unique(network[order]).tolist():
            rows = order[network[order] == number]
            if number == NONE:
                yield Diagonal(rows, self.white_m)
                continue
            states = np.unique(process[rows])
            states = states[states != NONE]
            step_s = np.diff(time_s[rows], prepend=time_s[rows[0]])
            parts = [
                term.transitions(rows, step_s, states[(states >= begin) & (states < end)] - begin)
                for term, begin, end in zip(self._structured, first, first[1:], strict=False)
            ]
            decay, added = (np.hstack(arrays) for arrays in zip(*parts, strict=True))
            local = np.where(process[rows] == NONE, NONE, np.searchsorted(states, process[rows]))
            min_variance_m2 = _MIN_INNOVATION_FRACTION * self.sigma_m[rows] ** 2
            white_m2 = self.white_m[rows] ** 2
            yield Filtered(
                rows,
                KalmanFilter.from_processes(local, sign[rows], white_m2, (decay, added), min_variance_m2),
            )


def _selected(term: Any, rows: Rows) -> Any:
    columns = {item.name: getattr(term, item.name) for item in fields(term)}
    return replace(
        term, **{name: column[rows] for name, column in columns.items() if isinstance(column, np.ndarray)}
    )
