"""Delays of equipment beyond the model's, s: of the target's transponder and of a station's receiving chain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows


def _over_transponder(rows: ObservationRows) -> NDArray[np.bool_]:
    return (~rows.baseline & ~rows.one_way)[:, None]


def _transponder(rows: ObservationRows) -> NDArray[np.float64]:
    return rows.computed.by_transponder_delay_m_s[:, None, None]


def _receives(rows: ObservationRows) -> NDArray[np.bool_]:
    received = ~rows.integrated
    return np.stack([received & rows.baseline, received], axis=-1)


def _receiving(rows: ObservationRows) -> NDArray[np.float64]:
    """The reading comes later than the arrival; a tag that names the arrival is late by as much."""
    receives = np.stack([rows.baseline, np.ones(len(rows), dtype=bool)], axis=-1)
    moved = -((rows.tagged & receives) * rows.computed.by_time_m_s[:, None])
    return (_receives(rows) * C_M_S * np.array([-1.0, 1.0]) + moved)[..., None]


TRANSPONDER_DELAY = ParameterKind(
    name="transponder_delay",
    unit="s",
    description="time for which the target's transponder holds the signal, beyond the model's",
    scopes=(Scope.TARGET,),
    partials=_transponder,
    acts_on=_over_transponder,
    scale=1.0 / C_M_S,
)
STATION_DELAY = ParameterKind(
    name="station_delay",
    unit="s",
    description="delay of a station's receiving equipment, beyond the model's",
    scopes=(Scope.STATION, Scope.PASS),
    partials=_receiving,
    acts_on=_receives,
    scale=1.0 / C_M_S,
)
