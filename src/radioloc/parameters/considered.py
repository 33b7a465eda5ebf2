"""Considered parameters: those of a study, and the defaults of their kinds for the rest.

Estimated parameters are not considered as well; members without observations in an arc are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import ParameterChoice, parameter_choices, with_canonical_names
from radioloc.parameters.columns import members
from radioloc.parameters.kind import Amount, Members, ParameterKind, Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.plugins import entry_errors


def considered_choices(settings: Mapping[str, Any]) -> dict[str, ParameterChoice]:
    """Sort keys such as ``station_position_sigma_m`` by kind; a sigma alone applies to all members."""
    everyone = {
        kind.name: True
        for kind in PARAMETERS.values()
        if kind.name not in settings and any(kind.keys[field] in settings for field in ("sigma", "per"))
    }
    return parameter_choices({**settings, **everyone})


def resolve_considered(
    stated: Mapping[str, ParameterChoice],
    rows: ObservationRows,
    estimated: Mapping[str, ParameterChoice],
    *,
    defaults: bool = True,
    without_defaults: Collection[str] = (),
) -> tuple[dict[str, ParameterChoice], list[str]]:
    """Return the considered members with sigmas, by kind, and notes; kinds `without_defaults` need to be stated."""
    choices, notes = {}, list[str]()
    for name, kind in PARAMETERS.items():
        choice = stated.get(name)
        if choice is None:
            if not (defaults and kind.considered) or name in without_defaults:
                continue
            if kind.term and not rows.model.has(kind.term):
                notes.append(f"{name} is not considered: the term {kind.term} is switched off")
                continue
            choice = ParameterChoice("all")
        if choice.names == "none":
            continue
        choice = replace(choice, per=choice.per or kind.considered_per)
        replacing = [estimated.get(name)]
        if name not in stated:
            replacing += [of.get(twin) for of in (estimated, stated) for twin in kind.replaced_by]
        considered, of_kind = _resolve_kind(kind, choice, rows, replacing)
        notes += of_kind
        if considered is not None:
            choices[name] = considered
    return choices, notes


def _resolve_kind(
    kind: ParameterKind,
    choice: ParameterChoice,
    rows: ObservationRows,
    replacing: Iterable[ParameterChoice | None],
) -> tuple[ParameterChoice | None, list[str]]:
    """Return the considered members of one kind with their sigmas, without those of other choices, and notes."""
    scope = choice.scope(kind)
    present = members(kind, scope, rows)
    choice = with_canonical_names(kind, choice, rows.predictor)
    listed = present if isinstance(choice.names, str) else choice.names
    stated = choice.sigma if isinstance(choice.sigma, Mapping) else {}
    notes = []
    if absent := [name for name in dict.fromkeys([*listed, *stated]) if name not in present]:
        has = "has" if len(absent) == 1 else "have"
        notes = [
            f"[consider] {kind.name}: {', '.join(absent)} {has} no observations, and the sigma no effect"
        ]
    if choice.sigma is None or isinstance(choice.sigma, Mapping):
        default, reason = default_sigmas(kind, rows, present)
        notes += [f"{kind.name} is not considered: {reason}"] if reason else []
        sigmas = {**default, **stated}
    else:
        sigmas = dict.fromkeys(present, choice.sigma)
    excluded = {
        name for twin in replacing for name in _members_of(kind, scope, rows.predictor, twin, present)
    }
    chosen = [name for name in present if name in listed and name not in excluded]
    missing = [name for name in chosen if name not in sigmas]
    if missing and choice.names != "all":
        raise InputError(
            f"{kind.sigma_key} of {missing[0]} is missing; a consider parameter needs an a-priori sigma"
        )
    sigma: dict[str, Any] = {name: sigmas[name] for name in chosen if name in sigmas}
    if not sigma:
        return None, notes
    value = choice.value
    if isinstance(value, Mapping):
        value = {name: amount for name, amount in value.items() if name in present}
    return ParameterChoice(tuple(sigma) if kind.scopes[0].named else "all", value, sigma, choice.per), notes


def default_sigmas(
    kind: ParameterKind, rows: ObservationRows, present: Members
) -> tuple[Mapping[str, Amount], str]:
    """Return the kind's own sigmas by member, or the reason for their absence."""
    if kind.considered is None or not present:
        return {}, ""
    with entry_errors(f"parameter {kind.name}", "considered"):
        default = kind.considered(rows.distinct, present)
    if isinstance(default, str):
        return {}, default
    if isinstance(default, Mapping):
        return default, ""
    raise InputError(
        f"considered of {kind.name}: expected sigmas by member, or a reason in words, got {type(default).__name__}"
    )


def _members_of(
    kind: ParameterKind, scope: Scope, predictor: Predictor, choice: ParameterChoice | None, present: Members
) -> Collection[str]:
    """Return the members of a choice; a station belongs to a choice that names all its links."""
    if choice is None or choice.names == "none":
        return ()
    owner = choice.scope(kind).owner
    if isinstance(choice.names, str) or (owner, scope.owner) == (Scope.STATION, Scope.LINK):
        return present
    names = with_canonical_names(kind, choice, predictor).names
    if owner is scope.owner:
        return names
    observations = predictor.observations
    listed = np.array([link.path in names for link in observations.links])[observations.link]
    return present.keys() - members(kind, scope, ObservationRows(predictor.select(~listed))).keys()
