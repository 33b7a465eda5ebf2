"""From J2000 to the mean-Earth axes of the Moon, in which maps and images are, and the Sun in these."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.lunar import rot_icrf_to_pa, rot_pa_to_me
from radioloc.time import Epochs, to_scale

Floats = NDArray[np.float64]


def rot_j2000_to_me(epoch_tdb_s: float, times_s: Floats) -> Floats:
    """Rotations from J2000 (the ICRF) to ME_DE421, shape (n, 3, 3), at times from an epoch, TDB seconds since J2000."""
    return _rot_icrf_to_me(Epochs.from_tdb_seconds(np.full(len(times_s), epoch_tdb_s)).shifted(times_s))


def sun_me_m(epochs: Epochs) -> Floats:
    """The Sun from the Moon's centre, ME_DE421, m, shape (n, 3).

    Geometric: aberration moves it by 0.006 degrees, a fiftieth of its radius on the sky.
    """
    tdb = to_scale(epochs, "TDB")
    ephemeris = Ephemeris.open("DE421")
    (sun_m, _), (moon_m, _) = (ephemeris.geocentric(body, tdb) for body in ("sun", "moon"))
    return vectors.rotated(_rot_icrf_to_me(tdb), sun_m - moon_m)


def _rot_icrf_to_me(tdb: Epochs) -> Floats:
    angles_rad, _ = LunarOrientation.open("DE421").angles(tdb)
    return rot_pa_to_me(CONSTANTS["DE421"]) @ rot_icrf_to_pa(angles_rad)
