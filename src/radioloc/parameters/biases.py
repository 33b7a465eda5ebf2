"""Biases of ranges, time tags, equipment and frequency references.

The range bias (m) is added to every range of a receiver. The time bias (s) is the time of the tagged events less the
station's tags; it leaves the values unchanged. Delays of the target's transponder and of the receiving chain (s) are
corrections to the model's. The frequency offset of Doppler and its drift are fractional: receiver's reference less
transmitter's. Integrated over the count interval T, an offset y adds y (c T - v) to the range difference v, as it
shifts the transmitted frequency: 1e-4 of that shift is 100 km on the Moon. Between hydrogen masers of two stations
1e-13 is usual; 1e-12 moves a Doppler solution of a lander by hundreds of metres.

Each range has errors of calibration by default: the delay of the station's ranging chain, and that of the transponder,
which is common to all radio ranges of a target. Sources of their sigmas:

- radio stations, 10 ns or 3 m of the round trip: systematic errors of the DSN are 1 m of the one-way distance
  (Interplanetary Network Progress Report 42-199C, 2014); the standard ECSS-E-ST-50-02C (2008) is for ranging accuracies
  of 2.5 to 30 ns; the stations of LRO had to reach 10 m (Morinelli et al. 2010, SpaceOps);
- transponders, 10 ns: within the same 2.5 to 30 ns, and some nanoseconds of the group delay of Mars Express are
  estimates without a measurement (Planetary Science Archive, MEX-X-MRS-1-2-3-EXT2-2714-V1.0);
- laser stations, 1 cm of the round trip: mean biases of the stations of the ILRS are millimetres to a centimetre one
  way (Appleby et al. 2016, J. Geodesy 90, 1371; Luceri et al. 2019, J. Geodesy 93, 2357).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.constants import C_M_S
from radioloc.parameters.kind import Members, ParameterKind, Scope, Sigmas, all_observations
from radioloc.parameters.rows import ObservationRows
from radioloc.vectors import Floats, Mask

_RADIO_DELAY_SIGMA_S = 10e-9
_LASER_BIAS_SIGMA_M = 0.01
_STATIONS_OR_LINKS = (Scope.STATION, Scope.PASS, Scope.LINK, Scope.LINK_AND_PASS)


def _at_second(acts: Mask) -> Mask:
    """Return flags of both stations, shape (m, 2), for a parameter of the second one."""
    return np.stack([np.zeros_like(acts), acts], axis=-1)


def _range(rows: ObservationRows) -> Mask:
    return _at_second(~rows.baseline & ~rows.integrated)


def _bias_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return sigmas of the stations that receive ranges, larger for radio than for laser signals."""
    radio = np.unique(rows.ends[_range(rows)[:, 1] & rows.radio, 1])
    return {
        name: C_M_S * _RADIO_DELAY_SIGMA_S if k in radio else _LASER_BIAS_SIGMA_M
        for name, k in members.items()
    }


def _tagging(rows: ObservationRows) -> Mask:
    # A tag of the bounce, or of a spacecraft's transmission, is attributed to the receiving station.
    first = rows.tagged[:, 0]
    return np.stack([first, ~first], axis=-1)


def _retransmitted(rows: ObservationRows) -> Mask:
    return ~rows.baseline & ~rows.one_way & rows.radio


