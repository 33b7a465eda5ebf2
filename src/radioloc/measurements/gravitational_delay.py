"""Gravitational (Shapiro) delay of a signal in the field of a body at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.vectors import length

PLANETS_MM = {"venus": 0.1, "jupiter": 2.0, "saturn": 0.3}
"""Planets whose delay is modelled beside those of the Sun, the Earth and the Moon: largest size on one way, mm."""


def gravitational_delay_m(
    start_m: NDArray[np.float64], end_m: NDArray[np.float64], body_m: NDArray[np.float64], gm_m3_s2: float
) -> NDArray[np.float64]:
    """Extra path between two points by the gravity of one body, m, shape (n,).

    Parameters
    ----------
    start_m, end_m : ndarray, shape (n, 3)
        Where the signal leaves and arrives, in one frame.
    body_m : ndarray, shape (n, 3)
        Where the body is, same frame.
    gm_m3_s2 : float
        Its gravitational parameter, m^3/s^2.

    Notes
    -----
    General relativity (gamma = 1): Moyer (2003), eq. 8-55, in which the term k = 2 GM/c^2 beside the distances
    accounts for the bending of the ray; IERS Conventions (2010), eq. 11.17 without it. With s = r1 + r2 the
    logarithm of (s + r12 + k) / (s - r12 + k) is taken as log1p, so that a short path loses no digits.
    """
    return delay_of_distances_m(
        length(start_m - body_m), length(end_m - body_m), length(end_m - start_m), gm_m3_s2
    )


def delay_of_distances_m(
    r1_m: NDArray[np.float64], r2_m: NDArray[np.float64], r12_m: NDArray[np.float64], gm_m3_s2: float
) -> NDArray[np.float64]:
    """The same from the distances of both points from the body and from each other, m, shapes (n,)."""
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return k_m * np.log1p(2.0 * r12_m / (r1_m + r2_m - r12_m + k_m))
