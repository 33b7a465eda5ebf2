"""Coverage of ellipses of the landing place, over drawn descents whose thrust is not that of the plan."""

import numpy as np
import pytest
from descent import SITE, Descent
from scipy.stats import binom, chi2

import radioloc
from radioloc.lunar import LunarPosition

DESCENTS = 100
# Throttle and attitude change every 15 s, in the midst of the segments of 20 s.
CASE = Descent(before_s=1500.0, step_s=20.0, segment_s=20.0, true_s=15.0)


@pytest.mark.slow
def test_ellipses_hold_the_landing_place(tmp_path):
    place_pa_m = LunarPosition.from_selenographic(*SITE).to_frame("PA_DE421").xyz_m
    horizontal = []
    for seed in range(DESCENTS):
        study = radioloc.read_study(CASE.written(tmp_path / "study.toml", seed=seed))
        solution = radioloc.locate(study, radioloc.simulate(study, seed=seed).observations)
        assert solution.converged, (seed, solution.message)
        off_m = (solution.rot_pa_to_enu @ (solution.position_pa_m - place_pa_m))[:2]
        horizontal.append(off_m @ np.linalg.solve(solution.position_covariance()[:2, :2], off_m))
    low, high = binom.ppf([0.005, 0.995], DESCENTS, 0.95)
    assert low <= (np.array(horizontal) < chi2.ppf(0.95, 2)).sum() <= high
