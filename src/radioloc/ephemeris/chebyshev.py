"""Chebyshev series of a kernel's segment, with derivatives, at epochs of two floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.chebyshev import chebyshev_sums
from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.errors import CoverageError
from radioloc.kernels import Kernel, Segment
from radioloc.time import Epochs, utc_strings


def evaluate(
    kernel: Kernel, segment: Segment, tdb: Epochs, derivatives: int = 1
) -> tuple[NDArray[np.float64], ...]:
    """Evaluate a segment: components and their derivatives up to an order, shapes (n, 3), in the file's units and s.

    The epoch's two floats meet only within a record, so an epoch is resolved to 1e-10 s: 0.1 micrometre of the Moon
    about the Earth.
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
    present, which = np.unique(record, return_inverse=True)
    coefficients = np.take(segment.coefficients[present].transpose(2, 1, 0), which.reshape(-1), axis=2)
    sums = chebyshev_sums(coefficients, s, derivatives)
    per_second = 2.0 / length_s
    return tuple(part.T if order == 0 else part.T * per_second**order for order, part in enumerate(sums))
