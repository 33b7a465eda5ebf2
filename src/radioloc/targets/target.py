"""Protocol of targets: located objects with their parameters, motion and estimate.

Further kinds of target are registered by the entry points ``radioloc.targets`` or :func:`radioloc.register`. Positions,
trajectories and orbiters need no ``kind``: their keys in ``[target]`` distinguish them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import InputError
from radioloc.estimation.status import Doubt
from radioloc.lunar.local import EAST_NORTH_UP, rot_pa_to_enu
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.target_motion import MotionLike, TargetMotion, as_motion
from radioloc.parameters.parameter import Parameter, Role
from radioloc.plugins import Registry
from radioloc.targets.doubts import FittedObservations
from radioloc.targets.orbit_state import OrbitState
from radioloc.time import Epochs
from radioloc.vectors import Floats


@runtime_checkable
class TargetDescription(Protocol):
    """A-priori description of a target: a dataclass whose fields are the keys of its table in a study file."""

    def target(self, name: str, model: PhysicalModel, role: Role = Role.ESTIMATED) -> Target:
        """Return the target with a name, which is empty if it is the only one, and parameters of a role."""
        ...


@dataclass(frozen=True, slots=True)
class TargetKind:
    """Kind of target of a study file."""

    name: str  #: unique name: ``kind`` of ``[target]`` and ``[targets.NAME]``
    record: type[TargetDescription]  #: dataclass of the other keys, a :class:`TargetDescription`


def declared_motion(record: MotionLike | TargetDescription, model: PhysicalModel) -> TargetMotion:
    """Return the a-priori motion of a position, a trajectory or a target of a registered kind."""
    return (
        record.target("", model).start if isinstance(record, TargetDescription) else as_motion(record, model)
    )


TARGET_KINDS: Mapping[str, TargetKind] = Registry("radioloc.targets", TargetKind, ())
"""Kinds by name."""


_NEWTON_STEP_COUNT = 20  # 5 suffice for elements of eccentric orbits
_NEWTON_TOLERANCE = 1e-7  # last step, in m or in the smallest unit of a parameter's scale


class ProcessNoise(Protocol):
    """Stochastic accelerations, constant over intervals and correlated from one to the next."""

    @property
    def interval_s(self) -> float:
        """Length of an interval, s."""

    @property
    def correlation_s(self) -> float:
        """Correlation time, s; zero without."""

    @property
    def persistence(self) -> float:
        """Correlation of an acceleration with that of the next interval."""

    @property
    def sigma_m_s2(self) -> Floats:
        """Sigmas of the accelerations radial, along and across, m/s^2, shape (3,)."""


class Target(Protocol):
    """A target whose motion follows from parameters x, shape (p,)."""

    @property
    def name(self) -> str:
        """Name in the observations; empty of the only target."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters, with a-priori values and sigmas."""

    @property
    def preceding(self) -> int:
        """Number of parameters of the targets before on which the motion depends as well; they come first in x."""

    @property
    def has_place(self) -> bool:
        """True if the target is, or comes to rest, at a place on the Moon."""

    @property
    def orbit(self) -> AdjustableOrbit | None:
        """A-priori orbit, if the motion follows from forces."""

    @property
    def process_noise(self) -> ProcessNoise | None:
        """Stochastic accelerations of the state, if the motion follows from forces."""

    @property
    def start(self) -> TargetMotion:
        """A-priori motion, at which visibility is decided first."""

    def motion(self, x: Floats) -> tuple[TargetMotion, Floats]:
        """Return the motion, and the partials of its own parameters with respect to x, shape (q, p)."""

    def solved(self, target_values: Floats, x: Floats) -> Floats:
        """Return x with this target's parameters for wanted motion parameters: a position, m, or those of an orbit."""

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the place on the Moon, principal axes, m, and its partials for x, (3, p); zeros of a spacecraft."""

    def orbit_at(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit of parameters x, if the motion follows from forces."""

    def with_orbit(self, orbit: AdjustableOrbit) -> Target:
        """Return the target about another a-priori orbit of the same parameters; a point returns itself."""

    @property
    def local_axes(self) -> tuple[str, str, str]:
        """Names of the axes of its errors, the first two horizontal."""

    def local_partials(self, x: Floats, tdb: Epochs, rot_pa_to_me: Floats) -> Floats:
        """Return the partials of position or state along the axes with respect to x, shape (q, d, p).

        Of a place q is 1 and d is 3, m. Of an orbit q is the number of epochs (TDB) and d is 6, m and m/s.
        """

    def gravity_errors(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit at x with the errors of its gravity field that are considered; None without any."""

    def doubts(self, x: Floats, fitted: FittedObservations) -> Iterable[Doubt]:
        """Return reasons why the estimate x cannot be used although the fit has converged."""

    def estimate(
        self, x: Floats, covariance: Floats, sensitivity: Floats, errors: AdjustableOrbit | None
    ) -> OrbitState | None:
        """Return the state of an orbit with its total covariance; None of a target whose place says all.

        `covariance`, shape (p, p), is that of x. `sensitivity`, shape (p, k), is that of x to errors of the gravity
        field, and `errors` is the orbit with these.
        """


class AtPlace:
    """Members of a target at a place on the Moon."""

    __slots__ = ()
    has_place: ClassVar[bool] = True
    local_axes: ClassVar[tuple[str, str, str]] = EAST_NORTH_UP
    # From the parameters to the place in principal axes, m, and its partials (3, p).
    position: Callable[[Floats], tuple[Floats, Floats]]

    def local_partials(self, x: Floats, tdb: Epochs, rot_pa_to_me: Floats) -> Floats:
        """Return the partials of the place with respect to x, east, north and up, shape (1, 3, p)."""
        position_pa_m, by_x = self.position(x)
        return (rot_pa_to_enu(position_pa_m, rot_pa_to_me) @ by_x)[None]


class WithoutForces:
    """Members of a target on which no forces act."""

    __slots__ = ()
    orbit: ClassVar[None] = None
    process_noise: ClassVar[None] = None

    def orbit_at(self, x: Floats) -> None:
        """Return None."""
        return None

    def with_orbit(self, orbit: AdjustableOrbit) -> Self:
        """Return the target itself."""
        return self

    def gravity_errors(self, x: Floats) -> None:
        """Return None."""
        return None

    def estimate(self, *_: object) -> None:
        """Return None."""
        return None


def solve_parameters(
    function: Callable[[Floats], tuple[Floats, Floats]], target_values: Floats, x: Floats
) -> Floats:
    """Return x, shape (p,), with its last q numbers changed until a function has target values, shape (q,)."""
    x, columns = x.copy(), slice(len(x) - len(target_values), None)
    for _ in range(_NEWTON_STEP_COUNT):
        values, by_x = function(x)
        step = np.linalg.solve(by_x[:, columns], target_values - values)
        x[columns] += step
        if np.abs(step).max() < _NEWTON_TOLERANCE:
            return x
    raise InputError(
        "expected parameters of a position or state, Newton's method does not converge; move [target] closer to it, or "
        "give the state in another form"
    )
