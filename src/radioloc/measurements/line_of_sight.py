"""The line of sight from a station to the target: all that delays a signal along it, and what is in its way.

One way and at one end of a path. The delays are those of the model's :mod:`media <radioloc.media.registry>`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.lunar_motion import behind_moon
from radioloc.media.medium import Leg, LegEnd, Medium
from radioloc.media.status import Status, first_of
from radioloc.plugins import named_where_it_fails


@dataclass(frozen=True, slots=True, eq=False)
class LineOfSight:
    """Delay of a signal on its way to the target or from it, and what stands against using it."""

    leg: Leg
    delay_m: NDArray[np.float64]  # of all media together, shape (n,)
    rate_m_s: NDArray[np.float64]  # derivatives with respect to time,
    by_position: NDArray[np.float64]  # to the target's position, celestial axes, shape (n, 3),
    by_zenith_wet: NDArray[np.float64]  # and to the wet delay at the zenith, m/m
    status: NDArray[np.int8]  # radioloc.media.status.Status: whether the model holds, or why not


def prepared_media(media: Iterable[Medium], end: LegEnd) -> dict[str, Any]:
    """What each medium has prepared for legs at one end, by name."""
    prepared = {}
    for medium in media:
        with named_where_it_fails(f"medium {medium.name}", "prepare"):
            prepared[medium.name] = medium.prepare(end)
    return prepared


def line_of_sight(
    leg: Leg,
    media: Iterable[Medium],
    prepared: Mapping[str, Any],
    moon_gcrs_m: NDArray[np.float64] | None = None,
) -> LineOfSight:
    """Add up the delays of a leg by the media on it, from what each of them has prepared, by name.

    The first medium whose status is not OK says what is wrong. `moon_gcrs_m`, shape (n, 3), is the geocentric position
    of the Moon where it can hide the target, a spacecraft.
    """
    n = len(leg)
    delay_m, rate_m_s, by_elevation_m_rad, by_zenith_wet = sums = np.zeros((4, n))
    names = ("delay_m", "rate_m_s", "by_elevation_m_rad", "by_zenith_wet")
    by_position: NDArray[np.float64] | float = 0.0
    status = np.zeros(n, dtype=np.int8)
    for medium in media:
        with named_where_it_fails(f"medium {medium.name}", "delay"):
            found = medium.delay(leg, prepared.get(medium.name))
        if found is None:
            continue
        for total, name in zip(sums, names, strict=True):
            part = getattr(found, name)
            if part is not None:
                total += part
        if found.by_position is not None:
            by_position = by_position + found.by_position
        if found.status is not None:
            status = first_of(status, found.status)
    elevation = leg.elevation
    rate_m_s = rate_m_s + by_elevation_m_rad * elevation.rate_rad_s
    by_position = by_position + by_elevation_m_rad[:, None] * elevation.by_position_rad_m
    if moon_gcrs_m is not None:
        hidden = behind_moon(leg.target_gcrs_m, leg.station.gcrs_m, moon_gcrs_m)
        status = np.where(hidden, Status.BEHIND_MOON, status).astype(np.int8)
    status = np.where(elevation.angle_rad < 0.0, Status.BELOW_HORIZON, status).astype(np.int8)
    return LineOfSight(leg, delay_m, rate_m_s, by_position, by_zenith_wet, status)
