"""Consistency tests: agreement of groups of observations and a-priori values with the other data.

1. Each group (station, link, pass or type) is removed by additional parameters that absorb it. The test compares the
   estimates with and without the group.
2. Explanations (:mod:`~radioloc.estimation.hypotheses`) are tested by :mod:`~radioloc.estimation.group_tests`: errors
   of a-priori values and of parameters that the fit holds at zero, steps and offsets.
3. The most significant explanation becomes a parameter, and the tests are repeated until none is significant.

Separability (Förstner 1983). An explanation remains possible if its estimation makes the finding insignificant.
Explanations that the data cannot separate are reported as one finding, errors of published models last. Of others with
equal likelihood, the one with the smallest ratio of amount to a-priori sigma is named first.

Noise estimated from the residuals contains the fault, so a large fault may be less significant than a small one. The
most significant explanation is therefore tested a second time, with the noise of the residuals after its estimation.
That variance ratio follows Fisher's distribution, with the degrees of freedom of the noise.

Probabilities are multiplied by the number of tests (Bonferroni correction).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.estimation.adaptation import AdaptedEstimate, adapted_estimate
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.group_tests import (
    BinnedProblem,
    ScoreProducts,
    ScoreTest,
    chi2_log_p_value,
    estimate_change,
    f_log_p_value,
)
from radioloc.estimation.hypotheses import ALL, TERM, Family, Hypotheses, Hypothesis, Links, Span, passes
from radioloc.estimation.reliability import Reliability, assess_reliability
from radioloc.estimation.series import SeriesOrder
from radioloc.noise.whitening import Rows
from radioloc.parameters.registry import parameter_label
from radioloc.time import Epochs, utc_strings
from radioloc.units import set_fields
from radioloc.vectors import Floats

SIGNIFICANCE_LEVEL = 1e-3  # fewer than one false finding in a thousand solutions
_LOG_ALTERNATIVE_LEVEL = math.log(
    1e-3
)  # of the test of a finding against an alternative: excludes one right cause in a thousand
_MAX_FINDING_COUNT = 3  # further findings are mostly consequences of the first
_MAX_GROUP_COUNT = 200  # bounds the time for long arcs of many passes
_KINDS = ("a priori", "parameter", "offset", "jump")  # of explanations, the more specific first
_MAX_PRINTED_ALTERNATIVES = 3
_MIN_SAME_EFFECT = 1.0 - 1e-6  # squared correlation of two columns but for rounding and light times
_MAX_ROUND_COUNT = 3  # of noise and most significant explanation, each found by the other


@dataclass(frozen=True, slots=True)
class ConsistencyTest:
    """Consistency test of a group of observations or of an explanation, with its result."""

    # Removed: "station", "link", "type", "pass"; estimated: "a priori", "parameter", "jump", "offset"; rejected: "run";
    # stated: "sigma"; corrected: "mistake"; of an orbit: "forces".
    kind: str
    name: str  # station, link, type or parameter that is tested
    chi2: float  # test statistic
    dof: int
    log10_p_value: float  # log10 of the p-value, corrected for the number of tests
    # Change of the position by the removal or estimation, together with the preceding findings, and its sigma
    shift_enu_m: tuple[float, float, float] | None
    shift_sigma_enu_m: tuple[float, float, float] | None
    amounts: dict[str, float]  # estimated components, in `unit`
    unit: str = ""
    first_utc: str = ""  # epochs of the interval, empty for the whole arc
    last_utc: str = ""
    prior_sigmas: float | None = None  # amounts over a-priori sigmas, or over the scale of the parameter
    data_values: dict[str, float] = field(default_factory=dict)  # a-priori values from the data alone
    alternatives: tuple[ConsistencyTest, ...] = ()  # other explanations that the data cannot exclude
    next_chi2_ratio: float | None = None  # of a mistake: chi-square of the next hypothesis over its own

    @property
    def significant(self) -> bool:
        """True if the p-value is below the significance level."""
        return self.log10_p_value < math.log10(SIGNIFICANCE_LEVEL)

    @property
    def participants(self) -> frozenset[str]:
        """Words of the name, among them the stations concerned."""
        return frozenset(re.split(r"[ .<>|]+", self.name))

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; a significant test has a sentence as ``text``."""
        content: dict[str, Any] = {name: getattr(self, name) for name in ("kind", "name", "chi2", "dof")}
        content["log10_chance"] = self.log10_p_value
        for key in ("shift", "shift_sigma"):
            values = getattr(self, f"{key}_enu_m") or (None, None, None)
            content[key] = dict(zip(("east_m", "north_m", "up_m"), values, strict=True))
        content |= {"amounts": self.amounts, "unit": self.unit}
        content |= {"first_utc": self.first_utc or None, "last_utc": self.last_utc or None}
        content |= {"prior_sigmas": self.prior_sigmas, "data_values": self.data_values}
        content["next_chi2_ratio"] = self.next_chi2_ratio
        content["alternatives"] = [
            {key: getattr(item, key) for key in ("kind", "name", "amounts", "unit", "prior_sigmas")}
            for item in self.alternatives
        ]
        return content | {"significant": self.significant, "text": str(self) if self.significant else None}

    @property
    def cause(self) -> str:
        """Cause in words, with its amounts."""
        period = f" from {self.first_utc} to {self.last_utc}" if self.last_utc else ""
        parts = " ".join(
            f"{value:+.3g}{'' if self.unit == '1' else f' {self.unit}'}{f' {name}' if name else ''}"
            for name, value in self.amounts.items()
        )
        value = next(iter(self.amounts.values()), 0.0)
        kind, _, label = self.name.partition(".")
        match self.kind:
            case "jump":
                return f"{self.name} jumps by {_amount(value, self.unit)} at {self.first_utc}"
            case "offset":
                return f"{self.name} is off by {_amount(value, self.unit)}{period}"
            case "mistake":
                return self.name
            case "forces":
                return "the forces of the orbit (gravity field, manoeuvres, radiation) do not fit the observations"
            case "run":
                return f"{self.dof} observations of {self.name}{period} are off by {value:+.3g} {self.unit}, rejected"
            case "sigma":
                factor, word = (value, "small") if value > 1.0 else (1.0 / value, "large")
                text = f"{factor:.0f}" if factor >= 10.0 else f"{factor:.2g}"
                members = f" of {self.name}" if self.name else ""
                return f"the stated sigmas{members} are about {text} times too {word}"
            case "parameter" if kind == TERM:
                return f"the observations contain the term {label}, which is switched off ({value:+.3g} of it fit)"
            case "parameter":
                return f"the {parameter_label(self.name)} is {parts}, not zero"
            case "a priori":
                label = label if kind == "position" else parameter_label(self.name)
                return f"the a-priori {label} does not fit the observations ({parts} explains it{self._data_alone()})"
        return f"{self.name}{period} does not fit the others"

    def _data_alone(self) -> str:
        """Value of a single a-priori value from the data alone."""
        if len(self.data_values) != 1 or not self.name.startswith("position."):
            return ""
        [value] = self.data_values.values()
        return f": the data alone give {value:.1f} {self.unit}"

    def __str__(self) -> str:
        sentence = self.cause
        if self.next_chi2_ratio is not None:
            sentence += f" (chi-square {self.next_chi2_ratio:.3g} times smaller than of the next hypothesis)"
        if self.shift_enu_m is not None:
            condition = "with that" if self.amounts else "without it"
            sentence += f"; {condition} the position moves by {math.hypot(*self.shift_enu_m):.3g} m"
        if self.alternatives:
            causes = [item.cause for item in self.alternatives[:_MAX_PRINTED_ALTERNATIVES]]
            rest_count = len(self.alternatives) - len(causes)
            causes += [f"{rest_count} more in solution.json"] if rest_count else []
            sentence += f"; the data cannot exclude that {', or '.join(causes)}"
        return sentence


