"""An orbit whose parameters are what else may act on it, such as the errors of its gravity field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.adjustable import AdjustableOrbit
from radioloc.ephemeris import Ephemeris
from radioloc.time import Epochs

Floats = NDArray[np.float64]


class Effects(Protocol):
    """What moves an orbit."""

    def at(self, tdb: Epochs) -> Floats:
        """Changes of the states at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, c)."""


@dataclass(frozen=True, slots=True, eq=False)
class DisturbedOrbit:
    """An orbit as something moves it; an :class:`~radioloc.ephemeris.trajectory.AdjustableTrajectory`."""

    orbit: AdjustableOrbit
    effects: Effects

    @property
    def name(self) -> str:
        """That of the orbit."""
        return self.orbit.name

    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """As without them."""
        return self.orbit.geocentric(ephemeris, tdb)

    def spans_s(self) -> list[tuple[float, float]]:
        """As without them."""
        return self.orbit.spans_s()

    def position_partials(self, tdb: Epochs) -> Floats:
        """By how much each effect moves the position, m, ICRF axes, shape (n, 3, c)."""
        return self.effects.at(tdb)[:, :3]

    def over(self, first: Epochs, last: Epochs) -> DisturbedOrbit:
        """The whole of it."""
        return self

    def corrected(self, x: Floats) -> DisturbedOrbit:
        """The same: effects are held at zero."""
        return self
