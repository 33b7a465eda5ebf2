"""TDB - TT: what a clock on Earth differs by from the time of the solar system's barycentre.

At the geocentre it is ERFA's series; what depends on the place is the exact first-order term v_E . r / c^2 (Moyer
2003, eq. 2-23; IERS Conventions 2010, eq. 10.7), from the ephemeris' own velocity. ERFA has terms for a place too, but
without the second order in the Earth's eccentricity and, along the spin axis, what Jupiter and the Moon do to its
velocity: up to 1.2 ns at a station and 2.2 ns, 0.65 m of three-way range, between two.
"""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S
from radioloc.time.epochs import Epochs
from radioloc.time.smooth import evaluate_smooth


def geocentric_tdb_minus_tt(epochs: Epochs) -> NDArray[np.float64]:
    """TDB - TT at the geocentre, s, shape (n,); the epochs may be TT or TDB.

    ERFA ``dtdb``: Fairhead and Bretagnon (1990), with 787 terms, good to some nanoseconds over decades.
    """
    return evaluate_smooth(lambda at: np.asarray(erfa.dtdb(at.jd, at.fraction, 0.0, 0.0, 0.0, 0.0)), epochs)


def topocentric_tdb_minus_tt(earth_velocity_m_s: ArrayLike, station_gcrs_m: ArrayLike) -> NDArray[np.float64]:
    """Part of TDB - TT that depends on the place, v_E . r / c^2, s, of BCRS velocity and GCRS position; shape (...,).

    Up to 2.1 microseconds, daily; it does not cancel in three-way range, where it reaches hundreds of metres.
    """
    return np.einsum("...i,...i->...", np.asarray(earth_velocity_m_s), np.asarray(station_gcrs_m)) / C_M_S**2
