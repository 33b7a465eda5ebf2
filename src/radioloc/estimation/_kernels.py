"""Compiled Kalman filter of a series for many noise models at once: cells, which are the last axis of all arrays.

Observations are gain_i s_i + e_i, with e_i white of unit variance and s a sum of p first-order Gauss-Markov processes.
In each cell these have other variances. Loops over cells are innermost, as compilers turn them to vector instructions:
one filter for each cell takes five times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]


_LOGARITHM_STEP = 16  # innovation variances, below 1e15, that are multiplied before a logarithm is taken


@compiled(error_model="numpy")
def filter_grid(
    step_s: Floats, tau_s: Floats, stationary: Floats, gain: Floats, columns: Floats
) -> tuple[Floats, Floats]:
    """Log-determinants of covariances (cells,), and products of columns by their inverses, (m, m, cells)."""
    # Correlation times are (p, shapes), for equally many cells each; variances of processes are (p, cells), with white
    # noise in the last cell.
    (n, m), (p, cells), shapes = columns.shape, stationary.shape, tau_s.shape[1]
    ratios = (cells - 1) // shapes
    log_determinant, determinant, products = np.zeros(cells), np.ones(cells), np.zeros((m, m, cells))
    covariance, kalman, state = np.zeros((p, p, cells)), np.empty((p, cells)), np.zeros((m, p, cells))
    factor, variance, innovation = np.zeros((p, cells)), np.empty(cells), np.empty((m, cells))
    for i in range(n):
        if i > 0 and (i == 1 or step_s[i] != step_s[i - 1]):
            for a in range(p):
                for k in range(shapes):
                    factor[a, k * ratios : (k + 1) * ratios] = math.exp(-step_s[i] / tau_s[a, k])
        _update(factor, stationary, gain[i], covariance, kalman, variance)
        for g in range(cells):
            determinant[g] *= variance[g]
        if i % _LOGARITHM_STEP == _LOGARITHM_STEP - 1 or i == n - 1:
            for g in range(cells):
                log_determinant[g] += math.log(determinant[g])
                determinant[g] = 1.0
        _innovate(factor, gain[i], kalman, columns[i], state, innovation)
        _add_products(innovation, variance, products)
    for j in range(m):
        for k in range(j):
            products[j, k] = products[k, j]
    return log_determinant, products


@compiled(error_model="numpy")
def half_products(
    begin: Integers,
    first: Integers,
    tau_s: Floats,
    variance: Floats,
    white: Floats,
    step_s: Floats,
    gain: Floats,
    columns: Floats,
) -> Floats:
    """Lower triangles of covariances of series with half their diagonals times columns, (n, m)."""
    # Series k has the points from begin[k] and the processes from first[k].
    m = columns.shape[1]
    out = np.zeros(columns.shape)
    for k in range(len(white)):
        p = first[k + 1] - first[k]
        state = np.zeros((p, m))
        decay = np.zeros(p)
        half_variance = 0.5 * variance[first[k] : first[k + 1]].sum()
        for i in range(begin[k], begin[k + 1]):
            if i > begin[k] and (i == begin[k] + 1 or step_s[i] != step_s[i - 1]):
                for a in range(p):
                    decay[a] = math.exp(-step_s[i] / tau_s[first[k] + a])
            for a in range(p):
                weight = variance[first[k] + a]
                for j in range(m):
                    state[a, j] = decay[a] * state[a, j] + gain[i] * columns[i, j]
                    out[i, j] += weight * state[a, j]
            for j in range(m):
                out[i, j] = (
                    gain[i] * out[i, j] + (0.5 * white[k] - half_variance * gain[i] ** 2) * columns[i, j]
                )
    return out


@compiled(error_model="numpy")
def eliminate(products: Floats) -> tuple[Floats, Floats]:
    """Log det(1 + A^T A) and the squares left of r, from products (m, m, cells) of columns A and, last, r."""
    m, cells = products.shape[1:]
    matrix, log_determinant, row = products.copy(), np.zeros(cells), np.empty(cells)
    for j in range(m - 1):
        pivot = matrix[j, j]
        for g in range(cells):
            pivot[g] += 1.0
            log_determinant[g] += math.log(pivot[g])
        for k in range(j + 1, m):
            for g in range(cells):
                row[g] = matrix[j, k, g] / pivot[g]
            for i in range(k, m):
                target, pivot_row = matrix[k, i], matrix[j, i]
                for g in range(cells):
                    target[g] -= row[g] * pivot_row[g]
    return log_determinant, matrix[m - 1, m - 1]


@compiled(error_model="numpy")
def _update(
    factor: Floats, stationary: Floats, gain: float, covariance: Floats, kalman: Floats, variance: Floats
) -> None:
    """Take the covariance of the processes over a step and an observation; Kalman gains, variance of the innovation."""
    p, cells = kalman.shape
    variance[:] = 1.0
    for a in range(p):
        cross_covariance = kalman[a]
        own_decay = factor[a]
        process_variance = stationary[a]
        own_variance = covariance[a, a]
        cross_covariance[:] = 0.0
        for b in range(p):
            element, decay = covariance[a, b], factor[b]
            for g in range(cells):
                element[g] *= own_decay[g] * decay[g]
        for g in range(cells):
            own_variance[g] += process_variance[g] * (1.0 - own_decay[g] * own_decay[g])
        for b in range(p):
            element = covariance[a, b]
            for g in range(cells):
                cross_covariance[g] += gain * element[g]
        for g in range(cells):
            variance[g] += gain * cross_covariance[g]
    for a in range(p):
        cross_covariance = kalman[a]
        for g in range(cells):
            cross_covariance[g] /= variance[g]
    for a in range(p):
        for b in range(p):
            element, gain_a, gain_b = covariance[a, b], kalman[a], kalman[b]
            for g in range(cells):
                element[g] -= gain_a[g] * gain_b[g] * variance[g]


@compiled(error_model="numpy")
def _innovate(
    factor: Floats, gain: float, kalman: Floats, columns: Floats, state: Floats, innovation: Floats
) -> None:
    """Innovations (m, cells) of a row of columns (m,), and the states of the processes behind it."""
    m, p, cells = state.shape
    for j in range(m):
        row_innovation = innovation[j]
        row_innovation[:] = columns[j]
        for a in range(p):
            process_state, decay = state[j, a], factor[a]
            for g in range(cells):
                process_state[g] *= decay[g]
                row_innovation[g] -= gain * process_state[g]
        for a in range(p):
            process_state, process_gain = state[j, a], kalman[a]
            for g in range(cells):
                process_state[g] += process_gain[g] * row_innovation[g]


@compiled(error_model="numpy")
def _add_products(innovation: Floats, variance: Floats, products: Floats) -> None:
    """Add the upper products of innovations over their variance."""
    m, cells = innovation.shape
    for j in range(m):
        weighted = innovation[j]
        for g in range(cells):
            weighted[g] /= variance[g]
        product = products[j, j]
        for g in range(cells):
            product[g] += weighted[g] * weighted[g] * variance[g]
        for k in range(j + 1, m):
            product, row_innovation = products[j, k], innovation[k]
            for g in range(cells):
                product[g] += weighted[g] * row_innovation[g]
