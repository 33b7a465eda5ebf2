"""Partials of dense series as polynomials of time.

The partials A of the observations of a link are smooth functions of time. In cells of some minutes they are A = B C,
with Legendre polynomials B of the epochs and coefficients C from a few of the observations. With the weights W and
residuals r of all observations, the orthogonal factorization of a cell has few rows:

    W B = Q R,    |W (r - B C dx)|^2 = |Q^T W r - R C dx|^2 + constant.

A further observation of each cell tests the polynomials. Elsewhere the partials of each observation are computed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.labels import changed
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.processes import KalmanFilter
from radioloc.noise.whitening import Blocks, Diagonal, Rows, RowsOf, Structure, StructuredWhitener, slices
from radioloc.vectors import Codes, Floats, Indices, Mask

_CELL_S = 256.0  # 1.1 degrees of the Earth's rotation, 13 degrees of a low lunar orbit
_COUNT = 6  # coefficients; the remainder is 1e-9 of the partials along a low lunar orbit
_MIN_ROWS = 2 * _COUNT  # of a cell
_MIN_COVERAGE = 0.6  # part of a cell with observations, so that the polynomials are nearly orthogonal
_DENSE_ROWS_AT_ONCE = 2**16  # whose columns fit the cache of a processor
_SECTION_BLOCKS = 2**18  # whose temporary columns are some megabytes
_TOLERANCE = 1e-9  # of the polynomials, relative to the largest partial by a parameter


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Division of n observations into c cells of one link and some minutes."""

    argument: Floats  # (n,), time in the cell from -1 to 1, the same for all links
    cell: Codes  # (n,), or -1
    nodes: Rows  # (c, d + 1), observations that determine the coefficients, and one that tests them
    inverse: Floats  # (c, d, d), from values at the former to coefficients

    @classmethod
    def from_keys(cls, keys: Sequence[NDArray[Any]], time_s: Floats) -> Cells:
        """Divide observations by keys (n,), the link first, within which partials are smooth, and epochs (n,), s."""
        order = np.argsort(keys[0], kind="stable")
        number, fraction = np.divmod((time_s - time_s.min()) / _CELL_S, 1.0)
        argument, cell = 2.0 * fraction - 1.0, np.full(len(order), -1, dtype=np.int32)
        new = changed(number[order])
        for key in keys:
            new |= False if key.strides == (0,) else changed(np.nan_to_num(key)[order])
        starts = np.flatnonzero(new)
        counts = np.diff(starts, append=len(order))
        is_ascending = np.add.reduceat(np.diff(argument[order], append=1.0) < 0.0, starts) <= 1
        ends = argument[order[[starts, starts + counts - 1]]]
        dense = (counts >= _MIN_ROWS) & (ends[1] - ends[0] >= 2.0 * _MIN_COVERAGE) & is_ascending
        starts, numbers = starts[dense], np.where(dense, np.cumsum(dense) - 1, -1)
        cell[order] = np.repeat(numbers, counts)
        places = np.append(0.5 - 0.5 * np.cos(np.pi * np.arange(_COUNT) / (_COUNT - 1)), 0.5)
        nodes = order[starts[:, None] + np.rint(places * (counts[dense, None] - 1)).astype(int)]
        inverse = np.linalg.inv(_polynomials(argument[nodes[:, :-1]]))
        return cls(argument, cell, nodes, np.asarray(inverse, dtype=np.float64))

    def basis(self, rows: Rows) -> Floats:
        """Legendre polynomials at the epochs of some observations, shape (..., d)."""
        return _polynomials(self.argument[rows])


