"""Cards as text, lines on reliability, and the significance of what cards compare."""

import math
from dataclasses import replace

import numpy as np
import pytest
from toy_moon import ToyMoon, solution_of, toy_fit, toy_solution

from radioloc.estimation import FitStatus
from radioloc.estimation.adaptation import AdaptedEstimate
from radioloc.estimation.combination import Agreement
from radioloc.estimation.consider import Consider
from radioloc.estimation.consistency_results import Consistency, ConsistencyTest
from radioloc.estimation.reliability import Reliability
from radioloc.parameters import Parameter, ParameterSet
from radioloc.results.build import compare_with, with_findings
from radioloc.results.cards import Card, Field, text_table
from radioloc.results.comparison import significant_pairs
from radioloc.results.fit_card import select_findings
from radioloc.results.reliability_card import reliability_lines
from radioloc.results.solution_card import solution_card


def test_the_largest_of_many_differences_needs_a_smaller_chance():
    pair = Agreement("a", "b", (5.0, 0.0, 0.0), components=3, chi2=17.5)  # chance of 5.6e-4
    equal = Agreement("a", "c", (0.0, 0.0, 0.0), components=3, chi2=1.0)
    untested = Agreement("b", "c", (0.0, 0.0, 0.0), why="they share observations")
    assert significant_pairs([pair]) == [pair]
    assert significant_pairs([pair, untested]) == [pair]
    assert significant_pairs([pair, *[equal] * 9]) == []


def test_consistent_comparisons_of_many_pairs_are_seldom_refused():
    squares = np.random.default_rng(3).chisquare(3, (2000, 15))
    pairs = ([Agreement("a", "b", (0.0,) * 3, components=3, chi2=x) for x in row] for row in squares)
    assert sum(bool(significant_pairs(row)) for row in pairs) <= 8  # 2 are expected, without correction 30


@pytest.mark.parametrize("axis", [0, 2])
def test_a_shift_is_compared_with_the_ellipsoid_in_its_direction(axis):
    solution = toy_solution(ToyMoon(200, 72.0))
    variances, axes = np.linalg.eigh(solution.position_covariance())
    shift_m = 2.5 * np.sqrt(variances[axis]) * axes[:, axis]
    finding = ConsistencyTest("offset", "A", 30.0, 1, -6.0, tuple(shift_m), (1.0, 1.0, 1.0), {"": 1.0}, "m")
    warned = replace(solution, consistency=Consistency(findings=(finding,)))
    assert [*select_findings(warned, serious=True)] == [finding]
    assert [*select_findings(warned, serious=False)] == []
    small = replace(finding, shift_enu_m=tuple(0.5 * shift_m))
    passed_over = replace(solution, consistency=Consistency(findings=(small,)))
    assert not [*select_findings(passed_over, serious=True)]
    pointer = f"see misfit, below: {small.cause}"
    assert [pointer in " ".join(str(solution_card(item)).split()) for item in (warned, passed_over)] == [
        False,
        True,
    ]


@pytest.mark.parametrize(("offset_m", "named"), [(0.9, False), (1.6, True)])
def test_a_link_of_one_range_is_compared_by_the_stated_sigma(offset_m, named):
    path = np.array(["A>x>A"] * 59 + ["B>x>A"])
    model = ToyMoon(60, 24.0, stations=("A",))
    solution = toy_solution(model, blunders_m={59: offset_m}, station=["A"] * 60, path=path)
    assert solution.residuals.used.all()
    assert ("disagree by" in str(solution_card(solution))) == named


