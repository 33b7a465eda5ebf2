"""Columns and parameters of a kind of parameter, as a study chooses them.

A member (station, link, target, ...) that is listed is estimated or considered about its a-priori value; one that has a
value and is not listed is held at it.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radioloc.errors import InputError, named
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.columns import PASS_GAP_H, Columns, columns_of, everyone, members
from radioloc.parameters.kind import Amount, Members, ParameterKind, Scope
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows, networks
from radioloc.units import ASTROPY_UNITS, in_unit


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """What a study says of one kind of parameter.

    Parameters
    ----------
    names : tuple of str, or "all" or "none"
        Whose parameter it is about: names of stations or targets, or paths.
    value : mapping of str to amount, or amount, or None
        A-priori value by name, or of all; zero where there is none.
    sigma : mapping of str to amount, or amount, or None
        Its standard deviation; free where there is none.
    per : Scope or None
        Whom the parameters belong to; the kind's default where ``None``.
    """

    names: tuple[str, ...] | str = "none"
    value: Mapping[str, Amount] | Amount = None
    sigma: Mapping[str, Amount] | Amount = None
    per: Scope | None = None

    @classmethod
    def of(
        cls, kind: ParameterKind, names: Any = None, value: Any = None, sigma: Any = None, per: Any = None
    ) -> ParameterChoice:
        """Check what was given.

        Raises
        ------
        InputError
            The message begins with the key.
        """
        choice = cls(
            _names(kind, "none" if names is None else names),
            _amounts(kind, kind.value_key, value, positive=False),
            _amounts(kind, kind.sigma_key, sigma, positive=True),
            _scope(kind, per),
        )
        for key, given in ((kind.sigma_key, sigma), (kind.keys["per"], per)):
            if names is None and given is not None:
                raise InputError(f"{key} needs {kind.name}, which says whose it is")
        return choice

    @property
    def is_given(self) -> bool:
        """Whether anything is said."""
        return self.names != "none" or self.value is not None or self.sigma is not None

    def scope(self, kind: ParameterKind) -> Scope:
        """Whom the parameters belong to."""
        return self.per or kind.scopes[0]


def chosen_parameters(
    kind: ParameterKind,
    choice: ParameterChoice,
    predictor: Predictor,
    role: Role = Role.ESTIMATED,
    gap_h: float = PASS_GAP_H,
) -> tuple[Columns, list[Parameter]] | None:
    """Return columns and parameters of a kind, or None; no observation of `predictor` is combined."""
    # `role` is that of what is listed; fixed for the errors of a simulated world, where a value may be of any member
    # that takes part, also where it could not be estimated. A new pass begins after `gap_h` hours without an
    # observation.
    if not choice.is_given:
        return None
    if kind.term and not predictor.model.has(kind.term):
        raise InputError(
            f"{kind.name}: it acts by the term {kind.term}, which is switched off; switch the term on "
            f"([model] off), or leave {kind.name} out"
        )
    scope = choice.scope(kind)
    present = everyone(scope, predictor) if role is Role.FIXED else members(kind, scope, predictor)

    def member_of(key: str, name: str) -> str:
        canonical = canonical_name(key, name, scope, predictor)
        if canonical not in present:
            what = {Scope.STATION: "stations", Scope.PASS: "stations", Scope.TARGET: "targets"}.get(
                scope, "links"
            )
            there = ", ".join(present) or "none"
            raise InputError(f"{key}: no observation of {canonical} that has one; the {what} are {there}")
        return canonical

    def by_member(key: str, given: Any, all_of_them: Collection[str]) -> dict[str, Any]:
        """Amounts of a table, or one for all of them."""
        if given is None or not isinstance(given, Mapping):
            return {} if given is None else dict.fromkeys(all_of_them, given)
        found: dict[str, Any] = {}
        for name, amount in given.items():
            member = member_of(key, name)
            if member in found:
                raise InputError(f"{key}: {member} is there twice, once as {name}")
            found[member] = amount
        return found

    listed = set(present) if choice.names == "all" else set()
    of_stations = scope in (Scope.STATION, Scope.PASS)
    if choice.names == "all" and kind.relative and role is Role.ESTIMATED and of_stations:
        listed -= _references(kind, predictor, present)
    elif not isinstance(choice.names, str):
        listed = {member_of(kind.name, name) for name in choice.names}
    values = by_member(kind.value_key, choice.value, present)
    sigmas = by_member(kind.sigma_key, choice.sigma, listed)
    for member in sigmas:
        if member not in listed:
            raise InputError(
                f"{kind.sigma_key}: {member} gets no {kind.name}; list it in {kind.name}, or leave its sigma out"
            )
    if not present and choice.names != "all" and choice.value is not None:
        raise InputError(f"{kind.value_key}: there is no observation that it acts on; leave it out")
    if choice.names == "all" and not present:
        if kind.scopes[0].named and scope is not Scope.TARGET:
            return None
        raise InputError(f"{kind.name}: there is no observation that it acts on")
    chosen = {name: k for name, k in present.items() if name in listed or name in values}
    if not chosen:
        return None
    whole = () if role is Role.FIXED else chosen.keys() - listed
    columns = columns_of(kind, scope, predictor, chosen, gap_h, whole)
    count = len(kind.components)
    parameters = []
    for name, member, span in zip(columns.names, columns.members, columns.spans_utc, strict=True):
        amounts = (
            np.broadcast_to(of.get(member, none), count) for of, none in ((values, 0.0), (sigmas, math.inf))
        )
        for parameter, value, sigma in zip(kind.parameter_names(name), *amounts, strict=True):
            parameters.append(
                Parameter(
                    parameter,
                    kind.unit,
                    kind.name,
                    float(value),
                    float(sigma),
                    role=role if member in listed else Role.FIXED,
                    scale=kind.scale,
                    span_utc=span,
                )
            )
    return columns, parameters


def of_part(kind: ParameterKind, choice: ParameterChoice, part: Predictor) -> ParameterChoice:
    """Return the choice without the members that have no observations in a part of the arc."""
    if not choice.is_given:
        return choice
    scope = choice.scope(kind)
    names = members(kind, scope, part)

    def stays(name: str) -> bool:
        return canonical_name(kind.name, name, scope, part) in names

    listed = choice.names
    if not names:
        listed = "none"
    elif not isinstance(listed, str):
        listed = tuple(filter(stays, listed)) or "none"
    kept = [
        {name: amount for name, amount in given.items() if stays(name)} or None
        if isinstance(given, Mapping)
        else given
        for given in (choice.value, choice.sigma)
    ]
    if listed == "none" and not isinstance(kept[1], Mapping):
        kept[1] = None
    return ParameterChoice(listed, kept[0] if names else None, kept[1], choice.per)


def _names(kind: ParameterKind, names: Any) -> tuple[str, ...] | str:
    if isinstance(names, bool):
        return "all" if names else "none"
    if names in ("all", "none"):
        return str(names)
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise InputError(
            f'{kind.name} must be a list of names, "all" or "none", not {names!r}: it says whose it is; '
            f"an a-priori value belongs to {kind.value_key}, its sigma to {kind.sigma_key}"
        )
    if not kind.scopes[0].named:
        raise InputError(f"{kind.name} belongs to nobody by name; use true or false, not {names!r}")
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{kind.name} must be names, not {name!r}")
    return tuple(names)


def _amounts(kind: ParameterKind, key: str, given: Any, *, positive: bool) -> Any:
    if given is None:
        return None
    if isinstance(given, Mapping):
        return {name: _amount(kind, f"{key} of {name}", value, positive) for name, value in given.items()}
    try:
        return _amount(kind, key, given, positive)
    except InputError as error:
        if isinstance(given, str) or (isinstance(given, Sequence) and any(isinstance(v, str) for v in given)):
            raise InputError(f"{error}; {kind.name} says whose it is") from None
        raise


def _amount(kind: ParameterKind, key: str, given: Any, positive: bool) -> Amount:
    given = in_unit(given, ASTROPY_UNITS.get(kind.unit, kind.unit), key)
    if isinstance(given, np.ndarray):
        given = given.tolist()
    count = len(kind.components)
    if count > 1 and isinstance(given, Sequence) and not isinstance(given, str):
        if len(given) != count:
            raise InputError(f"{key} must be {count} numbers ({', '.join(kind.components)}), not {given!r}")
        return tuple(_number(key, value, positive) for value in given)
    return _number(key, given, positive)


def _number(key: str, value: Any, positive: bool) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(f"{key} must be a number, not {value!r}")
    finite = -sys.float_info.max <= value <= sys.float_info.max
    if positive and not (finite and value > 0.0):
        raise InputError(f"{key} must be above zero, not {value!r}")
    if not finite:
        raise InputError(f"{key} must be a finite number, not {value!r}")
    return float(value)


def _scope(kind: ParameterKind, per: Any) -> Scope | None:
    if per is None or isinstance(per, Scope):
        return per
    allowed = {scope.value: scope for scope in kind.scopes}
    if per not in allowed:
        words = " or ".join(f'"{word}"' for word in allowed)
        raise InputError(f"{kind.keys['per']} must be {words}, not {per!r}")
    return allowed[per]


def _references(kind: ParameterKind, predictor: Predictor, present: Members) -> set[str]:
    """Only differences show, as of clocks: the first station of those that observe together is the reference."""
    rows = ObservationRows(predictor)
    network = networks(rows.ends[kind.acts_on(rows).all(axis=1)], len(predictor.stations))
    first = {int(network[k]): name for name, k in reversed(present.items())}
    return set(first.values())


def canonical_name(key: str, name: str, scope: Scope, predictor: Predictor) -> str:
    """The name under which the predictor has a station, link or target."""
    if scope in (Scope.STATION, Scope.PASS):
        with named(f"{key}:"):
            return predictor.model.catalogue.get(name).name
    if scope in (Scope.LINK, Scope.LINK_AND_PASS):
        with named(f"{key}:"):
            return Link.from_path(name).path
    return canonical_target(name) if scope is Scope.TARGET else name


def parameter_choices(
    given: Mapping[str, Any], before: Mapping[str, ParameterChoice] | None = None
) -> dict[str, ParameterChoice]:
    """Sort keys such as ``range_bias_sigma_m`` by kind of parameter; earlier choices stay but for the keys given."""
    keys = {key: (kind, field) for kind in PARAMETERS.values() for field, key in kind.keys.items()}
    fields: dict[str, dict[str, Any]] = {}
    for key, value in given.items():
        if key not in keys:
            near = difflib.get_close_matches(key, keys, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{key} is no parameter's{hint}; the parameters are {', '.join(PARAMETERS)}")
        kind, field = keys[key]
        fields.setdefault(kind.name, {})[field] = value
    choices = dict(before or {})
    for name, kind in PARAMETERS.items():
        if name in fields:
            old = choices.get(name)
            names = {} if old is None else {"names": old.names}
            made = ParameterChoice.of(kind, **(names | fields[name]))
            changed = {field: getattr(made, field) for field in fields[name]}
            choices[name] = made if old is None else replace(old, **changed)
    return choices


def chosen_keys(choices: Mapping[str, ParameterChoice]) -> dict[str, Any]:
    """The keys that :func:`parameter_choices` was given."""
    keys: dict[str, Any] = {}
    for name, choice in choices.items():
        for field, key in PARAMETERS[name].keys.items():
            given = getattr(choice, field)
            if given is not None:
                keys[key] = given.value if isinstance(given, Scope) else given
    return keys
