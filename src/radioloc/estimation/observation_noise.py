"""The noise of observations: standard deviations, and errors that several observations share.

The one place that knows what the weights of a fit are made of. The delays of one epoch between four VLBI stations are
six numbers, but each station's error is in three of them: they are not six independent delays. Their covariance is

    C = diag(own^2) + A A^T,

with a column of A for each shared error, of unit variance, and in its rows the effect on each observation. Observations
that share errors form a block. Turned to the principal axes of its covariance, the combinations of a block are
independent and take part in a fit as independent observations do: divided by their standard deviation.

Counts of one continuous phase have the error of the phase at their end less that at their start: contiguous counts
share one with opposite signs, and white phase noise makes neighbours correlated by -1/2. Their covariance is
tri-diagonal, and its Cholesky factor brings them to independent ones at a cost that is linear in the counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.labels import changed
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.vectors import Floats

ALONE = -1  # group of an observation that shares no error

Rows = NDArray[np.intp]
"""Indices of observations, in any order."""

RowsOf = Callable[[Rows], Floats]
"""From indices of observations (m,) to numbers that belong to them, such as partials, (m, c)."""

_MIN_VARIANCE_RATIO = 1e-10  # of combinations in a block: below, rounding shows in the weights


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """Errors that each observation shares with others of its group, and their effects on it."""

    group: NDArray[
        np.intp
    ]  # (n,), observations of a group share errors of the same source; ALONE shares none
    source: NDArray[np.intp]  # (n, m), such as indices of stations
    effect_m: Floats  # (n, m), of an error of one standard deviation of each source, with its sign

    def variance_m2(self) -> Floats:
        """What all shared errors together add to the variance of each observation, shape (n,)."""
        each = np.arange(len(self.group))[:, None]
        return np.where(self.group == ALONE, 0.0, self.covariance_m2(each)[:, 0, 0])

    def covariance_m2(self, rows: NDArray[np.intp]) -> Floats:
        """Covariance of observations (b, k), each of the b in one group, shape (b, k, k)."""
        source, effect_m = self.source[rows], self.effect_m[rows]
        covariance = np.zeros((*rows.shape, rows.shape[1]))
        for i in range(source.shape[2]):
            for j in range(source.shape[2]):
                same = source[:, :, None, i] == source[:, None, :, j]
                covariance += same * effect_m[:, :, None, i] * effect_m[:, None, :, j]
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class PhaseNoise:
    """White noise of the phase whose change a count is."""

    sigma_m: Floats  # (n,), of the phase at either end of a count; zero for what has none
    before: NDArray[np.intp]  # (n,), the count of the same sigma at whose end this one begins, or ALONE
    order: NDArray[np.intp]  # (m,), counts with phase noise, each after the one before it

    def factor(self, rows: NDArray[np.intp], own_m: Floats) -> Floats:
        """Cholesky factor of the covariance of some rows (k,) in their order: its diagonal, what is below, (2, k)."""
        from scipy.linalg import cholesky_banded

        phase_m2 = self.sigma_m[rows] ** 2
        banded = np.zeros((2, len(rows)))
        banded[0] = own_m[rows] ** 2 + 2.0 * phase_m2
        banded[1, :-1] = np.where(self.before[rows[1:]] == rows[:-1], -phase_m2[:-1], 0.0)
        return np.asarray(cholesky_banded(banded, lower=True))


def column(values: Floats) -> RowsOf:
    """A number of each observation as a column."""
    return lambda rows: values[rows, None]


def slices(n: int, width: int = 1) -> Iterator[slice]:
    """Some thousand rows after others, fewer where each is of several observations."""
    at_once = max(1, ROWS_AT_ONCE // width)
    return (slice(start, start + at_once) for start in range(0, n, at_once))


def slices_of_chain(factor: Floats) -> Iterator[slice]:
    """Likewise, cut where no row depends on the one before it, so that each can be whitened by itself."""
    cuts, start = np.flatnonzero(factor[1] == 0.0) + 1, 0
    for end in cuts[np.diff(cuts // ROWS_AT_ONCE, append=-1) != 0].tolist():
        yield slice(start, end)
        start = end


def unchained(factor: Floats, values: Floats, *, adjoint: bool = False) -> Floats:
    """Independent combinations of rows (k, c) by the factor (2, k), or the transpose of that."""
    from scipy.linalg import solve_banded

    if adjoint:
        return np.asarray(solve_banded((0, 1), np.stack([np.roll(factor[1], 1), factor[0]]), values))
    return np.asarray(solve_banded((1, 0), factor, values))


@dataclass(frozen=True, slots=True, eq=False)
class ObservationNoise:
    """Covariance of the observations of a fit; :class:`InputError` where it is not positive definite."""

    own_m: Floats  # (n,), sigma of each observation's own, independent error
    shared: SharedErrors | None = None
    blocks: tuple[Block, ...] = field(default=(), repr=False)  # that share errors, those of one size together
    phase: PhaseNoise | None = None  # counts share no other errors
    sigma_m: Floats = field(init=False)  # (n,), all errors together

    def __post_init__(self) -> None:
        bad = np.flatnonzero(~(np.isfinite(self.own_m) & (self.own_m > 0.0)))
        if len(bad):
            raise InputError(
                f"sigma of observation {bad[0]} is {self.own_m[bad[0]]} m; give a finite positive number"
            )
        sigma_m = self.own_m
        if self.shared is not None:
            if self.shared.group.shape != self.own_m.shape:
                raise InputError(
                    f"groups of shared errors have shape {self.shared.group.shape}; "
                    f"{len(self.own_m)} observations need ({len(self.own_m)},)"
                )
            if not np.isfinite(self.shared.effect_m).all():
                raise InputError("an effect of a shared error is not finite; give its standard deviation, m")
            if not self.blocks:
                rows = np.flatnonzero(self.shared.group != ALONE)
                object.__setattr__(self, "blocks", _blocks_of(self.own_m, self.shared, rows))
            sigma_m = np.sqrt(self.own_m**2 + self.shared.variance_m2())
        if self.phase is not None:
            sigma_m = np.sqrt(sigma_m**2 + 2.0 * self.phase.sigma_m**2)
        object.__setattr__(self, "sigma_m", sigma_m)

    @classmethod
    def of(cls, given: ArrayLike | ObservationNoise, n: int) -> ObservationNoise:
        """Noise of n observations from standard deviations (n,) or (), m, or as it is; errors as of the class."""
        if isinstance(given, ObservationNoise):
            if len(given) != n:
                raise InputError(f"noise of {len(given)} observations does not belong to {n} observations")
            return given
        try:
            own_m = np.array(np.broadcast_to(np.asarray(given, dtype=np.float64), (n,)))
        except ValueError:
            raise InputError(f"sigmas of shape {np.shape(given)} do not belong to {n} observations") from None
        return cls(own_m)

    def __len__(self) -> int:
        return len(self.own_m)

    def with_added(self, excess_m: Floats) -> ObservationNoise:
        """Noise with another independent error in each observation, standard deviations (n,), m.

        An error of one size in all observations of a block is one of that size along each of its axes, which stay.
        """
        own_m = np.hypot(self.own_m, excess_m)
        added_m = [excess_m[block.rows] for block in self.blocks]
        if not all((of_block == of_block[0, 0]).all() for of_block in added_m):
            return ObservationNoise(own_m, self.shared, phase=self.phase)
        blocks = (
            replace(block, combined_m=np.hypot(block.combined_m, of_block[0, 0]))
            for block, of_block in zip(self.blocks, added_m, strict=True)
        )
        return ObservationNoise(own_m, self.shared, tuple(blocks), self.phase)

    def among(self, used: NDArray[np.bool_] | None = None) -> Combinations:
        """Independent combinations of the observations in use, all of them by default."""
        used = np.ones(len(self), dtype=bool) if used is None else used
        rows, factor = np.zeros(0, dtype=np.intp), np.zeros((2, 0))
        if self.phase is not None:
            rows = self.phase.order[used[self.phase.order]]
            used = used & (self.phase.sigma_m == 0.0)
            factor = self.phase.factor(rows, self.own_m) if len(rows) else factor
        if self.shared is None:
            return Combinations(self.own_m, used, (), rows, factor)
        blocks: list[Block] = []
        for block in self.blocks:
            kept = used[block.rows]
            whole = np.asarray(kept.all(axis=1))
            if whole.any():
                blocks.append(block if whole.all() else block.select(whole))
            broken = block.rows[~whole]
            blocks += _blocks_of(self.own_m, self.shared, broken[kept[~whole]])
        alone = used & (self.shared.group == ALONE)
        return Combinations(self.own_m, alone, tuple(blocks), rows, factor)


class Whitening(Protocol):
    """Observations in use, brought to independent ones of unit variance."""

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations part by part, from indices of rows (m,) to numbers that belong to them (m, k)."""