@pytest.mark.parametrize(("sigmas", "status"), [(2.5, FitStatus.CONVERGED), (3.5, FitStatus.MISFIT)])
def test_the_reported_region_covers_the_position_with_the_finding_estimated(sigmas, status):
    assessed = toy_fit(ToyMoon(200, 72.0))
    solution = solution_of(assessed)
    variances, axes = np.linalg.eigh(solution.position_covariance())
    shift_m = sigmas * np.sqrt(variances[1]) * axes[:, 1]
    shift = solution.enu_partials.T @ shift_m  # the position alone
    finding = ConsistencyTest("offset", "A", 30.0, 1, -6.0, tuple(shift_m), (1.0, 1.0, 1.0), {"": 1.0}, "m")
    tests = Consistency(findings=(finding,), adapted=AdaptedEstimate(shift, solution.covariance))
    estimate = with_findings(assessed.estimate, tests)
    warned = solution_of(replace(assessed, estimate=estimate, consistency=tests))
    assert warned.status is status
    assert compare_with(warned, warned.with_findings().position_pa_m).combined_sigmas < 1.0
    assert sum(item.total_m**2 for item in warned.budget) == pytest.approx(
        np.square(solution.sigma_enu_m()).sum() + shift_m @ shift_m
    )
    record = warned.to_dict()["with_findings"]
    assert record["shift_sigmas"] == pytest.approx(sigmas)
    assert [*record["shift"].values()] == pytest.approx(shift_m, abs=1e-9)
    assert [*select_findings(warned, serious=True)] == [finding]


@pytest.mark.parametrize(("neglected_m", "explained"), [(0.0, False), (2.0, True)])
def test_sigma_above_the_a_priori_one_is_explained(neglected_m, explained):
    solution = toy_solution(ToyMoon(200, 72.0, stations=("A", "B")), bias_sigma_m=1.0)
    sensitivity = np.zeros((len(solution.parameters), 1))
    sensitivity[3] = neglected_m  # of the first bias
    gravity = ParameterSet([Parameter("gravity", "1", "gravity", 0.0, 1.0)])
    text = str(solution_card(replace(solution, consider=Consider(gravity, sensitivity))))
    assert ("above the a-priori one" in text) == explained


ROWS = (("KASHI", "1.0", "0 +- 10"), ("a name that is much too long for its column", "-22222.0", "free"))


def test_numbers_are_never_cut():
    lines = text_table(("station", *(f"column {k}" for k in range(9))), (("KASHI", *["-123456.78"] * 9),), 40)
    assert lines[1].split() == ["KASHI", *["-123456.78"] * 9]


def test_rows_of_the_rest_are_counted_by_name():
    rest = (("zenith_delay", "6 h", "1"), ("zenith_delay", "12 h", "1"), ("clock", "6 h", "1"))
    field = Field("estimated", (), ("parameter", "arc", "sigma"), ROWS[:1], ("below",), rest, "arcs.json")
    text = str(Card((field,)))
    assert "KASHI" in text
    assert "zenith_delay" not in text
    assert text.index("2 more in arcs.json") < text.index("below")
    page = Card((field,)).html()
    assert page.index("<summary>2 more</summary>") < page.index("zenith_delay") < page.index("below")


def test_markup_is_text():
    card = Card((Field("notes", ("[bold]not bold[/bold] :moon:",), ("[red]a", "b"), (("[/red]", "1"),)),))
    assert "[bold]not bold[/bold] :moon:" in str(card)
    assert "[red]a" in str(card)
    assert "[/red]" in str(card)
    assert "\x1b" not in str(card)


def item(
    name, minimal, unit="m", *, shift_m=1.0, per_unit_m=1.0, kind="parameter", components=("",), sigma=None
):
    return Reliability(kind, name, components, unit, minimal, shift_m, per_unit_m, sigma)


def test_the_smallest_error_and_the_largest_effect_of_each_kind_are_named():
    sizes, effect, hidden = reliability_lines(
        [
            item("range_bias.A", 4.0, shift_m=20.0),
            item("range_bias.B", 3.0),
            item("clock.C", 2e-9, "s"),
            item("moon_position.radial", 500.0, shift_m=400.0),  # no fault of a station, link or target
            item("range_bias.range", 1.0),  # of a type
            item("time_bias.all", 5e-3, "s", shift_m=120.0),
            item("transponder_delay", math.inf, "s", per_unit_m=1.5e8, sigma=1e-8),
            item("term.troposphere", 0.1, "1", shift_m=500.0),  # switched off by the user
        ]
    )
    assert (
        sizes
        == "smallest detectable errors (power 80 %): clock 2 ns (C), range bias 3 m (B), time bias 5 ms (common)"
    )
    effects = "120 m (common time bias, 5 ms), 20.0 m (range bias of A, 4 m), 1.00 m (clock of C, 2 ns)"
    assert effect == f"largest effects of undetected errors: {effects}"
    assert hidden == "not revealed: transponder delay (0.150 m of position per ns, sigma 10 ns)"
