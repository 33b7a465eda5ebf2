"""Sums of Chebyshev polynomials and their derivatives, many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def chebyshev_sums(
    coefficients: NDArray[np.float64], s: NDArray[np.float64], derivatives: int = 1
) -> tuple[NDArray[np.float64], ...]:
    """Return values and derivatives by s, (k, n), of series with coefficients (degrees, k, n), -1 <= s <= 1.

    Clenshaw's recurrence b_j = c_j + 2 s b_(j+1) - b_(j+2), differentiated.
    """
    twice = 2.0 * s
    b = b_next = db = db_next = ddb = ddb_next = np.zeros(coefficients.shape[1:])
    for k in range(len(coefficients) - 1, 0, -1):
        if derivatives > 1:
            ddb, ddb_next = 4.0 * db + twice * ddb - ddb_next, ddb
        db, db_next = 2.0 * b + twice * db - db_next, db
        # Summed in this order the leading coefficient, 1e4 rad for the lunar angle psi, rounds once.
        b, b_next = coefficients[k] + (twice * b - b_next), b
    values = coefficients[0] + (s * b - b_next)
    rates = b + s * db - db_next
    if derivatives == 1:
        return values, rates
    return values, rates, 2.0 * db + s * ddb - ddb_next
