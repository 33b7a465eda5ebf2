"""Interpolation among cells of a map or image: bilinear, and cubic convolution (Keys 1981, a = -1/2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.vectors import Floats

Indices = NDArray[np.int64]

STENCIL_CELLS = {"bilinear": 2, "bicubic": 4}
"""Cells along each side of those that a point needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Stencil:
    """The cells around points of a grid, shape (n, size, size), and how values follow from theirs."""

    rows: Indices
    columns: Indices
    row_weights: tuple[Floats, Floats]  # and their derivatives, by row, shape (n, size)
    column_weights: tuple[Floats, Floats]

    @classmethod
    def around(cls, row: Floats, column: Floats, shape: tuple[int, ...], interpolation: str) -> Stencil:
        """Find the cells around points at rows and columns, (n,), whose whole numbers are the cells' centres."""
        size = STENCIL_CELLS[interpolation]
        (first_row, in_row), (first_column, in_column) = (
            _first_cell(place, count, size) for place, count in zip((row, column), shape, strict=True)
        )
        steps = np.arange(size)
        rows, columns = np.broadcast_arrays(
            (first_row[:, None] + steps)[:, :, None], (first_column[:, None] + steps)[:, None, :]
        )
        return cls(rows, columns, _weights(interpolation, in_row), _weights(interpolation, in_column))

    def value(self, cells: Floats) -> Floats:
        """Values at the points, shape (n,), of those of the cells, shape (n, size, size)."""
        return np.asarray(np.einsum("nij,ni,nj->n", cells, self.row_weights[0], self.column_weights[0]))

    def value_and_slopes(self, cells: Floats, by_angle: Floats) -> tuple[Floats, Floats, Floats]:
        """Values and their derivatives by two angles; `by_angles` are those of row and column, shape (2, 2, n)."""
        by_row = np.einsum("nij,ni,nj->n", cells, self.row_weights[1], self.column_weights[0])
        by_column = np.einsum("nij,ni,nj->n", cells, self.row_weights[0], self.column_weights[1])
        first, second = by_row * by_angle[:, 0] + by_column * by_angle[:, 1]
        return self.value(cells), first, second


def _first_cell(position: Floats, cells: int, size: int) -> tuple[Indices, Floats]:
    """First cell of the stencil along one axis, and the place from 0 to 1 between its two middle cells."""
    half = size // 2
    # a point on the centre of the last cell that can be a middle one needs no cell beyond it
    lower = np.where(position == cells - half, cells - half - 1.0, np.floor(position))
    return lower.astype(np.int64) - (half - 1), position - lower


def _weights(interpolation: str, t: Floats) -> tuple[Floats, Floats]:
    """Weights of the cells along one axis at place t, and their derivatives by t, shape (n, size)."""
    unit = np.ones_like(t)
    if interpolation == "bilinear":
        return np.stack([1.0 - t, t], axis=-1), np.stack([-unit, unit], axis=-1)
    t2, t3 = t * t, t * t * t
    values = [-t3 + 2.0 * t2 - t, 3.0 * t3 - 5.0 * t2 + 2.0, -3.0 * t3 + 4.0 * t2 + t, t3 - t2]
    slopes = [-3.0 * t2 + 4.0 * t - 1.0, 9.0 * t2 - 10.0 * t, -9.0 * t2 + 8.0 * t + 1.0, 3.0 * t2 - 2.0 * t]
    return 0.5 * np.stack(values, axis=-1), 0.5 * np.stack(slopes, axis=-1)
