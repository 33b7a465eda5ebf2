"""A spacecraft on a known trajectory, without estimated parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.measurements.target_motion import TrajectoryMotion
from radioloc.parameters.parameter import Parameter, Role
from radioloc.targets.doubts import FittedObservations
from radioloc.targets.surface_point import cartesian
from radioloc.targets.target import WithoutForces
from radioloc.time import Epochs
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class KnownTrajectory(WithoutForces):
    """A spacecraft on a trajectory, whose offset from it is held at zero."""

    name: str  #: empty of the only one
    trajectory: SpacecraftTrajectory
    preceding: ClassVar[int] = 0
    has_place: ClassVar[bool] = False
    local_axes: ClassVar[tuple[str, str, str]] = EAST_NORTH_UP  # no component is estimated

    @property
    def parameters(self) -> list[Parameter]:
        """Offset in principal axes, held at zero."""
        name = f"offset.{self.name}" if self.name else "offset"
        return cartesian(np.zeros(3), role=Role.FIXED, name=name)[0]

    @property
    def start(self) -> TrajectoryMotion:
        """The trajectory."""
        return TrajectoryMotion(self.trajectory)

    def local_partials(self, x: Floats, tdb: Epochs, rot_pa_to_me: Floats) -> Floats:
        """Return no rows, shape (0, 3, p): nothing is estimated."""
        return np.zeros((0, 3, len(x)))

    def motion(self, x: Floats) -> tuple[TrajectoryMotion, Floats]:
        """Return the motion at an offset from the trajectory, and its partials."""
        return TrajectoryMotion(self.trajectory, x), np.eye(3)

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the offset, which stands for the place on the Moon, and its partials."""
        return x, np.eye(3)

    def doubts(self, x: Floats, fitted: FittedObservations) -> tuple[()]:
        """Return none: nothing is estimated."""
        return ()

    def solved(self, target_values: Floats, x: Floats) -> Floats:
        """Return the wanted offset."""
        return target_values
