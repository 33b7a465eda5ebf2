"""Zenith delay of the troposphere (m) and vertical electron content (TECU) above a station, beyond the model's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.parameters import apriori
from radioloc.parameters.kind import ParameterKind, Scope, both_stations
from radioloc.parameters.rows import ObservationRows


def _electron_content(rows: ObservationRows) -> NDArray[np.float64]:
    by_content = rows.computed.by_electron_content_m
    if np.isnan(by_content).any():
        row = int(rows.rows[np.flatnonzero(np.isnan(by_content).any(axis=-1))[0]])
        raise InputError(
            f"{rows.observations.origin(row)}: the electron content acts by the signal's frequency, which is not "
            "recorded; give uplink_hz and wavelength_um"
        )
    return (by_content * (rows.ends >= 0))[..., None]


ZENITH_DELAY = ParameterKind(
    name="zenith_delay",
    unit="m",
    description="wet zenith delay of radio signals above a station, beyond the model's",
    scopes=(Scope.STATION, Scope.PASS),
    partials=lambda rows: (rows.computed.by_zenith_wet * (rows.ends >= 0))[..., None],
    acts_on=both_stations,
    scale=0.3,
    term="troposphere",
    considered=apriori.zenith_delays,
    considered_per=Scope.PASS,
)
ELECTRON_CONTENT = ParameterKind(
    name="electron_content",
    unit="tecu",
    description="vertical electron content above a station, beyond the model's, 1e16 per square metre",
    scopes=(Scope.STATION, Scope.PASS),
    partials=_electron_content,
    acts_on=both_stations,
    scale=10.0,
    more_partials=True,
    considered=apriori.electron_contents,
    considered_per=Scope.PASS,
)
