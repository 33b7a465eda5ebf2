"""Compiled Kalman filter of white noise and first-order Gauss-Markov processes.

Observation i has the error e_i + sum_c sign_ic p_a(t_i) with a = process_ic. From one row to the next each process is
multiplied by `decay` (n, s) and gains the variance `added` (n, s). The functions release the interpreter's lock; every
number is computed by the same operations in the same order on any machine load. Callers allocate results, and zeros for
states, as compiled code that allocates takes the compiler a third longer.
"""

import math

from radioloc.compiled import compiled
from radioloc.vectors import Floats, Indices


@compiled(error_model="numpy")
def filter_gains(
    process: Indices,
    sign: Floats,
    white: Floats,
    min_variance: Floats,
    decay: Floats,
    added: Floats,
    covariance: Floats,
    gain: Floats,
    scale: Floats,
) -> None:
    """Kalman gains (n, s), and one over the standard deviation of each innovation, (n,), in place of zeros."""
    # An innovation whose variance is not above `min_variance` (n,) follows from earlier ones: zeros.
    (n, width), s = process.shape, len(covariance)
    for i in range(n):
        k, variance = gain[i], white[i]
        for a in range(s):
            for b in range(s):
                covariance[a, b] *= decay[i, a] * decay[i, b]
            covariance[a, a] += added[i, a]
        for c in range(width):
            if process[i, c] >= 0:
                for a in range(s):
                    k[a] += sign[i, c] * covariance[a, process[i, c]]
        for c in range(width):
            if process[i, c] >= 0:
                variance += sign[i, c] * k[process[i, c]]
        if not variance > min_variance[i]:
            for a in range(s):
                k[a] = 0.0
            continue
        scale[i] = 1.0 / math.sqrt(variance)
        for a in range(s):
            for b in range(s):
                covariance[a, b] -= k[a] * k[b] / variance
        for a in range(s):
            k[a] /= variance


@compiled(error_model="numpy")
def filter_innovations(
    process: Indices,
    sign: Floats,
    decay: Floats,
    gain: Floats,
    scale: Floats,
    state: Floats,
    columns: Floats,
    out: Floats,
) -> None:
    """Innovations of columns (n, m) over their standard deviations; the state (s, m) goes on between calls."""
    n, m = columns.shape
    s, width = len(state), process.shape[1]
    for i in range(n):
        for a in range(s):
            for j in range(m):
                state[a, j] *= decay[i, a]
        # Loops over columns are innermost, as compilers turn them to vector instructions.
        for j in range(m):
            out[i, j] = columns[i, j]
        for c in range(width):
            if process[i, c] >= 0:
                for j in range(m):
                    out[i, j] -= sign[i, c] * state[process[i, c], j]
        for a in range(s):
            for j in range(m):
                state[a, j] += gain[i, a] * out[i, j]
        for j in range(m):
            out[i, j] *= scale[i]


@compiled(error_model="numpy")
def filter_adjoint(
    process: Indices, sign: Floats, decay: Floats, gain: Floats, scale: Floats, state: Floats, columns: Floats
) -> None:
    """Transpose of :func:`filter_innovations`, in place: both together multiply by the inverse covariance."""
    n, m = columns.shape
    s, width = len(state), process.shape[1]
    for i in range(n - 1, -1, -1):
        for j in range(m):
            columns[i, j] *= scale[i]
        for a in range(s):
            for j in range(m):
                columns[i, j] += gain[i, a] * state[a, j]
        for c in range(width):
            if process[i, c] >= 0:
                for j in range(m):
                    state[process[i, c], j] -= sign[i, c] * columns[i, j]
        for a in range(s):
            for j in range(m):
                state[a, j] *= decay[i, a]


@compiled(error_model="numpy")
def recursions(decay: Floats, weight: Floats, drive: Floats, states: Floats, out: Floats) -> None:
    """Sum of the columns x_i = decay_i x_(i-1) + drive_i of p processes, (n, m), times their weights (p,)."""
    n, m = drive.shape
    for i in range(n):
        for a in range(len(weight)):
            for j in range(m):
                states[a, j] = decay[i, a] * states[a, j] + drive[i, j]
                out[i, j] += weight[a] * states[a, j]
