"""Compiled Kalman filter of a series for many noise models at once: cells, which are the last axis of all arrays.

Observations are gain_i s_i + e_i, with e_i white of unit variance and s a sum of p first-order Gauss-Markov processes.
In each cell these have other variances. Loops over cells are innermost, as compilers turn them to vector instructions:
one filter for each cell takes five times as long.
"""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled

Floats = NDArray[np.float64]


@compiled(error_model="numpy")
def filter_grid(
    decay: Floats, ratios: int, stationary: Floats, gain: Floats, columns: Floats
) -> tuple[Floats, Floats]:
    """Variances of innovations (n, cells), and products of columns by the inverse covariance, (m, m, cells)."""
    # Decay is (n, p, shapes), for so many cells each; the variances of processes are (p, cells), white noise last.
    (n, m), (p, cells) = columns.shape, stationary.shape
    variance, products = np.empty((n, cells)), np.zeros((m, m, cells))
    covariance, kalman, state = np.zeros((p, p, cells)), np.empty((p, cells)), np.zeros((m, p, cells))
    factor, innovation = np.zeros((p, cells)), np.empty((m, cells))
    for i in range(n):
        for a in range(p):
            for g in range(cells - 1):
                factor[a, g] = decay[i, a, g // ratios]
        _update(factor, stationary, gain[i], covariance, kalman, variance[i])
        _innovate(factor, gain[i], kalman, columns[i], state, innovation)
        _add_products(innovation, variance[i], products)
    for j in range(m):
        for k in range(j):
            products[j, k] = products[k, j]
    return variance, products


@compiled(error_model="numpy")
def _update(
    factor: Floats, stationary: Floats, gain: float, covariance: Floats, kalman: Floats, variance: Floats
) -> None:
    """Take the covariance of the processes over a step and an observation; Kalman gains, variance of the innovation."""
    p, cells = kalman.shape
    variance[:] = 1.0
    for a in range(p):
        into, d, q, own = kalman[a], factor[a], stationary[a], covariance[a, a]
        into[:] = 0.0
        for b in range(p):
            one, other = covariance[a, b], factor[b]
            for g in range(cells):
                one[g] *= d[g] * other[g]
        for g in range(cells):
            own[g] += q[g] * (1.0 - d[g] * d[g])
        for b in range(p):
            one = covariance[a, b]
            for g in range(cells):
                into[g] += gain * one[g]
        for g in range(cells):
            variance[g] += gain * into[g]
    for a in range(p):
        for b in range(p):
            one, left, right = covariance[a, b], kalman[a], kalman[b]
            for g in range(cells):
                one[g] -= left[g] * right[g] / variance[g]
    for a in range(p):
        into = kalman[a]
        for g in range(cells):
            into[g] /= variance[g]


@compiled(error_model="numpy")
def _innovate(
    factor: Floats, gain: float, kalman: Floats, columns: Floats, state: Floats, innovation: Floats
) -> None:
    """Innovations (m, cells) of a row of columns (m,), and the states of the processes behind it."""
    m, p, cells = state.shape
    for j in range(m):
        left = innovation[j]
        left[:] = columns[j]
        for a in range(p):
            known, d = state[j, a], factor[a]
            for g in range(cells):
                known[g] *= d[g]
                left[g] -= gain * known[g]
        for a in range(p):
            known, k = state[j, a], kalman[a]
            for g in range(cells):
                known[g] += k[g] * left[g]


@compiled(error_model="numpy")
def _add_products(innovation: Floats, variance: Floats, products: Floats) -> None:
    """Add the upper products of innovations over their variance."""
    m, cells = innovation.shape
    for j in range(m):
        left = innovation[j]
        for k in range(j, m):
            into, right = products[j, k], innovation[k]
            for g in range(cells):
                into[g] += left[g] * right[g] / variance[g]
