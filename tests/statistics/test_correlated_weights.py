"""Weights for residuals that are correlated in time: smaller errors, and 95 % regions that hold about what they claim.

Ranges and delays of a day of the Chang'e-5 lander, range biases of 10 m and a height of 5 m a priori, all drawn.
"""

import numpy as np
import pytest
from change5_case import NEAR, RANGING, sessions, study_of

import radioloc
from radioloc.simulation import Noise, NoiseModel, TruthSigma
from radioloc.study import ObservationChoice

pytestmark = pytest.mark.slow

TRIALS = 64
HELD = 55
"""Binomial of 64 at 0.95: 55 or more but for a chance of 5e-3 / 4."""
TRIAL_COUNT, HELD_OF_MANY = 256, 232
"""The same of 256."""
SAME_M = 1e-3
"""Fits of the linear model in two ways stop within a thousandth of a sigma of metres."""
STOP = "2020-12-02T15:10:00"
LASTING = NoiseModel(
    {"range": Noise(white_m=1.4, coloured_m=1.5, correlation_s=7200.0), "vlbi_delay": Noise(white_m=0.38)},
    vlbi_station=Noise(white_m=0.15, coloured_m=0.1, correlation_s=5400.0),
)
WHITE = NoiseModel(
    {"range": Noise(white_m=2.0), "vlbi_delay": Noise(white_m=0.38)}, vlbi_station=Noise(white_m=0.18)
)


STATIONS_LAST = NoiseModel(
    {"range": Noise(white_m=2.0), "vlbi_delay": Noise(white_m=0.38)},
    vlbi_station=Noise(white_m=0.02, coloured_m=0.1, correlation_s=7200.0),
)


def trials(step_s, noise, weights, station_sigma_m=0.18, count=TRIALS):
    drawn = TruthSigma(position_enu_m=(0.0, 0.0, 5.0), range_bias_m=dict.fromkeys(RANGING, 10.0))
    study = study_of(
        sessions(step_s, STOP, sigmas_m=(2.0, 0.38)),
        noise,
        target=NEAR,
        estimate={"weights": weights},
        scenario={"truth_sigma": drawn, "seed": 20201201},
        observations=ObservationChoice(vlbi_station_sigma_m=station_sigma_m),
        name="plan",
    )
    result = radioloc.monte_carlo(study, count, (24.0,))
    assert result.converged
    assert result.linear
    return result


def rms_m(result):
    """Root mean square of the errors in space, m."""
    return float(np.linalg.norm(result.arcs[0].rms_m))


@pytest.mark.parametrize("step_s", [60.0, 10.0])
def test_errors_that_last(step_s):
    plain, weighed = (trials(step_s, LASTING, weights) for weights in ("independent", "correlated"))
    assert rms_m(weighed) < 0.85 * rms_m(plain)
    assert np.median(weighed["sigma_north_m"]) < np.median(plain["sigma_north_m"])
    for result in (plain, weighed):
        assert all(part.count >= HELD for part in result.arcs[0].coverage.values())
    # Not by sigmas that are too large: the mean of 64 sums of three squares over theirs.
    assert 0.7 < weighed.arcs[0].nees.mean < weighed.arcs[0].nees.high


def test_white_errors():
    plain, weighed = (trials(60.0, WHITE, weights) for weights in ("independent", "correlated"))
    # One fit of a hundred seems correlated by chance; three of 64 or more have a chance of 3 %.
    common = np.abs(weighed["north_m"] - plain["north_m"]) < SAME_M
    assert common.sum() >= TRIALS - 3
    assert rms_m(weighed) < 1.05 * rms_m(plain)
    assert all(part.count >= HELD for part in weighed.arcs[0].coverage.values())


@pytest.mark.parametrize("station_sigma_m", [0.01, 0.1])
def test_errors_of_stations_that_last(station_sigma_m):
    """A stated error of stations must not hide from the fit that theirs last, and the baselines' own do not."""
    result = trials(60.0, STATIONS_LAST, "independent", station_sigma_m, TRIAL_COUNT)
    assert all(part.count >= HELD_OF_MANY for part in result.arcs[0].coverage.values())
    assert 0.7 < result.arcs[0].nees.mean < result.arcs[0].nees.high
