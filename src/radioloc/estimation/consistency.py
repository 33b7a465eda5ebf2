"""Who does not fit: stations, links, passes and types against the rest, a-priori values, steps and offsets in time.

Each group of observations is taken out of the fit by parameters of its own, and the estimate without it is held against
the one with it. Then explanations are tried by :mod:`~radioloc.estimation.group_tests`: an a-priori value that is wrong
(of a bias, or of a considered parameter such as a station's place), a step of a link or of all baselines of a station
at the epoch that fits best, an offset of a link in one pass or throughout. The chance of each allows for the number of
those that were tried (Bonferroni). The best one joins the parameters and the search goes on until nothing is left.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.group_tests import BinnedProblem, Verdict, noise_of_each
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import mixed_units
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.parameters.registry import parameter_label
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_Links = dict[int, float]
"""Series of single observations, with the sign that something has in each."""

SIGNIFICANCE_LEVEL = 1e-3  # of an inconsistency: by chance in fewer than one solution of a thousand
TEST_FAMILY_COUNT = 4  # groups, a-priori values, steps, offsets (Bonferroni correction)
_MAX_FINDING_COUNT = 3
_MAX_GROUP_COUNT = 200
_MIN_STEP_POINT_COUNT = 3  # on either side of a step


@dataclass(frozen=True, slots=True)
class Inconsistency:
    """Group of observations, or an explanation, and how it fits the rest."""

    kind: str  # "station", "link", "type", "pass": taken out; "a priori": set free; "jump", "offset": added
    name: str
    chi2: float
    dof: int
    log10_chance: float  # of chance alone making it as large, all that were tried allowed for
    shift_enu_m: tuple[float, float, float] | None  # of the position, without or with it
    shift_sigma_enu_m: tuple[float, float, float] | None  # how much it would move by chance
    amounts: dict[str, float]  # what explains it, by component, in `unit`
    unit: str = ""
    first_utc: str = ""  # empty where all the time
    last_utc: str = ""

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains it."""
        return self.log10_chance < math.log10(SIGNIFICANCE_LEVEL)

    def to_dict(self) -> dict[str, Any]:
        """Its numbers, with the sentence as ``text`` where it is significant."""
        content: dict[str, Any] = {
            name: getattr(self, name) for name in ("kind", "name", "chi2", "dof", "log10_chance")
        }
        for key in ("shift", "shift_sigma"):
            values = getattr(self, f"{key}_enu_m") or (None, None, None)
            content[key] = dict(zip(("east_m", "north_m", "up_m"), values, strict=True))
        content |= {"amounts": self.amounts, "unit": self.unit}
        content |= {"first_utc": self.first_utc or None, "last_utc": self.last_utc or None}
        return content | {"significant": self.significant, "text": str(self) if self.significant else None}

    def __str__(self) -> str:
        when = f" from {self.first_utc} to {self.last_utc}" if self.last_utc else ""
        what = f"{self.name}{when} does not fit the others"
        value = next(iter(self.amounts.values()), 0.0)
        if self.kind == "jump":
            what = f"{self.name} jumps by {_length(value)} at {self.first_utc}"
        elif self.kind == "offset":
            what = f"{self.name} is off by {_length(value)}{when}"
        elif self.kind == "a priori":
            what = self._wrong_prior()
        if self.shift_enu_m is None:
            return what
        how = "with that" if self.amounts else "without it"
        return f"{what}; {how} the position moves by {math.hypot(*self.shift_enu_m):.3g} m"

    def _wrong_prior(self) -> str:
        kind, _, of = self.name.partition(".")
        parts = " ".join(
            f"{value:+.3g} {self.unit}{f' {name}' if name else ''}".replace("  ", " ")
            for name, value in self.amounts.items()
        )
        if kind == "position":
            return f"the a-priori {of} does not fit the observations ({parts} explains it)"
        return (
            f"the a-priori {parameter_label(self.name)} does not fit the observations ({parts} explains it)"
        )


def _length(value_m: float) -> str:
    return f"{value_m:+.3g} m ({1e9 * value_m / C_M_S:+.3g} ns)"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Agreement of the observations with each other and with the a-priori values."""

    groups: tuple[Inconsistency, ...] = ()  # each without the rest; those that fit too
    # What does not fit, the clearest first, each with those before it taken into account.
    found: tuple[Inconsistency, ...] = ()

    def __repr__(self) -> str:
        return f"<Consistency of {len(self.groups)} groups, {len(self.found)} finding(s)>"

    def to_list(self) -> list[dict[str, Any]]:
        """What was found, then the groups, in types that JSON has."""
        return [item.to_dict() for item in (*self.found, *self.groups)]


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A group or an explanation before it has a name in words."""

    kind: str
    name: str
    columns: Floats  # of length one, all together
    verdict: Verdict
    components: tuple[str, ...]  # none where a group is taken out
    scale: Floats  # of the amounts
    unit: str = "m"
    span_s: tuple[float, float] | None = None
    links: _Links = field(default_factory=dict)
    width_s: float = 0.0  # of the bins that a step was found in
    log_chance: float = 0.0