@runtime_checkable
class Transposable(Whitening, Protocol):
    """The same where the transposed operation is known: both after each other weigh by the inverse covariance."""

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Rows (m,) part by part, and numbers that belong to them (m, k), from those of independent combinations."""


@dataclass(frozen=True, slots=True, eq=False)
class Combinations:
    """Independent combinations of those observations that are in use; made by :meth:`ObservationNoise.among`."""

    own_m: Floats  # (n,), of all observations
    alone: NDArray[np.bool_]  # (n,), those in use that share no error
    blocks: tuple[Block, ...]  # those that share errors with others in use, and what is left of their blocks
    counts: NDArray[np.intp]  # (k,), those in use with phase noise, in order
    factor: Floats  # (2, k), of their covariance

    def weights(self) -> Floats | None:
        """Weights (n,), zero of those not in use; none where observations share errors."""
        return None if self.blocks or len(self.counts) else np.where(self.alone, self.own_m**-2.0, 0.0)

    def parts(self, rows_of: RowsOf) -> Iterator[tuple[Floats, Floats]]:
        """Independent combinations (m, k) and their standard deviations (m,), m, part by part in their own order."""
        alone = np.flatnonzero(self.alone)
        for some in slices(len(alone)):
            yield rows_of(alone[some]), self.own_m[alone[some]]
        for block in self.blocks:
            for some in slices(*block.rows.shape):
                part = block.select(some)
                values = rows_of(part.rows.ravel()).reshape(*part.rows.shape, -1)
                combined = np.swapaxes(part.axes, 1, 2)[part.which] @ values
                yield combined.reshape(part.rows.size, -1), part.combined_m[part.which].ravel()

    def combined(self, values: Floats) -> tuple[Floats, Floats]:
        """Independent combinations of values (n,) and their standard deviations, m; without counts of a phase."""
        # Added noise is of one size in all combinations but those of counts of a phase.
        parts = list(self.parts(column(values)))
        if not parts:
            return np.zeros(0), np.zeros(0)
        combined, sigma_m = (np.concatenate(column, axis=None) for column in zip(*parts, strict=True))
        return combined, sigma_m

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Combinations over their standard deviations: all are independent and of unit variance."""
        for combined, sigma_m in self.parts(rows_of):
            combined *= (1.0 / sigma_m)[:, None]
            yield combined
        for part in slices_of_chain(self.factor):
            yield unchained(self.factor[:, part], rows_of(self.counts[part]))

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Rows and what the transpose of :meth:`whitened` makes of such parts."""
        part_of, alone = iter(parts), np.flatnonzero(self.alone)
        for some in slices(len(alone)):
            yield alone[some], next(part_of) / self.own_m[alone[some], None]
        for block in self.blocks:
            for some in slices(*block.rows.shape):
                part = block.select(some)
                values = next(part_of).reshape(*part.rows.shape, -1) / part.combined_m[part.which, :, None]
                yield part.rows.ravel(), (part.axes[part.which] @ values).reshape(part.rows.size, -1)
        for some in slices_of_chain(self.factor):
            yield self.counts[some], unchained(self.factor[:, some], next(part_of), adjoint=True)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Blocks of one size, of which most have the covariance of the one before."""

    rows: NDArray[np.intp]  # (b, k), observations of each block
    which: NDArray[np.intp]  # (b,), which of the u covariances is its
    axes: Floats  # (u, k, k), principal axes of the covariance in columns
    combined_m: Floats  # (u, k), standard deviations along the axes

    def select(self, some: NDArray[np.bool_] | slice) -> Block:
        """Some of the blocks."""
        return replace(self, rows=self.rows[some], which=self.which[some])


