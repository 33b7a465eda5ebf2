"""Columns of the design matrix that belong to one kind of parameter: one group for each station, pass, link, ..."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.predictor import Predictor, blocks
from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows, middle_of
from radioloc.time import Epochs, utc_strings

PASS_GAP_H = 4.0
"""A station that has not observed for so long begins a new pass. Between two passes the Moon is down for 5 h or more at
latitudes up to 57 degrees; within one a station is seldom silent for longer than this."""


@dataclass(frozen=True, slots=True)
class Member:
    """A station, link, target, or the whole, that parameters of a kind can belong to.

    Parameters
    ----------
    index : int
        Of the station, link or target in the predictor.
    name : str
        Its name; empty for the whole.
    """

    index: int
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The columns of one kind of parameter.

    Parameters
    ----------
    kind : ParameterKind
    scope : Scope
    names : tuple of str
        Of the groups, in order; each has as many columns as the kind has components.
    spans_utc : tuple of (str, str) or None
        First and last epoch of a group, where it is a pass.
    code : ndarray of int
        Group by index of the station (-1 for none, also as the last element), link or target; of passes by observation,
        shape (n, ends).
    """

    kind: ParameterKind
    scope: Scope
    names: tuple[str, ...]
    spans_utc: tuple[tuple[str, str] | None, ...]
    code: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.names) * len(self.kind.components)

    def design(self, rows: ObservationRows) -> NDArray[np.float64]:
        """Partial derivatives of computed values by the parameters, shape (m, number of columns)."""
        partials = self.kind.partials(rows)
        ends, components = partials.shape[1:]
        code = np.broadcast_to(self._codes(rows), (len(rows), ends))
        # Column by column in memory: several times as fast as row by row.
        columns = np.zeros((len(self.names), components, len(rows)))
        for end in range(ends):
            for group in range(len(self.names)):
                mine = code[:, end] == group
                if mine.any():
                    for component in range(components):
                        columns[group, component] += np.where(mine, partials[:, end, component], 0.0)
        return columns.reshape(len(self), len(rows)).T

    def _codes(self, rows: ObservationRows) -> NDArray[np.int32]:
        if self.scope is Scope.STATION:
            return np.asarray(self.code[rows.ends])
        if self.scope in (Scope.PASS, Scope.LINK_AND_PASS):
            return np.asarray(self.code[rows.rows])
        if self.scope is Scope.LINK:
            return np.asarray(self.code[rows.observations.link[rows.rows]][:, None])
        if self.scope is Scope.TARGET:
            return np.asarray(self.code[rows.target][:, None])
        return np.zeros((len(rows), 1), dtype=np.int32)


def members(kind: ParameterKind, scope: Scope, predictor: Predictor) -> list[Member]:
    """Whom parameters of a kind can belong to: those with observations that it acts on, in the predictor's order."""
    if not len(predictor.observations):
        return []
    reference = middle_of(predictor.observations)
    found: set[int] = set()
    for rows in blocks(predictor):
        part = ObservationRows(predictor, rows, reference)
        acts = kind.acts_on(part)
        if scope in (Scope.STATION, Scope.PASS):
            found |= set(np.unique(part.ends[acts]).tolist())
        elif scope in (Scope.LINK, Scope.LINK_AND_PASS):
            found |= set(np.unique(part.observations.link[rows][acts.any(axis=1)]).tolist())
        elif scope is Scope.TARGET:
            found |= set(np.unique(part.target[acts.any(axis=1)]).tolist())
        elif acts.any():
            found.add(0)
    name = _namer(scope, predictor)
    return [Member(k, name(k)) for k in sorted(found)]


def everyone(scope: Scope, predictor: Predictor) -> list[Member]:
    """Whom parameters can belong to, whether or not they can be estimated from the observations."""
    count = {
        Scope.STATION: len(predictor.stations),
        Scope.LINK: len(predictor.observations.links),
        Scope.TARGET: max(1, len(predictor.targets)),
    }
    name = _namer(scope, predictor)
    return [Member(k, name(k)) for k in range(count.get(scope, 1))]


