"""Bias of a receiving station's ranges that is proportional to the zenith angle, m/rad."""

import numpy as np

from radioloc.parameters import ObservationRows, ParameterKind, Scope


def acts_on(rows: ObservationRows) -> np.ndarray:
    ranges = ~rows.baseline & ~rows.integrated
    return np.stack([np.zeros_like(ranges), ranges], axis=-1)  # at the first and at the second station


def partials(rows: ObservationRows) -> np.ndarray:
    zenith_angle_rad = 0.5 * np.pi - rows.computed.elevation_rad  # shape (m, 2)
    return (acts_on(rows) * zenith_angle_rad)[..., np.newaxis]


ZENITH_ANGLE_BIAS = ParameterKind(
    name="zenith_angle_bias",
    unit="m/rad",
    description="bias of the ranges that a station receives, proportional to the zenith angle",
    scopes=(Scope.STATION, Scope.PASS),
    partials=partials,
    acts_on=acts_on,
)