def _blocks_of(own_m: Floats, shared: SharedErrors, rows: NDArray[np.intp]) -> tuple[Block, ...]:
    """Blocks of some rows (m,) that share errors, those of one size together."""
    if not len(rows):
        return ()
    order = rows[np.argsort(shared.group[rows], kind="stable")]
    starts = np.flatnonzero(changed(shared.group[order]))
    counts = np.diff(starts, append=len(order))
    blocks = []
    for size in np.unique(counts):
        mine = order[starts[counts == size][:, None] + np.arange(size)]
        new = changed(own_m[mine], shared.source[mine], shared.effect_m[mine])
        some = mine[new]
        covariance = shared.covariance_m2(some)
        covariance[:, np.arange(size), np.arange(size)] += own_m[some] ** 2
        variances, axes = np.linalg.eigh(covariance)
        flat = np.flatnonzero(variances[:, 0] <= _MIN_VARIANCE_RATIO * variances[:, -1])
        if len(flat):
            row = int(some[flat[0], np.argmin(own_m[some[flat[0]]])])
            raise InputError(
                f"sigma of observation {row} is {own_m[row]:g} m, too small beside "
                f"the error that it shares with others, {np.abs(shared.effect_m[row]).max():g} m; give at least a "
                "10000th of that"
            )
        blocks.append(Block(mine, np.cumsum(new) - 1, axes, np.sqrt(variances)))
    return tuple(blocks)
