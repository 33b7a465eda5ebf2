"""Motions of targets as functions of their parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from radioloc.dynamics import AdjustableOrbit
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.target_motion import FixedPoint, OrbitMotion, TargetMotion
from radioloc.parameters.parameter import Parameter
from radioloc.parameters.position import PositionFunction, PositionParameters
from radioloc.vectors import Floats

MotionFunction = Callable[[Floats], tuple[TargetMotion, Floats]]
"""From parameters to the motion, and the partials of its own parameters by them, (q, p)."""

MotionParameters = tuple[list[Parameter], MotionFunction]


@dataclass(frozen=True, slots=True, eq=False)
class OrbitFunction:
    """Motion along an orbit, from the changes of the orbit's parameters."""

    orbit: AdjustableOrbit
    changes: PositionFunction

    def __call__(self, x: Floats) -> tuple[OrbitMotion, Floats]:
        """Return the motion at parameters x, and the partials of the changes."""
        changes, by_x = self.changes(x)
        return OrbitMotion(self.orbit, changes), by_x


def of_points(positions: PositionParameters) -> MotionParameters:
    """Return the parameters of a position as those of a point fixed to the Moon."""
    parameters, function = positions

    def motion(x: Floats) -> tuple[FixedPoint, Floats]:
        position_pa_m, by_x = function(x)
        return FixedPoint(position_pa_m), by_x

    return parameters, motion


def orbit_of(predictor: Predictor) -> AdjustableOrbit | None:
    """Return the a-priori orbit that a predictor was prepared with; None without any."""
    orbits = [trajectory for trajectory in predictor.trajectories if isinstance(trajectory, AdjustableOrbit)]
    return orbits[0] if orbits else None
