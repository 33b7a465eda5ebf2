"""Consistency tests: agreement of groups of observations and a-priori values with the other data.

1. Each group (station, link, pass or type) is removed by additional parameters that absorb it. The test compares the
   estimates with and without the group.
2. Explanations are tested by :mod:`~radioloc.estimation.group_tests`: a wrong a-priori value of a bias or a consider
   parameter, a step of a link or station at the most likely epoch, an offset of a link in one pass or in all.
3. The most significant explanation becomes a parameter, and the tests are repeated until none is significant.

Probabilities are multiplied by the number of tests (Bonferroni correction).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.estimation.adaptation import AdaptedEstimate, adapted_estimate
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.group_tests import BinnedProblem, Verdict, log_probability, noise_of_each
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import mixed_units
from radioloc.noise.whitening import Rows
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.parameters.registry import parameter_label
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_Links = dict[int, float]
"""Indices of series, with the sign that the tested quantity has in each."""

SIGNIFICANCE_LEVEL = 1e-3  # fewer than one false finding in a thousand solutions
TEST_FAMILY_COUNT = 4  # families tested together: groups, a-priori values, steps, offsets
_MAX_FINDING_COUNT = 3  # further findings are mostly consequences of the first
_MAX_GROUP_COUNT = 200  # bounds the time for long arcs of many passes
_MIN_STEP_POINT_COUNT = 3  # points required on either side of a step


@dataclass(frozen=True, slots=True)
class Inconsistency:
    """Consistency test of a group of observations or of an explanation, with its result."""

    # Removed: "station", "link", "type", "pass"; estimated: "a priori", "jump", "offset"; rejected: "run".
    kind: str
    name: str  # station, link, type or parameter that is tested
    chi2: float  # test statistic
    dof: int
    log10_chance: float  # log10 of the p-value, corrected for the number of tests
    shift_enu_m: tuple[float, float, float] | None  # change of the position by the removal or estimation
    shift_sigma_enu_m: tuple[float, float, float] | None  # standard deviation of that change
    amounts: dict[str, float]  # estimated components, in `unit`
    unit: str = ""
    first_utc: str = ""  # epochs of the interval, empty for the whole arc
    last_utc: str = ""

    @property
    def significant(self) -> bool:
        """True if the p-value is below the significance level."""
        return self.log10_chance < math.log10(SIGNIFICANCE_LEVEL)

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; a significant test has a sentence as ``text``."""
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
        period = f" from {self.first_utc} to {self.last_utc}" if self.last_utc else ""
        sentence = f"{self.name}{period} does not fit the others"
        value = next(iter(self.amounts.values()), 0.0)
        if self.kind == "jump":
            sentence = f"{self.name} jumps by {_length(value)} at {self.first_utc}"
        elif self.kind == "offset":
            sentence = f"{self.name} is off by {_length(value)}{period}"
        elif self.kind == "run":
            sentence = f"{self.dof} observations of {self.name}{period} are off by {value:+.3g} {self.unit}, rejected"
        elif self.kind == "a priori":
            sentence = self._wrong_prior()
        if self.shift_enu_m is None:
            return sentence
        condition = "with that" if self.amounts else "without it"
        return f"{sentence}; {condition} the position moves by {math.hypot(*self.shift_enu_m):.3g} m"

    def _wrong_prior(self) -> str:
        kind, _, label = self.name.partition(".")
        parts = " ".join(
            f"{value:+.3g} {self.unit}{f' {name}' if name else ''}".replace("  ", " ")
            for name, value in self.amounts.items()
        )
        if kind == "position":
            return f"the a-priori {label} does not fit the observations ({parts} explains it)"
        return (
            f"the a-priori {parameter_label(self.name)} does not fit the observations ({parts} explains it)"
        )


