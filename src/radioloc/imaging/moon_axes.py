"""From J2000 to the mean-Earth axes of the Moon, in which maps and images are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import LunarOrientation
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.lunar import rot_icrf_to_pa, rot_pa_to_me
from radioloc.time import Epochs

Floats = NDArray[np.float64]


def rot_j2000_to_me(epoch_tdb_s: float, times_s: Floats) -> Floats:
    """Rotations from J2000 (the ICRF) to ME_DE421, shape (n, 3, 3), at times from an epoch, TDB seconds since J2000."""
    epochs = Epochs.from_tdb_seconds(np.full(len(times_s), epoch_tdb_s)).shifted(times_s)
    angles_rad, _ = LunarOrientation.open("DE421").angles(epochs)
    return rot_pa_to_me(CONSTANTS["DE421"]) @ rot_icrf_to_pa(angles_rad)
