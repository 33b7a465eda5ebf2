"""Compiled scalar Kalman filter of white noise plus a first-order Gauss-Markov process.

Observations y_i = gain_i s_i + e_i, with e_i white of unit variance and s a stationary first-order Gauss-Markov process
of variance `ratio` and correlation time `tau_s`; `step_s[i]` is the time from the observation before. The functions
release the interpreter's lock; every number is computed by the same operations in the same order on any machine load.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_EVERY = 16
"""Innovation variances multiplied before a logarithm is taken; each is below 1e15."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def filter_grid(
    step_s: Floats, gain: Floats, columns: Floats, tau_s: Floats, ratio: Floats
) -> tuple[Floats, Floats]:
    """Log-determinants, and squares that are left of the last column, for every correlation time and ratio."""
    n, m = columns.shape
    taus, ratios = ratio.shape
    size = taus * ratios
    stationary, decay = ratio.ravel(), np.zeros(size)
    variance, inverse = stationary.copy(), np.empty(size)
    determinant, log_determinant = np.ones(size), np.zeros(size)
    state, innovation, products = np.zeros((m, size)), np.empty((m, size)), np.zeros((m * m, size))
    weighted = np.empty(size)
    last_s = -1.0
    # Short loops over few arrays: compilers turn them to vector instructions.
    for i in range(n):
        if step_s[i] != last_s:
            last_s = step_s[i]
            for k in range(taus):
                decay[k * ratios : (k + 1) * ratios] = math.exp(-last_s / tau_s[k])
        h = gain[i]
        for g in range(size):
            variance[g] = stationary[g] + decay[g] * decay[g] * (variance[g] - stationary[g])
        for g in range(size):
            f = h * h * variance[g] + 1.0
            determinant[g] *= f
            inverse[g] = 1.0 / f
        for g in range(size):
            variance[g] *= inverse[g]
        if i % _EVERY == _EVERY - 1:
            for g in range(size):
                log_determinant[g] += math.log(determinant[g])
                determinant[g] = 1.0
        for j in range(m):
            y, s, e = columns[i, j], state[j], innovation[j]
            for g in range(size):
                predicted = decay[g] * s[g]
                e[g] = y - h * predicted
                s[g] = predicted + h * variance[g] * e[g]
        for j in range(m):
            one = innovation[j]
            for g in range(size):
                weighted[g] = one[g] * inverse[g]
            for k in range(j, m):
                into, other = products[j * m + k], innovation[k]
                for g in range(size):
                    into[g] += weighted[g] * other[g]
    for g in range(size):
        log_determinant[g] += math.log(determinant[g])
    # Cholesky's triangle of the products of all columns; its last diagonal is what A leaves of r.
    squares, triangle = np.empty(size), np.zeros((m, m))
    for g in range(size):
        for j in range(m):
            for k in range(j, m):
                value = products[j * m + k, g]
                for i in range(j):
                    value -= triangle[i, j] * triangle[i, k]
                if k > j:
                    triangle[j, k] = value / triangle[j, j]
                elif j < m - 1:
                    triangle[j, j] = math.sqrt(value) if value > 0.0 else math.nan
                    log_determinant[g] += 2.0 * math.log(triangle[j, j])
                else:
                    squares[g] = value
    return log_determinant.reshape(taus, ratios), squares.reshape(taus, ratios)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def whiten(step_s: Floats, tau_s: float, ratio: float, columns: Floats, adjoint: bool) -> Floats:
    """Innovations over their standard deviations, shape (n, m), for gains of one; or the transposed operation.

    Both one after the other multiply by the inverse of the covariance.
    """
    n, m = columns.shape
    decay, kalman, scale = np.empty(n), np.empty(n), np.empty(n)
    variance = ratio
    for i in range(n):
        decay[i] = math.exp(-step_s[i] / tau_s)
        predicted = ratio + decay[i] * decay[i] * (variance - ratio)
        kalman[i] = predicted / (predicted + 1.0)
        scale[i] = 1.0 / math.sqrt(predicted + 1.0)
        variance = kalman[i]
    out = np.empty((n, m))
    state = np.zeros(m)
    for k in range(n):
        i = n - 1 - k if adjoint else k
        for j in range(m):
            if adjoint:
                left = columns[i, j] * scale[i] + kalman[i] * state[j]
                out[i, j] = left
                state[j] = decay[i] * (state[j] - left)
            else:
                predicted = decay[i] * state[j]
                left = columns[i, j] - predicted
                state[j] = predicted + kalman[i] * left
                out[i, j] = left * scale[i]
    return out


@numba.njit(nogil=True, cache=True, error_model="numpy")
def products(step_s: Floats, tau_s: Floats, variance: Floats, columns: Floats) -> Floats:
    """Columns (n, m) times the covariance matrix, the sum of variance exp(-|dt| / tau), times columns; shape (m, m)."""
    n, m = columns.shape
    taus = len(tau_s)
    out, before, decay = np.zeros((m, m)), np.zeros((taus, m)), np.zeros(taus)
    earlier, total = np.empty(m), variance.sum()
    last_s = -1.0
    for i in range(n):
        if step_s[i] != last_s:
            last_s = step_s[i]
            for t in range(taus):
                decay[t] = math.exp(-last_s / tau_s[t])
        for j in range(m):
            earlier[j] = 0.5 * total * columns[i, j]
        for t in range(taus):
            for j in range(m):
                before[t, j] *= decay[t]
                earlier[j] += before[t, j]
                before[t, j] += variance[t] * columns[i, j]
        for j in range(m):
            for k in range(m):
                out[j, k] += columns[i, j] * earlier[k]
    return out + out.T


@numba.njit(nogil=True, cache=True, error_model="numpy")
def bins(time_s: Floats, most: int) -> tuple[NDArray[np.int64], float]:
    """Bin of each of some times in order, from zero up, none empty, and its duration, s; gaps take no bins."""
    n = len(time_s)
    step_s = np.diff(time_s)
    longest_s = 10.0 * np.median(step_s)
    span_s = 0.0
    for k in range(n - 1):
        span_s += min(step_s[k], longest_s)
    width_s = span_s / most
    place = np.zeros(n, dtype=np.int64)
    if width_s <= 0.0:  # all at one instant
        return np.arange(n) * most // n, 0.0
    clock_s, cell = 0.0, 0.0
    for k in range(1, n):
        clock_s += min(step_s[k - 1], longest_s)
        now = math.floor(clock_s / width_s)
        place[k] = place[k - 1] + (1 if now > cell else 0)
        cell = now
    return place, width_s


@numba.njit(nogil=True, cache=True, error_model="numpy")
def add_to_bins(
    place: NDArray[np.int64], whitening: Floats, values: Floats, sums: Floats, squares: Floats
) -> None:
    """Add whitened values (b, k, c) to the sums (m, k, c) of their bins, and squares of the first column to (k,)."""
    b, k, c = values.shape
    for i in range(b):
        for j in range(k):
            into = sums[place[i], j]
            first = 0.0
            for other in range(k):
                weight, from_other = whitening[i, j, other], values[i, other]
                first += weight * from_other[0]
                for column in range(c):
                    into[column] += weight * from_other[column]
            squares[j] += first * first
