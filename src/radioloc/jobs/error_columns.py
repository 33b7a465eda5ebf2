"""Columns of the design matrix for errors that a fit does not estimate: parameters, terms, gravity and other forces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.stochastic import interval_accelerations
from radioloc.estimation.consider import NO_ERRORS, Consider, UnestimatedErrors, owner
from radioloc.estimation.hypotheses import FORCES, TERM
from radioloc.measurements.physical_model import TERMS
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.columns import Columns, members
from radioloc.parameters.considered import default_sigmas
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.targets.design import DesignMatrix, ObservationModel, effects_on_orbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.vectors import Floats

ParameterBlock = tuple[Columns, list[Parameter]]
"""Parameters of one kind with their columns of the design matrix."""

GravityErrorOrbits = Mapping[int, AdjustableOrbit]
"""Orbits with considered errors of their gravity fields, by the index of the target."""


def parameter_errors(
    blocks: Sequence[ParameterBlock], model: ObservationModel, x: Floats
) -> UnestimatedErrors:
    """Return parameters with their partials at the parameters x of a model."""
    if not blocks:
        return NO_ERRORS
    errors = replace(ObservationModel.from_targets(model.predictor, (), blocks), rows=model.rows)
    motions = model.motions(x)
    prediction, residual_m = model.predictor.predict(motions), np.zeros(0)  # residuals are not asked for
    design = DesignMatrix(errors, prediction, motions, errors.parameters.prior_values, residual_m)
    return UnestimatedErrors(errors.parameters, design.partials)


def fixed_parameter_blocks(predictor: Predictor, parameters: Iterable[Parameter]) -> list[ParameterBlock]:
    """Return the parameters of one component that act on an arc and are not among those of a fit.

    Their sigmas are the usual ones of their kinds, or else their scales.
    """
    owners: dict[str, set[str]] = {}
    for item in parameters:
        owners.setdefault(item.kind, set()).add(owner(item))
    rows, blocks = ObservationRows(predictor), []
    for name, kind in PARAMETERS.items():
        available = predictor.more_partials or not kind.more_partials
        if len(kind.components) > 1 or not available or (kind.term and not predictor.model.has(kind.term)):
            continue
        present, estimated = members(kind, kind.scopes[0], rows), owners.get(name, set())
        if not estimated <= present.keys():  # the fit has parameters of another scope
            continue
        absent = [member for member in present if member not in estimated]
        sigmas, reason = default_sigmas(kind, rows, present)
        if reason or not absent:  # such as signals without a frequency
            continue
        choice = ParameterChoice(
            tuple(absent) if kind.scopes[0].named else "all",
            sigma={member: sigmas.get(member) or kind.scale for member in absent},
        )
        block = chosen_parameters(kind, choice, rows, Role.CONSIDERED)
        if block is not None:
            blocks.append(block)
    return blocks


def term_errors(model: ObservationModel, x: Floats) -> UnestimatedErrors:
    """Return each switched-off term of the model as a parameter: 1 if the observations contain the term."""
    predictor, physical, effects_m = model.predictor, model.predictor.model, dict[str, Floats]()
    unavailable = {"ionosphere"} if physical.ionosphere is None else set[str]()
    names = [name for name in TERMS if name not in unavailable and not physical.has(name)]
    if not names:
        return NO_ERRORS
    motions = model.motions(x)
    value_m = predictor.predict(motions).value_m
    for name in names:
        with_term = predictor.with_model(physical.with_terms(physical.terms | {name}), motions)
        effect_m = with_term.predict(motions).value_m - value_m
        if effect_m.any():
            effects_m[f"{TERM}.{name}"] = effect_m
    if not effects_m:
        return NO_ERRORS
    return unit_errors(TERM, list(effects_m), np.nan_to_num(np.column_stack(list(effects_m.values()))))


def unit_errors(kind: str, names: Iterable[str], effects_m: Floats) -> UnestimatedErrors:
    """Return errors of unit sigma from their effects on all observations, (n, k)."""
    items = [Parameter(name, "1", kind, 0.0, 1.0, scale=1.0, role=Role.CONSIDERED) for name in names]
    return UnestimatedErrors(ParameterSet(items), lambda rows: effects_m[rows])


def gravity_errors(orbits: GravityErrorOrbits, model: ObservationModel) -> UnestimatedErrors:
    """Return errors of gravity fields with their effects on the observations; orbits in one field share them."""
    if not orbits:
        return NO_ERRORS
    effects = dict[str, Floats]()
    for k, prefix in _name_prefixes(orbits, model).items():
        effects[prefix] = effects.get(prefix, 0.0) + effects_on_orbit(model.predictor, orbits[k], k)
    names = [f"{prefix}{j + 1}" for prefix, effect_m in effects.items() for j in range(effect_m.shape[1])]
    return unit_errors("gravity_error", names, np.hstack(list(effects.values())))


def force_errors(model: ObservationModel, x: Floats) -> UnestimatedErrors:
    """Return accelerations, constant in intervals, that the forces of the orbits lack."""
    effects = list[Floats]()
    for k in model.orbit_indices:
        orbit = model.targets[k].orbit_at(x[model.columns_of(k)])
        assert orbit is not None  # the target moves by forces
        with_errors = replace(orbit, errors=interval_accelerations(orbit.nearest()).state_changes)
        effects.append(effects_on_orbit(model.predictor, with_errors, k))
    if not effects:
        return NO_ERRORS
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
    consider: Consider,
    orbits: GravityErrorOrbits,
) -> OrbitState:
    """Return the state of the orbit of a target, with its sensitivity to errors of the gravity field."""
    columns = model.columns_of(target)
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
