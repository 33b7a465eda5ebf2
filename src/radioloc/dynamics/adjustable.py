"""Orbit as a function of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from radioloc.dynamics.elements import equatorial_axes
from radioloc.dynamics.forces import Forces
from radioloc.dynamics.orbit import MIN_RADIUS_M, STATE, Orbit, initial_state, orbit_text, since_j2000_s
from radioloc.dynamics.propagation import Motion, integrate_motion, raise_ground_error
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.time import Epochs
from radioloc.vectors import Floats

MAX_LINEAR_DISTANCE_M = 10.0
"""Largest distance from an integrated orbit at which its partials give the states; terms of second order are some
1e-4 m in low orbits over a day."""
MAX_START_DEPTH_M = 50e3
"""Largest depth below the lowest terrain at the start of a fit, m; harmonics of degree n grow by
(1 + depth / radius)^n, a factor of 18 at degree 100."""
_GROUND_STEP_S = 10.0  # an orbit of eccentricity 0.1 rises by 2 m from its lowest point in half of it
_CHECK_COUNT = 200  # epochs at which the distance from an integrated orbit is computed
_COARSE_DEGREE = 40
_CACHE_SIZE = 4  # integrated orbits in memory; partials of hundreds of parameters take tens of megabytes


@dataclass(frozen=True, slots=True, eq=False)
class AdjustableOrbit:
    """Orbit as a function of its parameters.

    Its states are integrated on request, or follow from the partials of a near orbit that is integrated already.
    """

    epoch: Epochs  #: single epoch, TDB
    state: Floats  #: at the epoch relative to the Moon's centre, ICRF axes, m and m/s, shape (6,)
    forces: Forces
    span_s: tuple[float, float]  #: first and last time of interest, TDB seconds from the epoch
    parameters: tuple[str, ...]  #: names of estimated parameters of the forces
    ephemeris: Ephemeris
    libration: LunarOrientation
    name: str = "orbit"  #: in messages
    touchdown: Epochs | None = None  #: start of the rest on the Moon, TDB
    #: Changes of the states by errors (`effects`), which then are the parameters in place of state and forces.
    errors: Callable[[Epochs], Floats] | None = None
    min_radius_m: float = MIN_RADIUS_M  #: smallest permitted distance from the Moon's centre
    #: Integrated orbits with the values of their parameters; copies share them if they differ only in these values, in
    #: their span or in the degree of their partials.
    integrated: list[tuple[Floats, Orbit]] = field(default_factory=list)

    def __str__(self) -> str:
        return orbit_text(self.name, self.epoch, self.covered_s)

    @property
    def covered_s(self) -> tuple[float, float]:
        """First and last time of the integration, which includes the epoch, TDB seconds from the epoch."""
        return min(0.0, self.span_s[0]), max(0.0, self.span_s[1])

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name: those of the state, then those of the forces."""
        of_forces = self.forces.parameters()
        state = dict(zip(STATE, self.state.tolist(), strict=True))
        return state | {name: of_forces[name] for name in self.parameters}

    def times(self, count: int) -> Epochs:
        """Return equidistant epochs in its span, TDB, a millisecond inside of its ends because of rounding."""
        times_s = np.linspace(self.span_s[0] + 1e-3, self.span_s[1] - 1e-3, count)
        return self.epoch.shifted(times_s)

    @property
    def gm_m3_s2(self) -> float:
        """GM of the Moon."""
        gm_m3_s2 = self.forces.gm_m3_s2
        return self.ephemeris.constants.gm_m3_s2("moon") if gm_m3_s2 is None else gm_m3_s2

    @property
    def equator(self) -> Floats:
        """Axes of the Moon's equator at the epoch as rows, shape (3, 3)."""
        return equatorial_axes(self.libration, self.epoch)

    def corrected(self, x: Floats) -> AdjustableOrbit:
        """Return the orbit of parameters increased by x, in the order of :attr:`values`."""
        of_forces = self.forces.parameters()
        changed = {name: of_forces[name] + float(x[k]) for k, name in enumerate(self.parameters, 6)}
        return replace(self, state=self.state + x[:6], forces=self.forces.with_parameters(changed))

    def with_epoch(self, epoch: Epochs, state: Floats | None = None) -> AdjustableOrbit:
        """Return the orbit with its state, or another one, at another epoch, TDB; its span covers both epochs."""
        by_s = float(self.epoch.seconds_since(epoch)[0])
        if state is None:
            first_s, last_s = self.span_s
            extended = replace(self, span_s=(min(first_s, -by_s), max(last_s, -by_s)))
            state = np.concatenate(extended.states(epoch), axis=-1)[0]
        span_s = (self.covered_s[0] + by_s, self.covered_s[1] + by_s)
        return replace(self, epoch=epoch, state=state, span_s=span_s, integrated=[])

    def restricted_to(self, first: Epochs, last: Epochs) -> AdjustableOrbit:
        """Return the orbit restricted to an interval of TDB."""
        first_s, last_s = (float(epoch.seconds_since(self.epoch)[0]) for epoch in (first, last))
        return replace(self, span_s=(first_s, last_s))

    def coarse(self) -> AdjustableOrbit:
        """Return the orbit with less accurate partials, for the iteration of a fit, at half the cost."""
        degree = min(_COARSE_DEGREE, self.forces.gradient_degree)
        return replace(self, forces=replace(self.forces, gradient_degree=degree))

    def reaching_below_ground(self) -> AdjustableOrbit:
        """Return the orbit, with a limit below the ground if it meets the ground at the start of a fit.

        The estimate is checked by :meth:`require_above_ground`.
        """
        try:
            self.coarse().nearest()
        except InputError:
            lowered = replace(self, min_radius_m=MIN_RADIUS_M - MAX_START_DEPTH_M)
            lowered.coarse().nearest()
            return lowered
        return self

    def require_above_ground(self) -> None:
        """Raise an InputError with the epoch at which an orbit with a limit below the ground meets the ground."""
        if self.min_radius_m < MIN_RADIUS_M:
            begin_s, end_s = self.covered_s
            tdb = self.epoch.shifted(np.arange(begin_s + 1e-3, end_s, _GROUND_STEP_S))
            below_ground = np.linalg.norm(self.states(tdb)[0], axis=-1) < MIN_RADIUS_M
            if below_ground.any():
                raise_ground_error(self.name, "Moon", tdb[[int(below_ground.argmax())]])

    def nearest(self) -> Orbit:
        """Return the integrated orbit, or its linearization about one already integrated."""
        values = np.array(list(self.values.values()))
        begin_s, end_s = self.covered_s
        check_epochs = self.epoch.shifted(np.linspace(begin_s, end_s, _CHECK_COUNT + 2)[1:-1])
        for orbit_values, orbit in reversed(self.integrated):
            changes = values - orbit_values
            fine = orbit.forces.gradient_degree >= self.forces.gradient_degree
            if fine and orbit.span_s[0] <= begin_s and end_s <= orbit.span_s[1]:
                if not changes.any():
                    return orbit
                if (
                    np.linalg.norm(orbit.partials(check_epochs)[:, :3] @ changes, axis=-1).max()
                    < MAX_LINEAR_DISTANCE_M
                ):
                    return replace(orbit, changes=changes)
        orbit = self.integrate(self.parameters)
        self.integrated.append((values, orbit))
        del self.integrated[:-_CACHE_SIZE]
        return orbit

    def integrate(self, parameters: tuple[str, ...] | None = None) -> Orbit:
        """Integrate the orbit, with or without partials with respect to the state and some force parameters."""
        state = initial_state(self.state[:3], self.state[3:], at_rest=self.touchdown is not None)
        bodies = self.ephemeris, self.libration
        motion = Motion(self.epoch, state, self.forces, *bodies, self.touchdown, self.name, self.min_radius_m)
        return integrate_motion(motion, self.span_s, parameters)

    def states(self, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return position and velocity as :meth:`~radioloc.dynamics.orbit.Orbit.states` does."""
        return self.nearest().states(tdb)

    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return geocentric states as :meth:`~radioloc.dynamics.orbit.Orbit.geocentric` does."""
        return self.nearest().geocentric(ephemeris, tdb)

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the span of interest as :meth:`~radioloc.dynamics.orbit.Orbit.spans_s` does."""
        return [since_j2000_s(self.epoch, self.span_s)]

    def partials(self, tdb: Epochs) -> Floats:
        """Return partials as :meth:`~radioloc.dynamics.orbit.Orbit.partials` does."""
        return self.nearest().partials(tdb)

    def position_partials(self, tdb: Epochs) -> Floats:
        """Return d(position)/d(parameter), or of errors, at epochs of TDB, ICRF axes, (n, 3, p)."""
        return (self.partials(tdb) if self.errors is None else self.effects(tdb))[:, :3]

    def effects(self, tdb: Epochs) -> Floats:
        """Return changes of the states by errors at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, n_errors)."""
        return np.zeros((len(tdb), 6, 0)) if self.errors is None else self.errors(tdb)
