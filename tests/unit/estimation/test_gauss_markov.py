"""Noise models that are estimated from series of residuals."""

import numpy as np

from radioloc.estimation.gauss_markov import (
    RATIOS,
    Points,
    RestrictedLikelihood,
    Series,
    SeriesNoise,
    half_products,
    noise_of_series,
)
from radioloc.simulation.noise import Noise


def points(residual, step_s=None, gain=None, unit=None):
    n = len(residual)
    return Points(
        (Series("a", "a", "g", "range"),),
        begin=np.array([0, n]),
        count=np.array([n]),
        squares=np.array([residual @ residual]),
        width_s=np.zeros(1),
        step_s=np.full(n, 60.0) if step_s is None else step_s,
        gain=np.ones(n) if gain is None else gain,
        residual=residual,
        unit=np.zeros((n, 1)) if unit is None else unit,
    )


def variance_of_mean(noise, data):
    return (
        2.0 * half_products([noise], data.begin, data.step_s, data.gain, np.full((1440, 1), 1440.0**-2)).sum()
    )


def test_flicker_noise_is_not_taken_for_one_short_process():
    """The uncertainty of a mean is compared: one process alone, of the likeliest time, has too little there."""
    stated, item, true = np.zeros(40), np.zeros(40), np.zeros(40)
    for seed in range(40):
        residual = Noise(white_m=1.0, flicker_m=0.7).series(1440, 60.0, [seed], "a")[0][0]
        true[seed] = residual.mean() ** 2
        data = points(residual - residual.mean(), unit=np.full((1440, 1), 1440.0**-0.5))
        noise = noise_of_series(data, 30.0)["a"]
        stated[seed] = variance_of_mean(noise, data)
        single = SeriesNoise(noise.white, np.array([noise.correlation_time_s]), noise.coloured.sum()[None])
        item[seed] = variance_of_mean(single, data)
    # Chi-square of 40 over 40 is below 1.48 but for 2.5 %; what is stated has more, as flicker noise goes on below the
    # frequencies that were drawn: a fifth process, three times as long as the data, nearly doubles it.
    assert 0.4 < (true / stated).mean() < 1.48
    assert (true / item).mean() > 1.48


def test_what_is_considered_is_no_noise():
    """A slope whose sigma is known explains what else would be correlated in time."""
    rng = np.random.default_rng(7)
    n = 400
    slope = np.linspace(-1.0, 1.0, n)[:, None]
    data = points(rng.normal(size=n) + 1.5 * slope[:, 0], unit=slope)
    assert noise_of_series(data, 0.0)["a"].share > 0.2
    assert noise_of_series(data, 1.5) == {}


def test_correlation_that_is_likely_but_not_significant_is_not_adopted():
    data = points(np.random.default_rng(15).normal(size=120))
    likelihood = RestrictedLikelihood.from_points(data, np.array([0]), 0.0)
    *_, joint, _ = likelihood.evaluate(np.array([30.0, 60.0, 240.0]), RATIOS[::4])
    # More likely than white noise, less than 4.6, the limit for two further parameters at 1 %.
    assert 2.0 < joint.max() < 4.6
    assert noise_of_series(data, 0.0) == {}
