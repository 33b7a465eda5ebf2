"""Consistency tests: detection and identification of gross errors (Baarda 1968; Teunissen 1990).

1. Detection. Each hypothesis adds columns Z to the design matrix. They model an error
   (:mod:`~radioloc.estimation.hypotheses`), or remove a group of observations from the fit (a station, link, type or
   pass). Without the error, the test statistic T = s^T F^-1 s of :mod:`~radioloc.estimation.group_tests` follows the
   chi-square distribution with q = rank F degrees of freedom. Its p-value is multiplied by the number of tests
   (Bonferroni correction).
2. Identification. A large error enlarges the noise that is estimated from the residuals, and so hides itself. The
   error with the smallest p-value is therefore estimated, and all errors are tested again with the noise of the
   residuals that remain. T/q then follows the F distribution with q and f degrees of freedom, where f is that of the
   variance of the noise as estimated from the residuals. The smaller of the two p-values decides; the correction for
   the number of tests counts those of both stages.
3. Separability (Foerstner 1983). Let T(Z, Z_2) be the statistic of two errors tested jointly. The error Z_2 is another
   possible cause if Z does not improve the fit significantly once Z_2 is estimated, that is, if T(Z, Z_2) - T(Z_2) is
   not significant. The finding names the possible cause with the largest odds, and the others as its alternatives.
4. Adaptation. Z becomes part of the design matrix, and stages 1 to 3 are repeated until no test is significant.

A link is the path of a signal from station to station, such as KASHI>lander>KASHI. A series holds the observations of
one type and link, and is named by the code of its link. A finding is a significant error.

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
    hypothesis_products,
    pass_spans_s,
)
from radioloc.estimation.reliability import assess_reliability
from radioloc.estimation.series import SeriesOrder
from radioloc.noise.whitening import Rows
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_LOG_SIGNIFICANCE_LEVEL = math.log(SIGNIFICANCE_LEVEL)
_LOG_SEPARABILITY_LEVEL = math.log(1e-3)  # probability of excluding the true cause
_MAX_FINDING_COUNT = 3  # further findings are mostly consequences of the first
_MAX_GROUP_COUNT = 200  # bounds the time for long arcs of many passes
_MAX_ROUND_COUNT = 3  # iterations between the noise and the most significant error
_MIN_SQUARED_CORRELATION = 1.0 - 1e-6  # above which two columns describe the same error
_JUMP_SEARCH_BIN_COUNT = 3.0  # bins on either side of a jump that are searched for its epoch
_ERROR_KINDS = ("a priori", "parameter", "offset", "jump", FORCES)  # the more specific first
_log_p_value = attrgetter("log_p_value")


@dataclass(frozen=True, slots=True, eq=False)
class _ErrorTest:
    """Test of an error, or of the removal of a group."""

    hypothesis: Hypothesis
    score_test: ScoreTest
    test_count: int  # number of tests in its family
    log_p_value: float  # corrected for the number of tests
    alternatives: tuple[_ErrorTest, ...] = ()

    @classmethod
    def from_score(cls, hypothesis: Hypothesis, score_test: ScoreTest, test_count: int) -> _ErrorTest:
        """Correct the p-value of a score test for the number of tests."""
        log_p_value = score_test.log_p_value + _log_test_count(test_count)
        return cls(hypothesis, score_test, test_count, log_p_value)

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.hypothesis.columns.shape[1])

    @property
    def is_group(self) -> bool:
        """True for the removal of a group of observations."""
        return self.hypothesis.family is Family.GROUP

    @property
    def is_significant(self) -> bool:
        """True if the p-value is below the significance level."""
        return self.log_p_value < _LOG_SIGNIFICANCE_LEVEL

    @property
    def sigmas(self) -> float:
        """Amount over the a-priori standard deviation; infinite for a group."""
        return math.inf if self.is_group else float(np.linalg.norm(self.score_test.estimate))


def assess_consistency(
    hypotheses: Hypotheses | None,
    epoch_utc: Epochs,
    enu_partials: Floats | None,
    run_findings: Sequence[ConsistencyTest] = (),
    orbit_partials: Floats | None = None,
) -> Consistency:
    """Search for gross errors, and assess the smallest errors that the search detects (reliability).

    `enu_partials` (3, p) are the partials of the east-north-up position with respect to the parameters, None for a
    moving target. `orbit_partials` (3, p) are the same for a position in an orbit, and serve its reliability only.
    `run_findings` are the findings on runs of outliers (:func:`outlier_run_findings`).
    """
    if hypotheses is None:
        return Consistency(findings=tuple(run_findings))
    search = _GrossErrorSearch(hypotheses, epoch_utc, _to_problem_units(enu_partials, hypotheses))
    group_tests = search.test_groups(hypotheses.problem)
    groups = tuple(map(search.to_record, group_tests))
    findings, problem = search.find_errors(group_tests)

    counts = Counter(item.family for item in hypotheses.continuous)
    reliability = assess_reliability(
        hypotheses.problem.with_noise_of(problem) if findings else problem,
        hypotheses.continuous,
        {family: _LOG_SIGNIFICANCE_LEVEL - _log_test_count(count) for family, count in counts.items()},
        _to_problem_units(enu_partials if orbit_partials is None else orbit_partials, hypotheses),
    )
    # An error whose observations are rejected as outliers no longer acts: their runs are reported in its place.
    if not findings or all(map(search.is_covered_by_rejections, findings)):
        return Consistency(groups, tuple(run_findings), None, reliability)
    records = tuple(search.joint_records(findings, problem))
    explained_runs = {
        search.run_key(rows)
        for rows in hypotheses.readmitted_runs
        if not search.is_run_significant(problem, rows)
    }
    other_runs = (item for item in run_findings if (item.name, item.first_utc) not in explained_runs)
    adapted = adapted_estimate(problem, hypotheses.fit)
    return Consistency(groups, (*records, *other_runs), adapted, reliability)


def outlier_run_findings(
    edited: EditedFit, order: SeriesOrder, runs: Iterable[Rows], epoch_utc: Epochs, count_s: Floats | None
) -> Iterator[ConsistencyTest]:
    """Yield a finding for each run of outliers (:func:`~radioloc.estimation.editing.outlier_runs`).

    Its amount is the mean residual, m; for Doppler counts, the mean range rate, mm/s.
    """
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
            amounts={"": float(residual_m.mean())},  # a scalar has no name of a component
            unit=unit,
            first_utc=str(first_utc),
            last_utc=str(last_utc),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _GrossErrorSearch:
    """Search for gross errors by tests of the hypotheses of a fit and of the removal of groups."""

    hypotheses: Hypotheses
    epoch_utc: Epochs
    enu_partials: Floats | None  # (3, w), with respect to the first parameters of the binned problem

    def find_errors(self, group_tests: list[_ErrorTest]) -> tuple[list[_ErrorTest], BinnedProblem]:
        """Return the significant errors, and the problem with all of them as parameters."""
        findings, problem = list[_ErrorTest](), self.hypotheses.problem
        while len(findings) < _MAX_FINDING_COUNT:
            finding = self.find_most_significant(problem, group_tests)
            if finding is None or not finding.is_significant:
                break
            findings.append(finding)
            problem = problem.with_columns(finding.hypothesis.columns)
            if finding.is_group or finding.hypothesis.kind == FORCES:
                break  # the residuals of other groups may follow from this error
            group_tests = self.test_groups(problem)
        return findings, problem

    def test_groups(self, problem: BinnedProblem) -> list[_ErrorTest]:
        """Test the removal of each group."""
        groups = self.list_groups(problem)
        tests = ((group, problem.test(group.columns, group.links, scaled=True)) for group in groups)
        return [_ErrorTest.from_score(group, test, len(groups)) for group, test in tests if test is not None]

    def list_groups(self, problem: BinnedProblem) -> list[Hypothesis]:
        """Return the groups (link, type, station, pass) that can be removed without removing all observations."""
        order, codes = self.hypotheses.order, self.hypotheses.codes
        group_links = {("link", order.series[code].name): {code: 1.0} for code in codes}
        for code in codes:
            group_links.setdefault(("type", order.series[code].kind), {})[code] = 1.0
        group_links |= {("station", name): links for name, links in order.of_stations(codes).items()}
        groups = list[Hypothesis]()
        for (kind, name), links in group_links.items():
            spans_s = pass_spans_s(problem, links) if kind == "station" else []
            if 1 < len(spans_s) < _MAX_GROUP_COUNT - len(groups):
                groups += [_removal(problem, "pass", name, links, span_s) for span_s in spans_s]
            if len(links) < len(codes):
                groups.append(_removal(problem, kind, name, links))
        return groups

    def test_hypotheses(self, problem: BinnedProblem, group: _ErrorTest | None = None) -> list[_ErrorTest]:
        """Test all hypotheses, jumps at their most significant epochs, and optionally a group again."""
        hypotheses = list(self.hypotheses.continuous)
        counts = Counter(item.family for item in hypotheses)
        for name, links in self.hypotheses.link_sets:
            epochs_s = self.hypotheses.step_epochs_s(links)
            counts[Family.STEP] += len(epochs_s)  # the maximum over epochs is one of so many tests
            if len(epochs_s):
                index = int(np.argmax(problem.chi2_of_steps(links, epochs_s)))
                hypotheses.append(self.hypotheses.step(name, links, float(epochs_s[index])))
        if group is not None:
            hypotheses.append(group.hypothesis)
            counts[Family.GROUP] = group.test_count
        tests = list[_ErrorTest]()
        for hypothesis, products, indices in hypothesis_products(problem, hypotheses):
            score_test = products.test(indices, hypothesis.links, scaled=hypothesis.family is Family.GROUP)
            if score_test is not None:
                tests.append(_ErrorTest.from_score(hypothesis, score_test, counts[hypothesis.family]))
        return tests

    def find_most_significant(
        self, problem: BinnedProblem, group_tests: list[_ErrorTest]
    ) -> _ErrorTest | None:
        """Return the most significant error or group, with the alternatives that the data cannot exclude."""
        tests = self.test_hypotheses(problem)
        detected = min([*tests, *group_tests], key=_log_p_value, default=None)
        if detected is None or detected.score_test.chi2 == 0.0:  # residuals are zero
            return None
        return self.identify(problem, detected)

    def identify(self, problem: BinnedProblem, detected: _ErrorTest) -> _ErrorTest:
        """Return the most significant error by the noise after its estimation, with its alternatives."""
        identified = detected
        for _ in range(_MAX_ROUND_COUNT):
            previous = identified.hypothesis
            reweighted = problem.with_noise_of(problem.with_columns(previous.columns))
            tests = self.test_hypotheses(reweighted, identified if identified.is_group else None)
            identified = min(tests, key=_log_p_value, default=identified)
            if (identified.hypothesis.kind, identified.hypothesis.name) == (previous.kind, previous.name):
                break
        score_test = identified.score_test
        noise_dof = reweighted.products(identified.hypothesis.columns).noise_dof(score_test.estimate)
        chi2 = score_test.chi2 / score_test.variance_factor
        log_p_value = f_log_p_value(chi2, score_test.dof, noise_dof) + _log_test_count(identified.test_count)
        identified = replace(identified, log_p_value=min(detected.log_p_value, log_p_value))
        if identified.is_significant:
            return _with_alternatives(identified, reweighted, tests, noise_dof)
        return identified

    def is_covered_by_rejections(self, finding: _ErrorTest) -> bool:
        """Return whether a finding is a jump or offset only of series with runs of rejected outliers."""
        codes = {int(self.hypotheses.order.code[rows[0]]) for rows in self.hypotheses.readmitted_runs}
        return finding.hypothesis.kind in ("jump", "offset") and codes >= finding.hypothesis.links.keys()

    def run_key(self, rows: Rows) -> tuple[str, str]:
        """Return name and first epoch of a run of outliers, by which its record is identified."""
        order = self.hypotheses.order
        [first_utc] = utc_strings(self.epoch_utc[rows[:1]], decimals=0)
        return order.series[order.code[rows[0]]].name, str(first_utc)

    def is_run_significant(self, problem: BinnedProblem, rows: Rows) -> bool:
        """Return whether the offset of a run of outliers is significant once the findings are parameters."""
        hypothesis, count = self.hypotheses.run(rows), len(self.hypotheses.readmitted_runs)
        score_test = problem.test(hypothesis.columns)
        return score_test is not None and _ErrorTest.from_score(hypothesis, score_test, count).is_significant

    def joint_records(self, findings: list[_ErrorTest], problem: BinnedProblem) -> Iterator[ConsistencyTest]:
        """Yield the records of the findings: joint amounts, and the change of the estimate by each in turn."""
        fitted, extended = self.hypotheses.fitted, self.hypotheses.problem.with_noise_of(problem)
        for finding in findings:
            begin = len(extended.estimate)
            extended = extended.with_parameters(finding.hypothesis.columns)
            shift, root = estimate_change(fitted, extended)
            estimate = problem.estimate[begin : len(extended.estimate)]
            joint = replace(finding.score_test, estimate=estimate, shift=shift, shift_root_covariance=root)
            yield self.to_record(replace(finding, score_test=joint))

    def to_record(self, test: _ErrorTest) -> ConsistencyTest:
        """Return the record of a test, in units and with its change of the position."""
        hypothesis, score_test = test.hypothesis, test.score_test
        shift_m = sigma_m = None
        if self.enu_partials is not None:
            shift_m = tuple((self.enu_partials @ score_test.shift).tolist())
            root_m = self.enu_partials @ score_test.shift_root_covariance
            sigma_m = tuple(np.linalg.norm(root_m, axis=1).tolist())
        amounts, data_values = dict[str, float](), dict[str, float]()
        if not test.is_group:
            values = score_test.estimate * hypothesis.sigmas
            # Forces have no names of components.
            amounts = dict(zip(hypothesis.components, values.tolist(), strict=False))
            if hypothesis.prior_values is not None:
                values = hypothesis.prior_values + values
                data_values = dict(zip(hypothesis.components, values.tolist(), strict=True))
        first_utc, last_utc = self.interval_utc(hypothesis)
        return ConsistencyTest(
            kind=hypothesis.kind,
            name=hypothesis.name,
            chi2=score_test.chi2,
            dof=score_test.dof,
            log10_p_value=min(test.log_p_value, 0.0) / math.log(10.0),
            shift_enu_m=shift_m,
            shift_sigma_enu_m=sigma_m,
            amounts=amounts,
            unit=hypothesis.unit,
            first_utc=first_utc,
            last_utc=last_utc,
            prior_sigmas=None if test.is_group else test.sigmas,
            data_values=data_values,
            alternatives=tuple(map(self.to_record, test.alternatives)),
        )

    def interval_utc(self, hypothesis: Hypothesis) -> tuple[str, str]:
        """Return the first and last epoch of an error, UTC; empty for the ends of the arc."""
        if hypothesis.span_s is None:
            return "", ""
        order, fit, (begin_s, end_s) = self.hypotheses.order, self.hypotheses.fit, hypothesis.span_s
        usable = fit.used.copy()
        usable[[row for rows in self.hypotheses.readmitted_runs for row in rows]] = True
        rows = np.flatnonzero(usable & np.isin(order.code, list(hypothesis.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first = int(np.searchsorted(time_s, begin_s))
        last = int(np.searchsorted(time_s, end_s, side="right")) - 1
        bin_s = self.hypotheses.problem.width_s(hypothesis.links) if hypothesis.kind == "jump" else 0.0
        if bin_s > 0.0:  # locate the jump within its bins
            near = np.flatnonzero(np.abs(time_s - begin_s) <= _JUMP_SEARCH_BIN_COUNT * bin_s)
            signs = np.array([hypothesis.links[code] for code in order.code[rows[near]].tolist()])
            first = int(near[_jump_index(signs * fit.residual_m[rows[near]])]) if len(near) > 1 else first
        first_utc, last_utc = utc_strings(self.epoch_utc[rows[[first, last]]], decimals=0)
        return str(first_utc), "" if math.isinf(end_s) else str(last_utc)


def _removal(problem: BinnedProblem, kind: str, name: str, links: Links, span_s: Span = None) -> Hypothesis:
    """Return the hypothesis that a group of observations is wrong, which removes it from the fit."""
    columns = problem.removal(links, span_s or (-np.inf, np.inf))
    return Hypothesis(Family.GROUP, kind, name, columns, np.zeros(0), "", links=links, span_s=span_s)


def _to_problem_units(partials: Floats | None, hypotheses: Hypotheses) -> Floats | None:
    """Transform partials (3, p) to the first parameters of the binned problem, (3, w)."""
    if partials is None:
        return None
    parameters, (units, width) = hypotheses.fit.parameters, hypotheses.units
    estimated = parameters.free & ~parameters.considered
    return partials[:, np.flatnonzero(estimated)] @ units[estimated[parameters.free], :width]


def _jump_index(values: Floats) -> int:
    """Return the index of the first value after the jump that lowers the sum of squares of two or more values most."""
    n, sums, counts = len(values), np.cumsum(values), np.arange(1, len(values))
    decreases = (sums[:-1] - counts * sums[-1] / n) ** 2 / (counts * (n - counts))  # times n
    return 1 + int(np.argmax(decreases))


def _with_alternatives(
    best: _ErrorTest, problem: BinnedProblem, tests: list[_ErrorTest], noise_dof: float
) -> _ErrorTest:
    """Return the most probable of the errors that the data cannot exclude, with the others as alternatives.

    Its p-value is that of the most significant error, since the data do not separate the two.
    """
    from scipy.sparse import hstack

    errors = [item for item in tests if not item.is_group]
    products_of_errors = hypothesis_products(problem, [item.hypothesis for item in errors], best.hypothesis)
    possible = [
        item
        for item, (_, products, indices) in zip(errors, products_of_errors, strict=True)
        if item.hypothesis is best.hypothesis or _is_possible(item, best, products, indices, noise_dof)
    ]
    if not possible:
        return best
    # A vector and its components share a name: the simplest one stays.
    simplest = dict[tuple[str, Span], _ErrorTest]()
    for item in sorted(possible, key=lambda item: (item.width, item.sigmas)):
        simplest.setdefault((item.hypothesis.name, item.hypothesis.span_s), item)
    products = problem.products(hstack([item.hypothesis.columns[:, :1] for item in possible], format="csc"))
    causes = [
        item
        for item in simplest.values()
        if not _has_specific_equivalent(possible.index(item), products, possible)
    ]
    causes.sort(key=_log_odds, reverse=True)
    if not causes:
        return best
    return replace(causes[0], log_p_value=best.log_p_value, alternatives=tuple(causes[1:]))


def _is_possible(
    item: _ErrorTest, best: _ErrorTest, products: ScoreProducts, indices: slice, noise_dof: float
) -> bool:
    """Return whether the best error, of the first columns, is insignificant once another error is estimated."""
    joint_test = products.test([*range(indices.start, indices.stop), *range(best.width)])
    assert joint_test is not None  # the other error alone is determined
    chi2, dof = joint_test.chi2 - item.score_test.chi2, joint_test.dof - item.score_test.dof
    return not dof or f_log_p_value(chi2, dof, noise_dof) >= _LOG_SEPARABILITY_LEVEL


def _has_specific_equivalent(index: int, products: ScoreProducts, tests: list[_ErrorTest]) -> bool:
    """Return whether a more specific error has the same effects; the products are those of the first columns."""
    hypothesis = tests[index].hypothesis
    if tests[index].width > 1:
        return False
    specific = [
        k
        for k, test in enumerate(tests)
        if test.width == 1 and _is_more_specific(test.hypothesis, hypothesis, is_earlier=k < index)
    ]
    squares = products.information([index], specific)[0] ** 2
    limits = _MIN_SQUARED_CORRELATION * products.variances([index]) * products.variances(specific)
    return bool((squares > limits).any())


def _is_more_specific(first: Hypothesis, second: Hypothesis, *, is_earlier: bool) -> bool:
    """Compare the kinds of two errors, one member's error with the common one, or two parameters of one member."""
    if _ERROR_KINDS.index(first.kind) < _ERROR_KINDS.index(second.kind):
        return True
    if second.member == ALL and first.member != ALL:
        return True
    return is_earlier and first.kind == second.kind == "parameter" and first.member == second.member


def _log_odds(test: _ErrorTest) -> float:
    """Logarithm of the odds of an error: its likelihood times the prior density of its amount, over one sigma.

    Errors of published models, which have no blunders, are normal. The size of a gross error is unknown, so that its
    prior density is that of a scale, 1 / amount (Jeffreys 1946).
    """
    score_test = test.score_test
    if test.hypothesis.is_of_published_model:
        return 0.5 * (score_test.chi2 - test.sigmas**2)
    return 0.5 * score_test.chi2 - score_test.dof * math.log(max(test.sigmas, 1.0))


def _log_test_count(family_count: int) -> float:
    """Logarithm of the number of tests: of a family, of all families, with the noise before and after."""
    return math.log(2 * len(Family) * max(family_count, 1))
