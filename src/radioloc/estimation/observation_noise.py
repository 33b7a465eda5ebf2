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
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError

ALONE = -1
"""Group of an observation that shares no error."""

_ROWS_AT_ONCE = 20000
"""Rows handled together: bounds the copies made."""

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

    def select(self, which: NDArray[np.bool_]) -> SharedErrors:
        """Those of some observations."""
        return SharedErrors(self.group[which], self.source[which], self.effect_m[which])

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
    _alone: NDArray[np.intp] = field(init=False)
    _blocks: tuple[_Block, ...] = field(init=False)

    def __post_init__(self) -> None:
        bad = np.flatnonzero(~(np.isfinite(self.own_m) & (self.own_m > 0.0)))
        if len(bad):
            raise InputError(
                f"sigma of observation {bad[0]} is {self.own_m[bad[0]]} m; give a finite positive number"
            )
        alone = np.arange(len(self.own_m))
        blocks: tuple[_Block, ...] = ()
        if self.shared is not None:
            if self.shared.group.shape != self.own_m.shape:
                raise InputError(
                    f"groups of shared errors have shape {self.shared.group.shape}; "
                    f"{len(self.own_m)} observations need ({len(self.own_m)},)"
                )
            if not np.isfinite(self.shared.effect_m).all():
                raise InputError("an effect of a shared error is not finite; give its standard deviation, m")
            alone = np.flatnonzero(self.shared.group == ALONE)
            blocks = tuple(_blocks(self.own_m, self.shared))
        sigma_m = self.own_m.copy()
        for block in blocks:
            sigma_m[block.rows] = block.sigma_m
        object.__setattr__(self, "sigma_m", sigma_m)
        object.__setattr__(self, "_alone", alone)
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

    def select(self, which: NDArray[np.bool_]) -> ObservationNoise:
        """Noise of some observations alone; those left out drop out of their blocks."""
        return ObservationNoise(self.own_m[which], None if self.shared is None else self.shared.select(which))

    def with_excess(self, excess_m: NDArray[np.float64]) -> ObservationNoise:
        """Noise with another independent error in each observation, standard deviations (n,), m."""
        return replace(self, own_m=np.hypot(self.own_m, excess_m))

    def combinations(
        self, rows_of: Callable[[NDArray[np.intp]], NDArray[np.float64]]
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Independent combinations of the observations, part by part, in an order of their own.

        Parameters
        ----------
        rows_of : callable
            From indices of observations (m,) to numbers that belong to them, shape (m, k), such as partials and
            residuals side by side.

        Yields
        ------
        combined : ndarray, shape (m, k)
            Of an observation that shares no error, its own row.
        sigma_m : ndarray, shape (m,)
            Their standard deviations, m.
        """
        for start in range(0, len(self._alone), _ROWS_AT_ONCE):
            rows = self._alone[start : start + _ROWS_AT_ONCE]
            yield rows_of(rows), self.own_m[rows]
        for block in self._blocks:
            at_once = max(1, _ROWS_AT_ONCE // block.rows.shape[1])
            for start in range(0, len(block.rows), at_once):
                part = slice(start, start + at_once)
                shape = block.rows[part].shape
                values = rows_of(block.rows[part].ravel()).reshape(*shape, -1)
                combined = (np.swapaxes(block.axes[part], 1, 2) @ values).reshape(shape[0] * shape[1], -1)
                yield combined, block.combined_m[part].ravel()

    def combined(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Independent combinations of values (n,), such as residuals, and their standard deviations, m, both (n,)."""
        parts = list(self.combinations(lambda rows: values[rows, None]))
        columns = [np.concatenate(column, axis=None) for column in zip(*parts, strict=True)]
        return (columns[0], columns[1]) if columns else (np.zeros(0), np.zeros(0))

    def whitened(
        self, rows_of: Callable[[NDArray[np.intp]], NDArray[np.float64]]
    ) -> Iterator[NDArray[np.float64]]:
        """Combinations over their standard deviations: all are independent and of unit variance.

        As :meth:`combinations`, whose second part is used up.
        """
        for combined, sigma_m in self.combinations(rows_of):
            yield combined / sigma_m[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Blocks of one size.

    Parameters
    ----------
    rows : ndarray of int, shape (b, k)
        Observations of each block.
    sigma_m : ndarray, shape (b, k)
        Their standard deviations.
    axes : ndarray, shape (b, k, k)
        Principal axes of their covariance in columns.
    combined_m : ndarray, shape (b, k)
        Standard deviations along the axes.
    """

    rows: NDArray[np.intp]
    sigma_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    combined_m: NDArray[np.float64]


def _blocks(own_m: NDArray[np.float64], shared: SharedErrors) -> Iterator[_Block]:
    """Group observations to blocks, those of one size together."""
    order = np.argsort(shared.group, kind="stable")
    order = order[shared.group[order] != ALONE]
    _, starts, counts = np.unique(shared.group[order], return_index=True, return_counts=True)
    for size in np.unique(counts):
        rows = order[starts[counts == size][:, None] + np.arange(size)]
        covariance = shared.covariance_m2(rows)
        diagonal = np.arange(size)
        covariance[:, diagonal, diagonal] += own_m[rows] ** 2
        variances, axes = np.linalg.eigh(covariance)
        flat = np.flatnonzero(variances[:, 0] <= _FLATTEST * variances[:, -1])
        if len(flat):
            row = int(rows[flat[0], np.argmin(own_m[rows[flat[0]]])])
            raise InputError(
                f"sigma of observation {row} is {own_m[row]:g} m, too small beside the error that it shares with "
                f"others, {np.abs(shared.effect_m[row]).max():g} m; give at least a 10000th of that"
            )
        sigma_m = np.sqrt(covariance[:, diagonal, diagonal])
        yield _Block(rows, sigma_m, axes, np.sqrt(variances))
