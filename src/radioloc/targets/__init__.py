"""Targets that are located: points fixed to the Moon, known trajectories, orbits and descents, behind one protocol.

A :class:`Target` has its parameters, its motion as a function of them, and its own estimate. :data:`TARGET_KINDS` are
kinds of other packages.
"""

from radioloc.estimation.status import Doubt
from radioloc.targets.descent import Descent
from radioloc.targets.doubts import place_doubts
from radioloc.targets.known_trajectory import KnownTrajectory
from radioloc.targets.orbit import TargetOrbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.targets.position_prior import PositionPrior
from radioloc.targets.surface_point import SurfacePoint
from radioloc.targets.target import TARGET_KINDS, Target, TargetDescription, TargetKind, WithoutForces

__all__ = [
    "TARGET_KINDS",
    "Descent",
    "Doubt",
    "KnownTrajectory",
    "OrbitState",
    "PositionPrior",
    "SurfacePoint",
    "Target",
    "TargetDescription",
    "TargetKind",
    "TargetOrbit",
    "WithoutForces",
    "place_doubts",
]
