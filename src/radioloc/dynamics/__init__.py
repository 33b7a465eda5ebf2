"""Motion of a spacecraft about the Moon: gravity, forces, propagation, partials."""

from radioloc.dynamics.accelerations import acceleration_sizes
from radioloc.dynamics.adjustable import AdjustableOrbit
from radioloc.dynamics.elements import elements_from_state, state_from_elements
from radioloc.dynamics.forces import BODIES, Acceleration, Forces, Impulse
from radioloc.dynamics.gravity import GravityField
from radioloc.dynamics.orbit import STATE, Orbit
from radioloc.dynamics.propagation import propagate

__all__ = [
    "BODIES",
    "STATE",
    "Acceleration",
    "AdjustableOrbit",
    "Forces",
    "GravityField",
    "Impulse",
    "Orbit",
    "acceleration_sizes",
    "elements_from_state",
    "propagate",
    "state_from_elements",
]
