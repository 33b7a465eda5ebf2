"""Gravitational (Shapiro) delay of a signal in the field of a body at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S

PLANETS_MM = {"venus": 0.1, "jupiter": 2.0, "saturn": 0.3}
"""Planets whose delay is modelled beside those of the Sun, the Earth and the Moon: largest size on one way, mm."""


def gravitational_delay_m(
    r1_m: NDArray[np.float64], r2_m: NDArray[np.float64], r12_m: NDArray[np.float64], gm_m3_s2: float
) -> NDArray[np.float64]:
    """Extra path between two points by the gravity of one body, of their distances from it and from each other, m.

    General relativity (gamma = 1): Moyer (2003), eq. 8-55, in which the term k = 2 GM/c^2 beside the distances
    accounts for the bending of the ray; IERS Conventions (2010), eq. 11.17 without it. With s = r1 + r2 the
    logarithm of (s + r12 + k) / (s - r12 + k) is taken as log1p, so that a short path loses no digits.
    """
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return k_m * np.log1p(2.0 * r12_m / (r1_m + r2_m - r12_m + k_m))
