"""Whiteners: linear maps of used observations to independent combinations of unit variance.

The map depends on the structure of the covariance: a diagonal, blocks of few observations (principal axes), a
tri-diagonal matrix (banded Cholesky factor), or processes in time (Kalman filter). Rows are whitened in parts, as the
partials of all observations by all parameters may be gigabytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.processes import KalmanFilter
from radioloc.vectors import Floats, Indices, Mask

Rows = NDArray[np.signedinteger[Any]]
"""Indices of observations, in any order."""

RowsOf = Callable[[Rows], Floats]
"""From indices of observations (m,) to numbers that belong to them, such as partials, (m, c)."""


def column(values: Floats) -> RowsOf:
    """Return the function that gives a number of each observation as a column."""
    return lambda rows: values[rows, None]


def slices(n: int, width: int = 1) -> Iterator[slice]:
    """Yield slices of some thousand rows, fewer if each is of several observations."""
    at_once = max(1, ROWS_AT_ONCE // width)
    return (slice(start, start + at_once) for start in range(0, n, at_once))


class Whitener(Protocol):
    """Linear map of the used observations to independent combinations of unit variance."""

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Yield whitened columns, part by part, of the columns (m, c) that `rows_of` gives of rows (m,)."""


@runtime_checkable
class TransposableWhitener(Whitener, Protocol):
    """Whitener L with its transpose: L^T L is the inverse covariance."""

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Yield rows (m,) and the transposed map of whitened columns, (m, c), part by part."""


@runtime_checkable
class LinkedWhitener(Whitener, Protocol):
    """Whitener of structures, the combinations of which a filter may whiten further."""

    @property
    def structures(self) -> tuple[Structure, ...]:
        """Structures of the used observations."""

    @property
    def stated(self) -> StructuredWhitener:
        """Whitener of the structures without the filter."""

    @property
    def filter(self) -> KalmanFilter | None:
        """Filter of all their combinations."""


class Structure(Protocol):
    """Whitener of observations with one structure of covariance."""

    @property
    def rows(self) -> Rows:
        """Rows of the observations (n,), or of blocks of them (b, k), in the order of whitening."""

    def parts(self) -> Iterator[slice]:
        """Yield parts of the rows."""

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Whiten the columns (m, c) of a part."""

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Apply the transposed map to the whitened columns (m, c) of a part."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagonal:
    """Whitener of independent observations."""

    rows: Rows  # (n,)
    white_m: Floats  # standard deviations of all observations, used or not

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations of the observations, m, (n,)."""
        return self.white_m[self.rows]

    def select(self, some: Mask | Rows | slice) -> Diagonal:
        """Select some of the observations."""
        return Diagonal(self.rows[some], self.white_m)

    def parts(self) -> Iterator[slice]:
        """Yield slices of some thousand successive rows."""
        return slices(len(self.rows))

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Values over their standard deviations."""
        return values * (1.0 / self.white_m[self.rows[part]])[:, None]

    transpose = whiten


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Whitener of blocks of k observations, with u different covariances."""

    rows: Rows  # (b, k), observations of each block
    which: Indices  # (b,), index of the covariance of each block
    roots: Floats  # (u, k, k), maps to independent combinations of unit variance
    axes_m: Floats  # (u, k), standard deviations along the principal axes

    def parts(self) -> Iterator[slice]:
        """Yield slices of some thousand successive rows, in whole blocks."""
        return slices(*self.rows.shape)

    def select(self, some: Mask | Rows | slice) -> Blocks:
        """Select some of the blocks."""
        return replace(self, rows=self.rows[some], which=self.which[some])

    def whiten(self, part: slice, values: Floats) -> Floats:
        """Return combinations of each block."""
        roots = self.roots[self.which[part]]
        return np.asarray(roots @ values.reshape(*roots.shape[:2], -1)).reshape(values.shape)

    def transpose(self, part: slice, values: Floats) -> Floats:
        """Return combinations of each block by the transposed matrices."""
        roots = np.swapaxes(self.roots, 1, 2)[self.which[part]]
        return np.asarray(roots @ values.reshape(*roots.shape[:2], -1)).reshape(values.shape)

    @property
    def sigma_m(self) -> Floats:
        """Standard deviation along the axis of each combination, m."""
        return self.axes_m[self.which].ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Banded:
    """Whitener of a tri-diagonal covariance."""

    rows: Rows  # (n,)
    factor: Floats  # (2, n), Cholesky factor of the covariance: diagonal and subdiagonal

    def parts(self) -> Iterator[slice]:
        """Yield slices of some thousand successive rows, cut where no row depends on the one before it."""
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

        diagonal, subdiagonal = self.factor[:, part]
        return np.asarray(solve_banded((0, 1), np.stack([np.roll(subdiagonal, 1), diagonal]), values))


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """Whitener of processes in time."""

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
        return self.filter.adjoint(values.copy())


@dataclass(frozen=True, slots=True, eq=False)
class StructuredWhitener:
    """Whitener of an observation covariance, structure by structure."""

    count: int  #: n, observations, used or not
    structures: tuple[Structure, ...]
    filter: ClassVar[None] = None  # none acts on the combinations

    def _groups(self) -> Iterator[list[tuple[Structure, slice]]]:
        """Yield groups of parts of structures of one type, of some thousand rows each."""
        group: list[tuple[Structure, slice]] = []
        size = 0
        for structure in self.structures:
            for part in structure.parts():
                size += structure.rows[part].size
                if group and (size > ROWS_AT_ONCE or type(structure) is not type(group[-1][0])):
                    yield group
                    group, size = [], structure.rows[part].size
                group.append((structure, part))
        if group:
            yield group

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations of unit variance, part by part."""
        for group in self._groups():
            rows, ends = _rows_of_group(group)
            values = np.split(rows_of(rows), ends)
            whitened = [
                structure.whiten(part, part_values)
                for (structure, part), part_values in zip(group, values, strict=True)
            ]
            yield np.concatenate(whitened) if len(group) > 1 else whitened[0]

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Yield rows and the transposed map of the parts of :meth:`whitened`."""
        for group, of_group in zip(self._groups(), parts, strict=False):
            rows, ends = _rows_of_group(group)
            values = np.split(of_group, ends)
            parts_of_group = [
                structure.transpose(part, part_values)
                for (structure, part), part_values in zip(group, values, strict=True)
            ]
            yield rows, np.concatenate(parts_of_group)

    @property
    def stated(self) -> StructuredWhitener:
        """The whitener itself."""
        return self

    @property
    def sigma_m(self) -> Floats | None:
        """Standard deviation of each combination, m; None if the combinations depend on the white noise."""
        # White noise of one size in all observations of a block is of that size along each of its axes.
        sigmas_m = [
            structure.sigma_m for structure in self.structures if isinstance(structure, Diagonal | Blocks)
        ]
        if len(sigmas_m) < len(self.structures):
            return None
        return np.concatenate([np.zeros(0), *sigmas_m])


def _rows_of_group(group: list[tuple[Structure, slice]]) -> tuple[Rows, Indices]:
    """Rows of parts of structures, and the ends of all parts but the last."""
    rows = [structure.rows[part].ravel() for structure, part in group]
    return np.concatenate(rows), np.cumsum([len(part_rows) for part_rows in rows])[:-1]
