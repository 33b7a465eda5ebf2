"""Hypotheses on the errors of a fit: columns that are added to its design matrix.

1. A wrong a-priori value, of an estimated or of a considered parameter: of one, of all components of a vector, and a
   common error of all members of a kind.
2. A parameter that the fit holds at zero, of any kind of one component: of one member, common to all, or common to
   the observations of one type. A term of the model that is switched off.
3. An offset of a link, or of a station in all its links of a type, in one pass or in the whole arc.
4. A step of such a link or station at an epoch.
5. Accelerations of an orbit, constant in intervals, that its forces lack: together, as gravity has many periods.

A coefficient counts a-priori standard deviations; where none is stated or usual, the scale of the parameter, which
changes an observation by about one metre, or one metre.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from radioloc.constants import C_M_S
from radioloc.estimation.consider import NO_ERRORS, UnestimatedErrors, owner
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.group_tests import BinnedProblem, ScoreProducts, noise_of_each
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import mixed_units
from radioloc.labels import USED
from radioloc.measurements.registry import KINDS, is_differenced, is_integrated
from radioloc.noise.whitening import Rows
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.vectors import Floats

if TYPE_CHECKING:  # which takes time to import
    from scipy.sparse import csc_array

Links = dict[int, float]
"""Indices of series, with the sign that the tested quantity has in each."""
Span = tuple[float, float] | None

_MIN_READMITTED_FRACTION = 0.5  # of a series: robust editing presupposes that the majority is right
_MIN_STEP_POINT_COUNT = 3  # points required on either side of a step
_MAX_BATCH_ELEMENTS = 2**22  # of columns that are tested at once, 32 MB
TERM = "term"
"""Kind of a term that is switched off."""
FORCES = "forces"
"""Kind of accelerations of an orbit that its forces lack."""
ALL = "all"
"""Owner of an error that is common to all members of a kind."""


class Family(Enum):
    """Family of hypotheses; each has an equal share of the significance level."""

    GROUP = "group"
    STATED_PRIOR = "stated a-priori value"
    CONSIDERED_PRIOR = "a-priori value of a considered parameter"
    PARAMETER = "parameter that the fit holds at zero"
    STEP = "step"
    OFFSET = "offset"


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Error that adds columns to a binned problem of n points and k a-priori values."""

    family: Family
    kind: str  # "a priori", "parameter", "jump" or "offset"
    name: str  # parameter, or link or station with its type
    columns: csc_array  # (n + k, w), change of the residuals by one of `sigmas` of each component
    sigmas: Floats  # (w,), a-priori standard deviations or scales, in `unit`
    unit: str
    components: tuple[str, ...] = ("",)
    prior_values: Floats | None = None  # (w,), stated a-priori values, in `unit`
    links: Links = field(default_factory=dict)
    span_s: Span = None  # interval of an offset; begin of a step

    @property
    def member(self) -> str:
        """Station, link, type or :data:`ALL` that a parameter belongs to; empty for other errors."""
        return self.name.partition(".")[2]

    @property
    def is_of_published_model(self) -> bool:
        """Return whether the error is one of the Moon's ephemeris or of the Earth's rotation."""
        kind = PARAMETERS.get(self.name.partition(".")[0])
        return kind is not None and not kind.scopes[0].named


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses of a fit on its binned problem."""

    problem: BinnedProblem
    fitted: BinnedProblem  # with the weights of the fit
    fit: FitResult
    order: SeriesOrder
    considered: UnestimatedErrors
    candidates: UnestimatedErrors  # parameters that the fit holds at zero
    codes: tuple[int, ...]  # indices of all series
    count_s: Floats | None = None  # (n,), count intervals
    readmitted_runs: tuple[Rows, ...] = ()  # runs of outliers that are observations of the problem

    @classmethod
    def from_fit(
        cls,
        edited: EditedFit,
        order: SeriesOrder,
        correlation: TimeCorrelation | None,
        considered: UnestimatedErrors = NO_ERRORS,
        candidates: UnestimatedErrors = NO_ERRORS,
        count_s: Floats | None = None,
        runs: Iterable[Rows] = (),
    ) -> Hypotheses | None:
        """Bin a fit; None without an estimate or redundancy.

        Runs of outliers that are most of a series may be right, and are observations of the problem.
        """
        fit = edited.fit
        used = edited.fit.used.copy()
        readmitted_runs = tuple(_majority_runs(edited, order, runs))
        for rows in readmitted_runs:
            used[rows] = True
        if not fit.converged or fit.dof < 1 or not (fit.parameters.free.any() and fit.used.any()):
            return None
        noise_of = (lambda _: {}) if correlation is None else noise_of_each
        fit = replace(fit, used=used)
        problem = BinnedProblem.from_fit(fit, order, noise_of, considered, candidates)
        codes = tuple(np.unique(problem.code).tolist())
        fitted = problem if edited.series_weights or readmitted_runs else replace(problem, roots=())
        return cls(problem, fitted, fit, order, considered, candidates, codes, count_s, readmitted_runs)

    @cached_property
    def units(self) -> tuple[Floats, int]:
        """Parameters by those of the binned problem, and the number of the latter, without considered ones."""
        return mixed_units(self.fit)

    @cached_property
    def continuous(self) -> tuple[Hypothesis, ...]:
        """All hypotheses but the steps, whose epochs depend on the residuals."""
        return (*self._wrong_priors(), *self._parameters(), *self._offsets())

    def run(self, rows: Rows) -> Hypothesis:
        """Return the hypothesis of an offset of a run of observations of one series."""
        code, time_s = int(self.order.code[rows[0]]), self.order.time_s[rows]
        name, span_s = self.order.series[code].name, (float(time_s.min()), float(time_s.max()))
        return self._constant(Family.OFFSET, "offset", name, {code: 1.0}, span_s)

    def step_epochs_s(self, links: Links) -> Floats:
        """Epochs at which a step is tested, s, (w,)."""
        return self.problem.times_s(links)[_MIN_STEP_POINT_COUNT : 1 - _MIN_STEP_POINT_COUNT]

    def step(self, name: str, links: Links, begin_s: float) -> Hypothesis:
        """Return the hypothesis of a step at an epoch."""
        return self._constant(Family.STEP, "jump", name, links, (begin_s, np.inf))

    @cached_property
    def link_sets(self) -> list[tuple[str, Links]]:
        """Links, and stations with several links of a type, with their names."""
        order = self.order
        link_sets = [(order.series[code].name, {code: 1.0}) for code in self.codes]
        for station, links in order.of_stations(self.codes).items():
            for kind in sorted({order.series[code].kind for code in links}):
                station_links = {
                    code: sign for code, sign in links.items() if sign and order.series[code].kind == kind
                }
                if len(station_links) > 1:
                    link_sets.append((f"{station} {kind}", station_links))
        return link_sets

    def _constant(self, family: Family, kind: str, name: str, links: Links, span_s: Span) -> Hypothesis:
        unit, factor, sigma = self._unit(links)
        columns = self.problem.columns(links, span_s or (-np.inf, np.inf)) * (factor * sigma)
        sigmas = np.array([sigma])
        return Hypothesis(family, kind, name, columns, sigmas, unit, links=links, span_s=span_s)

    def _unit(self, links: Links) -> tuple[str, float, float]:
        """Return the unit of an error of one type, metres in it, and its sigma: of a bias, or 1 m or 1 mm/s."""
        code = next(iter(links))
        series = self.order.series[code]
        kind = np.array(KINDS.index(series.kind))
        if is_integrated(kind) and self.count_s is not None:
            return "mm/s", 1e-3 * float(np.nanmedian(self.count_s[self.order.code == code])), 1.0
        if is_differenced(kind):
            return "s", C_M_S, 1.0 / C_M_S
        owners = (series.path, *(name for name, sign in series.signs.items() if sign))
        return "m", 1.0, min(self._range_bias_sigmas_m.get(name, 1.0) for name in owners)

    @cached_property
    def _range_bias_sigmas_m(self) -> dict[str, float]:
        """A-priori or usual sigmas of range biases by station or link."""
        errors = self.considered.parameters, self.candidates.parameters
        items = (item for parameters in (self.fit.parameters, *errors) for item in parameters)
        return {
            owner(item): item.prior_sigma
            for item in items
            if item.kind == "range_bias" and math.isfinite(item.prior_sigma)
        }

    def _offsets(self) -> Iterator[Hypothesis]:
        """Yield offsets of links and stations in the arc, and in each of several passes."""
        for name, links in self.link_sets:
            spans = pass_spans_s(self.problem, links)
            for span_s in (None, *(spans if len(spans) > 1 else ())):
                yield self._constant(Family.OFFSET, "offset", name, links, span_s)

    def _wrong_priors(self) -> Iterator[Hypothesis]:
        """Yield errors of a-priori values."""
        parameters = self.fit.parameters
        priors = [item for item in parameters if not item.fixed and math.isfinite(item.prior_sigma)]
        priors += self.considered.parameters
        first, places = len(self.problem.points.time_s), dict[str, list[int]]()
        common = dict[tuple[str, str], list[int]]()
        for index, item in enumerate(priors):
            places[item.name] = [index]
            if item.kind == "position":
                continue
            if item.name.count(".") == 2:  # component of a vector
                places.setdefault(item.name.rpartition(".")[0], []).append(index)
                if item.name.endswith(".up"):  # heights above another surface
                    common.setdefault((item.kind, f"{ALL}.up"), []).append(index)
            elif item.kind in PARAMETERS and len(PARAMETERS[item.kind].components) == 1:
                common.setdefault((item.kind, ALL), []).append(index)
                if item.span_utc is not None:
                    common.setdefault((item.kind, owner(item)), []).append(index)
        for indices in places.values():
            # The residual of an a-priori value is that value less the estimate, over its sigma.
            columns = self.problem.sparse(first + np.array(indices), -np.eye(len(indices)))
            yield self._wrong_prior([priors[index] for index in indices], columns)
        for (kind, member), indices in common.items():
            if len(indices) > 1:
                sigmas = np.array([priors[index].prior_sigma for index in indices])
                columns = self.problem.sparse(first + np.array(indices), (-sigmas.max() / sigmas)[:, None])
                role, unit = priors[indices[0]].role, priors[indices[0]].unit
                yield Hypothesis(
                    _prior_family(role),
                    "a priori",
                    f"{kind}.{member}",
                    columns,
                    sigmas.max(keepdims=True),
                    unit,
                )

    def _wrong_prior(self, items: list[Parameter], columns: csc_array) -> Hypothesis:
        """Return the error of the a-priori value of a parameter, or of several components of a vector."""
        kind, _, label = items[0].name.partition(".")
        name, _, component = label.partition(".") if kind != "position" else (label, "", "")
        return Hypothesis(
            _prior_family(items[0].role),
            "a priori",
            f"{kind}.{name}".rstrip("."),
            columns,
            np.array([item.prior_sigma for item in items]),
            items[0].unit,
            tuple(item.name.rpartition(".")[2] if component else "" for item in items),
            np.array([item.prior_value for item in items]),
        )

    def _parameters(self) -> Iterator[Hypothesis]:
        """Yield errors of parameters that the fit holds at zero."""
        from scipy.sparse import csc_array

        groups = dict[str, list[int]]()
        for index, item in enumerate(self.candidates.parameters):
            groups.setdefault(item.kind, []).append(index)
        types = {self.order.series[code].kind for code in self.codes}
        for kind, indices in groups.items():
            items = [self.candidates.parameters.parameters[index] for index in indices]
            if kind == FORCES:
                columns = self.problem.candidate_columns(indices)
                yield Hypothesis(Family.PARAMETER, FORCES, FORCES, columns, np.ones(len(items)), "1", ())
                continue
            for index, item in zip(indices, items, strict=True):
                name = item.name if kind == TERM else f"{kind}.{owner(item)}".rstrip(".")
                yield _fixed_parameter_hypothesis(name, self.problem.candidate_columns([index]), item)
            if kind == TERM or (len(items) == 1 and len(types) == 1):
                continue
            of_types = dict[str, csc_array]()
            for name in sorted(types):
                codes = [code for code in self.codes if self.order.series[code].kind == name]
                columns = self.problem.candidate_columns(indices, codes)
                if columns.nnz:
                    of_types[name] = csc_array(columns.sum(axis=1)[:, None])
            if of_types and len(items) > 1:
                first_type, *further_types = of_types.values()
                columns = sum(further_types, first_type)
                yield _fixed_parameter_hypothesis(f"{kind}.{ALL}", columns, items[0])
            if len(of_types) > 1:
                for name, columns in of_types.items():
                    yield _fixed_parameter_hypothesis(f"{kind}.{name}", columns, items[0])


def _majority_runs(edited: EditedFit, order: SeriesOrder, runs: Iterable[Rows]) -> Iterator[Rows]:
    """Yield the runs of outliers of series in which they are the majority of the usable observations."""
    usable = np.bincount(order.code[edited.initial_status.are(USED)], minlength=len(order.series))
    runs = list(runs)
    outliers = np.zeros(len(order.series))
    for rows in runs:
        outliers[order.code[rows[0]]] += len(rows)
    for rows in runs:
        code = order.code[rows[0]]
        if outliers[code] > _MIN_READMITTED_FRACTION * usable[code]:
            yield rows


def _fixed_parameter_hypothesis(name: str, columns: csc_array, item: Parameter) -> Hypothesis:
    return Hypothesis(Family.PARAMETER, "parameter", name, columns, np.array([item.prior_sigma]), item.unit)


def _prior_family(role: Role) -> Family:
    return Family.CONSIDERED_PRIOR if role is Role.CONSIDERED else Family.STATED_PRIOR


def hypothesis_products(
    problem: BinnedProblem, hypotheses: Sequence[Hypothesis], common: Hypothesis | None = None
) -> Iterator[tuple[Hypothesis, ScoreProducts, slice]]:
    """Yield hypotheses, products of columns of some of them, and the slice of their columns in the products.

    The columns of a `common` hypothesis come first in all products.
    """
    from scipy.sparse import hstack

    at_once, first = _MAX_BATCH_ELEMENTS // problem.whitened.shape[0], [] if common is None else [common]
    ends = np.cumsum([item.columns.shape[1] for item in hypotheses])
    for _, batch in groupby(
        zip(hypotheses, ends.tolist(), strict=True), lambda pair: pair[1] // (1 + at_once)
    ):
        items = [*first, *(item for item, _ in batch)]
        products, begin = problem.products(hstack([item.columns for item in items], format="csc")), 0
        for place, item in enumerate(items):
            indices = slice(begin, begin := begin + item.columns.shape[1])
            if place >= len(first):
                yield item, products, indices


def pass_spans_s(problem: BinnedProblem, links: Iterable[int]) -> list[tuple[float, float]]:
    """Begin and end of each pass of some links, s."""
    time_s = problem.times_s(links)
    gaps = np.flatnonzero(np.diff(time_s) > 3600.0 * PASS_GAP_H)
    begin, end = np.append(0, gaps + 1), np.append(gaps, len(time_s) - 1)
    return list(zip(time_s[begin].tolist(), time_s[end].tolist(), strict=True))
