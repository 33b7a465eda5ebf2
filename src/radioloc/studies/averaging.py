"""Counts of Doppler that follow each other, joined to longer ones: cycles add, nothing is lost but resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import is_integrated
from radioloc.time import tai_to_utc, utc_to_tai

_SAME_S = 1e-6
"""Counts meet if one begins when the one before it ends, to this time: at 2 km/s a gap of it would be 2 mm."""
_SAME = ("link", "kind", "tag", "count_s", "uplink_hz", "wavelength_um", "ramped")
"""What counts that are joined have in common; of ramped ones ``uplink_hz`` is what their cycles are in metres by."""


def with_averaged_counts(observations: Observations, average_s: float) -> tuple[Observations, int]:
    """Sum counts without gaps, of one path, type and frequency, over a longer interval; the others stay.

    Parameters
    ----------
    observations : Observations
        In any order.
    average_s : float
        The longer interval, a whole number of count intervals, s. Longer counts stay as they are.

    Returns
    -------
    Observations
        Rows stand where the first of their counts stood. The tag is the middle of the interval, weather that of a count
        there; sigmas are those of sums of independent counts.
    int
        How many counts are left out, since a gap, a pass or a frequency ended before the interval did.

    Raises
    ------
    InputError
        The interval is not a whole number of count intervals.
    """
    with np.errstate(invalid="ignore"):
        shorter = is_integrated(observations.kind) & (observations.count_s < average_s - _SAME_S)
    rows = np.flatnonzero(shorter)
    if not len(rows):
        return observations, 0
    number = np.rint(average_s / observations.count_s[rows]).astype(np.int64)
    wrong = np.abs(number * observations.count_s[rows] - average_s) > _SAME_S
    if wrong.any():
        row = int(rows[np.argmax(wrong)])
        raise InputError(
            f"[observations] doppler_average_s = {average_s:g} is no whole number of counts of "
            f"{observations.count_s[row]:g} s ({observations.origin(row)}); give a multiple of it"
        )
    tai = utc_to_tai(observations.epoch[rows])
    since_s = tai.seconds_since(tai[:1])
    columns = [np.nan_to_num(getattr(observations, name)[rows]) for name in _SAME]
    order = np.lexsort((since_s, *columns))
    rows, number, since_s = rows[order], number[order], since_s[order]
    # A run of counts without gaps; in it, intervals of so many counts from its first on.
    meets = np.abs(np.diff(since_s) - observations.count_s[rows[1:]]) < _SAME_S
    for column in columns:
        meets &= np.diff(column[order]) == 0
    begins = np.concatenate([[True], ~meets])
    run = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    place = np.arange(len(rows)) - first[run]
    whole = place - place % number + number <= np.bincount(run)[run]
    starts = np.flatnonzero((place % number == 0) & whole)
    if not len(starts):
        return observations.select(~shorter), len(rows)
    interval = np.cumsum((place % number == 0) & whole)[whole] - 1
    value_m, variance_m2 = (
        np.bincount(interval, weights=column[rows[whole]]).astype(np.float64)
        for column in (observations.value_m, observations.sigma_m**2)
    )
    half_s = 0.5 * (number[starts] - 1) * observations.count_s[rows[starts]]
    middle = observations.select(rows[starts + number[starts] // 2])
    joined = replace(
        middle,
        epoch=tai_to_utc(tai[order][starts].shifted(half_s)),
        value_m=value_m,
        sigma_m=np.sqrt(variance_m2),
        count_s=np.full(len(starts), average_s),
        file=observations.file[rows[starts]],
        line=observations.line[rows[starts]],
    )
    others = np.flatnonzero(~shorter)
    made = Observations.concatenate([joined, observations.select(others)])
    in_order = np.argsort(np.concatenate([rows[starts], others]), kind="stable")
    return made.select(in_order), int((~whole).sum())
