"""Protocol of targets: what is located, with its parameters, its motion and its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from radioloc.dynamics import AdjustableOrbit
from radioloc.measurements.target_motion import TargetMotion
from radioloc.parameters.parameter import Parameter
from radioloc.targets.orbit_state import OrbitState
from radioloc.vectors import Floats


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
    def orbit(self) -> AdjustableOrbit | None:
        """A-priori orbit, if the motion follows from forces."""

    def motion(self, x: Floats) -> tuple[TargetMotion, Floats]:
        """Return the motion, and the partials of its own parameters by x, shape (q, p)."""

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the place on the Moon, principal axes, m, and its partials by x, (3, p); zeros of a spacecraft."""

    def orbit_at(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit of parameters x, if the motion follows from forces."""

    def with_orbit(self, orbit: AdjustableOrbit) -> Target:
        """Return the target about another a-priori orbit of the same parameters; a point returns itself."""

    @property
    def start(self) -> TargetMotion:
        """A-priori motion, at which visibility is decided first."""

    def gravity_errors(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit at x with the errors of its gravity field that are considered; None without any."""

    def estimate(
        self, x: Floats, covariance: Floats, sensitivity: Floats, errors: AdjustableOrbit | None
    ) -> OrbitState | None:
        """Return the state of an orbit with its total covariance; None of a target whose place says all.

        `covariance`, shape (p, p), is that of x. `sensitivity`, shape (p, k), is that of x to errors of the gravity
        field, and `errors` is the orbit with these.
        """
