"""The parameters of an orbit: its state at the epoch, in one of several forms, and numbers of the forces.

Of one that ends on the ground the landing place and the velocity at the touchdown are in place of the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from radioloc.dynamics import STATE, AdjustableOrbit
from radioloc.dynamics.elements import FORMS, elements_of_state, state_by_elements
from radioloc.lunar import cartesian_to_selenographic, east_north_up
from radioloc.measurements.lunar_motion import lunar_motion
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.position import PositionFunction, PositionParameters
from radioloc.time import Epochs
from radioloc.vectors import Floats, rtn_axes

RTN = ("radial_m", "along_m", "across_m", "radial_m_s", "along_m_s", "across_m_s")
"""The state as what it differs by from that a priori, along fixed axes: those of the orbit at the epoch."""
_FORCE_UNITS = {"gm": ("m3/s2", 1e3), "k2": ("1", 1e-3), "radiation": ("m2/kg", 1e-3)}
"""Units of the forces' own numbers, and a change that moves observations by about a metre in a day."""
_ORBIT_SIZE_M = 2e6  # that of an orbit, for what moves a spacecraft by a metre


def orbit_parameters(
    orbit: AdjustableOrbit,
    sigmas: Mapping[str, float],
    estimated: bool,
    state: bool = True,
    form: str = "cartesian",
) -> PositionParameters:
    """Return the parameters of an orbit in one of the forms of a state, with a-priori sigmas by name, else free."""
    # Nothing is `estimated`, or all but the `state`. Angles are from the Moon's equator.
    impulses = {one.name for one in orbit.forces.impulses}
    # Thrust moves the spacecraft by a metre while it lasts, about.
    of_thrust = {
        one.name: float(one.stop.seconds_since(one.start)[0]) ** -2
        for one in orbit.forces.accelerations
        if one.start is not None and one.stop is not None
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

    def changes(x: Floats) -> tuple[Floats, Floats]:
        by = np.eye(len(apriori))
        of_state, by[:6, :6] = function(x[:6])
        return np.concatenate([of_state, x[6:]]) - apriori, by

    return parameters, changes


def _state(
    orbit: AdjustableOrbit, form: str
) -> tuple[dict[str, tuple[str, float]], Floats, Callable[[Floats], tuple[Floats, Floats]]]:
    """Names of the state's parameters with units and scales, values, and what they make: the state and its partials."""
    of_lengths = [("m", 1.0)] * 3 + [("m/s", 1e-3)] * 3
    if form == "cartesian":
        return dict(zip(STATE, of_lengths, strict=True)), orbit.state, lambda x: (x, np.eye(6))
    if form == "rtn":
        axes = np.zeros((6, 6))
        axes[:3, :3] = axes[3:, 3:] = rtn_axes(orbit.state[:3], orbit.state[3:]).T
        return dict(zip(RTN, of_lengths, strict=True)), np.zeros(6), lambda x: (orbit.state + axes @ x, axes)
    gm, equator = orbit.gm_m3_s2, orbit.equator

    def unit_and_scale(name: str) -> tuple[str, float]:
        if name.endswith("_m"):
            return "m", 1.0
        return (
            ("deg", math.degrees(1.0 / _ORBIT_SIZE_M))
            if name.endswith("_deg")
            else ("1", 1.0 / _ORBIT_SIZE_M)
        )

    names = {name: unit_and_scale(name) for name in FORMS[form]}
    values = elements_of_state(orbit.state, gm, equator, form)
    return names, values, lambda x: state_by_elements(x, gm, equator, form)


class Ground:
    """States of points of the ground at a touchdown (TDB), relative to the Moon's centre, ICRF axes."""

    def __init__(self, model: PhysicalModel, epoch: Epochs) -> None:
        self._model = model
        self._moon = lunar_motion(model, epoch, model.ephemeris.earth(epoch), np.zeros(1))
        self.rot_pa_to_icrf = self._moon.rot_pa_to_icrf[0]
        self.by_place = np.vstack([self.rot_pa_to_icrf, self._moon.rot_pa_to_icrf_rate[0]])

    def at_rest(self, place_pa_m: Floats) -> Floats:
        """State of a place, m and m/s, shape (6,), with its tide and in the lengths of barycentric coordinates."""
        point, centre = self._moon.point(self._model, place_pa_m), self._moon.centre
        return np.concatenate(
            [(point.position_m - centre.position_m)[0], (point.velocity_m_s - centre.velocity_m_s)[0]]
        )

    def place_pa_m(self, state: Floats) -> Floats:
        """The place, principal axes, m, at which a state is."""
        place_pa_m = state[:3] @ self.rot_pa_to_icrf
        for _ in range(2):  # the tide and the lengths depend on the place by parts of 1e-7
            place_pa_m = place_pa_m + (state[:3] - self.at_rest(place_pa_m)[:3]) @ self.rot_pa_to_icrf
        return np.asarray(place_pa_m)


@dataclass(frozen=True, slots=True, eq=False)
class LandingParameters:
    """From the parameters of a landing to those of its orbit, whose epoch is the touchdown."""

    parameters: list[Parameter]  # three of the place, three of the velocity, those of the forces
    place: PositionFunction  # of the first three
    orbit: AdjustableOrbit
    ground: Ground
    axes: Floats  # east, north and up at the a-priori place in the ICRF, as columns

    def changes(self, x: Floats) -> tuple[Floats, Floats]:
        """Changes of the orbit's parameters, shape (q,), and their partials, shape (q, p)."""
        place_pa_m, by_x = self.place(x[:3])
        state = self.ground.at_rest(place_pa_m)
        state[3:] += self.axes @ x[3:6]
        apriori = np.array(list(self.orbit.values.values()))
        partials = np.eye(len(x))
        partials[:6, :3] = self.ground.by_place @ by_x
        partials[3:6, 3:6] = self.axes
        return np.concatenate([state, x[6:]]) - apriori, partials

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """The place in principal axes, m, and its partials by all parameters, shape (3, p)."""
        place_pa_m, by_x = self.place(x[:3])
        return place_pa_m, np.pad(by_x, ((0, 0), (0, len(x) - 3)))

    def values_of(self, orbit: AdjustableOrbit) -> Floats:
        """The parameters of an orbit that lands near the a-priori place."""
        return np.concatenate([self.touchdown_of(orbit.state), list(orbit.values.values())[6:]])

    def touchdown_of(self, state: Floats) -> Floats:
        """Return the parameters of place and velocity, shape (6,), of a state at the touchdown."""
        place_pa_m = self.ground.place_pa_m(state)
        x = np.zeros(3)
        for _ in range(10):
            at_pa_m, by_x = self.place(x)
            x = x + np.linalg.solve(by_x, place_pa_m - at_pa_m)
        return np.concatenate([x, (state[3:] - self.ground.at_rest(place_pa_m)[3:]) @ self.axes])


def landing_parameters(
    orbit: AdjustableOrbit,
    ground: Ground,
    place: PositionParameters,
    velocity_sigma_m_s: float,
    sigmas: Mapping[str, float],
) -> LandingParameters:
    """Return the parameters of an orbit that ends at a position; its velocity over the ground is 0 a priori."""
    of_place, position = place
    x = np.array([one.prior_value for one in of_place])
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(position(x)[0])
    velocity = [
        Parameter(
            f"touchdown_velocity.{axis}", "m/s", "touchdown_velocity", 0.0, velocity_sigma_m_s, scale=0.1
        )
        for axis in ("east", "north", "up")
    ]
    forces = [one for one in orbit_parameters(orbit, sigmas, estimated=True)[0] if one.kind == "force"]
    axes = ground.rot_pa_to_icrf @ east_north_up(float(longitude_rad), float(latitude_rad)).T
    return LandingParameters([*of_place, *velocity, *forces], position, orbit, ground, axes)
