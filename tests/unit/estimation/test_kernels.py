"""The Kalman filter of white noise plus Gauss-Markov processes against dense algebra, and sums over bins.

Quick without the compiler too, so that lines and mutants of compiled code can be seen: nothing here is larger than it
must be.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from radioloc.estimation.gauss_markov import (
    Points,
    RestrictedLikelihood,
    Series,
    SeriesNoise,
    half_products,
    mean_correlation,
)
from radioloc.estimation.series import CorrelatedWhitener, IndependentSeries, bins, points_of
from radioloc.noise.whitening import Blocks, Diagonal

ROUNDING = 1e-10


@pytest.fixture(scope="module")
def case():
    """Unevenly spaced points, two at one instant, some of them means of several observations."""
    rng = np.random.default_rng(1)
    step_s = rng.exponential(60.0, 150)
    step_s[[0, 40]] = 0.0
    step_s[80] = 20000.0
    gain = np.sqrt(rng.integers(1, 5, 150).astype(float))
    absorbed = np.linalg.qr(np.column_stack([gain, gain * np.linspace(-1.0, 1.0, 150)]))[0]
    return step_s, gain, np.column_stack([absorbed, rng.normal(size=150)])


def dense(step_s, gain, tau_s, ratio):
    time_s = np.cumsum(step_s)
    correlation = np.exp(-np.abs(time_s[:, None] - time_s) / tau_s)
    return np.eye(len(time_s)) + ratio * gain[:, None] * correlation * gain


TAU_S, RATIO = np.array([30.0, 600.0, 50000.0]), np.array([1e-4, 0.3, 200.0])
SIGMAS = np.array([30.0, 2.0])


@pytest.mark.parametrize("compiled", [False, True])
def test_restricted_likelihoods_are_those_of_dense_algebra(case, compiled):
    """Two series with parameters in common: each by itself, and both together with the variances of each."""
    step_s, gain, columns = case
    data, ends = two_series(step_s, gain, columns), [slice(0, 90), slice(90, 150)]
    data = replace(data, compiled=compiled)
    restricted = RestrictedLikelihood.from_points(data, np.arange(2), SIGMAS)
    log, white, joint_log, log_variance = restricted.evaluate(TAU_S, RATIO)
    effects = data.unit * SIGMAS

    def each(k, tau_s, ratio):
        series_covariance = dense(data.step_s[ends[k]], gain[ends[k]], tau_s, ratio)
        return *likelihood(series_covariance, effects[ends[k]], data.residual[ends[k]]), series_covariance

    def both(tau_s, ratio):
        result = [each(k, tau_s, ratio) for k in range(2)]
        covariance = effects @ effects.T
        for members, (_, variance, series_covariance) in zip(ends, result, strict=True):
            covariance[members, members] += variance * series_covariance
        squares = data.residual @ np.linalg.solve(covariance, data.residual)
        return -0.5 * (np.linalg.slogdet(covariance)[1] + squares), result

    null, null_each = both(1.0, 0.0)
    for k, (tau_s, ratio) in enumerate(itertools.product(TAU_S, RATIO)):
        entry, result = both(tau_s, ratio)
        assert joint_log[k] == pytest.approx(entry - null, rel=1e-9, abs=1e-9)
        for j in range(2):
            assert log[j, k] == pytest.approx(result[j][0] - null_each[j][0], rel=1e-9, abs=1e-9)
            assert white[j, k] == pytest.approx(result[j][1], rel=1e-9)
            columns = effects[ends[j]]
            information = np.eye(2) + columns.T @ np.linalg.solve(result[j][2], columns)
            relative = np.linalg.slogdet(information)[1] / max(restricted.absorbed[j], 1.0)
            assert log_variance[j, k] == pytest.approx(np.log(result[j][1]) - relative, rel=1e-6, abs=1e-6)


def two_series(step_s, gain, columns):
    """The case as two series of 90 and 60 points."""
    steps_s = step_s.copy()
    steps_s[90] = 0.0
    return Points(
        names("ab"),
        begin=np.array([0, 90, 150]),
        count=np.array([90, 60]),
        squares=np.array([columns[:90, 2] @ columns[:90, 2], columns[90:, 2] @ columns[90:, 2]]),
        width_s=np.zeros(2),
        step_s=steps_s,
        gain=gain,
        residual=columns[:, 2].copy(),
        unit=columns[:, :2].copy(),
    )


def likelihood(covariance, effects, residual):
    """Restricted, with coefficients of unit variance for columns of effects; and the variance that it is taken at."""
    felt = effects.T @ effects
    dof = len(residual) - np.trace(np.linalg.solve(np.eye(len(felt)) + felt, felt))
    total = covariance + effects @ effects.T
    variance = residual @ np.linalg.solve(total, residual) / dof
    return -0.5 * (dof * np.log(variance) + np.linalg.slogdet(total)[1]), variance


@pytest.mark.parametrize("width_s", [0.0, 300.0])
def test_restricted_likelihood_of_bins_is_that_of_their_observations(width_s):
    """Three observations a bin share what their mean has of the process; the rest of it is white noise among them."""
    each, tau_s, ratio = 3, 600.0, 2.0
    residual = np.random.default_rng(2).normal(size=(40, each))
    data = points(
        residual.sum(axis=1) / np.sqrt(each),
        np.full(40, 900.0),
        np.full(40, np.sqrt(each)),
        np.full((40, 1), np.sqrt(each)),
        residual.size,
        float((residual**2).sum()),
        width_s,
    )
    result = RestrictedLikelihood.from_points(data, np.array([0]), 30.0).evaluate(
        np.array([tau_s]), np.array([ratio])
    )
    mean = mean_correlation(width_s, np.array([tau_s]))[0]
    between = dense(np.full(40, 900.0), np.ones(40), tau_s, ratio * mean) - np.eye(40)
    contained = np.eye(each) - 1.0 / each
    covariance = np.eye(40 * each) + np.kron(between, np.ones((each, each)))
    covariance += ratio * (1.0 - mean) * np.kron(np.eye(40), contained)
    constant = np.full((40 * each, 1), 30.0)
    (entry, variance), (null, _) = (
        likelihood(matrix, constant, residual.ravel()) for matrix in (covariance, np.eye(40 * each))
    )
    assert result[0].item() == pytest.approx(entry - null, rel=1e-9)
    assert result[1].item() == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize("at_once", [40, 1000])
def test_whitening_is_a_root_of_the_inverse_covariance(case, at_once, monkeypatch):
    """Two series one behind the other, the second white."""
    monkeypatch.setattr("radioloc.noise.whitening.ROWS_AT_ONCE", at_once)
    step_s, _, columns = case
    noise = {
        "a": SeriesNoise(0.8, np.array([600.0]), np.array([2.4])),
        "b": SeriesNoise(4.0, np.ones(1), np.zeros(1)),
    }
    structures = (Diagonal(np.arange(150), np.full(150, 2.0)),)
    number = np.repeat([0, 1], [90, 60])
    series = IndependentSeries(150, structures, names("ab"), number, np.cumsum(step_s))
    result = CorrelatedWhitener.from_noise(series, noise)
    whitened = np.concatenate(list(result.whitened(lambda rows: np.eye(150)[rows])))
    expected = np.eye(150) / 16.0
    expected[:90, :90] = np.linalg.inv(4.0 * 0.8 * dense(step_s[:90], np.ones(90), 600.0, 3.0))
    np.testing.assert_allclose(whitened.T @ whitened, expected, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(np.triu(whitened, 1), 0.0, rtol=0.0, atol=ROUNDING)
    parts = list(result.whitened(lambda rows: columns[rows]))
    weighted = np.concatenate([values for _, values in result.transposed(parts)])
    np.testing.assert_allclose(weighted, expected @ columns, rtol=0.0, atol=ROUNDING)


def names(keys):
    return tuple(Series(key, key, "g", "range") for key in keys)


def test_noise_of_a_series_multiplies_as_its_covariance(case):
    step_s, gain, columns = case
    mixed = SeriesNoise(0.8, np.array([60.0, 600.0]), np.array([1.0, 2.0]))
    expected = 0.8 * (np.eye(150) + dense(step_s, gain, 60.0, 1.25) + dense(step_s, gain, 600.0, 2.5))
    expected -= 2.0 * 0.8 * np.eye(150)
    half = columns.T @ half_products([mixed], np.array([0, 150]), step_s, gain, columns)
    np.testing.assert_allclose(half + half.T, columns.T @ expected @ columns, rtol=1e-10)
    assert mixed.share == pytest.approx(3.0 / 3.8)


def test_mean_correlation_in_a_bin():
    instants_s = np.arange(600) * 0.5
    for tau_s in (30.0, 300.0, 30000.0):
        expected = np.exp(-np.abs(instants_s[:, None] - instants_s) / tau_s).mean()
        # Steps of 0.5 s leave (0.5 / tau)^2 / 12 of the mean.
        assert mean_correlation(300.0, np.array([tau_s]))[0] == pytest.approx(expected, rel=3e-5)
    assert mean_correlation(0.0, np.array([3.0])).tolist() == [1.0]


def test_sections_hold_all_combinations_of_their_series(monkeypatch):
    """Two series one behind the other, then two of combinations in turn, from parts of seven rows."""
    monkeypatch.setattr("radioloc.estimation.series.ROWS_AT_ONCE", 8)
    number, columns = np.array([0] * 9 + [1] * 3 + [2, 3] * 6), np.random.default_rng(1).normal(size=(24, 2))
    series = IndependentSeries(24, (), names("abcd"), number, np.arange(24.0))
    sections = list(series.sections(np.split(columns, [7, 14, 21])))
    assert [numbers for _, numbers, _ in sections] == [[0], [1, 2, 3]]
    for part, _, values in sections:
        np.testing.assert_array_equal(values, columns[part])


@pytest.mark.parametrize("at_once", [4, 1000])
def test_sums_of_bins_are_those_of_whitened_values(monkeypatch, at_once):
    """Twelve times two observations that are combined, in bins of some, so many at a time."""
    monkeypatch.setattr("radioloc.noise.whitening.ROWS_AT_ONCE", at_once)
    monkeypatch.setattr("radioloc.estimation.series.MAX_POINTS", 4)
    rng = np.random.default_rng(3)
    values, rows = rng.normal(size=(24, 3)), rng.permutation(24).reshape(12, 2)
    blocks = Blocks(rows, np.arange(12), rng.normal(size=(12, 2, 2)), np.ones((12, 2)))
    time_s = 60.0 * np.arange(12)
    series = IndependentSeries(24, (blocks,), names("ab"), np.tile([0, 1], 12), np.repeat(time_s, 2))
    result = points_of(series, lambda rows: values[rows])
    whitened = np.moveaxis(blocks.roots @ values[rows], 1, 0)
    place, _ = bins(time_s, 4)
    in_bin = place == np.arange(place[-1] + 1)[:, None]
    expected = (in_bin @ whitened / np.sqrt(in_bin.sum(axis=1))[:, None]).reshape(-1, 3)
    np.testing.assert_allclose(np.column_stack([result.residual, result.unit]), expected, rtol=1e-12)
    np.testing.assert_allclose(result.squares, (whitened[:, :, 0] ** 2).sum(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(result.step_s[result.begin[:-1]], 0.0)


def points(residual, step_s, gain, unit, count, squares, width_s):
    n = len(residual)
    return Points(
        names("a"),
        begin=np.array([0, n]),
        count=np.array([count]),
        squares=np.array([squares]),
        width_s=np.array([width_s]),
        step_s=step_s,
        gain=gain,
        residual=residual,
        unit=unit,
    )
