"""The example of a landing: its tracking is that of its study, which finds the place that was put in."""

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc

STUDY = EXAMPLES / "descent" / "descent.toml"

# Revised Earth orientation would move the stations by some centimetres.
REVISED_M = 0.1


@pytest.mark.slow
def test_the_files_are_what_the_study_makes():
    simulated = radioloc.simulate(STUDY).observations
    shipped = radioloc.read_observations(STUDY.with_name("tracking.csv"))
    assert np.array_equal(simulated.epoch.mjd, shipped.epoch.mjd)
    assert np.abs(simulated.value_m - shipped.value_m).max() < REVISED_M


@pytest.mark.slow
def test_the_place_is_found():
    solution = radioloc.locate(STUDY)
    assert solution.converged
    assert solution.reference.combined_sigmas < 2.8  # 95 % of three
    assert solution.reference.distance_m < 15.0
    assert solution.ellipse().semi_major_m < 10.0
    assert solution.state.sigma_rtn_m(solution.state.epoch).max() < 5.0
