"""The types of measurement that there are: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.measurements`` that names a
:class:`~radioloc.measurements.measurement_type.MeasurementType`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.measurement_type import MeasurementType
from radioloc.measurements.standard_types import STANDARD_TYPES
from radioloc.plugins import LazyNames, registry

_OWN_PLACES = {kind.name: place for place, kind in enumerate(STANDARD_TYPES)}

MEASUREMENTS: Mapping[str, MeasurementType] = registry(
    "radioloc.measurements", MeasurementType, STANDARD_TYPES
)
"""Types of measurement by name; :attr:`Observations.kind` holds places in this order."""

KINDS = LazyNames(lambda: MEASUREMENTS)  # their names


@cache
def _table(trait: str) -> NDArray[np.bool_]:
    """Whether each type has a trait, or the geometry of that name."""
    return np.array([getattr(kind, trait, kind.geometry.name == trait) for kind in MEASUREMENTS.values()])


def is_integrated(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are differences over a count interval: Doppler and delay rates."""
    return np.asarray(_table("integrated")[kind])


def is_differenced(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements belong to a baseline, two stations that receive."""
    return np.asarray(_table("on_baseline")[kind])


def is_one_way(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are of a signal that the target generates, at one station."""
    return np.asarray(_table("ONE_WAY")[kind])


def is_combined(kind: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whether measurements are linear combinations of simpler ones."""
    return np.asarray(_table("COMBINED")[kind])


def kind_of(name: str) -> int:
    """Place of a type of measurement in :data:`KINDS`."""
    return _OWN_PLACES[name] if name in _OWN_PLACES else KINDS.index(name)
