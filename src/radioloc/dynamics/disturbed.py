"""An orbit whose parameters are the errors that its gravity field may have."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.adjustable import AdjustableOrbit
from radioloc.dynamics.gravity_errors import GravityErrorEffects, draw_gravity_errors
from radioloc.ephemeris import Ephemeris
from radioloc.time import Epochs

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DisturbedOrbit:
    """An orbit as its errors of gravity move it; an :class:`~radioloc.ephemeris.trajectory.AdjustableTrajectory`.

    Its parameters are `count` drawn errors of the field, each by one sigma, up to a degree; the state at the epoch is
    what it is.
    """

    orbit: AdjustableOrbit
    count: int
    degree: int

    @property
    def name(self) -> str:
        """That of the orbit."""
        return self.orbit.name

    @cached_property
    def effects(self) -> GravityErrorEffects:
        """What the errors do."""
        errors = draw_gravity_errors(self.orbit.forces.gravity, self.count, self.degree)
        return GravityErrorEffects(self.orbit.nearest()[0], errors, self.orbit.libration)

    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """As without them."""
        return self.orbit.geocentric(ephemeris, tdb)

    def spans_s(self) -> list[tuple[float, float]]:
        """As without them."""
        return self.orbit.spans_s()

    def position_partials(self, tdb: Epochs) -> Floats:
        """By how much each error moves the position, m, ICRF axes, shape (n, 3, count)."""
        return self.effects.at(tdb)[:, :3]

    def over(self, first: Epochs, last: Epochs) -> DisturbedOrbit:
        """The whole of it."""
        return self

    def corrected(self, x: Floats) -> DisturbedOrbit:
        """The same: errors are held at zero."""
        return self
