"""Coverage of 95 % regions with errors that last for hours; regions stay where they do not.

Stations A, B and C see the toy Moon for 10 h in 24.8 over 48 h, each with a range bias of 10 m a priori.
"""

import numpy as np
import pytest
from toy_moon import EPOCH_JD, LANDER_M, ToyMoon, assessed_fit, solution_of

from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.simulation.noise import gauss_markov
from radioloc.time import Epochs

pytestmark = pytest.mark.slow

RUNS = 120
BIAS_SIGMA_M, WHITE_M = 10.0, 0.3
CHI2_3_95 = 7.814727903251179


def solution(n, coloured_m, tau_h, seed):
    rng = np.random.default_rng([20201201, seed])
    model = ToyMoon(n, 48.0)
    noise_m = WHITE_M * rng.normal(size=n)
    step_s = model.time_s[3] - model.time_s[0]
    for name in model.biased:
        members = model.station == name
        drive = rng.normal(size=int(members.sum()))
        noise_m[members] += coloured_m * gauss_markov(drive, np.exp(-step_s / (3600.0 * tau_h)))
    rises_h = np.select([model.station == "A", model.station == "B"], [0.0, 8.0], 9.0)
    up = (model.time_s / 3600.0 + rises_h) % 24.8 < 10.0
    parameters = model.parameters(LANDER_M + np.array([200.0, 300.0, -100.0]))
    for name in model.biased:
        value_m = BIAS_SIGMA_M * rng.normal()
        parameters = parameters.changed(f"range_bias.{name}", prior_value=value_m, prior_sigma=BIAS_SIGMA_M)
    observed_m = model.ranges(np.concatenate([LANDER_M, np.zeros(3)]))[0] + noise_m
    status = np.where(up, "used", "below the horizon")
    edited = fit_with_variance_components(
        model.residual_function(observed_m), parameters, WHITE_M, status=status
    )
    assessed = assessed_fit(
        edited,
        position_pa_m=edited.fit.x[:3],
        position_partials=np.eye(3, len(parameters)),
        rot_pa_to_me=np.eye(3),
        pa_frame="PA",
        me_frame="ME",
        epoch_utc=Epochs.from_jd(EPOCH_JD, model.time_s / 86400.0, "UTC"),
        station=model.station,
        path=[f"{name}>lander>{name}" for name in model.station],
        type=["range"] * n,
        observed_m=observed_m,
    )
    return solution_of(assessed)


def held(n, coloured_m, tau_h):
    """Parts of the runs whose formal, and whose scaled, 95 % ellipsoid holds the truth, and that found something."""
    contained, alike = np.zeros(2), 0
    for seed in range(RUNS):
        result = solution(n, coloured_m, tau_h, seed)
        assert result.converged
        error_m = result.position_pa_m - LANDER_M
        formal, scaled = (result.position_covariance("pa", level) for level in ("formal", "scaled"))
        # Never smaller in any direction.
        assert np.linalg.eigvalsh(scaled - formal).min() > -1e-9 * np.trace(formal)
        contained += [error_m @ np.linalg.solve(c, error_m) < CHI2_3_95 for c in (formal, scaled)]
        alike += result.time_correlation is not None
    return *(contained / RUNS).tolist(), alike / RUNS


# Binomial of 120 at 0.95: 1e-4 and 1 - 1e-4 quantiles are 103 and 120.
COVERED = 103 / RUNS


@pytest.mark.parametrize(
    ("n", "coloured_m", "tau_h", "at_most"),
    [(4320, 0.3, 2.0, 0.15), (2880, 0.3, 3.0, 0.15), (2880, 0.15, 1.0, 0.45), (2880, 0.3, 0.3, 0.6)],
)
def test_errors_that_last_are_allowed_for(n, coloured_m, tau_h, at_most):
    formal, scaled, alike = held(n, coloured_m, tau_h)
    assert formal <= at_most
    assert scaled >= COVERED
    assert alike == 1.0


@pytest.mark.parametrize("n", [240, 2880])
def test_white_residuals_are_left_alone(n):
    formal, scaled, alike = held(n, 0.0, 1.0)
    assert formal >= COVERED
    assert scaled >= COVERED
    # One of a hundred is meant; six of 120 have a chance of 2e-3.
    assert alike <= 5 / RUNS
