"""Distribution of simulated noise, and its effect on a fitted position.

Bounds are those of chance at a probability of 1e-5 (chi-square, normal); with fixed seeds a failure is a change of the
code, not of luck.
"""

import numpy as np
import pytest

from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, all_ranges, baselines

RUNS = 400
# Chi-square of 400 * 3 degrees of freedom over 400: 1e-5 and 1 - 1e-5 quantiles are 2.506 and 3.551.
NEES_3 = (2.50, 3.55)
VLBI = ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
# All four stations see the lander.
START, STOP = "2020-12-01T15:11", "2020-12-01T23:07"


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=["troposphere"])


def prepared(model, *sessions):
    lander = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    return Scenario(Schedule(sessions), lander).world(model)


def nees(world, model, noise):
    """Squared error of the fitted position in its formal covariance, by run; the fit is linear at the truth."""
    partials = (
        ExactPredictor(model, world.plan.observations, FixedPoint(world.targets[0].position_pa_m))
        .compute()
        .by_position_pa
        / world.plan.observations.sigma_m[:, None]
    )
    information = partials.T @ partials
    result = []
    for seed in range(RUNS):
        right_side = partials.T @ (world.draw(noise, seed=seed).noise_m / world.plan.observations.sigma_m)
        result.append(right_side @ np.linalg.solve(information, right_side))
    return np.array(result)


@pytest.mark.slow
def test_white_noise_gives_positions_as_uncertain_as_the_sigmas_say(model):
    world = prepared(
        model,
        Session("range", all_ranges("JIAMUSI", "KASHI"), START, STOP, 1800.0, 3.0, one_uplink=True),
        Session("vlbi_delay", baselines(*VLBI), START, STOP, 1800.0, 0.5),
    )
    noise = NoiseModel({"range": Noise(white_m=3.0), "vlbi_delay": Noise(white_m=0.5)})
    assert NEES_3[0] < nees(world, model, noise).mean() < NEES_3[1]


@pytest.mark.slow
def test_six_baselines_of_four_stations_are_not_six_independent_delays(model):
    # With the same error at every station, the six differences of four arrival times tell what the four themselves do.
    # Weighted as if independent they claim twice that information: sum over i < j of (h_i - h_j)(h_i - h_j)' / (2 s^2)
    # is 4/2 times the sum over i of (h_i - mean)(h_i - mean)' / s^2.
    world = prepared(model, Session("vlbi_delay", baselines(*VLBI), START, STOP, 1800.0, 0.5))
    assert len(world.plan.observations) == 6 * 16
    station = NoiseModel(vlbi_station=Noise(white_m=0.5 / np.sqrt(2.0)))
    assert 2.0 * NEES_3[0] < nees(world, model, station).mean() < 2.0 * NEES_3[1]
    thermal = NoiseModel({"vlbi_delay": Noise(white_m=0.5)})
    assert NEES_3[0] < nees(world, model, thermal).mean() < NEES_3[1]


def test_covariance_between_baselines(model):
    world = prepared(model, Session("vlbi_delay", baselines(*VLBI), START, STOP, 60.0, 0.5))
    noise = NoiseModel({"vlbi_delay": Noise(white_m=0.5)}, vlbi_station=Noise(white_m=1.0))
    paths = world.plan.observations.paths()
    names = [f"{first}<lander>{second}" for first, second in baselines(*VLBI)]
    drawn = [world.draw(noise, seed=seed).noise_m for seed in range(20)]
    series = np.array([np.concatenate([noise_m[paths == name] for noise_m in drawn]) for name in names])
    n = series.shape[1]
    assert n == 20 * 477
    differences = np.zeros((6, 4))
    for row, (first, second) in enumerate(baselines(*range(4))):
        differences[row, [first, second]] = -1.0, 1.0
    expected = differences @ differences.T + 0.25 * np.eye(6)
    # A covariance of n normals has the variance (s_ii s_jj + s_ij^2) / n; 4.9 of its roots for 1e-5 over 21 of them.
    root = np.sqrt((np.multiply.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert (np.abs(series @ series.T / n - expected) < 4.9 * root).all()


def test_coloured_noise_has_its_variance_and_correlation_time():
    noise, step_s = Noise(coloured_m=2.0, correlation_s=600.0), 60.0
    runs = np.array([noise.series(41, step_s, [seed], "a")[0][0] for seed in range(4000)])
    # From the first epoch on: the process is stationary.
    for lag in (0, 1, 10, 40):
        expected = 4.0 * np.exp(-lag * step_s / 600.0)
        result = (runs[:, 0] * runs[:, lag]).mean()
        # As above, of 4000 runs; 4.4 standard deviations for 1e-5.
        assert abs(result - expected) < 4.4 * np.sqrt((16.0 + expected**2) / 4000.0)
    assert abs(runs.mean()) < 4.4 * 2.0 / np.sqrt(4000.0)


def test_links_are_independent(model):
    world = prepared(model, Session("range", all_ranges("JIAMUSI", "KASHI"), START, STOP, 60.0, 1.0))
    noise = NoiseModel({"range": Noise(white_m=1.0)})
    paths = world.plan.observations.paths()
    noise_m = world.draw(noise, seed=11).noise_m
    series = np.array([noise_m[paths == name][:470] for name in sorted(set(paths.tolist()))])
    assert len(series) == 4
    correlation = np.corrcoef(series)[np.triu_indices(4, 1)]
    # Of 470 pairs of independent normals: 1/sqrt(470) each, 4.8 of it for 1e-5 over six of them.
    assert np.abs(correlation).max() < 4.8 / np.sqrt(470.0)
    # White: the same from epoch to epoch.
    assert abs(np.corrcoef(series[0][1:], series[0][:-1])[0, 1]) < 4.4 / np.sqrt(470.0)
