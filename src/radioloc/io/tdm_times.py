"""Moving UTC time tags, and time as seconds since a common epoch."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.time import Epochs, tai_to_utc, utc_to_tai


def shifted_utc(utc: Epochs, shift_s: ArrayLike) -> Epochs:
    """Epochs moved by SI seconds, over leap seconds where need be; those not moved keep their last bit.

    Parameters
    ----------
    utc : Epochs
        Epochs in UTC, n of them.
    shift_s : array_like, shape () or (n,)
        How far to move, s; positive is later.
    """
    shift = np.broadcast_to(np.asarray(shift_s, dtype=np.float64), (len(utc),))
    moved = np.flatnonzero(shift)
    if len(moved) == 0:
        return utc
    new = tai_to_utc(utc_to_tai(utc[moved]).shifted(shift[moved]))
    jd, fraction = utc.jd.copy(), utc.fraction.copy()
    jd[moved], fraction[moved] = new.jd, new.fraction
    return Epochs(jd, fraction, "UTC")


def seconds_from(start: Epochs, utc: Epochs) -> NDArray[np.float64]:
    """SI seconds from an epoch to others, all UTC, shape (n,).

    Parameters
    ----------
    start : Epochs
        One epoch.
    utc : Epochs
        The others.
    """
    if len(utc) == 0:
        return np.empty(0)
    return utc_to_tai(utc).seconds_since(utc_to_tai(start))
