"""A search from any point of the near side ends at the same position."""

import math

import change5_case
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import radioloc
from radioloc import LunarPosition
from radioloc.measurements import PhysicalModel
from radioloc.search import search
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.study.study import HeightPrior

HEIGHT = HeightPrior(-2550.4, 5.0)
KINDS_OF_FIT = {
    "biases": (None, EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, height_prior=HEIGHT)),
    "ranges": (change5_case.RANGING, EstimateChoice(range_bias="all", height_prior=HEIGHT)),
    "delays": (change5_case.VLBI, EstimateChoice(height_prior=HEIGHT)),
    "cartesian": (None, EstimateChoice(position="cartesian")),
}
SAME_SIGMAS = 1e-2  # fits end within a thousandth of a sigma of the least sum of squares


@pytest.fixture(scope="module")
def tracking():
    return change5_case.observations(PhysicalModel.build(), 1200.0)


def study(fit, target):
    stations, estimate = KINDS_OF_FIT[fit]
    return radioloc.Study(
        target,
        ObservationChoice(hours=4.0, stations=stations),
        estimate,
        ModelChoice(off=["ionosphere"]),
    )


@pytest.fixture(scope="module")
def home(tracking):
    return {fit: radioloc.locate(study(fit, change5_case.NEAR), tracking) for fit in KINDS_OF_FIT}


@settings(max_examples=settings().max_examples // 3)
@given(
    st.sampled_from(sorted(KINDS_OF_FIT)), st.floats(0.0, math.radians(85.0)), st.floats(0.0, 2.0 * math.pi)
)
@pytest.mark.slow
def test_fits_come_home_from_the_whole_near_side(tracking, home, fit, from_middle_rad, azimuth_rad):
    across = math.sin(from_middle_rad)
    start = LunarPosition.from_selenographic(
        math.degrees(math.atan2(across * math.sin(azimuth_rad), math.cos(from_middle_rad))),
        math.degrees(math.asin(across * math.cos(azimuth_rad))),
        0.0,
    )
    solution, prior = radioloc.locate(search(study(fit, start), tracking).study, tracking), home[fit]
    assert solution.converged
    off_m = solution.rot_pa_to_enu @ (solution.position_pa_m - prior.position_pa_m)
    assert (np.abs(off_m) < SAME_SIGMAS * prior.sigma_enu_m()).all()


@pytest.mark.study
def test_a_good_position_is_kept_and_from_a_bad_one_the_search_is_named(tracking, home):
    assert search(study("biases", change5_case.NEAR), tracking).apriori_positions == ()
    assert not any("radioloc search" in note for note in home["biases"].notes)
    far_study = study("biases", LunarPosition.from_selenographic(8.0, 43.0, 0.0))
    assert any("`radioloc search STUDY.toml`" in note for note in radioloc.locate(far_study, tracking).notes)
    (result,) = search(far_study, tracking).apriori_positions
    assert result.away_m > 1e6