def _length(value_m: float) -> str:
    return f"{value_m:+.3g} m ({1e9 * value_m / C_M_S:+.3g} ns)"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Results of the consistency tests of a fit."""

    groups: tuple[Inconsistency, ...] = ()  # tests of all groups, significant or not
    found: tuple[Inconsistency, ...] = ()  # significant tests, each with the preceding ones as parameters
    adapted: AdaptedEstimate | None = None  # estimate with the findings as parameters; None without findings

    def __repr__(self) -> str:
        return f"<Consistency of {len(self.groups)} groups, {len(self.found)} finding(s)>"

    def to_list(self) -> list[dict[str, Any]]:
        """Return findings and groups in types of JSON."""
        return [item.to_dict() for item in (*self.found, *self.groups)]


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """Test of added columns of the design matrix."""

    kind: str
    name: str
    columns: Floats  # scaled to a Frobenius norm of one
    verdict: Verdict
    components: tuple[str, ...]  # names of the amounts; empty if a group is removed
    scale: Floats  # factors from estimates to amounts
    unit: str = "m"
    span_s: tuple[float, float] | None = None  # interval of the columns
    links: _Links = field(default_factory=dict)
    width_s: float = 0.0  # width of the bins that resolve a step
    log_chance: float = 0.0  # logarithm of the corrected p-value


def assess_consistency(
    edited: EditedFit,
    order: SeriesOrder,
    correlation: TimeCorrelation | None,
    epoch_utc: Epochs,
    enu_by_parameters: Floats | None,
    considered: ConsideredErrors | None = None,
) -> Consistency:
    """Test groups of observations, a-priori values, steps and offsets.

    Without it a VLBI clock error of 5 ns or a station error of 50 m stays unreported: residuals and status do not show
    them (`tests/unit/jobs/test_consistency.py`).
    """
    fit = edited.fit
    if not edited.converged or fit.dof < 1 or not (fit.parameters.free.any() and fit.used.any()):
        return Consistency()
    noise_of = (lambda _: {}) if correlation is None else noise_of_each
    problem = BinnedProblem.of(fit, order, noise_of, considered)
    search = _Candidates(
        fit, order, epoch_utc, enu_by_parameters, considered, np.unique(problem.code).tolist()
    )
    group_tests = search.groups(problem)
    groups = tuple(search.record(test) for test in group_tests)
    explanations: list[_Test] = []
    width = len(problem.estimate)
    while len(explanations) < _MAX_FINDING_COUNT:
        finding = min(
            [*search.explanations(problem), *group_tests], key=lambda test: test.log_chance, default=None
        )
        if finding is None or finding.log_chance > math.log(SIGNIFICANCE_LEVEL):
            break
        problem = problem.with_columns(finding.columns)
        explanations.append(
            replace(finding, verdict=replace(finding.verdict, shift=problem.estimate[:width]))
        )
        if not finding.components:
            break
        group_tests = search.groups(problem)
    findings = []
    for test in explanations:
        begin, width = width, width + test.columns.shape[1]
        verdict = replace(test.verdict, estimate=problem.estimate[begin:width])
        findings.append(search.record(replace(test, verdict=verdict)))
    return Consistency(groups, tuple(findings), adapted_estimate(problem, fit) if findings else None)


def rejected_runs(
    edited: EditedFit,
    order: SeriesOrder,
    runs: Iterable[Rows],
    epoch_utc: Epochs,
    count_s: Floats | None,
) -> Iterator[Inconsistency]:
    """Yield a finding for each run of outliers; its amount is the mean residual, of counts in mm/s."""
    for rows in runs:
        residual_m, unit = edited.fit.residual_m[rows], "m"
        chi2 = float(np.square(residual_m / edited.fit.sigma_m[rows]).sum())
        if count_s is not None and np.isfinite(count_s[rows]).all():
            residual_m, unit = 1e3 * residual_m / count_s[rows], "mm/s"
        first_utc, last_utc = utc_strings(epoch_utc[rows[[0, -1]]], decimals=0)
        yield Inconsistency(
            "run",
            order.series[order.code[rows[0]]].name,
            chi2,
            len(rows),
            log_probability(chi2, len(rows)) / math.log(10.0),
            None,
            None,
            {"": float(residual_m.mean())},
            unit,
            str(first_utc),
            str(last_utc),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Candidates for tests, with the fit that they belong to."""

    fit: FitResult
    order: SeriesOrder
    epoch_utc: Epochs
    enu_by_parameters: Floats | None
    considered: ConsideredErrors | None
    codes: list[int]  # indices of all series

    def groups(self, problem: BinnedProblem) -> list[_Test]:
        """Test the removal of each link, type, station and pass of a station."""
        order, width = self.order, mixed_units(self.fit)[1]
        groups: dict[tuple[str, str], _Links] = {
            ("link", order.series[code].name): {code: 1.0} for code in self.codes
        }
        for code in self.codes:
            groups.setdefault(("type", order.series[code].kind), {})[code] = 1.0
        groups |= {("station", name): links for name, links in order.of_stations(self.codes).items()}
        selections: list[tuple[str, str, _Links, tuple[float, float] | None]] = []
        for (kind, name), links in groups.items():
            spans = _passes(problem, links) if kind == "station" else []
            if 1 < len(spans) < _MAX_GROUP_COUNT - len(selections):
                selections += [("pass", name, links, span_s) for span_s in spans]
            if len(links) < len(self.codes):
                selections.append((kind, name, links, None))
        return _with_chances(
            (_test_links(problem, *selection, width) for selection in selections), len(selections)
        )

    def explanations(self, problem: BinnedProblem) -> list[_Test]:
        """Test a-priori values, and steps and offsets of links and of stations with several links of a type."""
        order = self.order
        link_sets = [(order.series[code].name, {code: 1.0}) for code in self.codes]
        for station, links in order.of_stations(self.codes).items():
            for kind in sorted({order.series[code].kind for code in links}):
                station_links = {
                    code: sign for code, sign in links.items() if sign and order.series[code].kind == kind
                }
                if len(station_links) > 1:
                    link_sets.append((f"{station} {kind}", station_links))
        steps, edge_count, offsets = [], 0, []
        for name, links in link_sets:
            edges_s = problem.times_s(links)[_MIN_STEP_POINT_COUNT : 1 - _MIN_STEP_POINT_COUNT]
            edge_count += len(edges_s)
            if len(edges_s):
                index = int(np.argmax(problem.chi2_of_steps(links, edges_s)))
                steps.append(_test_links(problem, "jump", name, links, (float(edges_s[index]), np.inf)))
            passes = _passes(problem, links)
            spans = (None, *(passes if len(passes) > 1 else ()))
            offsets += [_test_links(problem, "offset", name, links, span_s) for span_s in spans]
        return [
            *self._wrong_priors(problem),
            *_with_chances(steps, edge_count),
            *_with_chances(offsets, len(offsets)),
        ]

    def _wrong_priors(self, problem: BinnedProblem) -> list[_Test]:
        """Test each a-priori value, and all components of a vector together."""
        priors = [item for item in self.fit.parameters if not item.fixed and math.isfinite(item.prior_sigma)]
        priors += [] if self.considered is None else self.considered.parameters.parameters
        name_places: dict[str, list[int]] = {}
        for index, item in enumerate(priors):
            name_places[item.name] = [index]
            if item.kind != "position" and item.name.count(".") == 2:  # component of a vector
                name_places.setdefault(item.name.rpartition(".")[0], []).append(index)
        first, tests = len(problem.points.time_s), []
        for indices in name_places.values():
            columns = np.zeros((len(problem.whitened), len(indices)))
            columns[first + np.array(indices), np.arange(len(indices))] = 1.0
            items = [priors[index] for index in indices]
            kind, _, label = items[0].name.partition(".")
            owner, _, component = label.partition(".") if kind != "position" else (label, "", "")
            parts = tuple(item.name.rpartition(".")[2] if component else "" for item in items)
            # The residual is the a-priori value less the estimate
            sigmas, name = -np.array([item.prior_sigma for item in items]), f"{kind}.{owner}".rstrip(".")
            tests.append(_test_columns(problem, "a priori", name, columns, parts, sigmas, unit=items[0].unit))
        return _with_chances(tests, len(name_places))

    def record(self, test: _Test) -> Inconsistency:
        """Return the record of a test."""
        shift_m = sigma_m = None
        verdict = test.verdict
        if self.enu_by_parameters is not None:
            units, width = mixed_units(self.fit)
            estimated = self.fit.parameters.free & ~self.fit.parameters.considered
            adjusted = estimated[self.fit.parameters.free]
            by_unit = self.enu_by_parameters[:, np.flatnonzero(estimated)] @ units[adjusted, :width]
            shift_m = tuple((by_unit @ verdict.shift[:width]).tolist())
            sigma_m = tuple(np.linalg.norm(by_unit @ verdict.root_of_shift[:width], axis=1).tolist())
        amounts = verdict.estimate * test.scale if test.components else np.zeros(0)
        first, last = self._span(test)
        return Inconsistency(
            test.kind,
            test.name,
            verdict.chi2,
            verdict.dof,
            min(test.log_chance, 0.0) / math.log(10.0),
            shift_m,
            sigma_m,
            dict(zip(test.components, amounts.tolist(), strict=True)),
            test.unit if test.components else "",
            first,
            last,
        )

    def _span(self, test: _Test) -> tuple[str, str]:
        """First and last epoch, UTC, of the observations in the interval of a test."""
        if test.span_s is None:
            return "", ""
        order, (begin_s, end_s) = self.order, test.span_s
        rows = np.flatnonzero(self.fit.used & np.isin(order.code, list(test.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first_row = int(np.searchsorted(time_s, begin_s))
        if test.width_s > 0.0:
            near_rows = np.flatnonzero(np.abs(time_s - begin_s) <= 3.0 * test.width_s)
            signs = np.array([test.links[code] for code in order.code[rows[near_rows]].tolist()])
            sums = np.cumsum(signs * self.fit.residual_m[rows[near_rows]])
            counts = np.arange(1, len(near_rows))
            steps = (sums[:-1] - counts * sums[-1] / len(near_rows)) ** 2 / (
                counts * (len(near_rows) - counts)
            )
            first_row = int(near_rows[1 + int(np.argmax(steps))])
        last_row = int(np.searchsorted(time_s, end_s, side="right")) - 1
        epochs = utc_strings(self.epoch_utc[rows[[first_row, last_row]]], decimals=0)
        return str(epochs[0]), "" if math.isinf(end_s) else str(epochs[1])


def _test_links(
    problem: BinnedProblem,
    kind: str,
    name: str,
    links: _Links,
    span_s: tuple[float, float] | None,
    parameters: int = 0,
) -> _Test | None:
    """Test links in an interval with a constant, or with parameters that absorb them."""
    columns = problem.columns(links, span_s or (-np.inf, np.inf), parameters)
    components, width_s = () if parameters else ("",), problem.width_s(links) if kind == "jump" else 0.0
    return _test_columns(
        problem, kind, name, columns, components, links=links, span_s=span_s, width_s=width_s
    )


def _test_columns(
    problem: BinnedProblem,
    kind: str,
    name: str,
    columns: Floats,
    components: tuple[str, ...],
    scale: float | Floats = 1.0,
    **options: Any,
) -> _Test | None:
    """Test columns; None if the parameters absorb them."""
    length = float(np.linalg.norm(columns))
    verdict = problem.test(columns / max(length, 1e-300), options.get("links"))
    if verdict is None:
        return None
    return _Test(
        kind,
        name,
        columns / length,
        verdict,
        components,
        np.ones(len(components)) * scale / length,
        **options,
    )


def _with_chances(tests: Iterable[_Test | None], count: int) -> list[_Test]:
    """Return tests with p-values corrected for the number of tests."""
    log_count = math.log(TEST_FAMILY_COUNT * max(count, 1))
    return [
        replace(test, log_chance=test.verdict.log_chance + log_count) for test in tests if test is not None
    ]


def _passes(problem: BinnedProblem, links: Iterable[int]) -> list[tuple[float, float]]:
    """Begin and end of each pass of some links, s."""
    time_s = problem.times_s(links)
    gaps = np.flatnonzero(np.diff(time_s) > 3600.0 * PASS_GAP_H)
    begin, end = np.append(0, gaps + 1), np.append(gaps, len(time_s) - 1)
    return list(zip(time_s[begin].tolist(), time_s[end].tolist(), strict=True))
