"""Frequency offset of Doppler and its drift, per link or pass: fractional, receiver's reference less transmitter's.

Integrated over the count interval T, an offset y adds c y T to the range difference. Between two stations' hydrogen
masers 1e-13 is usual; 1e-12 moves a Doppler solution of a lander by hundreds of metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows

_SCOPES = (Scope.LINK, Scope.LINK_AND_PASS, Scope.PASS)


def _receiver(rows: ObservationRows) -> NDArray[np.bool_]:
    return np.stack([np.zeros_like(rows.integrated), rows.integrated], axis=-1)


def _offset(rows: ObservationRows) -> NDArray[np.float64]:
    return (_receiver(rows) * (C_M_S * rows.count_s)[:, None])[..., None]


def _drift(rows: ObservationRows) -> NDArray[np.float64]:
    return (_receiver(rows) * (C_M_S * rows.count_s * rows.elapsed_s)[:, None])[..., None]


FREQUENCY_OFFSET = ParameterKind(
    name="frequency_offset",
    unit="1",
    description="fractional offset of the received frequency's reference against the transmitted one's, of Doppler and "
    "delay rates",
    scopes=_SCOPES,
    partials=_offset,
    acts_on=_receiver,
    scale=1e-10,
)
FREQUENCY_RATE = ParameterKind(
    name="frequency_rate",
    unit="1/s",
    description="drift of the frequency offset, about its value at the reference epoch, the middle of the arc",
    scopes=_SCOPES,
    partials=_drift,
    acts_on=_receiver,
    scale=1e-14,
)
