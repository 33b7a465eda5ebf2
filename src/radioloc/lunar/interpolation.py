"""Interpolation among the cells of a map: bilinear, and cubic convolution (Keys 1981, a = -1/2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STENCIL_CELLS = {"bilinear": 2, "bicubic": 4}
"""Cells along each side of those that a point needs."""


def first_cell(position: Floats, cells: int, size: int) -> tuple[NDArray[np.int64], Floats]:
    """First cell of the stencil along one axis, and the place from 0 to 1 between its two middle cells."""
    half = size // 2
    # a point on the centre of the last cell that can be a middle one needs no cell beyond it
    lower = np.where(position == cells - half, cells - half - 1.0, np.floor(position))
    return lower.astype(np.int64) - (half - 1), position - lower


def weights(interpolation: str, t: Floats) -> tuple[Floats, Floats]:
    """Weights of the cells along one axis at place t, and their derivatives by t, shape (n, size)."""
    one = np.ones_like(t)
    if interpolation == "bilinear":
        return np.stack([1.0 - t, t], axis=-1), np.stack([-one, one], axis=-1)
    t2, t3 = t * t, t * t * t
    values = [-t3 + 2.0 * t2 - t, 3.0 * t3 - 5.0 * t2 + 2.0, -3.0 * t3 + 4.0 * t2 + t, t3 - t2]
    slopes = [
        -3.0 * t2 + 4.0 * t - 1.0,
        9.0 * t2 - 10.0 * t,
        -9.0 * t2 + 8.0 * t + 1.0,
        3.0 * t2 - 2.0 * t,
    ]
    return 0.5 * np.stack(values, axis=-1), 0.5 * np.stack(slopes, axis=-1)
