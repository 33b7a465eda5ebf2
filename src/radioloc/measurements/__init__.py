"""Measurements between stations on Earth and targets at the Moon, and their predictions.

A :class:`Predictor` (:func:`prepare_predictor`) computes a table of :class:`Observations` with a :class:`PhysicalModel`
for motions of the targets (:class:`TargetMotion`), with partial derivatives. :data:`MEASUREMENTS` has the types of
measurement, :data:`TERMS` the terms of the model by name.
"""

from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import TERMS, PhysicalModel
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.registry import MEASUREMENTS, Geometry, MeasurementType, Part
from radioloc.measurements.sources import read_sources
from radioloc.measurements.target_motion import FixedPoint, OrbitMotion, TargetMotion, TrajectoryMotion

__all__ = [
    "MEASUREMENTS",
    "TERMS",
    "ChebyshevPredictor",
    "Computed",
    "EquipmentDelays",
    "ExactPredictor",
    "FixedPoint",
    "Geometry",
    "Link",
    "MeasurementType",
    "Observations",
    "OrbitMotion",
    "Part",
    "PhysicalModel",
    "Predictor",
    "Ramps",
    "StationDelay",
    "TargetMotion",
    "TrajectoryMotion",
    "prepare_predictor",
    "read_sources",
]
