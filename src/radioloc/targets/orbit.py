"""A target on an orbit, and its parameters: the state at the epoch in one of several forms, and those of the forces."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np

from radioloc.dynamics import STATE, AdjustableOrbit
from radioloc.dynamics.elements import ELEMENT_NAMES, elements_from_state, state_with_partials
from radioloc.dynamics.gravity_errors import draw_gravity_errors, gravity_perturbations
from radioloc.estimation.status import Doubt
from radioloc.measurements.target_motion import OrbitMotion
from radioloc.parameters.parameter import Parameter, Role
from radioloc.targets.doubts import FittedObservations, cut_off_doubts
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL, OrbitState, along_across_radial
from radioloc.targets.surface_point import PositionFunction, PositionParameters
from radioloc.targets.target import ProcessNoise, solve_parameters
from radioloc.time import Epochs
from radioloc.vectors import Floats, rtn_axes

RTN = ("radial_m", "along_m", "across_m", "radial_m_s", "along_m_s", "across_m_s")
"""Corrections of the a-priori state along fixed axes, those of the orbit at the epoch."""
_FORCE_UNITS = {"gm": ("m3/s2", 1e3), "k2": ("1", 1e-3), "radiation": ("m2/kg", 1e-3)}
"""Units of the forces' own numbers, and a change that moves observations by about a metre in a day."""
_ORBIT_SIZE_M = 2e6  # of an orbit; scales parameters to the effect of one metre


Seed = int | np.random.Generator


@dataclass(frozen=True, slots=True)
class GravityErrors:
    """Drawn errors of a gravity field, so many up to a degree, which stand for all."""

    count: int
    degree: int

    def draw(
        self, orbit: AdjustableOrbit, count: int | None = None, seed: Seed = 0
    ) -> AdjustableOrbit | None:
        """Return the orbit with such errors, or so many others; None without any."""
        field, count = orbit.forces.gravity, self.count if count is None else count
        if not count or field.degree < 2:
            return None
        errors = draw_gravity_errors(field, count, max(field.degree, self.degree), seed)
        return replace(
            orbit, errors=gravity_perturbations(orbit.nearest(), errors, orbit.libration).state_changes
        )