def assess_consistency(
    edited: EditedFit,
    order: SeriesOrder,
    correlation: TimeCorrelation | None,
    epoch_utc: Epochs,
    enu_by_parameters: Floats | None,
    considered: ConsideredErrors | None = None,
) -> Consistency:
    """Test groups of observations and a-priori values against the rest, and look for steps and offsets.

    Without it nothing names a VLBI clock that is 5 ns off or a station 50 m from its place: residuals and status do not
    show them (`tests/unit/jobs/test_consistency.py`).
    """
    fit = edited.fit
    if not edited.converged or fit.dof < 1 or not (fit.parameters.free.any() and fit.used.any()):
        return Consistency()
    noise_of = (lambda _: {}) if correlation is None else noise_of_each
    problem = BinnedProblem.of(fit, order, noise_of, considered)
    search = _Search(fit, order, epoch_utc, enu_by_parameters, considered, np.unique(problem.code).tolist())
    tested = search.groups(problem)
    groups = tuple(search.named(tried) for tried in tested)
    explained: list[_Tried] = []
    width = len(problem.estimate)
    while len(explained) < _MAX_FINDING_COUNT:
        best = min([*search.explanations(problem), *tested], key=lambda tried: tried.log_chance, default=None)
        if best is None or best.log_chance > math.log(SIGNIFICANCE_LEVEL):
            break
        problem = problem.with_columns(best.columns)
        explained.append(replace(best, verdict=replace(best.verdict, shift=problem.estimate[:width])))
        if not best.components:
            break
        tested = search.groups(problem)
    found = []
    for tried in explained:
        begin, width = width, width + tried.columns.shape[1]
        verdict = replace(tried.verdict, estimate=problem.estimate[begin:width])
        found.append(search.named(replace(tried, verdict=verdict)))
    return Consistency(groups, tuple(found))


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What is tested in a problem."""

    fit: FitResult
    order: SeriesOrder
    epoch_utc: Epochs
    enu_by_parameters: Floats | None
    considered: ConsideredErrors | None
    codes: list[int]  # series of single observations

    def groups(self, problem: BinnedProblem) -> list[_Tried]:
        """The estimate without each group: links, types, stations and their passes."""
        order, width = self.order, mixed_units(self.fit)[1]
        every: dict[tuple[str, str], _Links] = {
            ("link", order.series[code].name): {code: 1.0} for code in self.codes
        }
        for code in self.codes:
            every.setdefault(("type", order.series[code].kind), {})[code] = 1.0
        every |= {("station", name): links for name, links in order.of_stations(self.codes).items()}
        tested: list[tuple[str, str, _Links, tuple[float, float] | None]] = []
        for (kind, name), links in every.items():
            spans = _passes(problem, links) if kind == "station" else []
            if 1 < len(spans) < _MAX_GROUP_COUNT - len(tested):
                tested += [("pass", name, links, span_s) for span_s in spans]
            if len(links) < len(self.codes):
                tested.append((kind, name, links, None))
        return _judged((_of_links(problem, *one, width) for one in tested), len(tested))

    def explanations(self, problem: BinnedProblem) -> list[_Tried]:
        """A-priori values set free; steps and offsets of links, and of stations with several links of one type."""
        order = self.order
        sets = [(order.series[code].name, {code: 1.0}) for code in self.codes]
        for station, links in order.of_stations(self.codes).items():
            for kind in sorted({order.series[code].kind for code in links}):
                some = {
                    code: sign for code, sign in links.items() if sign and order.series[code].kind == kind
                }
                if len(some) > 1:
                    sets.append((f"{station} {kind}", some))
        steps, edges, offsets = [], 0, []
        for name, links in sets:
            edges_s = problem.times_s(links)[_MIN_STEP_POINT_COUNT : 1 - _MIN_STEP_POINT_COUNT]
            edges += len(edges_s)
            if len(edges_s):
                best = int(np.argmax(problem.chi2_of_steps(links, edges_s)))
                steps.append(_of_links(problem, "jump", name, links, (float(edges_s[best]), np.inf)))
            passes = _passes(problem, links)
            spans = (None, *(passes if len(passes) > 1 else ()))
            offsets += [_of_links(problem, "offset", name, links, span_s) for span_s in spans]
        return [*self._wrong_priors(problem), *_judged(steps, edges), *_judged(offsets, len(offsets))]

    def _wrong_priors(self, problem: BinnedProblem) -> list[_Tried]:
        """A-priori values that are set free, each, and all components of one together."""
        known = [item for item in self.fit.parameters if not item.fixed and math.isfinite(item.prior_sigma)]
        known += [] if self.considered is None else self.considered.parameters.parameters
        sets: dict[str, list[int]] = {}
        for place, item in enumerate(known):
            sets[item.name] = [place]
            if item.kind != "position" and item.name.count(".") == 2:  # one of several components
                sets.setdefault(item.name.rpartition(".")[0], []).append(place)
        first, found = len(problem.points.time_s), []
        for places in sets.values():
            columns = np.zeros((len(problem.whitened), len(places)))
            columns[first + np.array(places), np.arange(len(places))] = 1.0
            items = [known[place] for place in places]
            kind, _, of = items[0].name.partition(".")
            whose, _, component = of.partition(".") if kind != "position" else (of, "", "")
            parts = tuple(item.name.rpartition(".")[2] if component else "" for item in items)
            # The residual is the a-priori value less the estimate
            sigmas, name = -np.array([item.prior_sigma for item in items]), f"{kind}.{whose}".rstrip(".")
            found.append(_tried(problem, "a priori", name, columns, parts, sigmas, unit=items[0].unit))
        return _judged(found, len(sets))

    def named(self, tried: _Tried) -> Inconsistency:
        """What was found, with its numbers."""
        shift = sigma = None
        verdict = tried.verdict
        if self.enu_by_parameters is not None:
            units, width = mixed_units(self.fit)
            estimated = self.fit.parameters.free & ~self.fit.parameters.considered
            adjusted = estimated[self.fit.parameters.free]
            by_unit = self.enu_by_parameters[:, np.flatnonzero(estimated)] @ units[adjusted, :width]
            shift = tuple((by_unit @ verdict.shift[:width]).tolist())
            sigma = tuple(np.linalg.norm(by_unit @ verdict.root_of_shift[:width], axis=1).tolist())
        amounts = verdict.estimate * tried.scale if tried.components else np.zeros(0)
        first, last = self._span(tried)
        return Inconsistency(
            tried.kind,
            tried.name,
            verdict.chi2,
            verdict.dof,
            min(tried.log_chance, 0.0) / math.log(10.0),
            shift,
            sigma,
            dict(zip(tried.components, amounts.tolist(), strict=True)),
            tried.unit if tried.components else "",
            first,
            last,
        )

    def _span(self, tried: _Tried) -> tuple[str, str]:
        """First and last epoch, of the observations that are in it."""
        if tried.span_s is None:
            return "", ""
        order, (begin_s, end_s) = self.order, tried.span_s
        rows = np.flatnonzero(self.fit.used & np.isin(order.code, list(tried.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first = int(np.searchsorted(time_s, begin_s))
        if tried.width_s > 0.0:
            near = np.flatnonzero(np.abs(time_s - begin_s) <= 3.0 * tried.width_s)
            signs = np.array([tried.links[code] for code in order.code[rows[near]].tolist()])
            sums = np.cumsum(signs * self.fit.residual_m[rows[near]])
            before = np.arange(1, len(near))
            steps = (sums[:-1] - before * sums[-1] / len(near)) ** 2 / (before * (len(near) - before))
            first = int(near[1 + int(np.argmax(steps))])
        last = int(np.searchsorted(time_s, end_s, side="right")) - 1
        epochs = utc_strings(self.epoch_utc[rows[[first, last]]], decimals=0)
        return str(epochs[0]), "" if math.isinf(end_s) else str(epochs[1])


def _of_links(
    problem: BinnedProblem,
    kind: str,
    name: str,
    links: _Links,
    span_s: tuple[float, float] | None,
    parameters: int = 0,
) -> _Tried | None:
    """Links in a span of time with parameters of their own, or with a constant."""
    columns = problem.columns(links, span_s or (-np.inf, np.inf), parameters)
    components, width_s = () if parameters else ("",), problem.width_s(links) if kind == "jump" else 0.0
    return _tried(problem, kind, name, columns, components, links=links, span_s=span_s, width_s=width_s)


def _tried(
    problem: BinnedProblem,
    kind: str,
    name: str,
    columns: Floats,
    components: tuple[str, ...],
    scale: float | Floats = 1.0,
    **more: Any,
) -> _Tried | None:
    """What a test says of columns; none where nothing is told."""
    length = float(np.linalg.norm(columns))
    verdict = problem.test(columns / max(length, 1e-300), more.get("links"))
    if verdict is None:
        return None
    return _Tried(
        kind, name, columns / length, verdict, components, np.ones(len(components)) * scale / length, **more
    )


def _judged(tried: Iterable[_Tried | None], count: int) -> list[_Tried]:
    """With their chances, so many having been tried in each family."""
    every = math.log(TEST_FAMILY_COUNT * max(count, 1))
    return [replace(one, log_chance=one.verdict.log_chance + every) for one in tried if one is not None]


def _passes(problem: BinnedProblem, links: Iterable[int]) -> list[tuple[float, float]]:
    """Begin and end of the passes of some links."""
    time_s = problem.times_s(links)
    gaps = np.flatnonzero(np.diff(time_s) > 3600.0 * PASS_GAP_H)
    begin, end = np.append(0, gaps + 1), np.append(gaps, len(time_s) - 1)
    return list(zip(time_s[begin].tolist(), time_s[end].tolist(), strict=True))
