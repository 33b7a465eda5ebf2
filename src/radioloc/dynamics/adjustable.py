"""An orbit with all that it follows from, so that it can be had for other values of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from radioloc.dynamics.elements import equatorial_axes
from radioloc.dynamics.forces import Forces
from radioloc.dynamics.orbit import LOWEST_M, STATE, Orbit, initial_state, integrated_over, since_j2000_s
from radioloc.dynamics.propagation import Motion, integrate_motion, refuse_ground
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.time import Epochs
from radioloc.vectors import Floats

LINEAR_M = 10.0
"""An orbit that is nowhere farther than this from one that was integrated follows from its partials: what is of second
order is some 1e-4 m in low orbits over a day."""
MAX_START_DEPTH_M = 50e3
"""Depth below the lowest terrain that an orbit may reach where a fit starts, m: coefficients of degree n grow by
(1 + depth / radius)^n, a factor of 18 at degree 100."""
_GROUND_STEP_S = 10.0  # in which an orbit of eccentricity 0.1 rises by 2 m from its lowest point
_CHECKED = 200
_COARSE_DEGREE = 40
_KEPT = 4
"""Orbits that were integrated last: one with partials by hundreds of parameters takes tens of megabytes."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustableOrbit:
    """An orbit as a function of its parameters, which predictors adjust.

    It is integrated when its states are asked for, unless an orbit that was integrated before is near.
    """

    epoch: Epochs  # TDB, one
    state: Floats  # at the epoch relative to the Moon's centre, ICRF axes, m and m/s, shape (6,)
    forces: Forces
    span_s: tuple[float, float]  # first and last time that is wanted, TDB seconds from the epoch
    parameters: tuple[str, ...]  # of the forces, by which there are partials, beside the state
    ephemeris: Ephemeris
    libration: LunarOrientation
    name: str = "orbit"  # in messages
    touchdown: Epochs | None = None  # from which on it rests on the Moon, TDB, one
    # Changes of the states by errors (`effects`); with them the parameters are these errors, which are held at zero.
    errors: Callable[[Epochs], Floats] | None = None
    lowest_m: float = LOWEST_M  # distance from the Moon's centre below which an integration is refused
    # Values of the parameters and orbits already integrated, shared by copies that differ in them, in their span or in
    # the degree of their partials only.
    integrated: list[tuple[Floats, Orbit]] = field(default_factory=list)

    def __str__(self) -> str:
        return integrated_over(self.name, self.epoch, self.covered_s)

    @property
    def covered_s(self) -> tuple[float, float]:
        """First and last time that is integrated, TDB seconds from the epoch, which is always there."""
        return min(0.0, self.span_s[0]), max(0.0, self.span_s[1])

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name: those of the state, then those of the forces."""
        known = self.forces.parameters()
        state = dict(zip(STATE, self.state.tolist(), strict=True))
        return state | {name: known[name] for name in self.parameters}

    def times(self, count: int) -> Epochs:
        """Epochs all over its span, TDB; within it by a millisecond, so that rounding leads none outside."""
        times_s = np.linspace(self.span_s[0] + 1e-3, self.span_s[1] - 1e-3, count)
        return self.epoch.shifted(times_s)

    @property
    def gm_m3_s2(self) -> float:
        """GM of the Moon."""
        given = self.forces.gm_m3_s2
        return self.ephemeris.constants.gm_m3_s2("moon") if given is None else given

    @property
    def equator(self) -> Floats:
        """Axes of the Moon's equator at the epoch, shape (3, 3), a row each."""
        return equatorial_axes(self.libration, self.epoch)

    def corrected(self, x: Floats) -> AdjustableOrbit:
        """Return the orbit of parameters increased by x, in the order of :attr:`values`."""
        known = self.forces.parameters()
        changed = {name: known[name] + float(by) for name, by in zip(self.parameters, x[6:], strict=True)}
        return replace(self, state=self.state + x[:6], forces=self.forces.with_parameters(changed))

    def moved_to(self, epoch: Epochs, state: Floats | None = None) -> AdjustableOrbit:
        """Return the orbit with its state, or another one, at another epoch, TDB; its span covers both epochs."""
        by_s = float(self.epoch.seconds_since(epoch)[0])
        if state is None:
            first_s, last_s = self.span_s
            reaching = replace(self, span_s=(min(first_s, -by_s), max(last_s, -by_s)))
            state = np.concatenate(reaching.states(epoch), axis=-1)[0]
        span_s = (self.covered_s[0] + by_s, self.covered_s[1] + by_s)
        return replace(self, epoch=epoch, state=state, span_s=span_s, integrated=[])

    def over(self, first: Epochs, last: Epochs) -> AdjustableOrbit:
        """Return the orbit restricted to an interval of TDB."""
        begin_s, end_s = (float(one.seconds_since(self.epoch)[0]) for one in (first, last))
        return replace(self, span_s=(begin_s, end_s))

    def coarse(self) -> AdjustableOrbit:
        """Return the orbit with partials of gravity that suffice until an estimate has converged, at half the cost."""
        degree = min(_COARSE_DEGREE, self.forces.gradient_degree)
        return replace(self, forces=replace(self.forces, gradient_degree=degree))

    def reaching_below_ground(self) -> AdjustableOrbit:
        """Return the orbit with a limit below the ground, for the start of a fit, if its integration meets the ground.

        What is estimated is to be checked by :meth:`require_above_ground`.
        """
        try:
            self.coarse().nearest()
        except InputError:
            deeper = replace(self, lowest_m=LOWEST_M - MAX_START_DEPTH_M)
            deeper.coarse().nearest()
            return deeper
        return self

    def require_above_ground(self) -> None:
        """Raise an InputError with the epoch at which an orbit with a limit below the ground meets the ground."""
        if self.lowest_m < LOWEST_M:
            begin_s, end_s = self.covered_s
            tdb = self.epoch.shifted(np.arange(begin_s + 1e-3, end_s, _GROUND_STEP_S))
            below = np.linalg.norm(self.states(tdb)[0], axis=-1) < LOWEST_M
            if below.any():
                refuse_ground(self.name, "Moon", tdb[[int(below.argmax())]])

    def nearest(self) -> Orbit:
        """Return the integrated orbit, or its linearization about one that was integrated near."""
        values = np.array(list(self.values.values()))
        begin_s, end_s = self.covered_s
        checked = self.epoch.shifted(np.linspace(begin_s, end_s, _CHECKED + 2)[1:-1])
        for of_orbit, orbit in reversed(self.integrated):
            by = values - of_orbit
            fine = orbit.forces.gradient_degree >= self.forces.gradient_degree
            if fine and orbit.span_s[0] <= begin_s and end_s <= orbit.span_s[1]:
                if not by.any():
                    return orbit
                if np.linalg.norm(orbit.partials(checked)[:, :3] @ by, axis=-1).max() < LINEAR_M:
                    return replace(orbit, changes=by)
        made = self.integrate(self.parameters)
        self.integrated.append((values, made))
        del self.integrated[:-_KEPT]
        return made

    def integrate(self, parameters: tuple[str, ...] | None = None) -> Orbit:
        """Integrate the orbit of these values anew, with partials by some parameters of the forces or with none."""
        state = initial_state(self.state[:3], self.state[3:], at_rest=self.touchdown is not None)
        bodies = self.ephemeris, self.libration
        motion = Motion(self.epoch, state, self.forces, *bodies, self.touchdown, self.name, self.lowest_m)
        return integrate_motion(motion, self.span_s, parameters)

    def states(self, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return position and velocity as :meth:`~radioloc.dynamics.orbit.Orbit.states` does."""
        return self.nearest().states(tdb)

    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return geocentric states as :meth:`~radioloc.dynamics.orbit.Orbit.geocentric` does."""
        return self.nearest().geocentric(ephemeris, tdb)

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the span that is wanted as :meth:`~radioloc.dynamics.orbit.Orbit.spans_s` does."""
        return [since_j2000_s(self.epoch, self.span_s)]

    def partials(self, tdb: Epochs) -> Floats:
        """Return partials as :meth:`~radioloc.dynamics.orbit.Orbit.partials` does."""
        return self.nearest().partials(tdb)

    def position_partials(self, tdb: Epochs) -> Floats:
        """Return partials of the position by the parameters, or by errors, at epochs of TDB, ICRF axes, (n, 3, p)."""
        return (self.partials(tdb) if self.errors is None else self.effects(tdb))[:, :3]

    def effects(self, tdb: Epochs) -> Floats:
        """Return changes of the states by errors at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, n_errors)."""
        return np.zeros((len(tdb), 6, 0)) if self.errors is None else self.errors(tdb)
