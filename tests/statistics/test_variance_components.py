"""Excess noise over many seeded trials: how often it is added for nothing, its size, and honest sigmas with it."""

import numpy as np
import pytest
from quick import some

from radioloc.estimation import Parameter, ParameterSet, fit_with_variance_components

N = 60
TRIALS = 300


def trial(excess_m, seed):
    rng = np.random.default_rng([20240502, seed])
    partials = np.column_stack([np.ones(N), np.sin(np.arange(N)), np.cos(1.7 * np.arange(N))])
    stated_m = 0.004 * np.exp(0.8 * rng.standard_normal(N))
    truth = rng.standard_normal(3)
    observed_m = partials @ truth + rng.standard_normal(N) * np.hypot(stated_m, excess_m)
    parameters = ParameterSet(Parameter(f"a.{k}", "m", "a") for k in range(3))
    found = fit_with_variance_components(
        lambda x: (observed_m - partials @ x, partials), parameters, stated_m
    )
    return found, (found.fit.x - truth) / found.fit.sigmas


def test_seldom_added_for_nothing():
    added = sum(trial(0.0, seed)[0].additive_sigma_m["all"] > 0.0 for seed in range(TRIALS))
    assert added <= 3  # one of a thousand is meant; four of 300 have a chance of 3e-4


@pytest.mark.parametrize("excess_m", some([0.01, 0.05], [0.01]))
def test_size_and_coverage(excess_m):
    excesses, errors = [], []
    for seed in range(TRIALS):
        found, error = trial(excess_m, seed)
        assert found.converged
        excesses.append(found.additive_sigma_m["all"])
        errors.append(error)
    # Standard error of the mean: about 1 / sqrt(2 * 57 * 300) = 0.5 % of it; it is biased by as much.
    assert np.mean(excesses) == pytest.approx(excess_m, rel=0.03)
    # 900 errors: 68.3 % within a sigma, with a standard error of 1.6 %; 95.4 % within two, 0.7 %.
    errors = np.abs(np.array(errors).ravel())
    assert np.mean(errors < 1.0) == pytest.approx(0.683, abs=0.06)
    assert np.mean(errors < 2.0) == pytest.approx(0.954, abs=0.03)
