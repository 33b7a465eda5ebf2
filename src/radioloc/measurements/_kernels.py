"""Compiled evaluation of polynomials, one per segment of time, at many rows.

Every row is computed by the same operations in the same order whatever rows are asked for together and however they
are divided among threads, so results do not depend on either. The functions release the interpreter's lock.
"""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.vectors import Floats

GROUP_SIZE = 2048  # rows sorted by segment at a time; results for one quantity stay in the nearest cache

BIN_COUNT = 32  # most segments among them; a group ends before the next one begins

BIN_SIZE = GROUP_SIZE + 72  # a power of two would let all bins compete for the same cache lines

MIN_RUN_LENGTH = 64  # so many successive rows of one segment are evaluated where they are

EXACT_SEGMENT = -1  # a segment's index from here down marks a row that is not interpolated


@compiled()
def _polynomial(coefficients: Floats, s: int, q: int, begin: int, t: Floats, out: Floats, m: int) -> None:
    """Evaluate quantity `q` of segment `s` at the first `m` of `t` by Horner's rule, from coefficient `begin` on."""
    # Coefficients, powers descending, have the shape (n_segments, n_quantities, n_coefficients); those before `begin`
    # are 0, and four, or a multiple of four, come after it.
    # Four steps for each time that `out` is read and written.
    b, c = coefficients[s, q, begin], coefficients[s, q, begin + 1]
    d, e, f = coefficients[s, q, begin + 2], coefficients[s, q, begin + 3], coefficients[s, q, begin + 4]
    for j in range(m):
        u = t[j]
        out[j] = (((b * u + c) * u + d) * u + e) * u + f
    for k in range(begin + 5, coefficients.shape[2], 4):
        c, d = coefficients[s, q, k], coefficients[s, q, k + 1]
        e, f = coefficients[s, q, k + 2], coefficients[s, q, k + 3]
        for j in range(m):
            u = t[j]
            out[j] = (((out[j] * u + c) * u + d) * u + e) * u + f


@compiled()
def _leading(coefficients: Floats, s: int, q: int) -> int:
    """Where :func:`_polynomial` may begin: coefficients before that are zero."""
    k = 0
    while k + 5 < coefficients.shape[2] and not coefficients[s, q, k : k + 4].any():
        k += 4
    return k


@compiled()
def quantities(
    segment: NDArray[np.int32], x: Floats, coefficients: Floats, out: Floats, begin: int, end: int
) -> None:
    """Evaluate all quantities of the rows from `begin` to `end` into `out`, shape (n_quantities, n)."""
    # `x`, -1 to 1, is the time within the segment; rows that are not interpolated (segment below zero) become NaN.
    n_quantities = coefficients.shape[1]
    next_place = np.full(coefficients.shape[0], -1, dtype=np.int64)
    found = np.empty(BIN_COUNT, dtype=np.int32)
    place = np.empty(GROUP_SIZE, dtype=np.uint32)  # indices with a sign would be looked at for negative ones
    t, at_t = np.empty(BIN_COUNT * BIN_SIZE), np.empty(BIN_COUNT * BIN_SIZE + 1)
    at_t[-1] = np.nan
    first = begin
    while first < end:
        # Where the rows are in order of their segments, their places in memory serve as they are.
        stop, same = min(first + GROUP_SIZE, end), first + 1
        while same < stop and segment[same] == segment[first]:
            same += 1
        if same - first >= MIN_RUN_LENGTH:
            s = segment[first]
            for q in range(n_quantities):
                if s > EXACT_SEGMENT:
                    k = _leading(coefficients, s, q)
                    _polynomial(coefficients, s, q, k, x[first:same], out[q, first:same], same - first)
                else:
                    out[q, first:same] = np.nan
            first = same
            continue
        # Rows that take turns: the times of each segment into a bin of its own.
        n_found = 0
        i = first
        while i < stop:
            s = segment[i]
            if s > EXACT_SEGMENT:
                to = next_place[s]
                if to < 0:
                    if n_found == BIN_COUNT:
                        break
                    found[n_found] = s
                    to = n_found * BIN_SIZE
                    n_found += 1
                t[to] = x[i]
                place[i - first] = to
                next_place[s] = to + 1
            else:
                place[i - first] = BIN_COUNT * BIN_SIZE
            i += 1
        stop = i
        # One quantity after the other, so that what is gathered is near and what is written stands together.
        for q in range(n_quantities):
            for g in range(n_found):
                s, of_bin = found[g], g * BIN_SIZE
                k = _leading(coefficients, s, q)
                _polynomial(coefficients, s, q, k, t[of_bin:], at_t[of_bin:], next_place[s] - of_bin)
            values = out[q, first:stop]
            for j in range(stop - first):
                values[j] = at_t[place[j]]
        for g in range(n_found):
            next_place[found[g]] = -1
        first = stop
