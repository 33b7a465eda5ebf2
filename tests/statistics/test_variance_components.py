"""Excess noise over many seeded trials: how often it is added for nothing, its size, and honest sigmas with it."""

import numpy as np
import pytest
from quick import some

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components

N = 60
TRIALS = 300


def trial(excess_m, seed):
    rng = np.random.default_rng([20240502, seed])
    partials = np.column_stack([np.ones(N), np.sin(np.arange(N)), np.cos(1.7 * np.arange(N))])
    stated_m = 0.004 * np.exp(0.8 * rng.standard_normal(N))
    truth = rng.standard_normal(3)
    observed_m = partials @ truth + rng.standard_normal(N) * np.hypot(stated_m, excess_m)
    parameters = ParameterSet(Parameter(f"a.{k}", "m", "a") for k in range(3))
    result = fit_with_variance_components(
        lambda x: (observed_m - partials @ x, partials), parameters, stated_m
    )
    return result, (result.fit.x - truth) / result.fit.sigmas


@pytest.mark.study
def test_seldom_added_for_nothing():
    added = sum(trial(0.0, seed)[0].additive_sigma_m["all"] > 0.0 for seed in range(TRIALS))
    assert added <= 3  # one of a thousand is meant; four of 300 have a chance of 3e-4


@pytest.mark.slow
@pytest.mark.parametrize("excess_m", [0.01, 0.05])
def test_size_and_coverage(excess_m):
    excesses, errors = [], []
    for seed in range(TRIALS):
        result, error = trial(excess_m, seed)
        assert result.converged
        excesses.append(result.additive_sigma_m["all"])
        errors.append(error)
    # Standard error of the mean: about 1 / sqrt(2 * 57 * 300) = 0.5 % of it; it is biased by as much.
    assert np.mean(excesses) == pytest.approx(excess_m, rel=0.03)
    # 900 errors: 68.3 % within a sigma, with a standard error of 1.6 %; 95.4 % within two, 0.7 %.
    errors = np.abs(np.array(errors).ravel())
    assert np.mean(errors < 1.0) == pytest.approx(0.683, abs=0.06)
    assert np.mean(errors < 2.0) == pytest.approx(0.954, abs=0.03)


STATIONS = "ABC"


def stations(seed, counts=(60, 60, 60), own_m=(0.0, 0.0, 0.0), tau_s=0.0, stated_m=0.5):
    """Ranges of 1 m by three stations over two days, each with a bias; noise of their own, half of it correlated."""
    rng = np.random.default_rng([77, seed])
    station = np.repeat(np.arange(3), counts)
    time_s = np.concatenate([np.sort(rng.uniform(0.0, 172800.0, count)) for count in counts])
    angle = 2.0 * np.pi * time_s / 86164.0
    harmonics = [np.cos(angle + station), np.sin(angle + station), np.cos(2.0 * angle)]
    partials = np.column_stack([*harmonics, station[:, None] == np.arange(3)])
    noise = rng.standard_normal(len(station))
    if tau_s:
        for k in range(3):
            members = time_s[station == k]
            lasting = np.linalg.cholesky(
                np.exp(-np.abs(members[:, None] - members) / tau_s) + 1e-9 * np.eye(len(members))
            )
            noise[station == k] += lasting @ rng.standard_normal(len(members))
        noise /= np.sqrt(2.0)
    truth = rng.standard_normal(6)
    observed_m = partials @ truth + noise * np.hypot(1.0, np.array(own_m)[station])
    paths = Labels(station.astype(np.int32), tuple(f"U>x>{name}" for name in STATIONS))
    result = fit_with_variance_components(
        lambda x: (observed_m - partials @ x, partials),
        ParameterSet(Parameter(f"a.{k}", "m", "a") for k in range(6)),
        np.full(len(station), stated_m),
        order=SeriesOrder.from_labels(
            Labels(np.zeros(len(station), dtype=np.int32), ("range",)), paths, time_s
        ),
    )
    assert result.converged
    return result, (result.fit.x - truth) / result.fit.sigmas


@pytest.mark.study
@pytest.mark.parametrize(
    "case",
    some(
        [{}, {"counts": (200, 60, 12)}, {"counts": (8, 8, 8)}, {"counts": (300, 300, 300), "tau_s": 3600.0}],
        [{"counts": (200, 60, 12)}],
    ),
)
def test_a_station_is_seldom_singled_out_for_nothing(case):
    separate = [
        name
        for seed in range(TRIALS)
        for name in stations(seed, **case)[0].additive_sigma_m
        if " of " in name
    ]
    assert len(separate) <= 3  # one of a thousand is meant; four of 300 have a chance of 3e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own_m", "counts", "found_in"),
    [(3.0, (60, 60, 60), 1.0), (1.5, (60, 60, 60), 0.5), (3.0, (12, 60, 60), 0.3)],
)
def test_noise_of_a_station(own_m, counts, found_in):
    sizes_m, errors = [], []
    for seed in range(TRIALS // 2):
        result, error = stations(seed, counts, (own_m, 0.0, 0.0))
        if (size_m := result.additive_sigma_m.get("range of A")) is not None:
            sizes_m.append(size_m)
        errors.append(error)
    assert len(sizes_m) >= found_in * (TRIALS // 2)
    expected_m = np.sqrt(1.0 + own_m**2 - 0.25)
    if found_in == 1.0:  # else the larger ones are found
        assert np.mean(sizes_m) == pytest.approx(expected_m, rel=0.03)
    # 900 errors: standard errors of 1.6 and 0.7 %
    errors = np.abs(np.array(errors).ravel())
    assert np.mean(errors < 1.0) == pytest.approx(0.683, abs=0.06)
    assert np.mean(errors < 2.0) == pytest.approx(0.954, abs=0.06 if min(counts) < 20 else 0.03)


def test_one_quiet_station_of_three():
    result, _ = stations(0, own_m=(5.0, 5.0, 0.0))
    assert result.additive_sigma_m["range"] == pytest.approx(5.0, rel=0.2)
    assert result.additive_sigma_m["range of C"] == pytest.approx(np.sqrt(1.0 - 0.25), rel=0.3)


def test_a_station_within_its_sigmas_is_left_alone():
    """Others are quieter than stated, which is no reason to add noise to it."""
    result, _ = stations(1, own_m=(2.0, 0.0, 0.0), stated_m=3.0)
    assert result.additive_sigma_m == {"range": 0.0}
