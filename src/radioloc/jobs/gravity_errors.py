"""Errors of the forces that orbits move by, and the states of the orbits with errors of the gravity field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.stochastic import interval_accelerations
from radioloc.estimation.consider import Consider, ConsideredErrors
from radioloc.estimation.hypotheses import FORCES
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


def force_errors(model: ObservationModel, x: Floats) -> ConsideredErrors | None:
    """Return accelerations, constant in intervals, that the forces of the orbits lack; None without any orbit."""
    effects, motions = list[Floats](), model.motions(x)
    for k in model.orbit_indices:
        orbit = motions[k].trajectory
        assert isinstance(orbit, AdjustableOrbit)
        with_errors = replace(orbit, errors=interval_accelerations(orbit.nearest()).state_changes)
        effects.append(effects_on_orbit(model.predictor, with_errors, k))
    if not effects:
        return None
    effects_m = np.hstack(effects)
    return unit_errors(FORCES, [f"{FORCES}.{j + 1}" for j in range(effects_m.shape[1])], effects_m)


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
