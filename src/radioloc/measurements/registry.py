"""The types of measurement that there are: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.measurements`` that names a
:class:`~radioloc.measurements.measurement_type.MeasurementType`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.differences import DIFFERENCED_DELAY, DIFFERENCED_DOPPLER, DIFFERENCED_RANGE
from radioloc.measurements.doppler import DOPPLER
from radioloc.measurements.measurement_type import Geometry, MeasurementType
from radioloc.measurements.one_way import ONE_WAY_DOPPLER, ONE_WAY_RANGE
from radioloc.measurements.range import RANGE
from radioloc.measurements.vlbi import VLBI_DELAY, VLBI_DELAY_RATE
from radioloc.plugins import with_plugins

MEASUREMENTS: dict[str, MeasurementType] = with_plugins(
    "radioloc.measurements",
    MeasurementType,
    [
        RANGE,
        VLBI_DELAY,
        DOPPLER,
        VLBI_DELAY_RATE,
        ONE_WAY_RANGE,
        ONE_WAY_DOPPLER,
        DIFFERENCED_RANGE,
        DIFFERENCED_DOPPLER,
        DIFFERENCED_DELAY,
    ],
)
"""Types of measurement by name; :attr:`Observations.kind` holds places in this order."""

KINDS = tuple(MEASUREMENTS)
"""Their names."""


def _lookup(column: list[bool]) -> NDArray[np.bool_]:
    table = np.array(column)
    table.flags.writeable = False
    return table


_INTEGRATED = _lookup([kind.integrated for kind in MEASUREMENTS.values()])
_BASELINE = _lookup([kind.on_baseline for kind in MEASUREMENTS.values()])
_ONE_WAY = _lookup([kind.geometry is Geometry.ONE_WAY for kind in MEASUREMENTS.values()])
_COMBINED = _lookup([kind.geometry is Geometry.COMBINED for kind in MEASUREMENTS.values()])


def is_integrated(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are differences over a count interval: Doppler and delay rates."""
    return np.asarray(_INTEGRATED[kind])


def is_differenced(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements belong to a baseline, two stations that receive."""
    return np.asarray(_BASELINE[kind])


def is_one_way(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are of a signal that the target generates, at one station."""
    return np.asarray(_ONE_WAY[kind])


def is_combined(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are linear combinations of simpler ones."""
    return np.asarray(_COMBINED[kind])


def kind_of(name: str) -> int:
    """Place of a type of measurement in :data:`KINDS`."""
    return KINDS.index(name)
