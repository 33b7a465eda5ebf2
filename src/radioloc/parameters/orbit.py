"""The parameters of an orbit: its state at the epoch, and numbers of the forces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.position import PositionParameters

if TYPE_CHECKING:
    from radioloc.dynamics import AdjustableOrbit

_OF_FORCES = {"gm": ("m3/s2", 1e3), "k2": ("1", 1e-3), "radiation": ("m2/kg", 1e-3)}
"""Units of the forces' own numbers, and a change that moves observations by about a metre in a day."""


def orbit_parameters(
    orbit: AdjustableOrbit, sigmas: Mapping[str, float], estimated: bool, state: bool = True
) -> PositionParameters:
    """The parameters of an orbit, with a-priori sigmas by name; those without one are free.

    Nothing is `estimated`, or all but the state.
    """
    # The compiler takes a third of a second to import.
    from radioloc.dynamics import STATE

    impulses = {one.name for one in orbit.forces.impulses}

    def unit_and_scale(name: str) -> tuple[str, float]:
        if name in STATE:
            return ("m/s", 1e-3) if name.startswith("v") else ("m", 1.0)
        if name in _OF_FORCES:
            return _OF_FORCES[name]
        return ("m/s", 1e-3) if name.rpartition(".")[0] in impulses else ("m/s2", 1e-9)

    parameters = []
    for name, value in orbit.values.items():
        unit, scale = unit_and_scale(name)
        kind = "state" if name in STATE else "force"
        role = Role.ESTIMATED if estimated and (state or kind == "force") else Role.FIXED
        sigma = sigmas.get(name, math.inf)
        parameters.append(Parameter(f"{kind}.{name}", unit, kind, value, sigma, role=role, scale=scale))
    apriori = np.array(list(orbit.values.values()))

    def changes(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return x - apriori, np.eye(len(apriori))

    return parameters, changes
