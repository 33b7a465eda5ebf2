"""Compiled evaluation of polynomials, one per segment of time, at many rows.

Every row is computed by the same operations in the same order whatever rows are asked for together and however they
are divided among threads, so results do not depend on either. The functions release the interpreter's lock.
"""

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GROUPED = 1024
"""Rows that are sorted by segment at a time; their results stay in the nearest cache."""

RUN = 64
"""So many successive rows of one segment need no sorting."""

EXACT = -1
"""A segment's index from here down marks a row that is not interpolated."""


@numba.njit(nogil=True, cache=True)
def _polynomial(coefficients: Floats, s: int, q: int, t: Floats, out: Floats, m: int) -> None:
    """Polynomial of quantity `q` in segment `s` at the first `m` of `t`, by Horner's rule.

    Parameters
    ----------
    coefficients : ndarray, shape (n_segments, n_quantities, n_coefficients)
        Powers descending.
    s, q : int
    t, out : ndarray, shape (>= m,)
        Where, and the values.
    m : int
    """
    last = coefficients.shape[2]
    first = coefficients[s, q, 0]
    for j in range(m):
        out[j] = first
    single = (last - 1) % 4
    for k in range(1, single + 1):
        c = coefficients[s, q, k]
        for j in range(m):
            out[j] = out[j] * t[j] + c
    # Four steps for each time that `out` is read and written.
    for k in range(single + 1, last, 4):
        c, d = coefficients[s, q, k], coefficients[s, q, k + 1]
        e, f = coefficients[s, q, k + 2], coefficients[s, q, k + 3]
        for j in range(m):
            u = t[j]
            out[j] = (((out[j] * u + c) * u + d) * u + e) * u + f


@numba.njit(nogil=True, cache=True)
def quantities(
    segment: NDArray[np.int32], x: Floats, coefficients: Floats, out: Floats, begin: int, end: int
) -> None:
    """Evaluate all quantities of some rows.

    Parameters
    ----------
    segment : ndarray of int32, shape (n,)
        Segment of each row; rows below zero are left as they are.
    x : ndarray, shape (n,)
        Time within the segment, -1 to 1.
    coefficients : ndarray, shape (n_segments, n_quantities, n_coefficients)
        Powers descending.
    out : ndarray, shape (n_quantities, n)
        Filled.
    begin, end : int
        The rows to evaluate.
    """
    ends = np.zeros(coefficients.shape[0], dtype=np.int64)
    found = np.empty(GROUPED, dtype=np.int64)
    rows = np.empty(GROUPED, dtype=np.int64)
    t, at_t = np.empty(GROUPED), np.empty(GROUPED)
    first = begin
    while first < end:
        # Where the rows are in order of their segments, their places in memory serve as they are.
        stop, same = min(first + GROUPED, end), first + 1
        while same < stop and segment[same] == segment[first]:
            same += 1
        if same - first >= RUN:
            if segment[first] > EXACT:
                for q in range(coefficients.shape[1]):
                    _polynomial(
                        coefficients, segment[first], q, x[first:same], out[q, first:same], same - first
                    )
            first = same
            continue
        # Rows in groups of one segment each, by counting.
        n_found = 0
        for i in range(first, stop):
            s = segment[i]
            if s > EXACT:
                if ends[s] == 0:
                    found[n_found] = s
                    n_found += 1
                ends[s] += 1
        start = 0
        for g in range(n_found):
            size = ends[found[g]]
            ends[found[g]] = start
            start += size
        for i in range(first, stop):
            s = segment[i]
            if s > EXACT:
                rows[ends[s]] = i
                ends[s] += 1
        start = 0
        for g in range(n_found):
            s = found[g]
            m = ends[s] - start
            for j in range(m):
                t[j] = x[rows[start + j]]
            for q in range(coefficients.shape[1]):
                _polynomial(coefficients, s, q, t, at_t, m)
                for j in range(m):
                    out[q, rows[start + j]] = at_t[j]
            start += m
            ends[s] = 0
        first = stop
