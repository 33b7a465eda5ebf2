"""Considered parameters: those of a study, and the defaults of their kinds for the rest.

Estimated parameters are not considered as well; members without observations in an arc are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from radioloc.errors import InputError
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import ParameterChoice, canonical_name, parameter_choices
from radioloc.parameters.columns import members
from radioloc.parameters.kind import Amount, ParameterKind, Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.plugins import named_where_it_fails

_LINKS, _STATIONS = (Scope.LINK, Scope.LINK_AND_PASS), (Scope.STATION, Scope.PASS)


def considered_choices(given: Mapping[str, Any]) -> dict[str, ParameterChoice]:
    """Sort keys such as ``station_position_sigma_m`` by kind; a sigma alone applies to all members."""
    everyone = {
        kind.name: True
        for kind in PARAMETERS.values()
        if kind.name not in given and any(kind.keys[field] in given for field in ("sigma", "per"))
    }
    return parameter_choices({**given, **everyone})


def resolved(
    given: Mapping[str, ParameterChoice],
    predictor: Predictor,
    estimated: Mapping[str, ParameterChoice],
    *,
    defaults: bool = True,
    without: Collection[str] = (),
) -> tuple[dict[str, ParameterChoice], list[str]]:
    """Return the considered members with sigmas, by kind, and notes; `without` are kinds that have no defaults."""
    choices, notes, rows_of = {}, [], cache(ObservationRows)
    for name, kind in PARAMETERS.items():
        choice = given.get(name)
        if choice is None:
            if not (defaults and kind.considered) or name in without:
                continue
            if kind.term and not predictor.model.has(kind.term):
                notes.append(f"{name} is not considered: the term {kind.term} is switched off")
                continue
            choice = ParameterChoice("all")
        if choice.names == "none":
            continue
        choice = replace(choice, per=choice.per or kind.considered_per)
        rows = rows_of(predictor.simple)
        found, of_kind = _resolved(kind, choice, rows, estimated.get(name))
        notes += of_kind
        if found is not None:
            choices[name] = found
    return choices, notes


def _resolved(
    kind: ParameterKind,
    choice: ParameterChoice,
    rows: ObservationRows,
    estimated: ParameterChoice | None,
) -> tuple[ParameterChoice | None, list[str]]:
    """One kind, and notes on it."""
    scope, predictor = choice.scope(kind), rows.predictor
    present = members(kind, scope, predictor)
    taken = set(_estimated(kind, scope, predictor, estimated, present))
    listed = None if isinstance(choice.names, str) else [*_named(kind, choice.names, scope, predictor)]
    by_name = choice.sigma if isinstance(choice.sigma, Mapping) else {}
    stated: dict[str, Amount] = dict(
        zip(_named(kind, by_name, scope, predictor), by_name.values(), strict=True)
    )
    absent = [name for name in dict.fromkeys([*(listed or ()), *stated]) if name not in present]
    has = "has" if len(absent) == 1 else "have"
    notes = [f"[consider] {kind.name}: {', '.join(absent)} {has} no observations that it acts on"] * bool(
        absent
    )
    default: Mapping[str, Amount] = {}
    if kind.considered is not None and present and (choice.sigma is None or by_name):
        with named_where_it_fails(f"parameter {kind.name}", "considered"):
            known = kind.considered(rows, present)
        if isinstance(known, str):
            notes.append(f"{kind.name} is not considered: {known}")
        elif isinstance(known, Mapping):
            default = known
        else:
            raise InputError(
                f"considered of {kind.name} gives a {type(known).__name__}; "
                "it needs sigmas by member, or why there are none"
            )
    of_all: Any = None if by_name else choice.sigma
    sigmas = {**default, **stated} if of_all is None else dict.fromkeys(present, of_all)
    chosen = [name for name in present if name not in taken and (listed is None or name in listed)]
    for name in chosen if listed is not None else ():
        if name not in sigmas:
            raise InputError(f"{kind.sigma_key} of {name} is missing; what is considered needs its sigma")
    chosen = [name for name in chosen if name in sigmas]
    if not chosen:
        return None, notes
    value = choice.value
    if isinstance(value, Mapping):
        value = dict(zip(_named(kind, value, scope, predictor), value.values(), strict=True))
        value = {name: amount for name, amount in value.items() if name in present}
    names = tuple(chosen) if kind.scopes[0].named else "all"
    sigma: Any = {name: sigmas[name] for name in chosen}
    return ParameterChoice(names, value, sigma, choice.per), notes


def _named(kind: ParameterKind, names: Collection[str], scope: Scope, predictor: Predictor) -> Iterator[str]:
    return (canonical_name(kind.name, name, scope, predictor) for name in names)


def _estimated(
    kind: ParameterKind,
    scope: Scope,
    predictor: Predictor,
    estimated: ParameterChoice | None,
    present: Collection[str],
) -> Collection[str]:
    """Members whose parameter is estimated; all where it is estimated of all, or of links in place of stations."""
    if estimated is None or estimated.names == "none":
        return ()
    other = estimated.scope(kind)
    alike = other is scope or any({other, scope} <= set(family) for family in (_LINKS, _STATIONS))
    if isinstance(estimated.names, str) or not alike:
        return present
    return list(_named(kind, estimated.names, other, predictor))
