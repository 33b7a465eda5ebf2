"""Compiled loops over series with white noise and first-order Gauss-Markov processes.

The Kalman filter is of many noise models at once: cells, the last axis of its arrays. Loops over cells are innermost,
as compilers turn them to vector instructions: one filter for each cell takes five times as long.
"""

import math

import numpy as np

from radioloc.compiled import compiled
from radioloc.vectors import Codes, Floats, Indices

_LOGARITHM_STEP = 16  # innovation variances, below 1e15, that are multiplied before a logarithm is taken
_PRODUCT_ROWS = 4  # innovations whose products are added at once


@compiled(error_model="numpy")
def likelihood_grid(
    step_s: Floats,
    tau_s: Floats,
    mean: Floats,
    ratio: Floats,
    gain: Floats,
    columns: Floats,
    turned: Floats,
    of_series: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Terms of restricted likelihoods, as :meth:`gauss_markov.RestrictedLikelihood.evaluate` has them.

    `of_series` (3, s) has degrees of freedom, observations less points, and squares of deviations from bins.
    """
    (series, n, m), (_, shapes, p), ratios, common = columns.shape, mean.shape, len(ratio), turned.shape[2]
    cells = shapes * ratios + 1
    log_determinant, eliminated, white = np.zeros((series, cells)), np.zeros((series, cells)), np.ones(cells)
    together, turned_row = np.zeros((common, common, cells)), np.empty(cells)
    variances = np.empty((series, cells))
    kalman, variance, scale = np.empty((p, cells)), np.empty(cells), np.empty(cells)
    innovation = np.empty((_PRODUCT_ROWS, m, cells))
    for k in range(series):
        determinant, factor, stationary = np.ones(cells), np.zeros((p, cells)), np.zeros((p, cells))
        covariance, state, sums = np.zeros((p, p, cells)), np.zeros((m, p, cells)), np.zeros((m, m, cells))
        for g in range(cells - 1):
            white[g] = 1.0 + (1.0 - mean[k, g // ratios].sum()) * ratio[g % ratios]
            for a in range(p):
                stationary[a, g] = mean[k, g // ratios, a] * ratio[g % ratios]
        for i in range(n):
            if i > 0 and (i == 1 or step_s[k, i] != step_s[k, i - 1]):
                for a in range(p):
                    for g in range(shapes):
                        factor[a, g * ratios : (g + 1) * ratios] = math.exp(-step_s[k, i] / tau_s[g, a])
            _update(factor, stationary, gain[k, i], covariance, kalman, variance)
            for g in range(cells):
                determinant[g] *= variance[g]
                scale[g] = 1.0 / math.sqrt(variance[g])
            if i % _LOGARITHM_STEP == _LOGARITHM_STEP - 1 or i == n - 1:
                for g in range(cells):
                    log_determinant[k, g] += math.log(determinant[g])
                    determinant[g] = 1.0
            row = i % _PRODUCT_ROWS
            _innovate(factor, gain[k, i], kalman, scale, columns[k, i], state, innovation[row])
            if i == n - 1:
                innovation[row + 1 :] = 0.0
            if row == _PRODUCT_ROWS - 1 or i == n - 1:
                _add_products(innovation, sums)
        for g in range(cells):
            log_determinant[k, g] += of_series[1, k] * math.log(white[g])
            sums[m - 1, m - 1, g] += of_series[2, k] / white[g]
        root = sums.copy()
        _eliminate(root, eliminated[k], variances[k])
        for g in range(cells):
            variances[k, g] /= of_series[0, k]
        for a in range(common):
            for j in range(m):
                turned_row[:] = 0.0
                for i in range(m):
                    product, weight = sums[min(i, j), max(i, j)], turned[k, i, a]
                    for g in range(cells):
                        turned_row[g] += weight * product[g]
                for g in range(cells):
                    turned_row[g] /= variances[k, g]
                for b in range(a, common):
                    product, weight = together[a, b], turned[k, j, b]
                    for g in range(cells):
                        product[g] += weight * turned_row[g]
    loss, squares = np.zeros(cells), np.zeros(cells)
    if common:
        _eliminate(together, loss, squares)
    return log_determinant, eliminated, variances, loss + squares


@compiled(error_model="numpy")
def _eliminate(root: Floats, log_determinant: Floats, squares: Floats) -> None:
    """Log-determinants and squares left of products (m, m, cells), as :func:`gauss_markov._eliminated`; in place."""
    m, _, cells = root.shape
    for j in range(m):
        pivot = root[j, j]
        for g in range(cells):
            squares[g] = pivot[g]
            pivot[g] += 1.0 if j < m - 1 else pivot[g]
        for k in range(j, m):
            element = root[j, k]
            for i in range(j):
                first, second = root[i, j], root[i, k]
                for g in range(cells):
                    element[g] -= first[g] * second[g]
            for g in range(cells):
                element[g] /= math.sqrt(pivot[g]) if k == j else pivot[g]
        for g in range(cells):
            squares[g] = pivot[g] * pivot[g] - squares[g]
            if j < m - 1:
                log_determinant[g] += 2.0 * math.log(pivot[g])


@compiled(error_model="numpy")
def _update(
    factor: Floats, stationary: Floats, gain: float, covariance: Floats, kalman: Floats, variance: Floats
) -> None:
    """Take the covariance of the processes over a step and an observation; Kalman gains, variance of the innovation."""
    p, cells = kalman.shape
    variance[:] = 1.0
    for a in range(p):
        cross_covariance, own_decay = kalman[a], factor[a]
        process_variance, own_variance = stationary[a], covariance[a, a]
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
    factor: Floats,
    gain: float,
    kalman: Floats,
    scale: Floats,
    columns: Floats,
    state: Floats,
    innovation: Floats,
) -> None:
    """Innovations (m, cells) of a row of columns (m,) times a scale, and the states of the processes behind it."""
    m, p, cells = state.shape
    for j in range(m):
        row_innovation = innovation[j]
        if p == 1:  # in one loop, as reading and writing take most of the time
            process_state, decay, process_gain, value = state[j, 0], factor[0], kalman[0], columns[j]
            for g in range(cells):
                predicted = process_state[g] * decay[g]
                difference = value - gain * predicted
                process_state[g] = predicted + process_gain[g] * difference
                row_innovation[g] = difference * scale[g]
            continue
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
        for g in range(cells):
            row_innovation[g] *= scale[g]


@compiled(error_model="numpy")
def _add_products(innovation: Floats, products: Floats) -> None:
    """Add the upper products of innovations (4, m, cells) of unit variance, those of four rows at once."""
    _, m, cells = innovation.shape
    for j in range(m):
        first, second, third, fourth = innovation[0, j], innovation[1, j], innovation[2, j], innovation[3, j]
        for k in range(j, m):
            product, a, b, c, d = (
                products[j, k],
                innovation[0, k],
                innovation[1, k],
                innovation[2, k],
                innovation[3, k],
            )
            for g in range(cells):
                product[g] += (first[g] * a[g] + second[g] * b[g]) + (third[g] * c[g] + fourth[g] * d[g])


@compiled(error_model="numpy")
def half_products(
    begin: Indices,
    step_s: Floats,
    gain: Floats,
    white: Floats,
    processes: Floats,
    columns: Floats,
    decay: Floats,
    states: Floats,
    half: Floats,
) -> None:
    """Lower triangle of the covariance of series, half its diagonal, times columns, as in :mod:`gauss_markov`."""
    # Series k has white noise and processes with variances and correlation times (s, p); zeros stand for no process.
    m, (_, series, p) = columns.shape[1], processes.shape
    variance, tau_s = processes[0], processes[1]
    for k in range(series):
        first, sum_variance = begin[k], 0.0
        for a in range(p):
            sum_variance += variance[k, a]
            for j in range(m):
                states[a, j] = 0.0
        for i in range(first, begin[k + 1]):
            weight = 0.5 * (white[k] - sum_variance * gain[i] * gain[i])
            for j in range(m):
                half[i, j] = weight * columns[i, j]
            for a in range(p):
                if variance[k, a] == 0.0:
                    continue
                if i == first + 1 or (i > first and step_s[i] != step_s[i - 1]):
                    decay[a] = math.exp(-step_s[i] / tau_s[k, a])
                for j in range(m):
                    states[a, j] = decay[a] * states[a, j] + gain[i] * columns[i, j]
                    half[i, j] += gain[i] * variance[k, a] * states[a, j]


@compiled(error_model="numpy")
def legendre_sums(argument: Floats, cell: Codes, coefficients: Floats) -> Floats:
    """Add up Legendre polynomials of arguments (n,) by the coefficients (c, d, w) of their cells, or zero; (n, w)."""
    n, (_, count, width) = len(argument), coefficients.shape
    sums = np.zeros((n, width))
    for i in range(n):
        if cell[i] < 0:
            continue
        previous, value = 0.0, 1.0
        for d in range(count):
            for j in range(width):
                sums[i, j] += value * coefficients[cell[i], d, j]
            previous, value = value, ((2 * d + 1) * argument[i] * value - d * previous) / (d + 1)
    return sums
