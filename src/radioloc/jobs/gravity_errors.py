"""Considered errors of the gravity fields that orbits move in, and the states of the orbits with these errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.estimation.consider import Consider, ConsideredErrors
from radioloc.jobs.error_columns import unit_errors
from radioloc.parameters.parameter import ParameterSet
from radioloc.targets.design import ObservationModel, effects_on_orbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.vectors import Floats

GravityErrorOrbits = Mapping[int, AdjustableOrbit]
"""Orbits with considered errors of their gravity fields, by the index of the target."""


def gravity_errors(orbits: GravityErrorOrbits, model: ObservationModel) -> ConsideredErrors | None:
    """Return errors of gravity fields with their effects on the observations; orbits in one field share them."""
    if not orbits:
        return None
    effects = dict[str, Floats]()
    for k, prefix in _name_prefixes(orbits, model).items():
        effects[prefix] = effects.get(prefix, 0.0) + effects_on_orbit(model.predictor, orbits[k], k)
    names = [f"{prefix}{j + 1}" for prefix, effect_m in effects.items() for j in range(effect_m.shape[1])]
    return unit_errors("gravity_error", names, np.hstack(list(effects.values())))


def own_gravity_errors(
    parameters: ParameterSet, orbits: GravityErrorOrbits, model: ObservationModel, target: int
) -> list[int]:
    """Return the indices of the considered errors of the gravity field that a target moves in."""
    prefix = _name_prefixes(orbits, model).get(target)
    return [k for k, name in enumerate(parameters.names) if prefix == f"{name.rpartition('.')[0]}."]


def orbit_state(
    model: ObservationModel,
    target: int,
    x: Floats,
    covariance: Floats,
    consider: Consider | None,
    orbits: GravityErrorOrbits,
) -> OrbitState:
    """Return the state of the orbit of a target, with its sensitivity to errors of the gravity field."""
    columns = model.columns_of(target)
    sensitivity = np.zeros((columns.stop - columns.start, 0))
    if consider is not None:
        errors = own_gravity_errors(consider.parameters, orbits, model, target)
        sensitivity = consider.sensitivity[columns][:, errors]
    state = model.targets[target].estimate(
        x[columns], covariance[columns, columns], sensitivity, orbits.get(target)
    )
    assert state is not None  # the target moves by forces
    return state


def _name_prefixes(orbits: GravityErrorOrbits, model: ObservationModel) -> dict[int, str]:
    """Return prefixes of the names of each orbit's gravity errors; that of the first field omits the target."""
    prefixes, field_prefixes = dict[int, str](), dict[tuple[str, int], str]()
    for k, orbit in orbits.items():
        gravity = orbit.forces.gravity
        prefix = f"gravity_error.{model.targets[k].name}." if field_prefixes else "gravity_error."
        prefixes[k] = field_prefixes.setdefault((gravity.name, gravity.degree), prefix)
    return prefixes
