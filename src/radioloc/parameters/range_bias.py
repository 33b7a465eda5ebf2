"""Range bias: what a receiver adds to every range, m."""

import numpy as np
from numpy.typing import NDArray

from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows


def _acts_on(rows: ObservationRows) -> NDArray[np.bool_]:
    ranges = ~rows.baseline & ~rows.integrated
    return np.stack([np.zeros_like(ranges), ranges], axis=-1)


def _partials(rows: ObservationRows) -> NDArray[np.float64]:
    return _acts_on(rows)[..., None].astype(np.float64)


RANGE_BIAS = ParameterKind(
    name="range_bias",
    unit="m",
    description="bias of the ranges that a station receives, of the round trip or the one-way path",
    scopes=(Scope.STATION, Scope.PASS, Scope.LINK, Scope.LINK_AND_PASS),
    partials=_partials,
    acts_on=_acts_on,
)
