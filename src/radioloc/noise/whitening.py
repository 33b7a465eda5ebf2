"""Whiteners: used observations brought to independent combinations of unit variance.

Each structure of the covariance has its own: a diagonal, blocks of few observations (by their principal axes), a
tri-diagonal matrix (by its banded Cholesky factor), and processes in time (by a Kalman filter). They whiten some
thousand rows after others, as partials of all observations by all parameters may be gigabytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.processes import KalmanFilter
from radioloc.vectors import Floats

Rows = NDArray[np.intp]
"""Indices of observations, in any order."""

RowsOf = Callable[[Rows], Floats]
"""From indices of observations (m,) to numbers that belong to them, such as partials, (m, c)."""


def column(values: Floats) -> RowsOf:
    """Return the function that gives a number of each observation as a column."""
    return lambda rows: values[rows, None]


def slices(n: int, width: int = 1) -> Iterator[slice]:
    """Some thousand rows after others, fewer where each is of several observations."""
    at_once = max(1, ROWS_AT_ONCE // width)
    return (slice(start, start + at_once) for start in range(0, n, at_once))


class Whitener(Protocol):
    """Used observations, brought to independent combinations of unit variance."""

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations part by part, from indices of rows (m,) to numbers that belong to them (m, c)."""


@runtime_checkable
class TransposableWhitener(Whitener, Protocol):
    """Whitener with its transpose: both one after the other weigh by the inverse covariance."""

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Rows (m,) part by part, and numbers that belong to them (m, c), from those of independent combinations."""


class Structure(Protocol):
    """Whitening of those observations that have one structure of covariance."""

    @property
    def rows(self) -> Rows:
        """Observations (n,), or blocks of them (b, k), in the order in which they are whitened."""

    def parts(self) -> Iterator[slice]:
        """Parts of the rows that are whitened one after the other."""

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Independent combinations of the values (m, c) of a part."""

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Values of a part from those of its independent combinations, by the transposed operation."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagonal:
    """Observations that share no error."""

    rows: Rows  # (n,)
    sigma_m: Floats  # (n,)

    def parts(self) -> Iterator[slice]:
        """Some thousand rows after others."""
        return slices(len(self.rows))

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Values over their standard deviations."""
        return values * (1.0 / self.sigma_m[part])[:, None]

    transpose = whiten


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of one size, of which most have the covariance of the one before."""

    rows: Rows  # (b, k), observations of each block
    which: NDArray[np.intp]  # (b,), which of the u covariances is its
    roots: Floats  # (u, k, k), from observations to independent combinations of unit variance
    axes_m: Floats  # (u, k), standard deviations along the principal axes

    def parts(self) -> Iterator[slice]:
        """Some thousand rows after others, in whole blocks."""
        return slices(*self.rows.shape)

    def select(self, some: NDArray[np.bool_] | slice) -> Blocks:
        """Some of the blocks."""
        return replace(self, rows=self.rows[some], which=self.which[some])

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Combinations of each block."""
        roots = self.roots[self.which[part]]
        return np.asarray(roots @ values.reshape(*roots.shape[:2], -1)).reshape(values.shape)

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Combinations of each block by the transposed matrices."""
        roots = np.swapaxes(self.roots, 1, 2)[self.which[part]]
        return np.asarray(roots @ values.reshape(*roots.shape[:2], -1)).reshape(values.shape)

    @property
    def sigma_m(self) -> Floats:
        """Standard deviation along the axis of each combination, m."""
        return self.axes_m[self.which].ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Banded:
    """Observations of which each is correlated with its neighbours in the order of the rows."""

    rows: Rows  # (n,)
    factor: Floats  # (2, n), Cholesky factor of the covariance: its diagonal, and what is below

    def parts(self) -> Iterator[slice]:
        """Some thousand rows after others, cut where no row depends on the one before it."""
        cuts, start = np.flatnonzero(self.factor[1] == 0.0) + 1, 0
        for end in cuts[np.diff(cuts // ROWS_AT_ONCE, append=-1) != 0].tolist():
            yield slice(start, end)
            start = end

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Values divided by the factor."""
        from scipy.linalg import solve_banded

        return np.asarray(solve_banded((1, 0), self.factor[:, part], values))

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Values divided by the transposed factor."""
        from scipy.linalg import solve_banded

        diagonal, below = self.factor[:, part]
        return np.asarray(solve_banded((0, 1), np.stack([np.roll(below, 1), diagonal]), values))


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """Observations whose errors are processes in time."""

    rows: Rows  # (n,), in order of time
    filter: KalmanFilter

    def parts(self) -> Iterator[slice]:
        """All rows together, as each depends on all before it."""
        return iter([slice(len(self.rows))])

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Innovations over their standard deviations."""
        return self.filter.innovations(values)

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Transpose of the filter."""
        return self.filter.adjoint(values)


@dataclass(frozen=True, slots=True, eq=False)
class StructuredWhitener:
    """Whitener of an observation covariance, structure by structure."""

    count: int  # n, observations, used or not
    structures: tuple[Structure, ...]

    def _groups(self) -> Iterator[list[tuple[Structure, slice]]]:
        """Parts of structures whose rows are asked for together, some thousand in all."""
        group: list[tuple[Structure, slice]] = []
        size = 0
        for one in self.structures:
            for part in one.parts():
                size += one.rows[part].size
                if group and size > ROWS_AT_ONCE:
                    yield group
                    group, size = [], one.rows[part].size
                group.append((one, part))
        if group:
            yield group

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations of unit variance, part by part."""
        for group in self._groups():
            rows, ends = _rows_of_group(group)
            values = np.split(rows_of(rows), ends)
            whitened = [one.whiten(part, some) for (one, part), some in zip(group, values, strict=True)]
            yield np.concatenate(whitened) if len(group) > 1 else whitened[0]

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Rows and what the transpose of :meth:`whitened` makes of such parts."""
        for group, of_group in zip(self._groups(), parts, strict=False):
            rows, ends = _rows_of_group(group)
            values = np.split(of_group, ends)
            found = [one.transpose(part, some) for (one, part), some in zip(group, values, strict=True)]
            yield rows, np.concatenate(found)

    @property
    def weights(self) -> Floats | None:
        """Weights (n,), zero of observations that are not used; None where observations share errors."""
        weights = np.zeros(self.count)
        for one in self.structures:
            if not isinstance(one, Diagonal):
                return None
            weights[one.rows] = one.sigma_m**-2.0
        return weights

    @property
    def sigma_m(self) -> Floats | None:
        """Standard deviation of each combination, m; None where it changes with white noise that is added."""
        # White noise of one size in all observations of a block is of that size along each of its axes.
        found = [one.sigma_m for one in self.structures if isinstance(one, Diagonal | Blocks)]
        if len(found) < len(self.structures):
            return None
        return np.concatenate([np.zeros(0), *found])


def _rows_of_group(group: list[tuple[Structure, slice]]) -> tuple[Rows, NDArray[np.intp]]:
    """Rows of parts of structures, and where all but the last of the parts end."""
    rows = [one.rows[part].ravel() for one, part in group]
    return np.concatenate(rows), np.cumsum([len(some) for some in rows])[:-1]
