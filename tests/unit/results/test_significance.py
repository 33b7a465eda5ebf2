"""Significance of what cards compare: the largest of many differences, shifts in space, means of few observations."""

from dataclasses import replace

import numpy as np
import pytest
from toy_moon import ToyMoon, toy_solution

from radioloc.estimation.combination import Agreement
from radioloc.estimation.consistency import Consistency, Inconsistency
from radioloc.results.comparison import significant_pairs
from radioloc.results.fit_card import inconsistent


def test_the_largest_of_many_differences_needs_a_smaller_chance():
    pair = Agreement("a", "b", (5.0, 0.0, 0.0), components=3, chi2=17.5)  # chance of 5.6e-4
    equal = Agreement("a", "c", (0.0, 0.0, 0.0), components=3, chi2=1.0)
    untested = Agreement("b", "c", (0.0, 0.0, 0.0), why="they share observations")
    assert significant_pairs([pair]) == [pair]
    assert significant_pairs([pair, untested]) == [pair]
    assert significant_pairs([pair, *[equal] * 9]) == []


def test_consistent_comparisons_of_many_pairs_are_seldom_refused():
    rng = np.random.default_rng(3)
    squares = rng.chisquare(3, (2000, 15))
    pairs = ([Agreement("a", "b", (0.0,) * 3, components=3, chi2=x) for x in row] for row in squares)
    assert sum(bool(significant_pairs(row)) for row in pairs) <= 8  # 2 are expected, without correction 30


@pytest.mark.parametrize("axis", [0, 2])
def test_a_shift_is_compared_with_the_ellipsoid_in_its_direction(axis):
    solution = toy_solution(ToyMoon(200, 72.0))
    variances, axes = np.linalg.eigh(solution.position_covariance())
    shift_m = 2.5 * np.sqrt(variances[axis]) * axes[:, axis]
    finding = Inconsistency("offset", "A", 30.0, 1, -6.0, tuple(shift_m), (1.0, 1.0, 1.0), {"": 1.0}, "m")
    warned = replace(solution, consistency=Consistency(found=(finding,)))
    assert [*inconsistent(warned, strongly=True)] == [finding]
    assert [*inconsistent(warned, strongly=False)] == []
    small = replace(finding, shift_enu_m=tuple(0.5 * shift_m))
    assert not [*inconsistent(replace(solution, consistency=Consistency(found=(small,))), strongly=True)]


@pytest.mark.parametrize(("offset_m", "named"), [(0.9, False), (1.6, True)])
def test_a_link_of_one_range_is_compared_by_the_stated_sigma(offset_m, named):
    path = np.array(["A>x>A"] * 59 + ["B>x>A"])
    model = ToyMoon(60, 24.0, stations=("A",))
    solution = toy_solution(model, blunders_m={59: offset_m}, station=["A"] * 60, path=path)
    assert solution.residuals.used.all()
    assert ("disagree by" in str(solution)) == named
