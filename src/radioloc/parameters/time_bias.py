"""Time bias: how much later the tagged events happened than a station's tags say, s; the values are not changed."""

import numpy as np
from numpy.typing import NDArray

from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows


def _acts_on(rows: ObservationRows) -> NDArray[np.bool_]:
    """A tag that names the bounce, or a spacecraft's transmission, is put down to the receiving station."""
    first = rows.tagged[:, 0]
    return np.stack([first, ~first], axis=-1)


def _partials(rows: ObservationRows) -> NDArray[np.float64]:
    return (_acts_on(rows) * rows.computed.by_time_m_s[:, None])[..., None]


TIME_BIAS = ParameterKind(
    name="time_bias",
    unit="s",
    description="offset of a station's time tags, which leaves the measured values as they are",
    scopes=(Scope.STATION, Scope.PASS, Scope.LINK, Scope.LINK_AND_PASS),
    partials=_partials,
    acts_on=_acts_on,
    scale=1e-3,
)
