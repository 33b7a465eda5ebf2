"""The noise of observations: standard deviations, and errors that several observations share.

The one place that knows what the weights of a fit are made of. The delays of one epoch between four VLBI stations are
six numbers, but each station's error is in three of them: they are not six independent delays. Their covariance is

    C = diag(own^2) + A A^T,

with a column of A for each shared error, of unit variance, and in its rows the effect on each observation. Observations
that share errors form a block. Turned to the principal axes of its covariance, the combinations of a block are
independent and take part in a fit as independent observations do: divided by their standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.measurements.predictor import ROWS_AT_ONCE

ALONE = -1
"""Group of an observation that shares no error."""

_FLATTEST = 1e-10
"""Least variance of a combination, in parts of the largest in its block: below, rounding shows in the weights."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """Which errors each observation shares with others of its group, and what they do to it.

    Parameters
    ----------
    group : ndarray of int, shape (n,)
        Observations of the same group share errors of the same source; :data:`ALONE` shares none.
    source : ndarray of int, shape (n, m)
        Sources of the errors, such as indices of stations.
    effect_m : ndarray, shape (n, m)
        What an error of one standard deviation of each source adds to the observation, with its sign, m.
    """

    group: NDArray[np.intp]
    source: NDArray[np.intp]
    effect_m: NDArray[np.float64]

    def select(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> SharedErrors:
        """Those of some observations."""
        return SharedErrors(self.group[which], self.source[which], self.effect_m[which])

    def variance_m2(self) -> NDArray[np.float64]:
        """What all shared errors together add to the variance of each observation, shape (n,)."""
        variance_m2 = np.zeros(len(self.group))
        for i in range(self.source.shape[1]):
            for j in range(self.source.shape[1]):
                same = self.source[:, i] == self.source[:, j]
                variance_m2 += same * self.effect_m[:, i] * self.effect_m[:, j]
        variance_m2[self.group == ALONE] = 0.0
        return variance_m2

    def covariance_m2(self, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """Covariance of observations (b, k), each of the b in one group, shape (b, k, k)."""
        source, effect_m = self.source[rows], self.effect_m[rows]
        covariance = np.zeros((*rows.shape, rows.shape[1]))
        for i in range(source.shape[2]):
            for j in range(source.shape[2]):
                same = source[:, :, None, i] == source[:, None, :, j]
                covariance += same * effect_m[:, :, None, i] * effect_m[:, None, :, j]
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class ObservationNoise:
    """Covariance of the observations of a fit.

    Parameters
    ----------
    own_m : ndarray, shape (n,)
        Standard deviation of each observation's own, independent error, m.
    shared : SharedErrors or None
        Errors shared with other observations; none where ``None``.

    Attributes
    ----------
    sigma_m : ndarray, shape (n,)
        Standard deviation of each observation, all its errors together, m.

    Raises
    ------
    InputError
        An own sigma is not positive and finite, or the shared errors are of another length, not finite, or so much
        larger than the own ones that the block cannot be told from a singular one.
    """

    own_m: NDArray[np.float64]
    shared: SharedErrors | None = None
    sigma_m: NDArray[np.float64] = field(init=False)
    _blocks: tuple[_Block, ...] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        bad = np.flatnonzero(~(np.isfinite(self.own_m) & (self.own_m > 0.0)))
        if len(bad):
            raise InputError(
                f"sigma of observation {bad[0]} is {self.own_m[bad[0]]} m; give a finite positive number"
            )
        blocks = self._blocks
        if self.shared is None:
            blocks = ()
        elif blocks is None:
            if self.shared.group.shape != self.own_m.shape:
                raise InputError(
                    f"groups of shared errors have shape {self.shared.group.shape}; "
                    f"{len(self.own_m)} observations need ({len(self.own_m)},)"
                )
            if not np.isfinite(self.shared.effect_m).all():
                raise InputError("an effect of a shared error is not finite; give its standard deviation, m")
            blocks = _blocks_of(self.own_m, self.shared)
        sigma_m = self.own_m
        if self.shared is not None:
            sigma_m = np.sqrt(self.own_m**2 + self.shared.variance_m2())
        object.__setattr__(self, "sigma_m", sigma_m)
        object.__setattr__(self, "_blocks", blocks)

    @classmethod
    def of(cls, given: ArrayLike | ObservationNoise, n: int) -> ObservationNoise:
        """Noise of n observations from standard deviations (n,) or (), m, or as it is.

        Raises
        ------
        InputError
            The shape is another, or a sigma is not positive and finite.
        """
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

    @property
    def blocks(self) -> tuple[_Block, ...]:
        """Observations that share errors, blocks of one size together."""
        return self._blocks or ()

    def select(self, which: NDArray[np.bool_]) -> ObservationNoise:
        """Noise of some observations alone; those left out drop out of their blocks."""
        return ObservationNoise(self.own_m[which], None if self.shared is None else self.shared.select(which))

    def with_added(self, excess_m: NDArray[np.float64]) -> ObservationNoise:
        """Noise with another independent error in each observation, standard deviations (n,), m.

        An error of one size in all observations of a block is one of that size along each of its axes, which stay.
        """
        own_m = np.hypot(self.own_m, excess_m)
        if self.shared is None:
            return ObservationNoise(own_m)
        blocks: list[_Block] = []
        for block in self.blocks:
            more_m = excess_m[block.rows]
            even = bool((more_m == more_m[:, :1]).all())
            blocks += [block.with_added(more_m)] if even else _blocks_of_rows(own_m, self.shared, block.rows)
        return ObservationNoise(own_m, self.shared, tuple(blocks))

    def among(self, used: NDArray[np.bool_] | None = None) -> Combinations:
        """Independent combinations of the observations in use, all of them by default."""
        if self.shared is None or used is None:
            return Combinations(self, used, self.blocks)
        blocks: list[_Block] = []
        for block in self.blocks:
            kept = used[block.rows]
            whole = np.asarray(kept.all(axis=1))
            if whole.all():
                blocks.append(block)
                continue
            if whole.any():
                blocks.append(block.select(whole))
            broken = block.rows[~whole]
            rows = broken[kept[~whole]]
            if len(rows):
                blocks += _blocks_of(self.own_m[rows], self.shared.select(rows), rows)
        return Combinations(self, used, tuple(blocks))


class Whitening(Protocol):
    """Observations in use, brought to independent ones of unit variance."""

    def whitened(
        self, rows_of: Callable[[NDArray[np.intp]], NDArray[np.float64]]
    ) -> Iterator[NDArray[np.float64]]:
        """Independent combinations part by part, from indices of rows (m,) to numbers that belong to them (m, k)."""


@dataclass(frozen=True, slots=True, eq=False)
class Combinations:
    """Independent combinations of those observations that are in use; made by :meth:`ObservationNoise.among`."""

    noise: ObservationNoise  # of all observations
    used: NDArray[np.bool_] | None  # (n,), those in use; all where None
    blocks: tuple[_Block, ...]  # those that share errors with others in use, and what is left of their blocks

    def weights(self) -> NDArray[np.float64] | None:
        """Weights (n,), zero of those not in use; none where observations share errors."""
        if self.noise.shared is not None:
            return None
        weight = self.noise.own_m**-2.0
        return weight if self.used is None else np.where(self.used, weight, 0.0)

    def rows(self) -> Iterator[tuple[NDArray[np.intp], _Block | None]]:
        """Observations part by part, in an order of their own: rows alone (m,), or of whole blocks (b, k)."""
        group = None if self.noise.shared is None else self.noise.shared.group
        for start in range(0, len(self.noise), ROWS_AT_ONCE):
            part = slice(start, min(start + ROWS_AT_ONCE, len(self.noise)))
            alone = np.ones(part.stop - start, dtype=bool) if group is None else group[part] == ALONE
            if self.used is not None:
                alone &= self.used[part]
            rows = start + np.flatnonzero(alone)
            if len(rows):
                yield rows, None
        for block in self.blocks:
            at_once = max(1, ROWS_AT_ONCE // block.rows.shape[1])
            for start in range(0, len(block.rows), at_once):
                part_of = block.select(slice(start, start + at_once))
                yield part_of.rows, part_of

    def parts(
        self, rows_of: Callable[[NDArray[np.intp]], NDArray[np.float64]]
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Independent combinations, part by part, in an order of their own."""
        for rows, block in self.rows():
            values = rows_of(rows.ravel())
            if block is None:
                yield values, self.noise.own_m[rows]
            else:
                combined = np.swapaxes(block.axes, 1, 2) @ values.reshape(*rows.shape, -1)
                yield combined.reshape(rows.size, -1), block.combined_m.ravel()

    def combined(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Independent combinations of values (n,), such as residuals, and their standard deviations, m, both (m,)."""
        if self.noise.shared is None:
            rows = slice(None) if self.used is None else self.used
            return values[rows], self.noise.own_m[rows]
        parts = list(self.parts(lambda rows: values[rows, None]))
        columns = [np.concatenate(column, axis=None) for column in zip(*parts, strict=True)]
        return (columns[0], columns[1]) if columns else (np.zeros(0), np.zeros(0))

    def whitened(
        self, rows_of: Callable[[NDArray[np.intp]], NDArray[np.float64]]
    ) -> Iterator[NDArray[np.float64]]:
        """Combinations over their standard deviations: all are independent and of unit variance.

        As :meth:`parts`, whose second part is used up.
        """
        for combined, sigma_m in self.parts(rows_of):
            combined *= (1.0 / sigma_m)[:, None]
            yield combined


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Blocks of one size."""

    rows: NDArray[np.intp]  # (b, k), observations of each block
    axes: NDArray[np.float64]  # (b, k, k), principal axes of their covariance in columns
    combined_m: NDArray[np.float64]  # (b, k), standard deviations along the axes

    def select(self, which: NDArray[np.bool_] | slice) -> _Block:
        """Some of the blocks."""
        return _Block(self.rows[which], self.axes[which], self.combined_m[which])

    def with_added(self, excess_m: NDArray[np.float64]) -> _Block:
        """With another independent error (b, k), the same in all observations of a block."""
        return _Block(self.rows, self.axes, np.hypot(self.combined_m, excess_m))


def _blocks_of(
    own_m: NDArray[np.float64], shared: SharedErrors, names: NDArray[np.intp] | None = None
) -> tuple[_Block, ...]:
    """Group observations to blocks, those of one size together; the rows are called by other indices if so asked."""
    order = np.argsort(shared.group, kind="stable")
    order = order[shared.group[order] != ALONE]
    _, starts, counts = np.unique(shared.group[order], return_index=True, return_counts=True)
    blocks: list[_Block] = []
    for size in np.unique(counts):
        rows = order[starts[counts == size][:, None] + np.arange(size)]
        blocks += _blocks_of_rows(own_m, shared, rows, names)
    return tuple(blocks)


def _blocks_of_rows(
    own_m: NDArray[np.float64],
    shared: SharedErrors,
    rows: NDArray[np.intp],
    names: NDArray[np.intp] | None = None,
) -> list[_Block]:
    """Blocks of given rows (b, k), each its own group."""
    size = rows.shape[1]
    axes, combined_m = np.empty((*rows.shape, size)), np.empty(rows.shape)
    diagonal = np.arange(size)
    at_once = max(1, ROWS_AT_ONCE // size)
    for start in range(0, len(rows), at_once):
        part = rows[start : start + at_once]
        covariance = shared.covariance_m2(part)
        covariance[:, diagonal, diagonal] += own_m[part] ** 2
        variances, axes[start : start + at_once] = np.linalg.eigh(covariance)
        flat = np.flatnonzero(variances[:, 0] <= _FLATTEST * variances[:, -1])
        if len(flat):
            row = int(part[flat[0], np.argmin(own_m[part[flat[0]]])])
            raise InputError(
                f"sigma of observation {row if names is None else names[row]} is {own_m[row]:g} m, too small beside "
                f"the error that it shares with others, {np.abs(shared.effect_m[row]).max():g} m; give at least a "
                "10000th of that"
            )
        combined_m[start : start + at_once] = np.sqrt(variances)
    return [_Block(rows if names is None else names[rows], axes, combined_m)]
