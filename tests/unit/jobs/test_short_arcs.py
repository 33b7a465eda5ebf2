"""Short arcs: what ranges alone know in an hour, what a height adds, what biases take away; that the card says so."""

import numpy as np
import pytest
from change5_case import LANDER, NOISE, START, observations

import radioloc
from radioloc import Study
from radioloc.simulation import Scenario, Schedule, Session, Truth, two_way
from radioloc.study import EstimateChoice, Reference


def fit(tracked, **estimate):
    choice = EstimateChoice(range_bias="all", **estimate)
    return radioloc.locate(
        Study(target=LANDER, estimate=choice, reference=Reference(LANDER, "truth"), consider_defaults=False),
        tracked,
    )


@pytest.fixture(scope="module")
def first_hour(model):
    """Ranges of 1 m a minute, after landing: Jiamusi sends, Jiamusi and Kashi receive."""
    return observations(model, 60.0, stop="2020-12-01T16:11:00", vlbi=False, bias_m={})


def test_two_uplinks_tell_directions_twice_as_well(first_hour, model):
    """What tells a direction is the difference of two distances, which two two-way ranges hold twice."""
    ranges = Session("range", two_way("JIAMUSI", "KASHI"), START, "2020-12-01T16:11:00", 60.0, sigma_m=1.0)
    joint = Scenario(Schedule([ranges]), LANDER, Truth()).world(model).draw(NOISE, seed=1).observations
    assert len(joint) == len(first_hour)
    of_two_m, of_one_m = (
        float(np.hypot(*fit(tracked, range_bias_sigma_m=10.0).sigma_enu_m()[:2]))
        for tracked in (joint, first_hour)
    )
    assert of_two_m == pytest.approx(110.0, abs=3.0)
    assert of_one_m == pytest.approx(2.0 * of_two_m, rel=0.05)


def test_free_biases_over_half_a_day_take_the_position_with_them(model):
    tracked = observations(model, 600.0, stop="2020-12-02T03:11:00", bias_m={})
    solution = fit(tracked)
    assert solution.converged
    sigma_m = float(np.linalg.norm(solution.sigma_enu_m()))
    assert sigma_m > 100.0
    [part] = solution.observability.common
    assert (part.kind, part.count) == ("range_bias", 3)
    biases = solution.biases()
    for _, bias_sigma_m in biases.values():
        assert bias_sigma_m > 200.0
        assert part.sigma == pytest.approx(bias_sigma_m, rel=0.02)
    # Nearly all of the position's error is that common part.
    assert part.position_m == pytest.approx(sigma_m, rel=0.05)
    # An a-priori value of each is what was missing.
    assert np.linalg.norm(fit(tracked, range_bias_sigma_m=10.0).sigma_enu_m()) < 10.0
