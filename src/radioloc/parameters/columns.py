"""Columns of the design matrix that belong to one kind of parameter: one group for each station, pass, link, ..."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.kind import Members, ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows
from radioloc.plugins import named_where_it_fails
from radioloc.time import utc_strings
from radioloc.vectors import Floats

PASS_GAP_H = 4.0
"""A station that has not observed for so long begins a new pass. Between two passes the Moon is down for 5 h or more at
latitudes up to 57 degrees; within one a station is seldom silent for longer than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The columns of one kind of parameter: groups with as many columns as the kind has components."""

    kind: ParameterKind
    scope: Scope
    names: tuple[str, ...]  # of the groups
    members: tuple[str, ...]  # whose they are
    spans_utc: tuple[tuple[str, str] | None, ...]  # first and last epoch of a group, where it is a pass
    code: NDArray[
        np.int32
    ]  # group by index of the member, the last -1; of passes by observation, shape (n, ends)

    def __len__(self) -> int:
        return len(self.names) * len(self.kind.components)

    def design(self, rows: ObservationRows, out: Floats | None = None) -> Floats:
        """Return partials of computed values, (m, number of columns), into zeros if given."""
        # They are stored column by column: several times as fast as row by row.
        partials = _asked(self.kind, "partials", rows)
        if self.kind.of_links_second and self.scope.owner is Scope.LINK:
            partials = partials[:, -1:]
        components = len(self.kind.components)
        if partials.ndim != 3 or partials.shape[::2] != (len(rows), components):
            raise InputError(
                f"partials of {self.kind.name} have the shape {partials.shape}; they need one of "
                f"({len(rows)}, ends, {components}), for the observations rows.rows"
            )
        ends = partials.shape[1]
        which = rows.rows if self.code.ndim == 2 else members_of_ends(self.scope, rows)
        code = np.broadcast_to(self.code[which], (len(rows), ends))
        out = np.zeros((len(self), len(rows))).T if out is None else out
        for end in range(ends):
            for group in np.flatnonzero(np.bincount(code[:, end] + 1)[1:]):
                mine = code[:, end] == group
                for component in range(components):
                    out[:, group * components + component] += np.where(mine, partials[:, end, component], 0.0)
        return out


def _asked(kind: ParameterKind, what: Literal["partials", "acts_on"], rows: ObservationRows) -> NDArray[Any]:
    with named_where_it_fails(f"parameter {kind.name}", what):
        found = np.asarray(rows.asked(getattr(kind, what)))
    if what == "acts_on" and (found.ndim != 2 or found.shape[0] != len(rows) or found.shape[1] not in (1, 2)):
        raise InputError(
            f"acts_on of {kind.name} has the shape {found.shape}; it needs ({len(rows)}, ends), for the observations "
            "rows.rows, with one or two ends"
        )
    return found


def members_of_ends(scope: Scope, rows: ObservationRows) -> NDArray[np.int32]:
    """Index of the member that each end of an observation belongs to, shape (m, ends); -1 where there is none."""
    if scope.owner is Scope.STATION:
        return rows.ends
    if scope.owner is Scope.LINK:
        return rows.observations.link[rows.rows][:, None]
    if scope is Scope.TARGET:
        return rows.target[:, None]
    return np.zeros((len(rows), 1), dtype=np.int32)


def all_members(scope: Scope, predictor: Predictor) -> Members:
    """Whom parameters can belong to, whether or not they can be estimated from the observations."""
    names: tuple[str, ...] = ("",)
    if scope.owner is Scope.STATION:
        names = predictor.stations
    elif scope.owner is Scope.LINK:
        names = tuple(link.path for link in predictor.observations.links)
    elif scope is Scope.TARGET and len(predictor.targets) > 1:
        names = predictor.targets
    return {name: k for k, name in enumerate(names)}


def members(kind: ParameterKind, scope: Scope, predictor: Predictor) -> Members:
    """Those of them with observations that the kind acts on."""
    rows = ObservationRows(predictor)
    acts, owner = _asked(kind, "acts_on", rows), members_of_ends(scope, rows)
    if owner.shape[1] == 1:
        acts = np.asarray(acts.any(axis=1, keepdims=True))
    there = np.bincount(owner[acts & (owner >= 0)], minlength=1)
    return {name: k for name, k in all_members(scope, predictor).items() if k < len(there) and there[k]}


def columns_of(
    kind: ParameterKind,
    scope: Scope,
    predictor: Predictor,
    chosen: Members,
    gap_h: float = PASS_GAP_H,
    whole: Collection[str] = (),
) -> Columns:
    """Columns for some of the members; those in `whole` are not divided into passes.

    A new pass begins where the station, or the link, has observed nothing at all for `gap_h` hours; a session, where
    nobody has.
    """
    if scope not in (Scope.PASS, Scope.LINK_AND_PASS, Scope.SESSION):
        by_member = np.full(len(all_members(scope, predictor)) + 1, -1, dtype=np.int32)
        by_member[list(chosen.values())] = np.arange(len(chosen))
        return Columns(kind, scope, tuple(chosen), tuple(chosen), (None,) * len(chosen), by_member)
    rows = ObservationRows(predictor)
    owner, since_s = members_of_ends(scope, rows), rows.elapsed_s
    acts = _asked(kind, "acts_on", rows)
    if scope is not Scope.PASS:
        acts = np.asarray(acts.any(axis=1, keepdims=True))
    code = np.full(owner.shape, -1, dtype=np.int32)
    names: list[str] = []
    of: list[str] = []
    spans: list[tuple[str, str] | None] = []
    for member, index in chosen.items():
        at: NDArray[np.bool_] = np.equal(owner, index)
        mine = np.flatnonzero(_any_end(at))
        mine = mine[np.argsort(since_s[mine], kind="stable")]
        number = np.full(len(rows), -1)
        gaps = np.diff(since_s[mine], prepend=since_s[mine[:1]]) > 3600.0 * gap_h
        number[mine] = 0 if member in whole else np.cumsum(gaps)
        for k in np.unique(number[_any_end(acts & at)]).tolist():
            inside = np.equal(number, k)[:, None] & at
            code[inside] = len(names)
            names.append(member if member in whole else f"{member} {of.count(member) + 1}".strip())
            of.append(member)
            shown = np.flatnonzero(_any_end(inside & acts))
            ends = shown[[int(since_s[shown].argmin()), int(since_s[shown].argmax())]]
            first, last = utc_strings(predictor.observations.epoch[ends], decimals=0)
            spans.append(None if member in whole else (str(first), str(last)))
    return Columns(kind, scope, tuple(names), tuple(of), tuple(spans), code)


def _any_end(of_ends: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether it is so at any end; numpy's own `any` along two of many is thirty times as slow."""
    return np.asarray(of_ends[:, 0] | of_ends[:, -1])
