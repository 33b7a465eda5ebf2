"""Targets that are located: points fixed to the Moon, known trajectories, orbits and descents, behind one protocol.

A :class:`Target` has its parameters, its motion as a function of them, and its own estimate.
"""

from radioloc.targets.descent import Descent
from radioloc.targets.known_trajectory import KnownTrajectory
from radioloc.targets.orbit import TargetOrbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.targets.position_prior import PositionPrior
from radioloc.targets.surface_point import SurfacePoint
from radioloc.targets.target import Target

__all__ = [
    "Descent",
    "KnownTrajectory",
    "OrbitState",
    "PositionPrior",
    "SurfacePoint",
    "Target",
    "TargetOrbit",
]
