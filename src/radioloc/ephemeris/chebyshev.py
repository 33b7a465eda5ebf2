"""Chebyshev series of a kernel's segment, with derivatives, at epochs of two floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.errors import CoverageError
from radioloc.kernels import Kernel, Segment
from radioloc.time import Epochs, utc_strings


def evaluate(
    kernel: Kernel, segment: Segment, tdb: Epochs, derivatives: int = 1
) -> tuple[NDArray[np.float64], ...]:
    """Evaluate a segment: components and their derivatives up to an order, shapes (n, 3), in the file's units and s.

    Clenshaw's recurrence b_k = c_k + 2 s b_(k+1) - b_(k+2), differentiated twice with respect to s. The epoch's two
    floats meet only within a record, so an epoch is resolved to 1e-10 s: 0.1 micrometre of the Moon about the Earth.
    """
    tdb.require("TDB")
    midnight_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY  # exact: a whole number of half days
    rest_s = tdb.fraction * SECONDS_PER_DAY
    outside = ((midnight_s - segment.start_s) + rest_s < 0) | ((midnight_s - segment.end_s) + rest_s > 0)
    if outside.any():
        first, last = utc_strings(tdb[np.lexsort((rest_s, midnight_s))[[0, -1]]], 3)
        raise CoverageError(
            f"{kernel.file.path} (NAIF code {segment.target})",
            segment.span,
            (f"{first} TDB", f"{last} TDB"),
            "open a kernel that covers these epochs, or leave them out",
        )
    length_s = segment.record_length_s
    index, offset_s = np.divmod(midnight_s - segment.first_record_s, length_s)
    carry, offset_s = np.divmod(offset_s + rest_s, length_s)
    record = (index + carry).astype(np.int64)
    # The very end of the last record belongs to it.
    past_end = record == len(segment.coefficients)
    record = record - past_end
    offset_s = offset_s + past_end * length_s
    s = 2.0 * offset_s / length_s - 1.0
    twice = 2.0 * s
    present, which = np.unique(record, return_inverse=True)
    coefficients = np.take(segment.coefficients[present].transpose(2, 1, 0), which.reshape(-1), axis=2)
    b = b_next = db = db_next = ddb = ddb_next = np.zeros((3, len(tdb)))
    for k in range(len(coefficients) - 1, 0, -1):
        if derivatives > 1:
            ddb, ddb_next = 4.0 * db + twice * ddb - ddb_next, ddb
        db, db_next = 2.0 * b + twice * db - db_next, db
        # Summed in this order the leading coefficient, 1e4 rad for the lunar angle psi, rounds once.
        b, b_next = coefficients[k] + (twice * b - b_next), b
    per_second = 2.0 / length_s
    values = coefficients[0] + (s * b - b_next)
    rates = (b + s * db - db_next) * per_second
    if derivatives == 1:
        return values.T, rates.T
    accelerations = (2.0 * db + s * ddb - ddb_next) * per_second**2
    return values.T, rates.T, accelerations.T