def _namer(scope: Scope, predictor: Predictor) -> Callable[[int], str]:
    if scope in (Scope.STATION, Scope.PASS):
        return lambda k: predictor.stations[k]
    if scope in (Scope.LINK, Scope.LINK_AND_PASS):
        return lambda k: predictor.observations.links[k].path
    if scope is Scope.TARGET and len(predictor.targets) > 1:
        return lambda k: predictor.targets[k]
    return lambda k: ""


def columns_of(
    kind: ParameterKind,
    scope: Scope,
    predictor: Predictor,
    chosen: list[Member],
    gap_h: float = PASS_GAP_H,
    whole: Sequence[Member] = (),
) -> tuple[Columns, list[int]]:
    """Columns for some of the members, and the place in `chosen` of the member that each group is of.

    Those in `whole` are not divided into passes.
    """
    if scope in (Scope.PASS, Scope.LINK_AND_PASS):
        return _by_pass(kind, scope, predictor, chosen, gap_h, whole)
    size = {Scope.STATION: len(predictor.stations), Scope.LINK: len(predictor.observations.links)}
    code = np.full(size.get(scope, max(1, len(predictor.targets))) + 1, -1, dtype=np.int32)
    code[[member.index for member in chosen]] = np.arange(len(chosen))
    names = tuple(member.name for member in chosen)
    return Columns(kind, scope, names, (None,) * len(names), code), list(range(len(chosen)))


def _by_pass(
    kind: ParameterKind,
    scope: Scope,
    predictor: Predictor,
    chosen: list[Member],
    gap_h: float,
    whole: Sequence[Member],
) -> tuple[Columns, list[int]]:
    """A new pass begins where the station, or the link, has observed nothing at all for long."""
    n = len(predictor.observations)
    part = ObservationRows(predictor, np.arange(n), middle_of(predictor.observations))
    acts, since_s = kind.acts_on(part), part.elapsed_s
    code = np.full((n, acts.shape[1] if scope is Scope.PASS else 1), -1, dtype=np.int32)
    names: list[str] = []
    spans: list[tuple[str, str] | None] = []
    owner: list[int] = []
    at: NDArray[np.bool_]
    for place, member in enumerate(chosen):
        if scope is Scope.PASS:
            at = np.equal(part.ends, member.index)
            acting = acts & at
        else:
            at = np.equal(part.observations.link, member.index)[:, None]
            acting = np.asarray(acts.any(axis=1))[:, None] & at
        mine = np.flatnonzero(at.any(axis=1))
        number = np.full(n, -1)
        number[mine] = 0 if member in whole else _pass_numbers(since_s[mine], gap_h)
        for k in np.unique(number[acting.any(axis=1)]).tolist():
            inside: NDArray[np.bool_] = np.equal(number, k)[:, None] & at
            code[inside] = len(names)
            shown = np.flatnonzero((inside & acting).any(axis=1))
            names.append(member.name if member in whole else f"{member.name} {owner.count(place) + 1}")
            spans.append(None if member in whole else _span(predictor.observations.epoch, since_s, shown))
            owner.append(place)
    return Columns(kind, scope, tuple(names), tuple(spans), code), owner


def _pass_numbers(since_s: NDArray[np.float64], gap_h: float) -> NDArray[np.int64]:
    order = np.argsort(since_s, kind="stable")
    number = np.empty(len(since_s), dtype=np.int64)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(since_s[order]) > 3600.0 * gap_h)])
    return number


def _span(epoch: Epochs, since_s: NDArray[np.float64], rows: NDArray[np.intp]) -> tuple[str, str]:
    ends = rows[[int(since_s[rows].argmin()), int(since_s[rows].argmax())]]
    first, last = utc_strings(epoch[ends], decimals=0)
    return str(first), str(last)
