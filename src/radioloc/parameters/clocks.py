"""Clocks of stations and of a transmitting target: offset (s), rate (s/s), the target's drift (1/s).

A clock that is ahead tags every event late. The offset of the second station adds to a flight time or a delay, that of
the first station (or of the target) reduces it, and the clock of the time tag moves the tag: the event was earlier than
its tag. Over a count interval an offset cancels and a rate remains; the clock of the tag defines the interval.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.constants import C_M_S
from radioloc.parameters.kind import Members, ParameterKind, Scope, Sigmas
from radioloc.parameters.rows import TRANSMIT, ObservationRows
from radioloc.vectors import Floats, Mask

_SIGN = np.array([-1.0, 1.0])


def _moved_tag(rows: ObservationRows) -> Floats:
    """Return partials of the values with respect to the offset of the clock of the tag, m/s, shape (m, 2)."""
    return -(rows.tagged * rows.computed.by_time_m_s[:, None])


def _offset(rows: ObservationRows) -> Floats:
    read = (~rows.integrated)[:, None] * C_M_S * _SIGN
    return ((read + _moved_tag(rows)) * (rows.ends >= 0))[..., None]


def _rate(rows: ObservationRows) -> Floats:
    counted = np.where(rows.integrated[:, None], rows.tagged * rows.computed.value_m[:, None], 0.0)
    moved = _moved_tag(rows) * rows.elapsed_s[:, None]
    return ((C_M_S * _SIGN * rows.elapsed_at_ends_s - counted + moved) * (rows.ends >= 0))[..., None]


def _target_tag(rows: ObservationRows) -> Mask:
    return rows.one_way & (rows.tag == TRANSMIT)


def _target_offset(rows: ObservationRows) -> Floats:
    moved = -(_target_tag(rows) * rows.computed.by_time_m_s)
    return np.where(rows.one_way, moved - np.where(rows.integrated, 0.0, C_M_S), 0.0)[:, None, None]


def _target_gains(rows: ObservationRows, gained_s: Floats, at_tag_s: Floats) -> Floats:
    """Return partials for the gain of the target's clock until its event, or in the count interval, and at the tag."""
    return np.where(rows.one_way, -C_M_S * gained_s - _target_tag(rows) * at_tag_s, 0.0)[:, None, None]


def _target_rate(rows: ObservationRows) -> Floats:
    counted = rows.integrated * rows.computed.value_m + rows.computed.by_time_m_s * rows.elapsed_s
    return _target_gains(rows, rows.elapsed_at_ends_s[:, 0], counted)


def _target_drift(rows: ObservationRows) -> Floats:
    since_s, first_s = rows.elapsed_s, rows.elapsed_at_ends_s[:, 0]
    # The middle of the count is read by the target when the signal leaves.
    middle_s = since_s - np.where(_target_tag(rows), 0.0, rows.light_time_s)
    gained_s = np.where(rows.integrated, middle_s * first_s, 0.5 * first_s**2)
    counted = rows.integrated * rows.computed.value_m + 0.5 * rows.computed.by_time_m_s * since_s
    return _target_gains(rows, gained_s, counted * since_s)


def _offset_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return 0.2 ns, the error of calibration by quasars, for VLBI stations; ranging stations agree to 10 ns."""
    by_quasars = np.unique(rows.ends[rows.baseline & ~rows.integrated])
    return {name: 0.2e-9 if k in by_quasars else 10e-9 for name, k in members.items()}


def _rate_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return the error of hydrogen masers after calibration by quasars; Doppler has frequency offsets instead."""
    by_quasars = np.unique(rows.ends[rows.baseline & ~rows.integrated])
    return {name: 5e-15 for name, k in members.items() if k in by_quasars}


CLOCK = ParameterKind(
    name="clock",
    unit="s",
    description="offset of a station's clock: its reading less the true time",
    scopes=(Scope.STATION, Scope.PASS, Scope.LINK, Scope.LINK_AND_PASS),
    of_links_second=True,
    partials=_offset,
    acts_on=lambda rows: (~rows.integrated & ~rows.two_way)[:, None] & (rows.ends >= 0),
    scale=1.0 / C_M_S,
    relative=True,
    considered=_offset_sigmas,
)
CLOCK_RATE = replace(
    CLOCK,
    name="clock_rate",
    unit="s/s",
    description="rate of a station's clock, about the offset at the epoch of the clocks",
    partials=_rate,
    acts_on=lambda rows: (~rows.two_way)[:, None] & (rows.ends >= 0),
    scale=1e-5 / C_M_S,
    considered=_rate_sigmas,
)
TARGET_CLOCK = ParameterKind(
    name="target_clock",
    unit="s",
    description="offset of the target's transmitter clock, for one-way ranges",
    scopes=(Scope.TARGET, Scope.LINK, Scope.LINK_AND_PASS),
    partials=_target_offset,
    acts_on=lambda rows: (rows.one_way & ~rows.integrated)[:, None],
    scale=1.0 / C_M_S,
)
TARGET_FREQUENCY = ParameterKind(
    name="target_frequency",
    unit="1",
    description="fractional frequency offset of the oscillator by which the target transmits, the rate of its clock",
    scopes=(Scope.TARGET, Scope.LINK, Scope.LINK_AND_PASS),
    partials=_target_rate,
    acts_on=lambda rows: rows.one_way[:, None],
    scale=1e-5 / C_M_S,
)
TARGET_FREQUENCY_RATE = replace(
    TARGET_FREQUENCY,
    name="target_frequency_rate",
    unit="1/s",
    description="drift of that frequency offset, about its value at the epoch of the clocks",
    partials=_target_drift,
    scale=1e-9 / C_M_S,
)