def _amount(value: float, unit: str) -> str:
    """Amount of a step or offset in the unit of its type."""
    if unit == "m":
        return f"{value:+.3g} m ({1e9 * value / C_M_S:+.3g} ns)"
    return f"{1e9 * value:+.3g} ns ({C_M_S * value:+.3g} m)" if unit == "s" else f"{value:+.3g} {unit}"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Results of the consistency tests of a fit."""

    groups: tuple[ConsistencyTest, ...] = ()  # tests of all groups, significant or not
    findings: tuple[
        ConsistencyTest, ...
    ] = ()  # significant tests, each with the preceding ones as parameters
    adapted: AdaptedEstimate | None = None  # estimate with the findings as parameters; None without findings
    reliability: tuple[Reliability, ...] = ()  # of all hypotheses on errors that last for the whole arc

    def __repr__(self) -> str:
        return f"<Consistency of {len(self.groups)} groups, {len(self.findings)} finding(s)>"

    def to_list(self) -> list[dict[str, Any]]:
        """Return findings and groups in types of JSON."""
        return [item.to_dict() for item in (*self.findings, *self.groups)]


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """Test of a hypothesis, or of the removal of a group of observations."""

    kind: str
    name: str
    columns: Floats
    verdict: ScoreTest
    log_count: float  # logarithm of the number of tests
    hypothesis: Hypothesis | None = None  # None of a group
    indices: tuple[int, ...] = ()  # of the columns in products of all hypotheses
    links: Links = field(default_factory=dict)
    span_s: Span = None
    alternatives: tuple[_Test, ...] = ()
    # Logarithm of the corrected p-value, by default that of the verdict.
    log_p_value: float = field(default=math.nan)

    def __post_init__(self) -> None:
        if math.isnan(self.log_p_value):
            set_fields(self, log_p_value=self.verdict.log_p_value + self.log_count)

    @property
    def sigmas(self) -> float:
        """Amount over the a-priori standard deviation; infinite for a group."""
        return math.inf if self.hypothesis is None else float(np.linalg.norm(self.verdict.estimate))

    @property
    def significant(self) -> bool:
        """True if the p-value is below the significance level."""
        return self.log_p_value < math.log(SIGNIFICANCE_LEVEL)


def assess_consistency(
    hypotheses: Hypotheses | None,
    epoch_utc: Epochs,
    enu_partials: Floats | None,
    rejected: Sequence[ConsistencyTest] = (),
    state_by_parameters: Floats | None = None,
) -> Consistency:
    """Test groups of observations, a-priori values, parameters held at zero, steps and offsets.

    Without these tests, a VLBI clock error of 5 ns or a station error of 50 m stays unreported: residuals and status do
    not show them (`tests/unit/jobs/test_consistency.py`).
    """
    if hypotheses is None:
        return Consistency(findings=tuple(rejected))
    problem = hypotheses.problem
    search = _Search(hypotheses, epoch_utc, enu_partials)
    reliability_search = (
        search if state_by_parameters is None else replace(search, enu_partials=state_by_parameters)
    )
    group_tests = search.groups(problem)
    groups = tuple(search.record(test) for test in group_tests)
    findings: list[_Test] = []
    while len(findings) < _MAX_FINDING_COUNT:
        finding = search.most_significant(problem, group_tests)
        if finding is None or not finding.significant:
            break
        findings.append(finding)
        problem = problem.with_columns(finding.columns)
        if finding.hypothesis is None:
            break
        group_tests = search.groups(problem)
    reliability = reliability_search.reliability(
        hypotheses.problem.with_noise_of(problem) if findings else problem
    )
    if findings and all(map(search.is_of_readmitted, findings)):
        return Consistency(groups, tuple(rejected), None, reliability)  # the rejection corrects the fault
    explained = {
        search.run_key(rows)
        for rows in hypotheses.readmitted
        if findings and not search.run_is_significant(problem, rows)
    }
    records = tuple(search.joint_records(findings, problem))
    runs = (item for item in rejected if (item.name, item.first_utc) not in explained)
    adapted = adapted_estimate(problem, hypotheses.fit) if records else None
    return Consistency(groups, (*records, *runs), adapted, reliability)


def rejected_runs(
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
            "run",
            order.series[order.code[rows[0]]].name,
            chi2,
            len(rows),
            chi2_log_p_value(chi2, len(rows)) / math.log(10.0),
            None,
            None,
            {"": float(residual_m.mean())},
            unit,
            str(first_utc),
            str(last_utc),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Tests of hypotheses and groups, with the fit that they belong to."""

    hypotheses: Hypotheses
    epoch_utc: Epochs
    enu_partials: Floats | None

    def groups(self, problem: BinnedProblem) -> list[_Test]:
        """Test the removal of each link, type, station and pass of a station."""
        order, codes = self.hypotheses.order, self.hypotheses.codes
        groups: dict[tuple[str, str], Links] = {
            ("link", order.series[code].name): {code: 1.0} for code in codes
        }
        for code in codes:
            groups.setdefault(("type", order.series[code].kind), {})[code] = 1.0
        groups |= {("station", name): links for name, links in order.of_stations(codes).items()}
        selections: list[tuple[str, str, Links, Span]] = []
        for (kind, name), links in groups.items():
            spans = passes(problem, links) if kind == "station" else []
            if 1 < len(spans) < _MAX_GROUP_COUNT - len(selections):
                selections += [("pass", name, links, span_s) for span_s in spans]
            if len(links) < len(codes):
                selections.append((kind, name, links, None))
        tests = []
        for kind, name, links, span_s in selections:
            columns = problem.removal(links, span_s or (-np.inf, np.inf))
            verdict = problem.test(columns, links, scaled=True)
            if verdict is not None:
                log_count = _log_test_count(len(selections))
                tests.append(_Test(kind, name, columns, verdict, log_count, links=links, span_s=span_s))
        return tests

    def explanations(
        self, problem: BinnedProblem, group: _Test | None = None
    ) -> tuple[ScoreProducts, list[_Test]]:
        """Test all hypotheses, steps at their most likely epochs, and a group again."""
        hypotheses = list(self.hypotheses.continuous)
        families = [hypothesis.family for hypothesis in hypotheses]
        counts = {family: families.count(family) for family in Family}
        for name, links in self.hypotheses.link_sets:
            edges_s = self.hypotheses.step_epochs_s(links)
            counts[Family.STEP] += len(edges_s)
            if len(edges_s):
                index = int(np.argmax(problem.chi2_of_steps(links, edges_s)))
                hypotheses.append(self.hypotheses.step(name, links, float(edges_s[index])))
        columns = [item.columns for item in hypotheses]
        products = problem.products(np.hstack(columns if group is None else [*columns, group.columns]))
        tests, begin = list[_Test](), 0
        for item in hypotheses:
            indices = tuple(range(begin, begin := begin + item.columns.shape[1]))
            verdict = products.test(indices, item.links)
            if verdict is not None:
                log_count = _log_test_count(counts[item.family])
                test = _Test(item.kind, item.name, item.columns, verdict, log_count, item, indices)
                tests.append(replace(test, links=item.links, span_s=item.span_s))
        if group is not None:
            indices = tuple(range(begin, begin + group.columns.shape[1]))
            verdict = products.test(indices, group.links, scaled=True)
            tests += (
                []
                if verdict is None
                else [replace(group, verdict=verdict, indices=indices, log_p_value=math.nan)]
            )
        return products, tests

    def reliability(self, problem: BinnedProblem) -> tuple[Reliability, ...]:
        """Return the smallest errors that the tests find, and the effect of those that they do not find."""
        hypotheses = self.hypotheses.continuous
        counts = Counter(item.family for item in hypotheses)
        log_levels = {
            family: math.log(SIGNIFICANCE_LEVEL) - _log_test_count(count) for family, count in counts.items()
        }
        return assess_reliability(problem, hypotheses, log_levels, self._enu_by_unit())

    def _enu_by_unit(self) -> Floats | None:
        """Return the partials of the position by the first parameters of the problem, (3, w)."""
        if self.enu_partials is None:
            return None
        fit = self.hypotheses.fit
        units, width = self.hypotheses.units
        estimated = fit.parameters.free & ~fit.parameters.considered
        adjusted = estimated[fit.parameters.free]
        return self.enu_partials[:, np.flatnonzero(estimated)] @ units[adjusted, :width]

    def most_significant(self, problem: BinnedProblem, group_tests: list[_Test]) -> _Test | None:
        """Return the most significant explanation or group, with alternatives that the data cannot exclude."""
        _, tests = self.explanations(problem)
        initial = min([*tests, *group_tests], key=_log_chance, default=None)
        if initial is None or initial.verdict.chi2 == 0.0:  # residuals are zero
            return None
        best = initial
        for _ in range(_MAX_ROUND_COUNT):
            group = best if best.hypothesis is None else None
            renewed = problem.with_noise_of(problem.with_columns(best.columns))
            products, tests = self.explanations(renewed, group)
            likeliest = min(tests, key=_log_chance, default=best)
            if likeliest.name == best.name and likeliest.kind == best.kind:
                best = likeliest
                break
            best = likeliest
        noise_dof, verdict = products.noise_dof(best.indices, best.verdict.estimate), best.verdict
        log_ratio_chance = f_log_p_value(verdict.chi2 / verdict.variance_factor, verdict.dof, noise_dof)
        best = replace(best, log_p_value=min(initial.log_p_value, log_ratio_chance + best.log_count))
        return _with_alternatives(best, products, tests, noise_dof) if best.significant else best

    def joint_records(self, findings: list[_Test], problem: BinnedProblem) -> Iterator[ConsistencyTest]:
        """Yield records of findings: amounts of all together, changes by each with the preceding ones."""
        fitted, changed = self.hypotheses.fitted, self.hypotheses.problem.with_noise_of(problem)
        for test in findings:
            changed = changed.with_parameters(test.columns)
            shift, root_shift = estimate_change(fitted, changed)
            begin, end = len(changed.estimate) - test.columns.shape[1], len(changed.estimate)
            verdict = replace(
                test.verdict,
                estimate=problem.estimate[begin:end],
                shift=shift,
                root_shift=root_shift,
            )
            yield self.record(replace(test, verdict=verdict))

    def is_of_readmitted(self, test: _Test) -> bool:
        """Return whether a finding is a step or offset of a series whose outliers are most of it."""
        codes = {int(self.hypotheses.order.code[rows[0]]) for rows in self.hypotheses.readmitted}
        return test.kind in ("jump", "offset") and codes >= test.links.keys()

    def run_key(self, rows: Rows) -> tuple[str, str]:
        """Name and first epoch of a run, by which its record is identified."""
        order = self.hypotheses.order
        [first_utc] = utc_strings(self.epoch_utc[rows[:1]], decimals=0)
        return order.series[order.code[rows[0]]].name, str(first_utc)

    def run_is_significant(self, problem: BinnedProblem, rows: Rows) -> bool:
        """Return whether a run of outliers is off once the findings are parameters."""
        verdict = problem.test(self.hypotheses.run(rows).columns)
        log_count = _log_test_count(len(self.hypotheses.readmitted))
        return verdict is not None and verdict.log_p_value + log_count < math.log(SIGNIFICANCE_LEVEL)

    def record(self, test: _Test) -> ConsistencyTest:
        """Return the record of a test."""
        shift_m = sigma_m = None
        verdict, item = test.verdict, test.hypothesis
        if (by_unit := self._enu_by_unit()) is not None:
            width = by_unit.shape[1]
            shift_m = tuple((by_unit @ verdict.shift[:width]).tolist())
            sigma_m = tuple(np.linalg.norm(by_unit @ verdict.root_shift[:width], axis=1).tolist())
        amounts, data_values = dict[str, float](), dict[str, float]()
        if item is not None:
            values = verdict.estimate * item.sigmas
            amounts = dict(zip(item.components, values.tolist(), strict=True))
            if item.prior_values is not None:
                values = item.prior_values + values
                data_values = dict(zip(item.components, values.tolist(), strict=True))
        first, last = self._span(test)
        return ConsistencyTest(
            test.kind,
            test.name,
            verdict.chi2,
            verdict.dof,
            min(test.log_p_value, 0.0) / math.log(10.0),
            shift_m,
            sigma_m,
            amounts,
            "" if item is None else item.unit,
            first,
            last,
            test.sigmas if item is not None else None,
            data_values,
            tuple(map(self.record, test.alternatives)),
        )

    def _span(self, test: _Test) -> tuple[str, str]:
        """Return the first and last epoch, UTC, of the interval of a test; a jump is located within its bins."""
        if test.span_s is None:
            return "", ""
        order, fit, (begin_s, end_s) = self.hypotheses.order, self.hypotheses.fit, test.span_s
        rows = np.flatnonzero(fit.used & np.isin(order.code, list(test.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first_row = int(np.searchsorted(time_s, begin_s))
        width_s = self.hypotheses.problem.width_s(test.links) if test.kind == "jump" else 0.0
        if width_s > 0.0:
            near_rows = np.flatnonzero(np.abs(time_s - begin_s) <= 3.0 * width_s)
            signs = np.array([test.links[code] for code in order.code[rows[near_rows]].tolist()])
            sums = np.cumsum(signs * fit.residual_m[rows[near_rows]])
            counts = np.arange(1, len(near_rows))
            steps = (sums[:-1] - counts * sums[-1] / len(near_rows)) ** 2 / (
                counts * (len(near_rows) - counts)
            )
            first_row = int(near_rows[1 + int(np.argmax(steps))])
        last_row = int(np.searchsorted(time_s, end_s, side="right")) - 1
        epochs = utc_strings(self.epoch_utc[rows[[first_row, last_row]]], decimals=0)
        return str(epochs[0]), "" if math.isinf(end_s) else str(epochs[1])


def _with_alternatives(best: _Test, products: ScoreProducts, tests: list[_Test], noise_dof: float) -> _Test:
    """Return the explanation of the smallest a-priori ratio that the data cannot exclude, with the others."""
    possible = list[_Test]()
    for test in tests:
        if test.hypothesis is None:
            continue
        union = tuple(dict.fromkeys((*test.indices, *best.indices)))
        union_verdict = products.test(union)
        assert union_verdict is not None  # a part of it is determined
        added_chi2, added_dof = union_verdict.chi2 - test.verdict.chi2, union_verdict.dof - test.verdict.dof
        if added_dof and f_log_p_value(added_chi2, added_dof, noise_dof) < _LOG_ALTERNATIVE_LEVEL:
            continue
        possible.append(test)
    possible.sort(key=lambda test: (len(test.indices), test.sigmas))
    distinct = dict[tuple[str, Span], _Test]()
    for test in possible:  # a vector and its components share a name: the simplest one stays
        distinct.setdefault((test.name, test.span_s), test)
    causes = [test for test in distinct.values() if not _is_named_otherwise(test, products, possible)]
    causes.sort(key=_log_odds, reverse=True)
    if not causes:
        return best
    first, *alternatives = causes
    return replace(first, log_p_value=best.log_p_value, alternatives=tuple(alternatives))


def _is_named_otherwise(test: _Test, products: ScoreProducts, tests: list[_Test]) -> bool:
    """Return whether a more specific hypothesis has the same effects: a kind of error before, or of one owner."""
    if len(test.indices) > 1:
        return False
    [k] = test.indices
    rank, owner = _KINDS.index(test.kind), test.name.partition(".")[2]
    specific = []
    for item in tests:
        same_owner = item.kind == test.kind == "parameter" and item.name.partition(".")[2] == owner
        precedes = _KINDS.index(item.kind) < rank or (same_owner and item.indices < test.indices)
        precedes |= owner == ALL and not item.name.endswith(ALL)
        if len(item.indices) == 1 and precedes:
            specific.append(item.indices[0])
    squares = products.information([k], specific)[0] ** 2
    limits = _MIN_SAME_EFFECT * products.variances([k]) * products.variances(specific)
    return bool((squares > limits).any())


def _log_odds(test: _Test) -> float:
    """Logarithm of the odds of a cause: its likelihood times the prior density of its amount, over one sigma.

    Errors of published models, which have no blunders, are normal. The size of a gross error is unknown, so that its
    prior density is that of a scale, 1 / amount (Jeffreys 1946).
    """
    if test.hypothesis is not None and test.hypothesis.is_of_published_model:
        return 0.5 * (test.verdict.chi2 - test.sigmas**2)
    return 0.5 * test.verdict.chi2 - test.verdict.dof * math.log(max(test.sigmas, 1.0))


def _log_chance(test: _Test) -> float:
    return test.log_p_value


def _log_test_count(count: int) -> float:
    """Logarithm of the number of tests: of a family, of all families, with the noise before and after."""
    return math.log(2 * len(Family) * max(count, 1))
