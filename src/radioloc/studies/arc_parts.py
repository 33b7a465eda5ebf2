"""The first hours of an arc, for several lengths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.studies.study import ObservationChoice
from radioloc.time import utc_to_tai

DEFAULT_HOURS = (12.0, 24.0, 48.0)
"""Arcs of Wang et al. (2021), table 1."""

_ROUNDING_S = 1e-9
"""Both ends of an arc belong to it; epochs are rounded to 1e-11 s."""


def arc_lengths(hours: Iterable[float] | float, choice: ObservationChoice) -> list[float]:
    """Lengths of arcs, each once, the shortest first, h.

    Raises
    ------
    InputError
        None is given, or one is not above zero.
    """
    lengths = sorted({float(length) for length in np.atleast_1d(np.asarray(hours, dtype=np.float64))})
    if not lengths:
        raise InputError("no arc to fit; give at least one length in hours")
    for length in lengths:
        replace(choice, hours=length)  # refuses what is no length
    return lengths


def arc_parts(
    observations: Observations, choice: ObservationChoice, lengths: Iterable[float]
) -> list[tuple[float, float, NDArray[np.intp]]]:
    """Which observations belong to arcs of several lengths.

    Parameters
    ----------
    observations : Observations
        Of the longest arc.
    choice : ObservationChoice
        Its start is that of all arcs; the first observation is where there is none.
    lengths : iterable of float
        h.

    Returns
    -------
    list of (float, float, ndarray of int)
        Length asked for and from the start to the last observation, h; rows.

    Raises
    ------
    InputError
        An arc holds no observation.
    """
    epoch = utc_to_tai(observations.epoch)
    if choice.start is not None:
        start = utc_to_tai(choice.start)
    else:
        start = epoch[int(np.lexsort((epoch.fraction, epoch.jd))[0])]
    since_s = epoch.seconds_since(start)
    parts = []
    for length in lengths:
        rows = np.flatnonzero(since_s <= 3600.0 * length + _ROUNDING_S)
        if not len(rows):
            raise InputError(
                f"the arc of {length:g} h holds no observation: the first comes {since_s.min() / 3600.0:.2f} h after "
                "the start; give a longer arc or a later start"
            )
        parts.append((length, float(since_s[rows].max()) / 3600.0, rows))
    return parts
