"""Columns of the design matrix for errors that a fit does not estimate."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from radioloc.estimation.consider import ConsideredErrors, owner
from radioloc.estimation.hypotheses import TERM
from radioloc.measurements.physical_model import TERMS
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.columns import Columns, members
from radioloc.parameters.considered import default_sigmas
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.targets.design import DesignMatrix, ObservationModel
from radioloc.vectors import Floats

ParameterBlock = tuple[Columns, list[Parameter]]
"""Parameters of one kind with their columns of the design matrix."""


def parameter_errors(
    blocks: Sequence[ParameterBlock], model: ObservationModel, x: Floats
) -> ConsideredErrors | None:
    """Return parameters with their partials at the parameters x of a model; None without any."""
    if not blocks:
        return None
    errors = replace(ObservationModel.from_targets(model.predictor, (), blocks), reference=model.reference)
    motions = model.motions(x)
    prediction, residual_m = model.predictor.predict(motions), np.zeros(0)  # residuals are not asked for
    design = DesignMatrix(errors, prediction, motions, errors.parameters.prior_values, residual_m)
    return ConsideredErrors(errors.parameters, design.partials)


def fixed_parameter_blocks(predictor: Predictor, parameters: Iterable[Parameter]) -> list[ParameterBlock]:
    """Return the parameters of one component that act on an arc and are not among those of a fit.

    Their sigmas are the usual ones of their kinds, or else their scales.
    """
    owners: dict[str, set[str]] = {}
    for item in parameters:
        owners.setdefault(item.kind, set()).add(owner(item))
    blocks = []
    for name, kind in PARAMETERS.items():
        available = predictor.more_partials or not kind.more_partials
        if len(kind.components) > 1 or not available or (kind.term and not predictor.model.has(kind.term)):
            continue
        present, estimated = members(kind, kind.scopes[0], predictor), owners.get(name, set())
        if not estimated <= present.keys():  # the fit has parameters of another scope
            continue
        absent = [member for member in present if member not in estimated]
        sigmas, reason = default_sigmas(kind, ObservationRows(predictor), present)
        if reason or not absent:  # such as signals without a frequency
            continue
        choice = ParameterChoice(
            tuple(absent) if kind.scopes[0].named else "all",
            sigma={member: sigmas.get(member) or kind.scale for member in absent},
        )
        block = chosen_parameters(kind, choice, predictor, Role.CONSIDERED)
        if block is not None:
            blocks.append(block)
    return blocks


def term_errors(model: ObservationModel, x: Floats) -> ConsideredErrors | None:
    """Return each switched-off term of the model as a parameter: 1 if the observations contain the term."""
    predictor, physical, effects_m = model.predictor, model.predictor.model, dict[str, Floats]()
    unavailable = {"ionosphere"} if physical.ionosphere is None else set[str]()
    names = [name for name in TERMS if name not in unavailable and not physical.has(name)]
    if not names:
        return None
    motions = model.motions(x)
    value_m = predictor.predict(motions).value_m
    for name in names:
        with_term = predictor.with_model(physical.with_terms(physical.terms | {name}), motions)
        effect_m = with_term.predict(motions).value_m - value_m
        if effect_m.any():
            effects_m[f"{TERM}.{name}"] = effect_m
    if not effects_m:
        return None
    return unit_errors(TERM, list(effects_m), np.nan_to_num(np.column_stack(list(effects_m.values()))))


def unit_errors(kind: str, names: Iterable[str], effects_m: Floats) -> ConsideredErrors:
    """Return errors of unit sigma from their effects on all observations, (n, k)."""
    items = [Parameter(name, "1", kind, 0.0, 1.0, scale=1.0, role=Role.CONSIDERED) for name in names]
    return ConsideredErrors(ParameterSet(items), lambda rows: effects_m[rows])


def join_errors(first: ConsideredErrors | None, second: ConsideredErrors | None) -> ConsideredErrors | None:
    """Return two sets of errors as one."""
    if first is None or second is None:
        return second if first is None else first
    return ConsideredErrors(
        ParameterSet([*first.parameters, *second.parameters]),
        lambda rows: np.hstack([first.partials(rows), second.partials(rows)]),
    )
