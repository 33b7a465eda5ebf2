"""Consistency tests: detection and identification of gross errors (Baarda 1968; Teunissen 1990).

1. Detection. Columns Z that are added to the design matrix remove a group of observations (station, link, type, pass)
   from the fit, or describe an error (:mod:`~radioloc.estimation.hypotheses`). Without the error, the test statistic
   T = s^T F^-1 s of :mod:`~radioloc.estimation.group_tests` is chi-square of q = rank F degrees of freedom. Its p-value
   is multiplied by the number of tests (Bonferroni correction).
2. Identification. The error with the smallest p-value is tested again with the noise of the residuals after its
   estimation, since noise from residuals that contain a large error hides it. T/q then follows Fisher's distribution
   with q and f degrees of freedom, f of the noise.
3. Separability (Foerstner 1983). Another error Z_2 remains possible if T(Z, Z_2) - T(Z_2) is not significant. Of the
   possible errors, that of the largest odds is named first, the others are its alternatives.
4. Adaptation. Z becomes part of the design matrix, and steps 1 to 3 are repeated until no test is significant.

References: Baarda (1968), A testing procedure for use in geodetic networks; Foerstner (1983), Reliability and
discernability of extended Gauss-Markov models; Teunissen (1990), Quality control in integrated navigation systems.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from radioloc.estimation.adaptation import adapted_estimate
from radioloc.estimation.consistency_results import SIGNIFICANCE_LEVEL, Consistency, ConsistencyTest
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.group_tests import (
    BinnedProblem,
    ScoreProducts,
    ScoreTest,
    chi2_log_p_value,
    estimate_change,
    f_log_p_value,
)
from radioloc.estimation.hypotheses import (
    ALL,
    FORCES,
    Family,
    Hypotheses,
    Hypothesis,
    Links,
    Span,
    passes,
    products_of,
)
from radioloc.estimation.reliability import assess_reliability
from radioloc.estimation.series import SeriesOrder
from radioloc.noise.whitening import Rows
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_LOG_SIGNIFICANCE_LEVEL = math.log(SIGNIFICANCE_LEVEL)
_LOG_SEPARABILITY_LEVEL = math.log(1e-3)  # excludes one right cause in a thousand
_MAX_FINDING_COUNT = 3  # further findings are mostly consequences of the first
_MAX_GROUP_COUNT = 200  # bounds the time for long arcs of many passes
_MAX_ROUND_COUNT = 3  # of noise and most significant error, each computed from the other
_MIN_SQUARED_CORRELATION = 1.0 - 1e-6  # above which two columns describe the same error
_ERROR_KINDS = ("a priori", "parameter", "offset", "jump", FORCES)  # of errors, the more specific first
_log_p_value = attrgetter("log_p_value")


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """Hypothesis, or removal of a group, with its test."""

    hypothesis: Hypothesis
    score_test: ScoreTest
    test_count: int  # number of tests in its family
    log_p_value: float  # corrected for the number of tests
    alternatives: tuple[_Candidate, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.hypothesis.columns.shape[1])

    @property
    def is_group(self) -> bool:
        """True for the removal of a group of observations."""
        return self.hypothesis.family is Family.GROUP

    @property
    def sigmas(self) -> float:
        """Amount over the a-priori standard deviation; infinite for a group."""
        return math.inf if self.is_group else float(np.linalg.norm(self.score_test.estimate))


def assess_consistency(
    hypotheses: Hypotheses | None,
    epoch_utc: Epochs,
    enu_partials: Floats | None,
    runs: Sequence[ConsistencyTest] = (),
    state_partials: Floats | None = None,
) -> Consistency:
    """Search for gross errors, and assess the smallest errors that the search detects (reliability).

    `enu_partials` (3, p) are those of the position, None for a moving target; `state_partials` those of the position in
    an orbit, for its reliability; `runs` the findings on runs of outliers. Without the search, a VLBI clock error
    of 5 ns or a station error of 50 m stays unreported (`tests/unit/jobs/test_consistency.py`).
    """
    if hypotheses is None:
        return Consistency(findings=tuple(runs))
    problem = hypotheses.problem
    search = _GrossErrorSearch(hypotheses, epoch_utc, _to_problem_units(enu_partials, hypotheses))
    group_tests = search.test_groups(problem)
    groups = tuple(map(search.record, group_tests))

    findings: list[_Candidate] = []
    while len(findings) < _MAX_FINDING_COUNT:
        finding = search.find_most_significant(problem, group_tests)
        if finding is None or finding.log_p_value >= _LOG_SIGNIFICANCE_LEVEL:
            break
        findings.append(finding)
        problem = problem.with_columns(finding.hypothesis.columns)
        if finding.is_group or finding.hypothesis.kind == FORCES:
            break  # the residuals of other groups may follow from this error
        group_tests = search.test_groups(problem)

    counts = Counter(item.family for item in hypotheses.continuous)
    log_levels = {
        family: _LOG_SIGNIFICANCE_LEVEL - _log_test_count(count) for family, count in counts.items()
    }
    reliability = assess_reliability(
        hypotheses.problem.with_noise_of(problem) if findings else problem,
        hypotheses.continuous,
        log_levels,
        _to_problem_units(enu_partials if state_partials is None else state_partials, hypotheses),
    )
    if findings and all(map(search.is_rejected_series, findings)):
        return Consistency(groups, tuple(runs), None, reliability)  # the rejection corrects the error
    explained_runs = {
        search.run_key(rows)
        for rows in hypotheses.readmitted
        if findings and not search.is_run_significant(problem, rows)
    }
    other_runs = (item for item in runs if (item.name, item.first_utc) not in explained_runs)
    records = tuple(search.joint_records(findings, problem))
    adapted = adapted_estimate(problem, hypotheses.fit) if records else None
    return Consistency(groups, (*records, *other_runs), adapted, reliability)


def run_findings(
    edited: EditedFit,
    order: SeriesOrder,
    runs: Iterable[Rows],
    epoch_utc: Epochs,
    count_s: Floats | None,
) -> Iterator[ConsistencyTest]:
    """Yield a finding for each run of outliers; its amount is the mean residual, of counts in mm/s."""
    for rows in runs:
        residual_m, unit = edited.fit.residual_m[rows], "m"
        chi2 = float(np.square(residual_m / edited.fit.sigma_m[rows]).sum())
        if count_s is not None and np.isfinite(count_s[rows]).all():
            residual_m, unit = 1e3 * residual_m / count_s[rows], "mm/s"
        first_utc, last_utc = utc_strings(epoch_utc[rows[[0, -1]]], decimals=0)
        yield ConsistencyTest(
            kind="run",
            name=order.series[order.code[rows[0]]].name,
            chi2=chi2,
            dof=len(rows),
            log10_p_value=chi2_log_p_value(chi2, len(rows)) / math.log(10.0),
            amounts={"": float(residual_m.mean())},
            unit=unit,
            first_utc=str(first_utc),
            last_utc=str(last_utc),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _GrossErrorSearch:
    """Tests of the groups and hypotheses of a fit."""

    hypotheses: Hypotheses
    epoch_utc: Epochs
    enu_partials: Floats | None  # (3, w), with respect to the first parameters of the binned problem

    def test_groups(self, problem: BinnedProblem) -> list[_Candidate]:
        """Test the removal of each group."""
        groups = self.list_groups(problem)
        tests = ((group, problem.test(group.columns, group.links, scaled=True)) for group in groups)
        return [_candidate(group, test, len(groups)) for group, test in tests if test is not None]

    def list_groups(self, problem: BinnedProblem) -> list[Hypothesis]:
        """Return each link, type, station and pass of a station whose removal leaves other observations."""
        order, codes = self.hypotheses.order, self.hypotheses.codes
        group_links: dict[tuple[str, str], Links] = {
            ("link", order.series[code].name): {code: 1.0} for code in codes
        }
        for code in codes:
            group_links.setdefault(("type", order.series[code].kind), {})[code] = 1.0
        group_links |= {("station", name): links for name, links in order.of_stations(codes).items()}
        groups: list[Hypothesis] = []

        def add(kind: str, name: str, links: Links, span_s: Span = None) -> None:
            columns = problem.removal(links, span_s or (-np.inf, np.inf))
            sigmas = np.zeros(0)
            group = Hypothesis(Family.GROUP, kind, name, columns, sigmas, "", links=links, span_s=span_s)
            groups.append(group)

        for (kind, name), links in group_links.items():
            spans = passes(problem, links) if kind == "station" else []
            if 1 < len(spans) < _MAX_GROUP_COUNT - len(groups):
                for span_s in spans:
                    add("pass", name, links, span_s)
            if len(links) < len(codes):
                add(kind, name, links)
        return groups

    def test_hypotheses(self, problem: BinnedProblem, group: _Candidate | None = None) -> list[_Candidate]:
        """Test all hypotheses, steps at their most significant epochs, and a group again."""
        hypotheses = list(self.hypotheses.continuous)
        counts = Counter(item.family for item in hypotheses)
        for name, links in self.hypotheses.link_sets:
            epochs_s = self.hypotheses.step_epochs_s(links)
            counts[Family.STEP] += len(epochs_s)
            if len(epochs_s):
                index = int(np.argmax(problem.chi2_of_steps(links, epochs_s)))
                hypotheses.append(self.hypotheses.step(name, links, float(epochs_s[index])))
        if group is not None:
            hypotheses.append(group.hypothesis)
            counts[Family.GROUP] = group.test_count
        candidates = list[_Candidate]()
        for item, products, indices in products_of(problem, hypotheses):
            score_test = products.test(indices, item.links, scaled=item.family is Family.GROUP)
            if score_test is not None:
                candidates.append(_candidate(item, score_test, counts[item.family]))
        return candidates

    def find_most_significant(
        self, problem: BinnedProblem, group_tests: list[_Candidate]
    ) -> _Candidate | None:
        """Return the most significant error or group, with alternatives that the data cannot exclude."""
        candidates = self.test_hypotheses(problem)
        initial = min([*candidates, *group_tests], key=_log_p_value, default=None)
        if initial is None or initial.score_test.chi2 == 0.0:  # residuals are zero
            return None
        best = initial
        for _ in range(_MAX_ROUND_COUNT):
            previous = best.hypothesis
            reweighted = problem.with_noise_of(problem.with_columns(previous.columns))
            candidates = self.test_hypotheses(reweighted, best if best.is_group else None)
            best = min(candidates, key=_log_p_value, default=best)
            if (best.hypothesis.kind, best.hypothesis.name) == (previous.kind, previous.name):
                break
        score_test = best.score_test
        noise_dof = reweighted.products(best.hypothesis.columns).noise_dof(score_test.estimate)
        chi2 = score_test.chi2 / score_test.variance_factor
        log_p_value = f_log_p_value(chi2, score_test.dof, noise_dof) + _log_test_count(best.test_count)
        best = replace(best, log_p_value=min(initial.log_p_value, log_p_value))
        if best.log_p_value >= _LOG_SIGNIFICANCE_LEVEL:
            return best
        return _with_alternatives(best, reweighted, candidates, noise_dof)

    def is_rejected_series(self, finding: _Candidate) -> bool:
        """Return whether a finding is a step or offset of series that have runs of rejected outliers."""
        codes = {int(self.hypotheses.order.code[rows[0]]) for rows in self.hypotheses.readmitted}
        return finding.hypothesis.kind in ("jump", "offset") and codes >= finding.hypothesis.links.keys()

    def run_key(self, rows: Rows) -> tuple[str, str]:
        """Return name and first epoch of a run, by which its record is identified."""
        order = self.hypotheses.order
        [first_utc] = utc_strings(self.epoch_utc[rows[:1]], decimals=0)
        return order.series[order.code[rows[0]]].name, str(first_utc)

    def is_run_significant(self, problem: BinnedProblem, rows: Rows) -> bool:
        """Return whether the offset of a run of outliers is significant once the findings are parameters."""
        score_test = problem.test(self.hypotheses.run(rows).columns)
        if score_test is None:
            return False
        return (
            score_test.log_p_value + _log_test_count(len(self.hypotheses.readmitted))
            < _LOG_SIGNIFICANCE_LEVEL
        )

    def joint_records(self, findings: list[_Candidate], problem: BinnedProblem) -> Iterator[ConsistencyTest]:
        """Yield records of findings: amounts of all together, changes by each with the preceding ones."""
        fitted, changed = self.hypotheses.fitted, self.hypotheses.problem.with_noise_of(problem)
        for finding in findings:
            begin = len(changed.estimate)
            changed = changed.with_parameters(finding.hypothesis.columns)
            shift, root_shift = estimate_change(fitted, changed)
            estimate = problem.estimate[begin : len(changed.estimate)]
            score_test = replace(finding.score_test, estimate=estimate, shift=shift, root_shift=root_shift)
            yield self.record(replace(finding, score_test=score_test))

    def record(self, candidate: _Candidate) -> ConsistencyTest:
        """Return the record of a test, in units and with its change of the position."""
        item, score_test = candidate.hypothesis, candidate.score_test
        shift_m = sigma_m = None
        if self.enu_partials is not None:
            width = self.enu_partials.shape[1]
            shift_m = tuple((self.enu_partials @ score_test.shift[:width]).tolist())
            root_m = self.enu_partials @ score_test.root_shift[:width]
            sigma_m = tuple(np.linalg.norm(root_m, axis=1).tolist())
        amounts, data_values = dict[str, float](), dict[str, float]()
        if not candidate.is_group:
            values = score_test.estimate * item.sigmas
            amounts = dict(zip(item.components, values.tolist(), strict=False))  # forces have no components
            if item.prior_values is not None:
                values = item.prior_values + values
                data_values = dict(zip(item.components, values.tolist(), strict=True))
        first_utc, last_utc = self.interval_utc(item)
        return ConsistencyTest(
            kind=item.kind,
            name=item.name,
            chi2=score_test.chi2,
            dof=score_test.dof,
            log10_p_value=min(candidate.log_p_value, 0.0) / math.log(10.0),
            shift_enu_m=shift_m,
            shift_sigma_enu_m=sigma_m,
            amounts=amounts,
            unit=item.unit,
            first_utc=first_utc,
            last_utc=last_utc,
            prior_sigmas=None if candidate.is_group else candidate.sigmas,
            data_values=data_values,
            alternatives=tuple(map(self.record, candidate.alternatives)),
        )

    def interval_utc(self, hypothesis: Hypothesis) -> tuple[str, str]:
        """Return the first and last epoch of an error, UTC; empty for the ends of the arc."""
        if hypothesis.span_s is None:
            return "", ""
        order, fit, (begin_s, end_s) = self.hypotheses.order, self.hypotheses.fit, hypothesis.span_s
        rows = np.flatnonzero(fit.used & np.isin(order.code, list(hypothesis.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first = int(np.searchsorted(time_s, begin_s))
        last = int(np.searchsorted(time_s, end_s, side="right")) - 1
        width_s = self.hypotheses.problem.width_s(hypothesis.links) if hypothesis.kind == "jump" else 0.0
        if width_s > 0.0:  # locate the step within its bins
            near_rows = np.flatnonzero(np.abs(time_s - begin_s) <= 3.0 * width_s)
            signs = np.array([hypothesis.links[code] for code in order.code[rows[near_rows]].tolist()])
            if len(near_rows) > 1:
                first = int(near_rows[_step_index(signs * fit.residual_m[rows[near_rows]])])
        first_utc, last_utc = utc_strings(self.epoch_utc[rows[[first, last]]], decimals=0)
        return str(first_utc), "" if math.isinf(end_s) else str(last_utc)


def _to_problem_units(partials: Floats | None, hypotheses: Hypotheses) -> Floats | None:
    """Transform partials (3, p) to the first parameters of the binned problem, (3, w)."""
    if partials is None:
        return None
    parameters, (units, width) = hypotheses.fit.parameters, hypotheses.units
    estimated = parameters.free & ~parameters.considered
    return partials[:, np.flatnonzero(estimated)] @ units[estimated[parameters.free], :width]


def _step_index(values: Floats) -> int:
    """Return the index of the first value after the step that fits values (n,) best."""
    n, sums, counts = len(values), np.cumsum(values), np.arange(1, len(values))
    chi2 = (sums[:-1] - counts * sums[-1] / n) ** 2 / (counts * (n - counts))
    return 1 + int(np.argmax(chi2))


def _with_alternatives(
    best: _Candidate, problem: BinnedProblem, candidates: list[_Candidate], noise_dof: float
) -> _Candidate:
    """Return the most probable of the errors that the data cannot exclude, with the others as alternatives."""
    from scipy.sparse import hstack

    errors = [item for item in candidates if not item.is_group]
    products_of_errors = products_of(problem, [item.hypothesis for item in errors], best.hypothesis)
    possible = [
        item
        for item, (_, products, indices) in zip(errors, products_of_errors, strict=True)
        if item.hypothesis is best.hypothesis or _is_possible(item, best, products, indices, noise_dof)
    ]
    if not possible:
        return best
    # A vector and its components share a name: the simplest one stays.
    simplest = dict[tuple[str, Span], int]()
    for place in sorted(
        range(len(possible)), key=lambda place: (possible[place].width, possible[place].sigmas)
    ):
        hypothesis = possible[place].hypothesis
        simplest.setdefault((hypothesis.name, hypothesis.span_s), place)
    products = problem.products(hstack([item.hypothesis.columns[:, :1] for item in possible], format="csc"))
    causes = [
        possible[place]
        for place in simplest.values()
        if not _has_specific_equivalent(place, products, possible)
    ]
    causes.sort(key=_log_odds, reverse=True)
    if not causes:
        return best
    return replace(causes[0], log_p_value=best.log_p_value, alternatives=tuple(causes[1:]))


def _is_possible(
    item: _Candidate, best: _Candidate, products: ScoreProducts, indices: tuple[int, ...], noise_dof: float
) -> bool:
    """Return whether the best error, of the first columns, becomes insignificant once another one is estimated."""
    union = products.test((*indices, *range(best.width)))
    assert union is not None  # a part of it is determined
    chi2, dof = union.chi2 - item.score_test.chi2, union.dof - item.score_test.dof
    return not dof or f_log_p_value(chi2, dof, noise_dof) >= _LOG_SEPARABILITY_LEVEL


def _has_specific_equivalent(column: int, products: ScoreProducts, candidates: list[_Candidate]) -> bool:
    """Return whether a more specific hypothesis has the same effects: a preceding kind of error, or of one owner.

    The products are those of the first column of each candidate.
    """
    if candidates[column].width > 1:
        return False
    hypothesis = candidates[column].hypothesis
    rank, owner = _ERROR_KINDS.index(hypothesis.kind), hypothesis.name.partition(".")[2]
    specific = []
    for place, item in enumerate(candidates):
        kind, other_owner = item.hypothesis.kind, item.hypothesis.name.partition(".")[2]
        same_owner = kind == hypothesis.kind == "parameter" and other_owner == owner
        precedes = _ERROR_KINDS.index(kind) < rank or (same_owner and place < column)
        precedes |= owner == ALL and not item.hypothesis.name.endswith(ALL)
        if item.width == 1 and precedes:
            specific.append(place)
    squares = products.information([column], specific)[0] ** 2
    limits = _MIN_SQUARED_CORRELATION * products.variances([column]) * products.variances(specific)
    return bool((squares > limits).any())


def _log_odds(candidate: _Candidate) -> float:
    """Logarithm of the odds of an error: its likelihood times the prior density of its amount, over one sigma.

    Errors of published models, which have no blunders, are normal. The size of a gross error is unknown, so that its
    prior density is that of a scale, 1 / amount (Jeffreys 1946).
    """
    score_test = candidate.score_test
    if candidate.hypothesis.is_of_published_model:
        return 0.5 * (score_test.chi2 - candidate.sigmas**2)
    return 0.5 * score_test.chi2 - score_test.dof * math.log(max(candidate.sigmas, 1.0))


def _candidate(hypothesis: Hypothesis, score_test: ScoreTest, test_count: int) -> _Candidate:
    """Correct the p-value of a test for the number of tests."""
    log_p_value = score_test.log_p_value + _log_test_count(test_count)
    return _Candidate(hypothesis, score_test, test_count, log_p_value)


def _log_test_count(family_count: int) -> float:
    """Logarithm of the number of tests: of a family, of all families, with the noise before and after."""
    return math.log(2 * len(Family) * max(family_count, 1))