class OnOrbit:
    """Members of a target whose motion follows from an a-priori orbit and changes of its parameters."""

    __slots__ = ()
    orbit: AdjustableOrbit  # a priori
    # From the parameters to changes of those of the orbit (q,), with partials (q, p).
    changes: PositionFunction
    errors: GravityErrors
    has_place: ClassVar[bool] = False
    local_axes: ClassVar[tuple[str, str, str]] = ALONG_ACROSS_RADIAL

    def local_partials(self, x: Floats, tdb: Epochs, rot_pa_to_me: Floats) -> Floats:
        """Return the partials of the states at epochs with respect to x, along, across and radial, shape (n, 6, p)."""
        changes, by_x = self.changes(x)
        orbit = self.orbit.corrected(changes)
        return along_across_radial(orbit, tdb, orbit.partials(tdb) @ by_x)

    @property
    def start(self) -> OrbitMotion:
        """A-priori orbit, with partials that suffice until an estimate has converged."""
        return OrbitMotion(self.orbit.coarse())

    def motion(self, x: Floats) -> tuple[OrbitMotion, Floats]:
        """Return the motion at parameters x, and the partials of the orbit's parameters."""
        changes, by_x = self.changes(x)
        return OrbitMotion(self.orbit, changes), by_x

    def orbit_at(self, x: Floats) -> AdjustableOrbit:
        """Return the orbit of parameters x."""
        return self.orbit.corrected(self.changes(x)[0])

    def with_orbit(self, orbit: AdjustableOrbit) -> Self:
        """Return the target about another a-priori orbit of the same parameters."""
        return replace(self, orbit=orbit)  # type: ignore[type-var]

    def solved(self, target_values: Floats, x: Floats) -> Floats:
        """Return the parameters for target values of the orbit's parameters, starting at x."""
        changes = target_values - np.array(list(self.orbit.values.values()))
        return solve_parameters(self.changes, changes, x)

    def doubts(self, x: Floats, fitted: FittedObservations) -> Iterator[Doubt]:
        """Doubt an orbit whose first or last observations are all outliers."""
        yield from cut_off_doubts(fitted)

    def gravity_errors(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit at x with the errors of its gravity field that are considered; None without any."""
        return self.errors.draw(self.orbit_at(x))


@dataclass(frozen=True, slots=True, eq=False)
class TargetOrbit(OnOrbit):
    """A spacecraft on an orbit, which follows from its parameters by their changes of the a-priori orbit."""

    name: str
    parameters: list[Parameter]
    changes: PositionFunction  #: from the parameters to changes of those of the orbit, with partials
    orbit: AdjustableOrbit  #: a priori
    errors: GravityErrors
    body: int  #: NAIF code of the spacecraft in kernels
    process_noise: ProcessNoise | None = None
    preceding: int = 0

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """Return zeros: the target is at no place on the Moon."""
        return np.zeros(3), np.zeros((3, len(x)))

    def estimate(
        self, x: Floats, covariance: Floats, sensitivity: Floats, errors: AdjustableOrbit | None
    ) -> OrbitState:
        """Return the state at the epoch of the orbit; an InputError of an orbit that meets the ground."""
        _, by_x = self.changes(x)
        orbit = self.orbit_at(x)
        orbit.require_above_ground()
        moved = by_x @ sensitivity
        return OrbitState(orbit, by_x @ covariance @ by_x.T, moved, errors if moved.size else None, self.body)


def orbit_parameters(
    orbit: AdjustableOrbit,
    sigmas: Mapping[str, float],
    estimated: bool,
    state: bool = True,
    form: str = "cartesian",
) -> PositionParameters:
    """Return the parameters of an orbit in one of the forms of a state, with a-priori sigmas by name, else free."""
    # Nothing is `estimated`, or all but the `state`. Angles are from the Moon's equator.
    impulses = {item.name for item in orbit.forces.impulses}
    # Thrust moves the spacecraft by a metre while it lasts, about.
    of_thrust = {
        item.name: float(item.stop.seconds_since(item.start)[0]) ** -2
        for item in orbit.forces.accelerations
        if item.start is not None and item.stop is not None
    }

    def unit_and_scale(name: str) -> tuple[str, float]:
        if name in _FORCE_UNITS:
            return _FORCE_UNITS[name]
        owner = name.rpartition(".")[0]
        return ("m/s", 1e-3) if owner in impulses else ("m/s2", of_thrust.get(owner, 1e-9))

    names, values, function = _state(orbit, form)
    role = Role.ESTIMATED if estimated and state else Role.FIXED
    parameters = [
        Parameter(f"state.{name}", unit, "state", value, sigmas.get(name, math.inf), role=role, scale=scale)
        for (name, (unit, scale)), value in zip(names.items(), values.tolist(), strict=True)
    ]
    apriori = np.array(list(orbit.values.values()))
    for name, value in list(orbit.values.items())[6:]:
        unit, scale = unit_and_scale(name)
        role = Role.ESTIMATED if estimated else Role.FIXED
        sigma = sigmas.get(name, math.inf)
        parameters.append(Parameter(f"force.{name}", unit, "force", value, sigma, role=role, scale=scale))

    # Functions of a module can be sent to workers.
    return parameters, partial(_orbit_changes, function, apriori)


def _orbit_changes(function: PositionFunction, apriori: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return changes of the orbit's parameters, and their partials."""
    by_x = np.eye(len(apriori))
    state, by_x[:6, :6] = function(x[:6])
    return np.concatenate([state, x[6:]]) - apriori, by_x


def _state(
    orbit: AdjustableOrbit, form: str
) -> tuple[dict[str, tuple[str, float]], Floats, Callable[[Floats], tuple[Floats, Floats]]]:
    """Names of the state's parameters with units and scales, their values, and the state with its partials."""
    of_lengths = [("m", 1.0)] * 3 + [("m/s", 1e-3)] * 3
    if form == "cartesian":
        return (
            dict(zip(STATE, of_lengths, strict=True)),
            orbit.state,
            partial(_linear_state, np.zeros(6), np.eye(6)),
        )
    if form == "rtn":
        axes = np.zeros((6, 6))
        axes[:3, :3] = axes[3:, 3:] = rtn_axes(orbit.state[:3], orbit.state[3:]).T
        return dict(zip(RTN, of_lengths, strict=True)), np.zeros(6), partial(_linear_state, orbit.state, axes)
    gm, equator = orbit.gm_m3_s2, orbit.equator

    def unit_and_scale(name: str) -> tuple[str, float]:
        if name.endswith("_m"):
            return "m", 1.0
        return (
            ("deg", math.degrees(1.0 / _ORBIT_SIZE_M))
            if name.endswith("_deg")
            else ("1", 1.0 / _ORBIT_SIZE_M)
        )

    names = {name: unit_and_scale(name) for name in ELEMENT_NAMES[form]}
    values = elements_from_state(orbit.state, gm, equator, form)
    return names, values, partial(state_with_partials, gm_m3_s2=gm, axes=equator, form=form)


def _linear_state(origin: Floats, axes: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return a state by its components along axes, with partials."""
    return origin + axes @ x, axes
