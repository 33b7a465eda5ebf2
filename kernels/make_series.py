"""Make the tables of two long series of ERFA that ship: `python kernels/make_series.py`, from the root of the sources.

Chebyshev polynomials over spans of 32 days from 1972-01-01 to 2050-01-22, in TT or TDB. They go through the series at
the zeros of the polynomial of the next degree, and miss it between them by less than 2e-14 rad or 3e-16 s.
"""

import erfa
import numpy as np

from radioloc.time.smooth import FIRST_JD, SPAN_D

SPANS = 891


def series(function, degree: int) -> np.ndarray:
    """Coefficients of Chebyshev polynomials, lowest first, shape (spans, functions, degree + 1)."""
    angle = np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)
    midnight = FIRST_JD + SPAN_D * np.arange(SPANS)
    values = np.stack(function(midnight[:, None], 0.5 * SPAN_D * (1.0 + np.cos(angle))), axis=1)
    weights = 2.0 / (degree + 1) * np.cos(np.multiply.outer(angle, np.arange(degree + 1)))
    weights[:, 0] *= 0.5
    return values @ weights


if __name__ == "__main__":
    np.save("src/radioloc/earth/data/celestial_pole.npy", series(lambda jd, d: erfa.xys06a(jd, d)[:2], 37))
    np.save(
        "src/radioloc/time/data/tdb_minus_tt.npy",
        series(lambda jd, d: [erfa.dtdb(jd, d, 0.0, 0.0, 0.0, 0.0)], 27),
    )
