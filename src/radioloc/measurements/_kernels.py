"""Compiled evaluation of the polynomials of segments of time at many rows.

Each row is computed by the same operations in the same order, so results do not depend on the selected rows or on the
number of threads. The functions release the interpreter's lock.
"""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.vectors import Floats, Indices

GROUP_SIZE = 2048  # rows sorted by segment together; results of a quantity fit into the nearest cache
BIN_COUNT = 32  # largest number of segments of a group
BIN_SIZE = GROUP_SIZE + 72  # with a power of two all bins would compete for the same cache lines
MIN_RUN_LENGTH = 64  # successive rows of a segment that are evaluated without sorting
EXACT_SEGMENT = -1  # segments up to this index mark rows that are not interpolated


@compiled()
def _polynomial(coefficients: Floats, t: Floats, out: Floats) -> None:
    """Evaluate a polynomial at places t by Horner's rule, from the first four coefficients on that are not all zero."""
    # Powers are descending, and a multiple of four follows the first. Four steps are made for each access to `out`.
    begin, size = 0, len(coefficients)
    while begin + 5 < size and (
        coefficients[begin]
        == coefficients[begin + 1]
        == coefficients[begin + 2]
        == coefficients[begin + 3]
        == 0.0
    ):
        begin += 4
    b, c = coefficients[begin], coefficients[begin + 1]
    d, e, f = coefficients[begin + 2], coefficients[begin + 3], coefficients[begin + 4]
    for j in range(len(t)):
        u = t[j]
        out[j] = (((b * u + c) * u + d) * u + e) * u + f
    for k in range(begin + 5, size, 4):
        c, d = coefficients[k], coefficients[k + 1]
        e, f = coefficients[k + 2], coefficients[k + 3]
        for j in range(len(t)):
            u = t[j]
            out[j] = (((out[j] * u + c) * u + d) * u + e) * u + f


def quantities(
    segment: NDArray[np.int32], x: Floats, coefficients: Floats, out: Floats, begin: int, end: int
) -> None:
    """Evaluate all quantities of the rows from `begin` to `end` into `out`, shape (n_quantities, n)."""
    # `coefficients` have the shape (n_segments, n_quantities, n_coefficients). `x`, -1 to 1, is the time within the
    # segment; rows that are not interpolated (segment below zero) become NaN. Each array that compiled code allocates
    # takes the compiler a tenth of a second.
    next_place = np.full(len(coefficients), -1)
    place = np.empty(GROUP_SIZE, dtype=np.uint32)  # signed indices would be checked for negative values
    binned = np.empty((2, BIN_COUNT * BIN_SIZE + 1))  # times, and values at them
    binned[1, -1] = np.nan
    _quantities(segment, x, coefficients, next_place, place, binned, out, begin, end)


@compiled()
def _quantities(
    segment: NDArray[np.int32],
    x: Floats,
    coefficients: Floats,
    next_place: Indices,
    place: NDArray[np.uint32],
    binned: Floats,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    n_quantities, t, at_t = coefficients.shape[1], binned[0], binned[1]
    bin_segment = np.empty(BIN_COUNT, dtype=np.int32)
    first = begin
    while first < end:
        # Long runs of a segment are evaluated in place.
        stop, run_end = min(first + GROUP_SIZE, end), first + 1
        while run_end < stop and segment[run_end] == segment[first]:
            run_end += 1
        if run_end - first >= MIN_RUN_LENGTH:
            s = segment[first]
            for q in range(n_quantities):
                if s > EXACT_SEGMENT:
                    _polynomial(coefficients[s, q], x[first:run_end], out[q, first:run_end])
                else:
                    out[q, first:run_end] = np.nan
            first = run_end
            continue
        # Otherwise the times of each segment are collected in a bin.
        bin_count = 0
        i = first
        while i < stop:
            s = segment[i]
            if s > EXACT_SEGMENT:
                to = next_place[s]
                if to < 0:
                    if bin_count == BIN_COUNT:
                        break
                    bin_segment[bin_count] = s
                    to = bin_count * BIN_SIZE
                    bin_count += 1
                t[to] = x[i]
                place[i - first] = to
                next_place[s] = to + 1
            else:
                place[i - first] = BIN_COUNT * BIN_SIZE
            i += 1
        stop = i
        # Quantity by quantity, for contiguous memory.
        for q in range(n_quantities):
            for g in range(bin_count):
                s, of_bin = bin_segment[g], g * BIN_SIZE
                _polynomial(coefficients[s, q], t[of_bin : next_place[s]], at_t[of_bin:])
            values = out[q, first:stop]
            for j in range(stop - first):
                values[j] = at_t[place[j]]
        for g in range(bin_count):
            next_place[bin_segment[g]] = -1
        first = stop
