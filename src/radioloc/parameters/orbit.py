"""The parameters of an orbit: its state at the epoch, in one of several forms, and numbers of the forces."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.position import PositionParameters

if TYPE_CHECKING:
    from radioloc.dynamics import AdjustableOrbit
    from radioloc.dynamics.arcs import OrbitArcs

Floats = NDArray[np.float64]

RTN = ("radial_m", "along_m", "across_m", "radial_m_s", "along_m_s", "across_m_s")
"""The state as what it differs by from that a priori, along fixed axes: those of the orbit at the epoch."""
_OF_FORCES = {"gm": ("m3/s2", 1e3), "k2": ("1", 1e-3), "radiation": ("m2/kg", 1e-3)}
"""Units of the forces' own numbers, and a change that moves observations by about a metre in a day."""
_SIZE_M = 2e6
"""That of an orbit, for what moves a spacecraft by a metre."""


def orbit_parameters(
    orbit: AdjustableOrbit,
    sigmas: Mapping[str, float],
    estimated: bool,
    state: bool = True,
    form: str = "cartesian",
) -> PositionParameters:
    """The parameters of an orbit, with a-priori sigmas by name; those without one are free.

    Nothing is `estimated`, or all but the state. The state is ``"cartesian"``, ``"rtn"``, ``"keplerian"`` or
    ``"equinoctial"``: sigmas and correlations are then of these, with angles from the Moon's equator.
    """
    impulses = {one.name for one in orbit.forces.impulses}
    # Thrust moves the spacecraft by a metre while it lasts, about.
    of_thrust = {
        one.name: float(one.stop.seconds_since(one.start)[0]) ** -2
        for one in orbit.forces.accelerations
        if one.start is not None and one.stop is not None
    }

    def unit_and_scale(name: str) -> tuple[str, float]:
        if name in _OF_FORCES:
            return _OF_FORCES[name]
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


def arcs_parameters(
    arcs: OrbitArcs[AdjustableOrbit],
    sigmas: Mapping[str, float],
    estimated: bool,
    state: bool = True,
    form: str = "cartesian",
) -> PositionParameters:
    """The parameters of all arcs of an orbit, as :func:`orbit_parameters`; sigmas of the state are of the first's."""
    from radioloc.dynamics import STATE

    parameters: dict[int, Parameter] = {}
    functions = []
    for k, (arc, mine) in enumerate(zip(arcs.arcs, arcs.columns, strict=True)):
        known = {name: sigma for name, sigma in sigmas.items() if k == 0 or name in arc.parameters}
        found, function = orbit_parameters(arc, known, estimated, state, form)
        functions.append(function)
        for column, name, parameter in zip(mine, (*STATE, *arc.parameters), found, strict=True):
            number = arcs.names[column].removeprefix(name)
            parameters.setdefault(int(column), replace(parameter, name=f"{parameter.name}{number}"))

    def changes(x: Floats) -> tuple[Floats, Floats]:
        out, by = np.zeros(len(x)), np.zeros((len(x), len(x)))
        for function, mine in zip(functions, arcs.columns, strict=True):
            out[mine], by[np.ix_(mine, mine)] = function(x[mine])
        return out, by

    return [parameters[column] for column in range(len(arcs.names))], changes


def _state(
    orbit: AdjustableOrbit, form: str
) -> tuple[dict[str, tuple[str, float]], Floats, Callable[[Floats], tuple[Floats, Floats]]]:
    """Names of the state's parameters with units and scales, values, and what they make: the state and its partials."""
    # The compiler takes a third of a second to import.
    from radioloc.dynamics import STATE
    from radioloc.dynamics.elements import (
        FORMS,
        elements_of_state,
        rtn_axes,
        state_by_elements,
    )

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
        return ("deg", math.degrees(1.0 / _SIZE_M)) if name.endswith("_deg") else ("1", 1.0 / _SIZE_M)

    names = {name: unit_and_scale(name) for name in FORMS[form]}
    values = elements_of_state(orbit.state, gm, equator, form)
    return names, values, lambda x: state_by_elements(x, gm, equator, form)