def _transponder_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return sigmas of targets with ranges; Doppler hardly depends on the delay."""
    ranged = np.unique(rows.target[_retransmitted(rows) & ~rows.integrated])
    return {name: _RADIO_DELAY_SIGMA_S for name, k in members.items() if k in ranged}


def _receives(rows: ObservationRows) -> Mask:
    received = ~rows.integrated
    return np.stack([received & rows.baseline, received], axis=-1)


def _receiving(rows: ObservationRows) -> Floats:
    # The reading comes later than the arrival; a tag of the arrival is late by as much.
    receives = np.stack([rows.baseline, np.ones(len(rows), dtype=bool)], axis=-1)
    moved = -((rows.tagged & receives) * rows.computed.by_time_m_s[:, None])
    return (_receives(rows) * C_M_S * np.array([-1.0, 1.0]) + moved)[..., None]


def _counted(rows: ObservationRows) -> Mask:
    return _at_second(rows.integrated)


def _offset(rows: ObservationRows) -> Floats:
    return (_counted(rows) * (C_M_S * rows.count_s - rows.computed.value_m)[:, None])[..., None]


def _offset_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return the relative offset of two masers (three-way) and the error of quasar calibration (delay rates)."""
    # Two-way Doppler has no offset; that of one-way Doppler is to be estimated.
    link, three_way = rows.observations.link, ~rows.baseline & ~rows.two_way & ~rows.one_way
    sigmas: Sigmas = {}
    for selected, sigma in ((rows.baseline, 1e-14), (three_way, 1e-13)):
        links = np.unique(link[selected & rows.integrated])
        sigmas |= {name: sigma for name, k in members.items() if k in links}
    return sigmas


RANGE_BIAS = ParameterKind(
    name="range_bias",
    unit="m",
    description="bias of the ranges that a station receives, of the round trip or the one-way path",
    scopes=_STATIONS_OR_LINKS,
    partials=lambda rows: _range(rows)[..., None].astype(np.float64),
    acts_on=_range,
    considered=_bias_sigmas,
    replaced_by=("station_delay",),
)
TIME_BIAS = ParameterKind(
    name="time_bias",
    unit="s",
    description="offset of a station's time tags, which leaves the measured values as they are",
    scopes=_STATIONS_OR_LINKS,
    partials=lambda rows: (_tagging(rows) * rows.computed.by_time_m_s[:, None])[..., None],
    acts_on=_tagging,
    scale=1e-3,
)
TRANSPONDER_DELAY = ParameterKind(
    name="transponder_delay",
    unit="s",
    description="time for which the target's transponder holds the radio signal, beyond the model's",
    scopes=(Scope.TARGET,),
    partials=lambda rows: (_retransmitted(rows) * rows.computed.by_transponder_delay_m_s)[:, None, None],
    acts_on=lambda rows: _retransmitted(rows)[:, None],
    scale=1.0 / C_M_S,
    considered=_transponder_sigmas,
)
STATION_DELAY = ParameterKind(
    name="station_delay",
    unit="s",
    description="delay of a station's receiving equipment, beyond the model's",
    scopes=_STATIONS_OR_LINKS,
    of_links_second=True,
    partials=_receiving,
    acts_on=_receives,
    scale=1.0 / C_M_S,
)
SCALE_FACTOR = ParameterKind(
    name="scale_factor",
    unit="1",
    description="scale of the measured values of a link less one, as of a wrong unit or velocity of light",
    scopes=(Scope.LINK, Scope.LINK_AND_PASS),
    partials=lambda rows: rows.computed.value_m[:, None, None],
    acts_on=all_observations,
    scale=1e-10,  # a decimetre at the Moon; frequency standards of stations are better by orders of magnitude
)
FREQUENCY_OFFSET = ParameterKind(
    name="frequency_offset",
    unit="1",
    description="fractional offset of the received frequency's reference against the transmitted one's, of Doppler and "
    "delay rates",
    scopes=(Scope.LINK, Scope.LINK_AND_PASS, Scope.PASS),
    partials=_offset,
    acts_on=_counted,
    scale=1e-10,
    considered=_offset_sigmas,
)
FREQUENCY_RATE = replace(
    FREQUENCY_OFFSET,
    name="frequency_rate",
    unit="1/s",
    description="drift of the frequency offset, about its value at the epoch of the clocks",
    partials=lambda rows: _offset(rows) * rows.elapsed_s[:, None, None],
    scale=1e-14,
    considered=None,
)