def _polynomials(argument: Floats) -> Floats:
    """Legendre polynomials of arguments, shape (..., d)."""
    return np.asarray(np.polynomial.legendre.legvander(argument, _COUNT - 1), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothPartials:
    """Partials of n observations by p parameters, polynomials in cells."""

    cells: Cells
    partials: RowsOf  # of each observation
    coefficients: Floats  # (c, d, p)
    cell: Codes  # (n,), -1 where the polynomials are not precise

    @classmethod
    def from_nodes(cls, cells: Cells, partials: RowsOf) -> SmoothPartials:
        """Determine the coefficients from partials of the nodes."""
        coefficients, errors, largest = list[Floats](), list[Floats](), np.zeros(1)
        for part in slices(len(cells.nodes), 8):
            nodes = cells.nodes[part]
            values = partials(nodes.ravel()).reshape(*nodes.shape, -1)
            coefficients.append(cells.inverse[part] @ values[:, :-1])
            errors.append(np.abs((cells.basis(nodes[:, -1:]) @ coefficients[-1])[:, 0] - values[:, -1]))
            largest = np.maximum(largest, np.abs(values).max(axis=(0, 1), initial=0.0))
        is_precise: Mask = np.all(np.concatenate(errors) <= _TOLERANCE * largest, axis=1)
        numbers = np.append(np.where(is_precise, np.arange(len(is_precise)), -1), -1).astype(np.int32)
        cell = cells.cell if is_precise.all() else numbers[cells.cell]
        return cls(cells, partials, np.concatenate(coefficients), cell)

    def combined(self, matrix: Floats) -> RowsOf:
        """Return the function from rows (m,) to partials times a matrix (p, w), shape (m, w)."""
        from radioloc.estimation._kernels import legendre_sums

        products, single_rows = self.coefficients @ matrix, np.flatnonzero(self.cell < 0)
        of_singles = self.partials(single_rows) @ matrix if len(single_rows) <= ROWS_AT_ONCE else None

        def rows_of(rows: Rows) -> Floats:
            cell = self.cell[rows]
            out = np.asarray(legendre_sums(self.cells.argument[rows], cell, products))
            singles = np.flatnonzero(cell < 0)
            if of_singles is not None:
                out[singles] = of_singles[np.searchsorted(single_rows, rows[singles])]
            elif len(singles):
                out[singles] = self.partials(rows[singles]) @ matrix
            return out

        return rows_of

    def condensed(
        self, structures: Sequence[Structure], noise: KalmanFilter | None, residual_m: Floats, free: Rows
    ) -> Iterator[Floats]:
        """Yield rows (m, q + 1) with the normal matrix of whitened partials by free parameters and residuals.

        `noise` is a further filter of all whitened observations.
        """

        def rows_of(rows: Rows) -> Floats:
            return np.column_stack([self.partials(rows)[:, free], residual_m[rows]])

        smooth, start = replace(self, coefficients=self.coefficients[:, :, free]), 0
        for structure in structures:
            part = slice(start, start := start + structure.rows.size)
            count = len(self.cell)
            if not isinstance(structure, Diagonal | Blocks):
                values = np.concatenate(list(StructuredWhitener(count, (structure,)).whitened(rows_of)))
                yield values if noise is None else noise.innovations(values, part)
            elif noise is not None and noise.gain[part].any():
                yield from smooth._filtered(structure, noise, part, residual_m, rows_of)
            else:
                scale = np.broadcast_to(1.0, structure.rows.size) if noise is None else noise.scale[part]
                scale = scale.reshape(len(structure.rows), -1)
                for section in smooth._sections(structure.rows.reshape(len(scale), -1)[:, 0]):
                    yield from smooth._independent(
                        structure.select(section), scale[section], residual_m, rows_of
                    )

    def _sections(self, rows: Rows) -> Iterator[slice]:
        """Yield slices of some thousand rows, cut between cells."""
        end = 0
        while (begin := end) < len(rows):
            end = begin + _SECTION_BLOCKS
            new = np.flatnonzero(changed(self.cell[rows[end - 1 : end + _SECTION_BLOCKS]]))[1:2]
            end = end - 1 + int(new[0]) if len(new) else len(rows)
            yield slice(begin, end)

    def _groups(self, members: Rows, codes: Indices | None = None) -> tuple[Rows, Mask]:
        """Numbers of successive blocks (b, k) of one cell and code, (g,), and whether polynomials represent them."""
        cell = self.cell[members]
        starts = np.flatnonzero(changed(cell) if codes is None else changed(cell, codes))
        counts, argument = np.diff(starts, append=len(cell)), self.cells.argument[members[:, 0]]
        covered = argument[starts + counts - 1] - argument[starts] >= 2.0 * _MIN_COVERAGE
        return counts, (cell[starts] >= 0).all(axis=1) & (counts >= _MIN_ROWS) & covered

    def _independent(
        self, structure: Diagonal | Blocks, scale: Floats, residual_m: Floats, rows_of: RowsOf
    ) -> Iterator[Floats]:
        """Condense independent blocks of k observations, whose whitened values are multiplied by a scale (b, k)."""
        blocks = structure.rows.reshape(len(structure.rows), -1)
        if isinstance(structure, Blocks):
            order, codes = np.arange(len(blocks)), structure.which
        else:
            order, codes = np.argsort(self.cell[structure.rows], kind="stable"), None
        counts, smooth = self._groups(blocks[order], codes)
        mask, begin = np.repeat(smooth, counts), 0
        for values in StructuredWhitener(len(self.cell), (structure.select(order[~mask]),)).whitened(rows_of):
            yield values * scale[order[~mask]].ravel()[begin : (begin := begin + len(values)), None]
        order, counts = order[mask], counts[smooth]
        ends = np.cumsum(counts)
        cuts = np.flatnonzero(np.diff(ends * blocks.shape[1] // _DENSE_ROWS_AT_ONCE)) + 1
        for part in np.split(np.arange(len(counts)), cuts) if len(counts) else ():
            rows = order[ends[part[0]] - counts[part[0]] : ends[part[-1]]]
            yield from self._dense_rows(structure.select(rows), counts[part], scale[rows], residual_m)

    def _dense_rows(
        self, dense: Diagonal | Blocks, counts: Rows, scale: Floats, residual_m: Floats
    ) -> Iterator[Floats]:
        """Condense groups of blocks that polynomials represent; `counts` (g,) are the numbers of their blocks."""
        members = dense.rows.reshape(len(dense.rows), -1)
        whitened = dense.whiten(slice(None), residual_m[members.ravel()][:, None])
        residual = whitened.reshape(members.shape) * scale
        basis = self.cells.basis(members[:, 0])
        first = np.cumsum(counts) - counts
        if isinstance(dense, Blocks):
            roots = dense.roots[dense.which[first]] * scale[first][:, :, None]
        else:
            basis, roots = basis * (scale / dense.sigma_m[:, None]), np.ones((len(first), 1, 1))
        columns = [*np.ascontiguousarray(basis.T), *np.ascontiguousarray(residual.T)]
        products = np.empty((len(first), _COUNT, len(columns)))
        for i in range(_COUNT):
            for j in range(i, len(columns)):
                products[:, i, j] = np.add.reduceat(columns[i] * columns[j], first)
        # Legendre polynomials are nearly orthogonal: normal equations of a cell lose no digits.
        factor = np.linalg.cholesky(products[:, :, :_COUNT], upper=True)
        right_side = np.linalg.solve(np.swapaxes(factor, 1, 2), products[:, :, _COUNT:])
        coefficients = self.coefficients[self.cell[members[first]]]
        for k in range(members.shape[1]):
            combined = np.einsum("gl,gldp->gdp", roots[:, k], coefficients)
            rows = np.concatenate([factor @ combined, right_side[:, :, k : k + 1]], axis=2)
            yield rows.reshape(-1, rows.shape[2])

    def _filtered(
        self, structure: Structure, noise: KalmanFilter, part: slice, residual_m: Floats, rows_of: RowsOf
    ) -> Iterator[Floats]:
        """Condense observations whose errors are correlated in time: the filter's state goes on from cell to cell."""
        assert isinstance(structure, Diagonal)
        weight, rows = 1.0 / structure.sigma_m, structure.rows
        basis = np.column_stack([self.cells.basis(rows) * weight[:, None], np.zeros(len(rows))])
        residual = noise.innovations((residual_m[rows] * weight)[:, None], part)
        state = np.zeros((1, self.coefficients.shape[2]))
        end = 0
        for count, smooth in zip(*self._groups(rows[:, None]), strict=True):
            group = slice(end, end := end + count)
            filter_rows = slice(part.start + group.start, part.start + end)
            if not smooth:
                values = rows_of(rows[group])[:, :-1] * weight[group, None]
                values = noise.innovations(values, filter_rows, state)
                yield np.column_stack([values, residual[group]])
                continue
            # Columns of the polynomials, and of the state before the cell.
            response = np.append(np.zeros(_COUNT), 1.0)[None]
            whitened = noise.innovations(basis[group], filter_rows, response)
            triangle = np.asarray(np.linalg.qr(np.column_stack([whitened, residual[group]]), mode="r"))[:-1]
            of_cell = np.concatenate([self.coefficients[self.cell[rows[group.start]]], state])
            yield np.column_stack([triangle[:, :-1] @ of_cell, triangle[:, -1]])
            state = response @ of_cell
