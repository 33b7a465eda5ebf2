"""The types of measurement that there are: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.measurements`` that names a
:class:`~radioloc.measurements.measurement_type.MeasurementType`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.differences import DIFFERENCED_DELAY, DIFFERENCED_DOPPLER, DIFFERENCED_RANGE
from radioloc.measurements.doppler import DOPPLER
from radioloc.measurements.measurement_type import Geometry, MeasurementType
from radioloc.measurements.one_way import ONE_WAY_DOPPLER, ONE_WAY_RANGE
from radioloc.measurements.range import RANGE
from radioloc.measurements.vlbi import VLBI_DELAY, VLBI_DELAY_RATE
from radioloc.plugins import LazyNames, registry

_OWN = [
    RANGE,
    VLBI_DELAY,
    DOPPLER,
    VLBI_DELAY_RATE,
    ONE_WAY_RANGE,
    ONE_WAY_DOPPLER,
    DIFFERENCED_RANGE,
    DIFFERENCED_DOPPLER,
    DIFFERENCED_DELAY,
]
_OWN_PLACES = {kind.name: place for place, kind in enumerate(_OWN)}

MEASUREMENTS: Mapping[str, MeasurementType] = registry("radioloc.measurements", MeasurementType, _OWN)
"""Types of measurement by name; :attr:`Observations.kind` holds places in this order."""

KINDS = LazyNames(lambda: MEASUREMENTS)
"""Their names."""


@cache
def _lookup() -> dict[str, NDArray[np.bool_]]:
    kinds = MEASUREMENTS.values()
    return {
        "integrated": np.array([kind.integrated for kind in kinds]),
        "baseline": np.array([kind.on_baseline for kind in kinds]),
        "one_way": np.array([kind.geometry is Geometry.ONE_WAY for kind in kinds]),
        "combined": np.array([kind.geometry is Geometry.COMBINED for kind in kinds]),
    }


def is_integrated(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are differences over a count interval: Doppler and delay rates."""
    return np.asarray(_lookup()["integrated"][kind])


def is_differenced(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements belong to a baseline, two stations that receive."""
    return np.asarray(_lookup()["baseline"][kind])


def is_one_way(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are of a signal that the target generates, at one station."""
    return np.asarray(_lookup()["one_way"][kind])


def is_combined(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are linear combinations of simpler ones."""
    return np.asarray(_lookup()["combined"][kind])


def kind_of(name: str) -> int:
    """Place of a type of measurement in :data:`KINDS`."""
    return _OWN_PLACES[name] if name in _OWN_PLACES else KINDS.index(name)
