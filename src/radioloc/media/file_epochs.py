"""Epochs of a file around those of observations, for interpolation that never goes over an edge or a gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import CoverageError
from radioloc.time import Epochs


def epochs_around(
    file_mjd_utc: NDArray[np.float64], mjd_utc: NDArray[np.float64], longest_gap_d: float, source: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Indices of a file's epochs before and after each epoch, and the share of the way between them.

    Parameters
    ----------
    file_mjd_utc : ndarray, shape (k,)
        Epochs of the file, rising, at least one.
    mjd_utc : ndarray, shape (n,)
        Epochs asked for.
    longest_gap_d : float
        Between epochs of the file further apart than this, days, nothing is given.
    source : str
        What the file is, for errors.

    Returns
    -------
    before, after : ndarray of int, shape (n,)
        Indices; the same where the file has one epoch only.
    share : ndarray, shape (n,)
        From 0 at the epoch before to 1 at that after.

    Raises
    ------
    CoverageError
        An epoch is before the first, after the last, or in a gap.
    """
    last = len(file_mjd_utc) - 1
    outside = (mjd_utc < file_mjd_utc[0]) | (mjd_utc > file_mjd_utc[-1])
    if outside.any():
        wrong = mjd_utc[outside]
        raise CoverageError(
            source,
            (_hour(file_mjd_utc[0]), _hour(file_mjd_utc[-1])),
            (_hour(wrong.min()), _hour(wrong.max())),
            "read the files of the days before and after too",
        )
    before = np.clip(np.searchsorted(file_mjd_utc, mjd_utc, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    gap = file_mjd_utc[after] - file_mjd_utc[before]
    # On an epoch of the file no neighbour is needed.
    between = (mjd_utc != file_mjd_utc[before]) & (mjd_utc != file_mjd_utc[after])
    wide = np.flatnonzero((gap > longest_gap_d) & between)
    if len(wide):
        k = wide[0]
        edges = _hour(file_mjd_utc[before[k]]), _hour(file_mjd_utc[after[k]])
        raise CoverageError(
            f"{source}, which lacks epochs,",
            (_hour(file_mjd_utc[0]), f"{edges[0]} and from {edges[1]}"),
            (_hour(mjd_utc[k]),) * 2,
            "read the files between too",
        )
    return before, after, (mjd_utc - file_mjd_utc[before]) / np.where(gap > 0.0, gap, 1.0)


def _hour(mjd_utc: float) -> str:
    epoch = Epochs.from_jd(2400000.5, mjd_utc, "UTC")
    return f"{epoch.day_strings()[0]} {24.0 * epoch.fraction[0]:04.1f} h UTC"
