"""The nuisance parameters: what they are called, whom they belong to and what they do to a computed value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.measurements.arc import Computed
from radioloc.measurements.observations import (
    RANGE,
    TIME_TAGS,
    VLBI_DELAY,
    VLBI_DELAY_RATE,
    is_differenced,
)
from radioloc.measurements.tracking_arc import TrackingArc
from radioloc.time import utc_to_tai

Shares = Callable[[TrackingArc, Computed | None], NDArray[np.float64]]
"""Partials by the parameter of the first and of the second station of each observation, shape (n, 2)."""


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One kind of parameter, of which each station can have its own.

    Parameters
    ----------
    key : str
        Name of the kind, and of the list of stations in ``[estimate]``; the prior's key adds ``_sigma`` and the unit.
    unit : str
        Unit of the parameter.
    scale : float
        A change worth about one metre.
    shares : callable
        What the parameters of an observation's two stations do to its value. Called without a computation it may
        give any non-zero partials where there are some.
    """

    key: str
    unit: str
    scale: float
    shares: Shares

    @property
    def sigma_key(self) -> str:
        """Key of the prior's sigma in ``[estimate]``."""
        return f"{self.key}_sigma_{self.unit.replace('/', '_')}"

    def stations(self, arc: TrackingArc) -> list[int]:
        """Indices of the stations with observations that such a parameter acts on."""
        acts = self.shares(arc, None) != 0.0
        taking_part = {int(i) for i in arc.transmitters[acts[:, 0]]} | {
            int(i) for i in arc.receivers[acts[:, 1]]
        }
        return sorted(taking_part)

    def columns(self, arc: TrackingArc, computed: Computed, stations: list[int]) -> NDArray[np.float64]:
        """Partials by the parameters of some stations, shape (n, number of stations)."""
        if not stations:
            return np.zeros((len(arc.observations), 0))
        shares = self.shares(arc, computed)
        mine = np.array(stations)
        first = (arc.transmitters[:, None] == mine) * shares[:, :1]
        return first + (arc.receivers[:, None] == mine) * shares[:, 1:]


def _range_bias(arc: TrackingArc, computed: Computed | None) -> NDArray[np.float64]:
    ranges = (arc.observations.kind == RANGE).astype(np.float64)
    return np.stack([np.zeros_like(ranges), ranges], axis=-1)


def _time_bias(arc: TrackingArc, computed: Computed | None) -> NDArray[np.float64]:
    """The tag belongs to the transmitter if it names the transmission, and to the first station of a delay."""
    tags, delays = arc.observations.tag, is_differenced(arc.observations.kind)
    first = delays | (tags == TIME_TAGS.index("transmit"))
    by_time = np.ones(len(tags)) if computed is None else computed.by_time_m_s
    return np.stack([np.where(first, by_time, 0.0), np.where(first, 0.0, by_time)], axis=-1)


def _clock(arc: TrackingArc, computed: Computed | None) -> NDArray[np.float64]:
    """A clock that is ahead reads an arrival later: the second station's adds to the delay, but not to its growth."""
    delays = (arc.observations.kind == VLBI_DELAY) * C_M_S
    return np.stack([-delays, delays], axis=-1)


def _clock_rate(arc: TrackingArc, computed: Computed | None) -> NDArray[np.float64]:
    """Times the time since the middle of the arc, which hardly ties it to the offset, or times the count interval."""
    observations = arc.observations
    shares, rates = _clock(arc, computed), observations.kind == VLBI_DELAY_RATE
    grown = np.where(rates, observations.count_s, 0.0)[:, None] * np.array([-C_M_S, C_M_S])
    if computed is None or not len(shares):
        return shares + grown
    tai = utc_to_tai(observations.epoch)
    elapsed_s = tai.seconds_since(tai[np.zeros(len(tai), dtype=int)])
    return shares * (elapsed_s - 0.5 * (elapsed_s.min() + elapsed_s.max()))[:, None] + grown


def _zenith_delay(arc: TrackingArc, computed: Computed | None) -> NDArray[np.float64]:
    if computed is None:
        return np.ones((len(arc.observations), 2))
    return computed.by_zenith_wet


NUISANCES = (
    Nuisance("range_bias", "m", 1.0, _range_bias),
    Nuisance("time_bias", "s", 1e-3, _time_bias),
    Nuisance("clock", "s", 1.0 / C_M_S, _clock),
    Nuisance("clock_rate", "s/s", 1e-5 / C_M_S, _clock_rate),
    Nuisance("zenith_delay", "m", 0.3, _zenith_delay),
)
"""The kinds: a bias of the receiver's ranges; an offset of the time tags; offset and rate of a VLBI station's clock;
what the wet delay at the zenith is beyond the model."""
