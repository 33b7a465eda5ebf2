"""Columns of the design matrix of one kind of parameter: a group for each station, pass, link, ..."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.kind import Members, ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows
from radioloc.plugins import entry_errors
from radioloc.time import utc_strings
from radioloc.vectors import Floats, Mask

PASS_GAP_H = 4.0
"""Time without observations of a station after which a new pass begins. Between two passes the Moon is down for 5 h or
more at latitudes up to 57 degrees; gaps within a pass are seldom longer than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of one kind of parameter: groups with a column for each component of the kind."""

    kind: ParameterKind
    scope: Scope
    names: tuple[str, ...]  # of the groups
    members: tuple[str, ...]  # their owners
    spans_utc: tuple[tuple[str, str] | None, ...]  # first and last epoch of a pass
    # Group by index of the member, the last -1; of passes by observation, shape (n, ends).
    code: NDArray[np.signedinteger[Any]]

    def __len__(self) -> int:
        return len(self.names) * len(self.kind.components)

    def design(self, rows: ObservationRows, out: Floats | None = None) -> Floats:
        """Return partials of computed values, (m, number of columns), into zeros if given."""
        # Storage by columns is several times as fast as by rows.
        partials = _evaluated(self.kind, "partials", rows)
        if self.kind.of_links_second and self.scope.owner is Scope.LINK:
            partials = partials[:, -1:]
        components = len(self.kind.components)
        if partials.ndim != 3 or partials.shape[::2] != (len(rows), components):
            raise InputError(
                f"partials of {self.kind.name}: expected the shape ({len(rows)}, ends, {components}) for the "
                f"observations rows.rows, got {partials.shape}"
            )
        ends = partials.shape[1]
        index = rows.rows if self.code.ndim == 2 else members_of_ends(self.scope, rows)
        code = np.broadcast_to(self.code[index], (len(rows), ends))
        out = np.zeros((len(self), len(rows))).T if out is None else out
        for end in range(ends):
            members = np.flatnonzero(code[:, end] >= 0)
            first_column = components * code[members, end].astype(np.intp)
            for component in range(components):
                out.T[first_column + component, members] += partials[members, end, component]
        return out


def _evaluated(
    kind: ParameterKind, name: Literal["partials", "acts_on"], rows: ObservationRows
) -> NDArray[Any]:
    with entry_errors(f"parameter {kind.name}", name):
        return np.asarray(rows.evaluate(getattr(kind, name)))


def _acts_on(kind: ParameterKind, rows: ObservationRows) -> NDArray[Any]:
    acts = _evaluated(kind, "acts_on", rows)
    if acts.shape not in ((len(rows), 1), (len(rows), 2)):
        raise InputError(
            f"acts_on of {kind.name}: expected the shape ({len(rows)}, ends) for the observations rows.rows, with one "
            f"or two ends, got {acts.shape}"
        )
    return acts


def members_of_ends(scope: Scope, rows: ObservationRows) -> NDArray[np.int32]:
    """Return the index of the member at each end of an observation, shape (m, ends), or -1."""
    if scope.owner is Scope.STATION:
        return rows.ends
    if scope.owner is Scope.LINK:
        return rows.observations.link[rows.rows][:, None]
    if scope is Scope.TARGET:
        return rows.target[:, None]
    return np.zeros((len(rows), 1), dtype=np.int32)


def all_members(scope: Scope, predictor: Predictor) -> Members:
    """Return the members of a scope, whether or not observations determine their parameters."""
    names: Iterable[str] = ("",)
    if scope.owner is Scope.STATION:
        names = predictor.stations
    elif scope.owner is Scope.LINK:
        names = (link.path for link in predictor.observations.links)
    elif scope is Scope.TARGET and len(predictor.targets) > 1:
        names = predictor.targets
    return {name: k for k, name in enumerate(names)}


def members(kind: ParameterKind, scope: Scope, rows: ObservationRows) -> Members:
    """Return the members with observations that depend on the kind."""
    rows = rows.distinct
    acts, owner = _acts_on(kind, rows), members_of_ends(scope, rows)
    if owner.shape[1] == 1:
        acts = _any_end(acts)[:, None]
    present = np.flatnonzero(np.bincount(np.where(acts, owner, -1).ravel() + 1)[1:]).tolist()
    return {name: k for name, k in all_members(scope, rows.predictor).items() if k in present}


def columns_of(
    kind: ParameterKind,
    scope: Scope,
    rows: ObservationRows,
    chosen: Members,
    gap_h: float = PASS_GAP_H,
    undivided: Collection[str] = (),
) -> Columns:
    """Return columns for some members; those in `undivided` are not divided into passes.

    A new pass begins after `gap_h` hours without any observation of the station or link, a session without any at all.
    """
    if scope not in (Scope.PASS, Scope.LINK_AND_PASS, Scope.SESSION):
        by_member = np.full(len(all_members(scope, rows.predictor)) + 1, -1, dtype=np.int32)
        by_member[list(chosen.values())] = np.arange(len(chosen))
        return Columns(kind, scope, tuple(chosen), tuple(chosen), (None,) * len(chosen), by_member)
    owner, since_s = members_of_ends(scope, rows), rows.elapsed_s
    acts = _acts_on(kind, rows)
    if scope is not Scope.PASS:
        acts = _any_end(acts)[:, None]
    code = np.full(owner.shape, -1, dtype=np.int32)
    names: list[str] = []
    owners: list[str] = []
    spans: list[tuple[str, str] | None] = []
    for member, index in chosen.items():
        ends_of_member: Mask = np.equal(owner, index)
        order = np.flatnonzero(_any_end(ends_of_member))
        order = order[np.argsort(since_s[order], kind="stable")]
        is_undivided = member in undivided
        gaps = np.flatnonzero(np.diff(since_s[order]) > 3600.0 * gap_h) + 1
        for rows_of_pass in [order] if is_undivided else np.split(order, gaps):
            ends = ends_of_member[rows_of_pass]
            acting = rows_of_pass[_any_end(acts[rows_of_pass] & ends)]
            if not len(acting):
                continue
            code[rows_of_pass] = np.where(ends, len(names), code[rows_of_pass])
            names.append(member if is_undivided else f"{member} {owners.count(member) + 1}".strip())
            owners.append(member)
            first, last = utc_strings(rows.observations.epoch[acting[[0, -1]]], decimals=0)
            spans.append(None if is_undivided else (str(first), str(last)))
    code = code.astype(np.min_scalar_type(-len(names) - 1))
    return Columns(kind, scope, tuple(names), tuple(owners), tuple(spans), code)


def _any_end(of_ends: Mask) -> Mask:
    """Return whether any end is true, thirty times as fast as `any` along an axis of two."""
    return np.asarray(of_ends[:, 0] | of_ends[:, -1])
