"""Motions of targets: points fixed to the Moon, and spacecraft on known or adjustable trajectories.

A motion has the position of a target and its partial derivatives by the parameters of the motion: the principal-axes
coordinates of a point, the coordinates of an offset from a known trajectory, or the parameters of an adjustable
trajectory.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris.trajectory import AdjustableTrajectory, SpacecraftTrajectory
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.quantities import convert_fields
from radioloc.time import Epochs
from radioloc.units import set_fields
from radioloc.vectors import Floats


@runtime_checkable
class TargetMotion(Protocol):
    """Motion of a target."""

    @property
    def trajectory(self) -> SpacecraftTrajectory | None:
        """Trajectory of a spacecraft; None for a point fixed to the Moon."""

    @property
    def position_pa_m(self) -> Floats:
        """Position of a point fixed to the Moon, or constant offset from the trajectory, principal axes, m, (3,)."""

    @property
    def adjustable(self) -> AdjustableTrajectory | None:
        """A-priori trajectory, if its parameters are those of the motion, in place of `position_pa_m`."""
        return None

    @property
    def path_key(self) -> Hashable:
        """Key that is equal for motions along the same trajectory."""

    def position_partials(self, tdb: Epochs) -> Floats | None:
        """Return partials of the position, ICRF axes, by parameters, (n, 3, p); None if these are `position_pa_m`."""
        return None

    def restricted_to(self, first: Epochs, last: Epochs) -> TargetMotion:
        """Return the motion restricted to an interval of TDB, by default the motion itself."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class FixedPoint(TargetMotion):
    """Point fixed to the Moon.

    Raises
    ------
    InputError
        The coordinates are not three finite numbers.
    """

    position_pa_m: Floats  #: (3,), position in principal axes, m
    trajectory: ClassVar[None] = None
    path_key: ClassVar[None] = None

    def __post_init__(self) -> None:
        convert_fields(self)
        position_pa_m = np.asarray(self.position_pa_m, dtype=np.float64)
        if position_pa_m.shape != (3,) or not np.isfinite(position_pa_m).all():
            raise InputError(
                f"position_pa_m: expected three finite coordinates in principal axes, m, got {position_pa_m.tolist()}"
            )
        set_fields(self, position_pa_m=position_pa_m)


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryMotion(TargetMotion):
    """Spacecraft on a known trajectory, or at a constant offset from it in principal axes, m."""

    trajectory: SpacecraftTrajectory
    position_pa_m: Floats = field(default_factory=lambda: np.zeros(3))

    @property
    def path_key(self) -> Hashable:
        """Identity of the trajectory."""
        return id(self.trajectory)


@dataclass(frozen=True, slots=True, eq=False)
class OrbitMotion:
    """Spacecraft on an adjustable trajectory, with changes of its parameters, shape (p,), by default without."""

    apriori: AdjustableTrajectory
    changes: Floats = field(default_factory=lambda: np.zeros(0))
    _corrected: list[AdjustableTrajectory] = field(default_factory=list)

    @property
    def trajectory(self) -> AdjustableTrajectory:
        """Trajectory of the changed parameters."""
        if not self.changes.any():
            return self.apriori
        if not self._corrected:
            self._corrected.append(self.apriori.corrected(self.changes))
        return self._corrected[0]

    @property
    def adjustable(self) -> AdjustableTrajectory:
        """A-priori trajectory."""
        return self.apriori

    @property
    def position_pa_m(self) -> Floats:
        """Offset from the trajectory, zeros."""
        return np.zeros(3)

    @property
    def path_key(self) -> Hashable:
        """Identity of the a-priori trajectory, and the changes."""
        return id(self.apriori), self.changes.tobytes() if self.changes.any() else b""

    def position_partials(self, tdb: Epochs) -> Floats:
        """Return the partials of the position with respect to the parameters, ICRF axes, shape (n, 3, p)."""
        return self.trajectory.position_partials(tdb)

    def restricted_to(self, first: Epochs, last: Epochs) -> OrbitMotion:
        """Return the motion restricted to an interval of TDB, the span of its integration."""
        return replace(self, apriori=self.apriori.restricted_to(first, last), _corrected=[])


MotionLike: TypeAlias = TargetMotion | LunarPosition | SpacecraftTrajectory
"""Motion, position on the Moon, or trajectory."""

MotionsLike: TypeAlias = MotionLike | Sequence[MotionLike]
"""Motions of all targets in their order, or of a single target."""

Motions: TypeAlias = tuple[TargetMotion, ...]


def as_motions(motions: MotionsLike, model: PhysicalModel, targets: Sequence[str]) -> Motions:
    """Return the motions of targets; positions are turned to the principal axes of the model's ephemeris."""
    items = motions if isinstance(motions, list | tuple) else (motions,)
    converted = tuple(as_motion(item, model) for item in items)
    if len(converted) != max(1, len(targets)):
        names = f" ({', '.join(targets)})" if targets else ""
        raise InputError(
            f"motions: expected {max(1, len(targets))}, one for each target{names}, got {len(converted)}"
        )
    return converted


def as_motion(motion: MotionLike, model: PhysicalModel) -> TargetMotion:
    """Return the motion of a position or trajectory; raise an InputError for arrays, whose axes are unknown."""
    if isinstance(motion, TargetMotion):
        return motion
    if isinstance(motion, LunarPosition):
        return FixedPoint(motion.to_axes("PA", model.ephemeris.constants).xyz_m)
    if isinstance(motion, AdjustableTrajectory):
        return OrbitMotion(motion)
    if isinstance(motion, SpacecraftTrajectory):
        return TrajectoryMotion(motion)
    raise InputError(
        f"motions: expected a LunarPosition, a FixedPoint (position in principal axes, m) or a trajectory, or one for "
        f"each target, got {type(motion).__name__}; write FixedPoint(position_pa_m)"
    )


def positions_pa_m(motions: Motions) -> Floats:
    """Return the positions of motions, or their offsets from trajectories, principal axes, m, shape (k, 3)."""
    return np.array([motion.position_pa_m for motion in motions])


def partials_of_points(by_position_pa: Floats, target: NDArray[np.int32], count: int) -> Floats:
    """Return d(value)/d(positions of `count` targets), (n, 3 count), from those of each row's target, (n, 3)."""
    if count == 1:
        return by_position_pa
    mask = target[:, None] == np.arange(count)
    return (by_position_pa[:, None, :] * mask[:, :, None]).reshape(len(target), 3 * count)
