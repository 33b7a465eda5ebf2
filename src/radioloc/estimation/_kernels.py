"""Compiled Kalman filter of white noise plus first-order Gauss-Markov processes.

Observations y_i = gain_i s_i + e_i, with e_i white of unit variance and s a stationary first-order Gauss-Markov process
of variance `ratio` and correlation time `tau_s`, or a sum of such; `step_s[i]` is the time from the observation before.
The functions release the interpreter's lock; every number is computed by the same operations in the same order on any
machine load.
"""

import math

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]

_LANE_COUNT = 8  # pairs of a correlation time and a ratio that are done at a time
_INNOVATION_COUNT = 4  # innovations whose products are added at once
_LOGARITHM_STEP = 16  # innovation variances, each below 1e15, that are multiplied before a logarithm is taken


@compiled(error_model="numpy")
def filter_grid(
    step_s: Floats, gain: Floats, columns: Floats, tau_s: Floats, part: Floats, ratio: Floats
) -> tuple[Floats, Floats]:
    """Log-determinants of V, and upper products of columns (n, m) by its inverse (m, m), for each cell (k * r)."""
    # Cells are shapes (k, p), sums of p processes with a part of the variance each, by ratios (r,); white noise is
    # last.
    n, m = columns.shape
    shapes, p = tau_s.shape
    ratios = len(ratio)
    cells = shapes * ratios + 1
    size = -(-cells // _LANE_COUNT) * _LANE_COUNT
    stationary, decay = np.zeros((p, size)), np.zeros((p, size))
    covariance, projected, inverse = np.zeros((p, p, size)), np.empty((p, size)), np.empty(size)
    for a in range(p):
        for g in range(cells - 1):
            stationary[a, g] = part[g // ratios, a] * ratio[g % ratios]
            covariance[a, a, g] = stationary[a, g]
    determinant, log_determinant = np.ones(size), np.zeros(size)
    state, products = np.zeros((m, p, size)), np.zeros((m, m, size))
    innovation, weighted = np.zeros((_INNOVATION_COUNT, m, size)), np.zeros((_INNOVATION_COUNT, m, size))
    last_s = -1.0
    # Short loops over few arrays: compilers turn them to vector instructions.
    for i in range(n):
        if step_s[i] != last_s:
            last_s = step_s[i]
            for k in range(shapes):
                for a in range(p):
                    of_shape = math.exp(-last_s / tau_s[k, a])
                    for g in range(k * ratios, (k + 1) * ratios):
                        decay[a, g] = of_shape
        h = gain[i]
        for g in range(size):
            inverse[g] = 1.0
        for a in range(p):
            into, d, q = projected[a], decay[a], stationary[a]
            for g in range(size):
                into[g] = h * q[g] * (1.0 - d[g] * d[g])
            for b in range(p):
                one, other = covariance[a, b], decay[b]
                for g in range(size):
                    one[g] *= d[g] * other[g]
                    into[g] += h * one[g]
            same = covariance[a, a]
            for g in range(size):
                same[g] += q[g] * (1.0 - d[g] * d[g])
                inverse[g] += h * into[g]
        for g in range(size):
            determinant[g] *= inverse[g]
            inverse[g] = 1.0 / inverse[g]
        for a in range(p):
            for b in range(p):
                one, left, right = covariance[a, b], projected[a], projected[b]
                for g in range(size):
                    one[g] -= left[g] * right[g] * inverse[g]
        if i % _LOGARITHM_STEP == _LOGARITHM_STEP - 1:
            for g in range(size):
                log_determinant[g] += math.log(determinant[g])
                determinant[g] = 1.0
        now = i % _INNOVATION_COUNT
        for j in range(m):
            y, e, w = columns[i, j], innovation[now, j], weighted[now, j]
            for g in range(size):
                e[g] = y
            for a in range(p):
                s, d = state[j, a], decay[a]
                for g in range(size):
                    s[g] *= d[g]
                    e[g] -= h * s[g]
            for g in range(size):
                w[g] = e[g] * inverse[g]
            for a in range(p):
                s, into = state[j, a], projected[a]
                for g in range(size):
                    s[g] += into[g] * w[g]
        if now < _INNOVATION_COUNT - 1 and i < n - 1:
            continue
        for j in range(m):
            for k in range(now + 1, _INNOVATION_COUNT):
                for g in range(size):
                    weighted[k, j, g] = 0.0
        for j in range(m):
            w0, w1, w2, w3 = weighted[0, j], weighted[1, j], weighted[2, j], weighted[3, j]
            for k in range(j, m):
                e0, e1, e2, e3 = innovation[0, k], innovation[1, k], innovation[2, k], innovation[3, k]
                into = products[j, k]
                for g in range(size):
                    into[g] += w0[g] * e0[g] + w1[g] * e1[g] + w2[g] * e2[g] + w3[g] * e3[g]
    for g in range(size):
        log_determinant[g] += math.log(determinant[g])
    return log_determinant[:cells], products[:, :, :cells]


@compiled(error_model="numpy")
def solved(products: Floats) -> tuple[Floats, Floats]:
    """Log det(1 + A^T A) and squares left of r, of cells, from upper products (m, m, cells) of columns A and r."""
    m, cells = products.shape[0], products.shape[2]
    triangle = products.copy()
    log_determinant, scale = np.zeros(cells), np.empty(cells)
    for j in range(m - 1):
        pivot = triangle[j, j]
        for g in range(cells):
            pivot[g] += 1.0
            log_determinant[g] += math.log(pivot[g])
            scale[g] = 1.0 / pivot[g]
        for k in range(j + 1, m):
            one = triangle[j, k]
            for i in range(k, m):
                other, into = triangle[j, i], triangle[k, i]
                for g in range(cells):
                    into[g] -= one[g] * other[g] * scale[g]
    return log_determinant, triangle[m - 1, m - 1]


@compiled(error_model="numpy")
def mean_correlation(width_s: float, tau_s: Floats) -> Floats:
    """Mean of exp(-|dt| / tau) over pairs of instants of a bin, shape (taus,)."""
    if width_s == 0.0:
        return np.ones(len(tau_s))
    x = np.maximum(width_s / tau_s, 1e-4)  # below, rounding is larger than what is left out
    return 2.0 * (x - 1.0 + np.exp(-x)) / x**2


@compiled(error_model="numpy")
def likelihoods(
    begin: Integers,
    numbers: Floats,
    step_s: Floats,
    gain: Floats,
    columns: Floats,
    tau_s: Floats,
    part: Floats,
    ratio: Floats,
    turned: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Log restricted likelihoods of s series over white noise, variances w (s, cells), and of all together (cells,)."""
    # `numbers` (s, 4): observations, how many are absorbed, duration of bins, squares of deviations from bins' means.
    # The mean of a bin has less of a process by the mean correlation in it; the deviations, taken as white, have the
    # rest. Coefficients of all columns but the residuals have unit variance; `turned` (s, r, c) leads to them from
    # common ones.
    series, ratios, m = len(begin) - 1, len(ratio), columns.shape[1]
    shapes, p = tau_s.shape
    cells, common = shapes * ratios, turned.shape[2]
    log, white = np.empty((series, cells + 1)), np.empty((series, cells + 1))
    together, products = np.zeros(cells + 1), np.zeros((common + 1, common + 1, cells + 1))
    of_all, half = np.zeros((m, common + 1)), np.empty((common + 1, cells + 1))
    mean, of_white, deviation = np.empty((shapes, p)), np.empty(cells + 1), np.ones(cells + 1)
    of_all[m - 1, common] = 1.0
    for k in range(series):
        rows = slice(begin[k], begin[k + 1])
        count, absorbed, width_s, inside = numbers[k]
        dof, inside_dof = count - absorbed, count - (begin[k + 1] - begin[k])
        for i in range(m - 1):
            for c in range(common):
                of_all[i, c] = turned[k, i, c]
        for i in range(shapes):
            rest, correlation = 1.0, mean_correlation(width_s, tau_s[i])
            for a in range(p):
                mean[i, a] = part[i, a] * correlation[a]
                rest -= mean[i, a]
            for c in range(ratios):
                deviation[i * ratios + c] = 1.0 + ratio[c] * rest
        log_determinant, mine = filter_grid(step_s[rows], gain[rows], columns[rows], tau_s, mean, ratio)
        for g in range(cells + 1):
            log_determinant[g] += inside_dof * math.log(deviation[g])
            mine[m - 1, m - 1, g] += inside / deviation[g]
        own, squares = solved(mine)
        for g in range(cells + 1):
            white[k, g] = squares[g] / dof
            of_white[g] = 1.0 / white[k, g]
            log[k, g] = -0.5 * (dof * math.log(white[k, g]) + log_determinant[g] + own[g])
            together[g] += count * math.log(white[k, g]) + log_determinant[g]
        for i in range(m):
            for c in range(common + 1):
                into = half[c]
                for g in range(cells + 1):
                    into[g] = 0.0
                for j in range(m):
                    factor, value = of_all[j, c], mine[min(i, j), max(i, j)]
                    if factor != 0.0:
                        for g in range(cells + 1):
                            into[g] += factor * value[g]
            for b in range(common + 1):
                factor = of_all[i, b]
                if factor != 0.0:
                    for c in range(b, common + 1):
                        into, part_of = products[b, c], half[c]
                        for g in range(cells + 1):
                            into[g] += factor * part_of[g] * of_white[g]
    shared, squares = solved(products)
    for g in range(cells + 1):
        together[g] = -0.5 * (together[g] + shared[g] + squares[g])
    for g in range(cells):
        together[g] -= together[cells]
        for k in range(series):
            log[k, g] -= log[k, cells]
    return log[:, :cells], white[:, :cells], together[:cells]


@compiled(error_model="numpy")
def combine(factors: Floats, values: Floats, into: Floats) -> None:
    """Values (j, m) combined by factors (j,), put into an array (m,)."""
    for j in range(len(into)):
        into[j] = factors[0] * values[0, j]
    for k in range(1, len(factors)):
        for j in range(len(into)):
            into[j] += factors[k] * values[k, j]


@compiled(error_model="numpy")
def whiten(
    step_s: Floats,
    white: Floats,
    tau_s: Floats,
    ratio: Floats,
    combined: Floats,
    which: Integers,
    values: Floats,
    variance: Floats,
    state: Floats,
) -> Floats:
    """Innovations of k series over their standard deviations, (k, n, m), for gains of one."""
    # `combined` (u, k, j) by `which` (n,) leads from values (n, j, m); `variance` (k,), `state` (k, m) go on between
    # calls.
    n, _, m = values.shape
    series = len(white)
    out, value = np.empty((series, n, m)), np.empty(m)
    for s in range(series):
        decay, last_s, now, before = 1.0, 0.0, variance[s], state[s]
        for i in range(n):
            combine(combined[which[i], s], values[i], value)
            into = out[s, i]
            if step_s[i] != last_s:
                last_s = step_s[i]
                decay = math.exp(-last_s / tau_s[s])
            predicted = ratio[s] + decay * decay * (now - ratio[s])
            now = predicted / (predicted + 1.0)
            scale = 1.0 / math.sqrt(white[s] * (predicted + 1.0))
            for j in range(m):
                known = decay * before[j]
                left = value[j] - known
                before[j] = known + now * left
                into[j] = left * scale
        variance[s] = now
    return out


@compiled(error_model="numpy")
def weigh(step_s: Floats, white: Floats, tau_s: Floats, ratio: Floats, values: Floats) -> Floats:
    """Transpose of :func:`whiten`: both one after the other multiply by the inverse of the covariance."""
    series, n, m = values.shape
    out = np.empty((series, n, m))
    decay, kalman, scale, state = np.empty(n), np.empty(n), np.empty(n), np.empty(m)
    for s in range(series):
        variance = ratio[s]
        for i in range(n):
            same = i > 0 and step_s[i] == step_s[i - 1]
            decay[i] = decay[i - 1] if same else math.exp(-step_s[i] / tau_s[s])
            predicted = ratio[s] + decay[i] * decay[i] * (variance - ratio[s])
            kalman[i] = predicted / (predicted + 1.0)
            scale[i] = 1.0 / math.sqrt(white[s] * (predicted + 1.0))
            variance = kalman[i]
        state[:] = 0.0
        for i in range(n - 1, -1, -1):
            for j in range(m):
                left = values[s, i, j] * scale[i] + kalman[i] * state[j]
                out[s, i, j] = left
                state[j] = decay[i] * (state[j] - left)
    return out


@compiled(error_model="numpy")
def add_to_bins(
    place: Integers, combined: Floats, which: Integers, values: Floats, sums: Floats, squares: Floats
) -> None:
    """Add combined values (n, j, m) to sums (k, bins, m) at places (n,), squares of the first column to (k,)."""
    n, _, m = values.shape
    value = np.empty(m)
    for i in range(n):
        for s in range(len(squares)):
            combine(combined[which[i], s], values[i], value)
            into = sums[s, place[i]]
            for j in range(m):
                into[j] += value[j]
            squares[s] += value[0] * value[0]


@compiled(error_model="numpy")
def products(
    step_s: Floats,
    gain: Floats,
    columns: Floats,
    width_s: float,
    white: float,
    tau_s: Floats,
    variance: Floats,
) -> Floats:
    """Columns (n, m) times the covariance of bins, `white` and variance exp(-|dt| / tau), times columns, (m, m)."""
    variance = variance * mean_correlation(width_s, tau_s)
    matters = variance > 1e-6 * variance.sum()
    tau_s, variance = tau_s[matters], variance[matters]
    n, m = columns.shape
    taus = len(tau_s)
    out, before, decay = np.zeros((m, m)), np.zeros((taus, m)), np.zeros(taus)
    lasting, earlier, total = np.empty(m), np.empty(m), variance.sum()
    last_s = -1.0
    for i in range(n):
        if step_s[i] != last_s:
            last_s = step_s[i]
            for t in range(taus):
                decay[t] = math.exp(-last_s / tau_s[t])
        half = 0.5 * (total + white / gain[i] ** 2)
        for j in range(m):
            lasting[j] = gain[i] * columns[i, j]
            earlier[j] = half * lasting[j]
        for t in range(taus):
            for j in range(m):
                now = before[t, j] * decay[t]
                earlier[j] += now
                before[t, j] = now + variance[t] * lasting[j]
        for j in range(m):
            for k in range(m):
                out[j, k] += lasting[j] * earlier[k]
    return out + out.T


@compiled(error_model="numpy")
def filter_processes(
    time_s: Floats,
    process: Integers,
    sign: Floats,
    white_m2: Floats,
    least_m2: Floats,
    variance_m2: Floats,
    tau_s: Floats,
    walk_m2_s: Floats,
    hold_s: Floats,
    covariance: Floats,
    state: Floats,
    last_s: Floats,
    begun_s: Floats,
    columns: Floats,
) -> Floats:
    """Innovations of columns (n, m) over their standard deviations, of white noise and shared processes."""
    # `covariance` (s, s), `state` (s, m), their time `last_s` (1,) and when held values were taken, `begun_s` (s,),
    # go on between calls. An innovation whose variance is not above `least_m2` tells nothing: zeros.
    n, m = columns.shape
    s, most = len(tau_s), process.shape[1]
    decay, gain = np.empty(s), np.empty(s)
    out = np.empty((n, m))
    for i in range(n):
        step_s = time_s[i] - last_s[0]
        if step_s > 0.0:
            last_s[0] = time_s[i]
            for a in range(s):
                decay[a] = math.exp(-step_s / tau_s[a]) if tau_s[a] > 0.0 else 0.0
                if walk_m2_s[a] > 0.0 or hold_s[a] > 0.0:
                    decay[a] = 1.0
                for j in range(m):
                    state[a, j] *= decay[a]
            for a in range(s):
                for b in range(s):
                    covariance[a, b] *= decay[a] * decay[b]
                covariance[a, a] += variance_m2[a] * (1.0 - decay[a] * decay[a]) + walk_m2_s[a] * step_s
        for k in range(most):
            a = process[i, k]
            if a >= 0 and hold_s[a] > 0.0 and (sign[i, k] > 0.0 or time_s[i] > begun_s[a] + hold_s[a]):
                begun_s[a] = time_s[i]
                state[a] = 0.0
                covariance[a] = 0.0
                covariance[:, a] = 0.0
                covariance[a, a] = variance_m2[a]
        variance = white_m2[i]
        gain[:] = 0.0
        for k in range(most):
            if process[i, k] >= 0:
                for a in range(s):
                    gain[a] += sign[i, k] * covariance[a, process[i, k]]
        for k in range(most):
            if process[i, k] >= 0:
                variance += sign[i, k] * gain[process[i, k]]
        if not variance > least_m2[i]:
            out[i] = 0.0
            continue
        scale = 1.0 / math.sqrt(variance)
        for j in range(m):
            left = columns[i, j]
            for k in range(most):
                if process[i, k] >= 0:
                    left -= sign[i, k] * state[process[i, k], j]
            out[i, j] = left * scale
            for a in range(s):
                state[a, j] += gain[a] / variance * left
        for a in range(s):
            for b in range(s):
                covariance[a, b] -= gain[a] * gain[b] / variance
    return out
