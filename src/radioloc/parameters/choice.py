"""Parameters that a study chooses, and their columns of the design matrix.

A listed member (station, link, target, ...) is estimated or considered about its a-priori value; a member with a value
that is not listed is held at it.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radioloc.errors import InputError, error_context
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.columns import PASS_GAP_H, Columns, all_members, columns_of, members
from radioloc.parameters.kind import Amount, Members, ParameterKind, Scope
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows, networks
from radioloc.units import ASTROPY_UNITS, in_unit


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """Choice of a study about one kind of parameter."""

    names: tuple[str, ...] | str = "none"  #: members with a parameter: names of stations or targets, or paths
    value: Mapping[str, Amount] | Amount = None  #: a-priori value by name, or of all; zero by default
    #: Its standard deviation; infinite by default, which leaves the parameter free.
    sigma: Mapping[str, Amount] | Amount = None
    per: Scope | None = None  #: scope of the parameters; the kind's first by default

    @classmethod
    def from_values(
        cls, kind: ParameterKind, names: Any = None, value: Any = None, sigma: Any = None, per: Any = None
    ) -> ParameterChoice:
        """Return the choice that values of a study file make; the message of an error begins with the key."""
        choice = cls(
            _names(kind, "none" if names is None else names),
            _amounts(kind, kind.value_key, value, positive=False),
            _amounts(kind, kind.sigma_key, sigma, positive=True),
            _scope(kind, per),
        )
        for key, setting in ((kind.sigma_key, sigma), (kind.keys["per"], per)):
            if names is None and setting is not None:
                raise InputError(f"{key} needs {kind.name}, the list of its members")
        return choice

    @property
    def is_given(self) -> bool:
        """Return whether the study states anything about the kind."""
        return self.names != "none" or self.value is not None or self.sigma is not None

    def scope(self, kind: ParameterKind) -> Scope:
        """Return the scope of the parameters."""
        return self.per or kind.scopes[0]


def chosen_parameters(
    kind: ParameterKind,
    choice: ParameterChoice,
    rows: ObservationRows,
    role: Role = Role.ESTIMATED,
    gap_h: float = PASS_GAP_H,
) -> tuple[Columns, list[Parameter]] | None:
    """Return columns and parameters of a kind, or None, from the rows of all observations of an arc."""
    # `role` is that of the listed members. It is fixed for the errors of a simulated world, where any participant may
    # have a value, even one that cannot be estimated. A new pass begins after `gap_h` hours without an observation.
    if not choice.is_given:
        return None
    if kind.term and not rows.model.has(kind.term):
        raise InputError(
            f"{kind.name}: it acts by the term {kind.term}, which is switched off; switch the term on "
            f"([model] off), or leave {kind.name} out"
        )
    scope = choice.scope(kind)
    present = all_members(scope, rows.predictor) if role is Role.FIXED else members(kind, scope, rows)
    choice = with_canonical_names(kind, choice, rows.predictor)
    _require_observations(kind, choice, present)
    listed = set(present if choice.names == "all" else () if choice.names == "none" else choice.names)
    if choice.names == "all" and kind.relative and role is Role.ESTIMATED and scope.owner is Scope.STATION:
        listed -= _reference_stations(kind, rows, present)
    values, sigmas = _by_member(choice.value, present), _by_member(choice.sigma, listed)
    if unlisted := sigmas.keys() - listed:
        raise InputError(
            f"{kind.sigma_key}: {min(unlisted)} gets no {kind.name}; list it in {kind.name}, or leave its sigma out"
        )
    chosen = {name: k for name, k in present.items() if name in listed or name in values}
    if not chosen:
        return None
    undivided = () if role is Role.FIXED else chosen.keys() - listed
    columns = columns_of(kind, scope, rows, chosen, gap_h, undivided)
    parameters = []
    for name, member, span in zip(columns.names, columns.members, columns.spans_utc, strict=True):
        priors = np.empty((2, len(kind.components)))
        priors[0], priors[1] = values.get(member, 0.0), sigmas.get(member, math.inf)
        member_role = role if member in listed else Role.FIXED
        parameters += [
            Parameter(component, kind.unit, kind.name, value, sigma, member_role, kind.scale, span)
            for component, value, sigma in zip(kind.parameter_names(name), *priors.tolist(), strict=True)
        ]
    return columns, parameters


def with_canonical_names(
    kind: ParameterKind, choice: ParameterChoice, predictor: Predictor
) -> ParameterChoice:
    """Return the choice with the names that the predictor has for stations, links and targets."""
    scope = choice.scope(kind)

    def renamed(key: str, amounts_by_name: Any) -> Any:
        if not isinstance(amounts_by_name, Mapping):
            return amounts_by_name
        amounts: dict[str, Amount] = {}
        for name, amount in amounts_by_name.items():
            member = canonical_name(key, name, scope, predictor)
            if member in amounts:
                raise InputError(f"{key}: expected each member once, got {member} twice, once as {name}")
            amounts[member] = amount
        return amounts

    names = choice.names
    if not isinstance(names, str):
        names = tuple(canonical_name(kind.name, name, scope, predictor) for name in names)
    value, sigma = renamed(kind.value_key, choice.value), renamed(kind.sigma_key, choice.sigma)
    return ParameterChoice(names, value, sigma, choice.per)


def _require_observations(kind: ParameterKind, choice: ParameterChoice, present: Members) -> None:
    """Raise an error if the kind acts on no observation of a named member, or on none where one is needed."""
    members_by_key: dict[str, Collection[str]] = {
        key: amounts
        for key, amounts in ((kind.value_key, choice.value), (kind.sigma_key, choice.sigma))
        if isinstance(amounts, Mapping)
    }
    if not isinstance(choice.names, str):
        members_by_key[kind.name] = choice.names
    for key, names in members_by_key.items():
        if absent := [name for name in names if name not in present]:
            raise InputError(
                f"{key}: expected a member with observations on which {kind.name} acts "
                f"({', '.join(present) or 'none'}), got {absent[0]}"
            )
    if not present and (choice.value is not None or choice.names == "all"):
        optional = kind.scopes[0].named and choice.scope(kind) is not Scope.TARGET
        if not (choice.names == "all" and optional):
            key = kind.name if choice.names == "all" else kind.value_key
            raise InputError(f"{key}: expected observations on which it acts, got none; leave it out")


def _by_member(amount: Any, names: Collection[str]) -> dict[str, Any]:
    """Return amounts by member, an amount without names for each of `names`."""
    if isinstance(amount, Mapping):
        return dict(amount)
    return {} if amount is None else dict.fromkeys(names, amount)


def without_unobserved_members(
    kind: ParameterKind, choice: ParameterChoice, part: Predictor
) -> ParameterChoice:
    """Return the choice without the members that have no observations in a part of the arc."""
    if not choice.is_given:
        return choice
    present = members(kind, choice.scope(kind), ObservationRows(part))
    if not present:
        return ParameterChoice(per=choice.per)
    choice = with_canonical_names(kind, choice, part)

    def within_part(amounts: Any) -> Any:
        if not isinstance(amounts, Mapping):
            return amounts
        return {name: amount for name, amount in amounts.items() if name in present} or None

    names = choice.names
    if not isinstance(names, str):
        names = tuple(name for name in names if name in present) or "none"
    sigma = None if names == "none" else within_part(choice.sigma)
    return ParameterChoice(names, within_part(choice.value), sigma, choice.per)


def _names(kind: ParameterKind, names: Any) -> tuple[str, ...] | str:
    if isinstance(names, bool):
        return "all" if names else "none"
    if names in ("all", "none"):
        return str(names)
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise InputError(
            f'{kind.name}: expected a list of names, "all" or "none", got {names!r}; '
            f"give an a-priori value as {kind.value_key}, its sigma as {kind.sigma_key}"
        )
    if not kind.scopes[0].named:
        raise InputError(f"{kind.name} has no members with names; use true or false, not {names!r}")
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{kind.name}: expected names, got {name!r}")
    return tuple(names)


def _amounts(kind: ParameterKind, key: str, amounts: Any, *, positive: bool) -> Any:
    if amounts is None:
        return None
    if isinstance(amounts, Mapping):
        return {name: _amount(kind, f"{key} of {name}", value, positive) for name, value in amounts.items()}
    return _amount(kind, key, amounts, positive)


def _amount(kind: ParameterKind, key: str, amount: Any, positive: bool) -> Amount:
    amount = in_unit(amount, ASTROPY_UNITS.get(kind.unit, kind.unit), key)
    if isinstance(amount, np.ndarray):
        amount = amount.tolist()
    count = len(kind.components)
    if count > 1 and isinstance(amount, Sequence) and not isinstance(amount, str):
        if len(amount) != count:
            raise InputError(
                f"{key}: expected {count} numbers ({', '.join(kind.components)}), got {amount!r}"
            )
        return tuple(_number(key, value, positive) for value in amount)
    return _number(key, amount, positive)


def _number(key: str, value: Any, positive: bool) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(f"{key}: expected a number, got {value!r}")
    finite = -sys.float_info.max <= value <= sys.float_info.max
    if positive and not (finite and value > 0.0):
        raise InputError(f"{key}: expected a number above zero, got {value!r}")
    if not finite:
        raise InputError(f"{key}: expected a finite number, got {value!r}")
    return float(value)


def _scope(kind: ParameterKind, per: Any) -> Scope | None:
    if per is None or isinstance(per, Scope):
        return per
    allowed = {scope.value: scope for scope in kind.scopes}
    if per not in allowed:
        words = " or ".join(f'"{word}"' for word in allowed)
        raise InputError(f"{kind.keys['per']}: expected {words}, got {per!r}")
    return allowed[per]


def _reference_stations(kind: ParameterKind, rows: ObservationRows, present: Members) -> set[str]:
    """Return the first station of each network; only differences from it are observable, as of clocks."""
    rows = rows.distinct
    network = networks(rows.ends[kind.acts_on(rows).all(axis=1)], len(rows.predictor.stations))
    first = {int(network[k]): name for name, k in reversed(present.items())}
    return set(first.values())


def canonical_name(key: str, name: str, scope: Scope, predictor: Predictor) -> str:
    """Return the name that the predictor has for a station, link or target."""
    with error_context(f"{key}:"):
        if scope.owner is Scope.STATION:
            return predictor.model.catalogue.get(name).name
        if scope.owner is Scope.LINK:
            return Link.from_path(name).path
    return canonical_target(name) if scope is Scope.TARGET else name


def parameter_choices(
    settings: Mapping[str, Any], earlier_choices: Mapping[str, ParameterChoice] | None = None
) -> dict[str, ParameterChoice]:
    """Sort keys such as ``range_bias_sigma_m`` by kind of parameter; the given keys replace earlier choices."""
    keys = {key: (kind, field) for kind in PARAMETERS.values() for field, key in kind.keys.items()}
    fields: dict[str, dict[str, Any]] = {}
    for key, value in settings.items():
        if key not in keys:
            matches = difflib.get_close_matches(key, keys, n=1)
            hint = f"; did you mean {matches[0]!r}?" if matches else ""
            raise InputError(
                f"{key}: unknown key of a parameter{hint}; the parameters are {', '.join(PARAMETERS)}"
            )
        kind, field = keys[key]
        fields.setdefault(kind.name, {})[field] = value
    choices = dict(earlier_choices or {})
    for name, new_fields in fields.items():
        earlier = choices.get(name, ParameterChoice())
        names = {"names": earlier.names} if name in choices else {}
        choice = ParameterChoice.from_values(PARAMETERS[name], **(names | new_fields))
        choices[name] = replace(earlier, **{field: getattr(choice, field) for field in new_fields})
    return choices


def chosen_keys(choices: Mapping[str, ParameterChoice]) -> dict[str, Any]:
    """Return the keys and values from which :func:`parameter_choices` makes the choices."""
    keys: dict[str, Any] = {}
    for name, choice in choices.items():
        for field, key in PARAMETERS[name].keys.items():
            setting = getattr(choice, field)
            if setting is not None:
                keys[key] = setting.value if isinstance(setting, Scope) else setting
    return keys
