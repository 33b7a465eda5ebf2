"""Agreement of estimates and the joint estimate: by hand, and over seeded draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

from radioloc.errors import InputError
from radioloc.estimation.combination import PositionEstimate, agreement, joint_estimate
from radioloc.lunar.local import axes_at, displaced, local_difference

PLACE = np.array([1737400.0, 0.0, 0.0])
"""Where x is up, y east and z north."""
UP_EAST_NORTH = [1, 2, 0]
RNG = np.random.default_rng(20140101)


def estimate(name, enu_m, noise_m2, errors=None, **case):
    moved = np.zeros(3)
    moved[UP_EAST_NORTH] = enu_m
    errors = {key: np.array(moves, dtype=float) for key, moves in (errors or {}).items()}
    return PositionEstimate(name, PLACE + moved, np.array(noise_m2, dtype=float), errors, **case)


def test_independent_estimates_are_weighed_by_their_variances():
    item = estimate("one", [10.0, 0.0, 0.0], np.diag([1.0, 4.0, 9.0]))
    two = estimate("two", [13.0, 5.0, 0.0], np.diag([2.0, 4.0, 9.0]))
    pair = agreement(item, two)
    assert pair.difference_enu_m == pytest.approx((-3.0, -5.0, 0.0), abs=1e-4)  # the horizon of 5 m
    assert pair.chi2 == pytest.approx(9.0 / 3.0 + 25.0 / 8.0, rel=1e-4)
    assert (pair.components, pair.sigma_enu_m) == (3, pytest.approx(np.sqrt([3.0, 8.0, 18.0])))
    joint = joint_estimate([item, two])
    difference = (joint.position_me_m - PLACE)[UP_EAST_NORTH]
    assert difference == pytest.approx([11.0, 2.5, 0.0], abs=1e-4)
    assert np.diag(joint.covariance_enu_m2) == pytest.approx([2.0 / 3.0, 2.0, 4.5])
    assert joint.chi2 == pytest.approx(pair.chi2, rel=1e-4)
    assert (joint.dof, joint.chance) == (3, pytest.approx(pair.chance, rel=1e-3))


def test_an_error_in_common_neither_separates_nor_averages_out():
    tie = {"map_tie.east": [25.0, 0.0, 0.0]}
    item, two = (estimate(name, [5.0, 0.0, 0.0], np.eye(3), tie) for name in ("one", "two"))
    assert agreement(item, two).sigma_enu_m == pytest.approx([np.sqrt(2.0)] * 3)
    assert np.diag(joint_estimate([item, two]).covariance_enu_m2) == pytest.approx([625.5, 0.5, 0.5])


def test_part_and_whole_differ_by_less_than_independent_estimates():
    """The mean of four values of variance 1 differs from that of the first two by variance 1/2 - 1/4."""
    total = estimate("48 h", [0.0, 0.0, 0.0], 0.25 * np.eye(3), study="s", data=frozenset("d"))
    part = estimate("24 h", [1.0, 0.0, 0.0], 0.5 * np.eye(3), study="s", data=frozenset("d"), hours=24.0)
    assert agreement(part, total).chi2 == pytest.approx(4.0)
    assert agreement(total, part).chi2 == pytest.approx(4.0)
    assert joint_estimate([part, total]) is None
    joint = joint_estimate([part, total, estimate("images", [0.0, 0.0, 0.0], np.eye(3))])
    assert joint.names == ("48 h", "images")
    assert joint.left_out == {"24 h": "it shares observations with 48 h"}
    whole_as_part = estimate("24 h", [1.0, 0.0, 0.0], 0.25 * np.eye(3), study="s", hours=24.0)
    assert agreement(whole_as_part, total).chi2 is None
    low = replace(
        part, noise_enu_m2=np.diag([*np.diag(part.noise_enu_m2)[:2], 0.5 * total.noise_enu_m2[2, 2]])
    )
    flat = agreement(low, total, horizontal=True)
    assert (flat.components, flat.sigma_enu_m[2]) == (2, None)


def test_a_height_that_one_does_not_determine_is_the_others():
    flat = np.diag([4.0, 4.0, np.nan])
    item, two = estimate("map", [2.0, 0.0, 0.0], flat), estimate("radio", [0.0, 0.0, 7.0], 4.0 * np.eye(3))
    assert agreement(item, two).components == 2
    assert agreement(item, two).sigma_enu_m[2] is None
    joint = joint_estimate([item, two])
    assert (joint.position_me_m - PLACE)[UP_EAST_NORTH] == pytest.approx([1.0, 0.0, 7.0], abs=1e-4)
    assert np.diag(joint.covariance_enu_m2) == pytest.approx([2.0, 2.0, 4.0])
    empty = joint_estimate([item, estimate("other map", [0.0, 0.0, 0.0], flat)])
    assert np.isnan(empty.covariance_enu_m2[2, 2])


@pytest.mark.slow
def test_draws_are_as_likely_as_stated_and_the_joint_ellipse_holds_the_truth():
    """Three estimates with noise of their own and two errors in common, 2000 times."""
    roots = [RNG.normal(size=(3, 3)) * size for size in (4.0, 7.0, 12.0)]
    errors = [{"stations": RNG.normal(size=3) * 5.0, "map": RNG.normal(size=3) * s} for s in (0.0, 8.0, 8.0)]
    chances, joint_chances, contained = [], [], 0
    trials = 2000
    for _ in range(trials):
        drawn = dict(zip(("stations", "map"), RNG.normal(size=2), strict=True))
        calls = [
            estimate(
                str(k),
                root @ RNG.normal(size=3) + sum(drawn[name] * moved for name, moved in error.items()),
                root @ root.T,
                error,
            )
            for k, (root, error) in enumerate(zip(roots, errors, strict=True))
        ]
        chances.append(agreement(calls[0], calls[1]).chance)
        joint = joint_estimate(calls)
        joint_chances.append(joint.chance)
        difference = (joint.position_me_m - PLACE)[UP_EAST_NORTH]
        contained += (
            difference @ np.linalg.solve(joint.covariance_enu_m2, difference) < 7.815
        )  # 95 % in three dimensions
    # Uniform if the covariances are right; 1e-5 of chance below, and outside these bounds.
    assert kstest(chances, "uniform").pvalue > 1e-5
    assert kstest(joint_chances, "uniform").pvalue > 1e-5
    assert binom.ppf(1e-5, trials, 0.95) <= contained <= binom.ppf(1.0 - 1e-5, trials, 0.95)


def at(place_m, name, sigmas_m, **case):
    return PositionEstimate(name, place_m, np.diag(np.square(sigmas_m)), {}, **case)


def test_estimates_76_km_apart_at_the_same_height_agree_as_their_horizontal_sigmas_say():
    """The tangent plane would put one 1.7 km below the other, 100 of its sigmas."""
    other_m = displaced(PLACE, np.array([76e3, 0.0, 0.0]))
    item, two = at(PLACE, "one", [40e3, 40e3, 10.0]), at(other_m, "two", [30e3, 30e3, 10.0])
    pair = agreement(item, two)
    assert pair.difference_enu_m == pytest.approx((-76e3, 0.0, 0.0), abs=1e-4)
    assert pair.chi2 == pytest.approx((76.0 / 50.0) ** 2)
    joint = joint_estimate([item, two])
    assert local_difference(joint.position_me_m, PLACE).enu_m == pytest.approx(
        [76e3 * 16.0 / 25.0, 0.0, 0.0], abs=1e-3
    )
    assert joint.chi2 == pytest.approx(pair.chi2)


def test_an_estimate_from_lines_of_sight_is_combined_along_straight_lines():
    """One direction in space is determined to 1 cm 10 km to the east, where verticals are 0.33 deg apart."""
    other_m = displaced(PLACE, np.array([10e3, 0.0, 0.0]))
    sigmas_m = np.array([3e3, 3e3, 0.01])
    item, two = at(PLACE, "map", [3e3, 3e3, 3e3]), at(other_m, "radio", sigmas_m, straight=True)
    joint = joint_estimate([item, two])
    along_m = axes_at(other_m) @ (joint.position_me_m - other_m)
    assert abs(along_m[2]) < 0.1  # 29 m where the vertical turned along the sphere
    across_m = axes_at(other_m) @ axes_at(joint.position_me_m).T
    variance_m2 = across_m @ joint.covariance_enu_m2 @ across_m.T
    assert np.sqrt(variance_m2[2, 2]) == pytest.approx(0.01, rel=1e-3)


def test_covariances_are_compared_in_common_axes_beyond_a_pole():
    """An ellipse that is long along the meridian of the one is long along that of the other, whose east is its west."""
    pole_m = np.array([0.0, 0.0, 1737400.0])
    places = [displaced(pole_m, np.array([along_m, 0.0, 0.0])) for along_m in (1000.0, -1000.0)]
    # At 90 degrees E and W north is along the line through the pole, also of a point at right angles to it.
    third_m = displaced(pole_m, np.array([0.0, 1000.0, 0.0]))
    item, two = (at(place_m, name, [1.0, 1000.0, 1.0]) for name, place_m in zip("ab", places, strict=True))
    assert agreement(item, two).chi2 == pytest.approx(2000.0**2 / (2.0 * 1000.0**2), rel=1e-6)
    across = at(third_m, "c", [1000.0, 1.0, 1.0])  # long in the same direction in space as the others
    assert agreement(item, across).sigma_enu_m[0] == pytest.approx(np.hypot(1000.0, 1000.0), rel=1e-4)


@pytest.mark.parametrize(
    ("number", "first_utc", "last_utc", "shared"),
    [
        (1, "2020-12-01T10:00:00", "2020-12-01T16:00:00", 1.0),  # of an arc that begins later
        (2, "2020-12-03T10:00:00", "2020-12-03T16:00:00", 0.0),
        (2, "2020-12-01T13:00:00", "2020-12-01T19:00:00", 0.5),
    ],
)
def test_errors_of_a_pass_are_the_same_where_the_pass_is(number, first_utc, last_utc, shared):
    """The number of a pass counts from the start of the arc."""
    pass_utc = ("2020-12-01T10:00:00", "2020-12-01T16:00:00")
    names = ["zenith_delay.KASHI 2", f"zenith_delay.KASHI {number}"]
    item, two = (
        estimate(name, [0.0, 0.0, 0.0], np.eye(3), {name: [3.0, 0.0, 0.0]}, spans_utc={name: span})
        for name, span in zip(names, (pass_utc, (first_utc, last_utc)), strict=True)
    )
    assert agreement(item, two).sigma_enu_m[0] ** 2 == pytest.approx(20.0 - 18.0 * shared, rel=1e-3)


def test_a_target_on_a_trajectory_has_no_estimate():
    with pytest.raises(InputError, match="trajectory"):
        PositionEstimate.from_solution({"name": "orbiter", "position": None})
