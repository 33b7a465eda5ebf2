"""Motions of targets: points fixed to the Moon, and spacecraft on known or adjustable trajectories.

Each is what a predictor takes of a target: where it is, and the partial derivatives of its position by the motion's own
parameters. These are the three principal-axes coordinates of a point, those of an offset from a known trajectory, and
the parameters of an adjustable one.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris.trajectory import AdjustableTrajectory, AnyTrajectory
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.quantities import convert_fields
from radioloc.time import Epochs
from radioloc.vectors import Floats


@runtime_checkable
class TargetMotion(Protocol):
    """Motion of one target, as predictors take it."""

    @property
    def trajectory(self) -> AnyTrajectory | None:
        """Trajectory of a spacecraft; None of a point fixed to the Moon."""

    @property
    def position_pa_m(self) -> Floats:
        """Position of a point fixed to the Moon, or constant offset from the trajectory, principal axes, m, (3,)."""

    @property
    def adjustable(self) -> AdjustableTrajectory | None:
        """A-priori trajectory, if its parameters are those of the motion."""

    @property
    def path_key(self) -> Hashable:
        """Key that is equal for motions along the same trajectory."""

    def position_partials(self, tdb: Epochs) -> Floats | None:
        """Partials of the position, ICRF axes, by the parameters, (n, 3, p); None if these are `position_pa_m`."""

    def restricted_to(self, first: Epochs, last: Epochs) -> TargetMotion:
        """Return the motion restricted to an interval of TDB."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedPoint:
    """A point fixed to the Moon.

    Parameters
    ----------
    position_pa_m : array_like, shape (3,)
        Position in principal axes, m.

    Raises
    ------
    InputError
        The coordinates are not three finite numbers.
    """

    position_pa_m: Floats

    def __post_init__(self) -> None:
        convert_fields(self)
        position_pa_m = np.asarray(self.position_pa_m, dtype=np.float64)
        if position_pa_m.shape != (3,) or not np.isfinite(position_pa_m).all():
            raise InputError(
                f"a position is {position_pa_m.tolist()}; give three finite coordinates in principal axes, m"
            )
        object.__setattr__(self, "position_pa_m", position_pa_m)

    @property
    def trajectory(self) -> None:
        """None: the point follows from the Moon's orientation."""
        return None

    @property
    def adjustable(self) -> None:
        """None: the parameters are coordinates."""
        return None

    @property
    def path_key(self) -> Hashable:
        """Key that is equal for all points."""
        return None

    def position_partials(self, tdb: Epochs) -> None:
        """Return None, as the parameters are the coordinates in principal axes."""
        return None

    def restricted_to(self, first: Epochs, last: Epochs) -> FixedPoint:
        """Return the point itself, which holds always."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryMotion:
    """A spacecraft on a known trajectory, or at a constant offset from it in principal axes, m."""

    trajectory: AnyTrajectory
    position_pa_m: Floats = field(default_factory=lambda: np.zeros(3))

    @property
    def adjustable(self) -> None:
        """None: the parameters are coordinates of an offset."""
        return None

    @property
    def path_key(self) -> Hashable:
        """Identity of the trajectory."""
        return id(self.trajectory)

    def position_partials(self, tdb: Epochs) -> None:
        """Return None, as the parameters are the coordinates of the offset."""
        return None

    def restricted_to(self, first: Epochs, last: Epochs) -> TrajectoryMotion:
        """Return the motion itself, whose states are read where they are needed."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class OrbitMotion:
    """A spacecraft on an adjustable trajectory, by changes of its parameters, shape (p,); by default none."""

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
        """Return the partials of the position by the parameters, ICRF axes, shape (n, 3, p)."""
        return self.trajectory.position_partials(tdb)

    def restricted_to(self, first: Epochs, last: Epochs) -> OrbitMotion:
        """Return the motion restricted to an interval of TDB, over which alone it is integrated."""
        return replace(self, apriori=self.apriori.restricted_to(first, last), _corrected=[])


GivenMotion: TypeAlias = TargetMotion | LunarPosition | AnyTrajectory
"""A motion, or what stands for one: a position on the Moon or a trajectory."""

GivenMotions: TypeAlias = GivenMotion | Sequence[GivenMotion]
"""Motions of all targets in their order, or of the only one."""

Motions: TypeAlias = tuple[TargetMotion, ...]


def as_motions(given: GivenMotions, model: PhysicalModel, targets: Sequence[str]) -> Motions:
    """Return the motions of targets; positions are turned to the principal axes of the model's ephemeris."""
    several = given if isinstance(given, list | tuple) else (given,)
    motions = tuple(as_motion(item, model) for item in several)
    if len(motions) != max(1, len(targets)):
        names = f" ({', '.join(targets)})" if targets else ""
        raise InputError(
            f"motions: expected {max(1, len(targets))}, one for each target{names}, got {len(motions)}"
        )
    return motions


def as_motion(given: GivenMotion, model: PhysicalModel) -> TargetMotion:
    """Return a motion; an InputError of an array, which does not state what its numbers are."""
    if isinstance(given, TargetMotion):
        return given
    if isinstance(given, LunarPosition):
        return FixedPoint(given.to_axes("PA", model.ephemeris.constants).xyz_m)
    if isinstance(given, AdjustableTrajectory):
        return OrbitMotion(given)
    if isinstance(given, AnyTrajectory):
        return TrajectoryMotion(given)
    raise InputError(
        f"motions: expected a LunarPosition, a FixedPoint (position in principal axes, m) or a trajectory, or one for "
        f"each target, got {type(given).__name__}; write FixedPoint(position_pa_m)"
    )


def positions_pa_m(motions: Motions) -> Floats:
    """Return the positions of motions, or their offsets from trajectories, principal axes, m, shape (k, 3)."""
    return np.array([motion.position_pa_m for motion in motions])


def is_fixed(motions: Motions) -> bool:
    """Return whether all targets are points fixed to the Moon."""
    return all(motion.trajectory is None for motion in motions)


def partials_of_points(by_position_pa: Floats, target: NDArray[np.int32], count: int) -> Floats:
    """Return partials by the positions of so many targets, (n, 3 count), from those by each row's own, (n, 3)."""
    if count == 1:
        return by_position_pa
    own = target[:, None] == np.arange(count)
    return (by_position_pa[:, None, :] * own[:, :, None]).reshape(len(target), 3 * count)
