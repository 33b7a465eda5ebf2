"""Groups taken out of a fit, and columns added to it, from products of matrices: against fits without them."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.gauss_markov import SeriesNoise
from radioloc.estimation.group_tests import BinnedProblem, chi2_log_p_value
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.series import SeriesOrder
from radioloc.noise import ObservationCovariance, SharedAtEpoch, White

PATHS = ("A<x>B", "A<x>C", "B<x>C")
N = 36  # epochs: too few for sums over time to say anything
STOPPED = 2e-3
"""Fits stop within a thousandth of a sigma, two of them within twice that; all sigmas here are about one."""


def problem(seed, noise):
    rng = np.random.default_rng(seed)
    n = N * len(PATHS)
    matrix = rng.normal(size=(n, 4))
    residual_m = matrix @ np.array([3.0, -2.0, 0.5, 0.0]) + rng.normal(size=n)
    parameters = ParameterSet(
        [Parameter(name, "m", "position", prior_sigma=2.0) for name in ("position.a", "position.b")]
        + [Parameter("range_bias.c", "m", "range_bias"), Parameter("clock.d", "m", "clock")]
    )

    def linear(at):
        return residual_m - matrix @ at, matrix

    paths = Labels(np.tile(np.arange(3, dtype=np.int32), N), PATHS)
    order = SeriesOrder.from_labels(
        Labels(np.zeros(n, dtype=np.int32), ("vlbi_delay",)), paths, np.repeat(60.0 * np.arange(N), 3)
    )
    fit = fit_least_squares(linear, parameters, noise)

    def white(points):
        return {item.key: SeriesNoise(1.0, np.ones(1), np.zeros(1)) for item in points.series}

    return linear, order, fit, BinnedProblem.from_fit(fit, order, white)


def shared():
    n = 3 * N
    stations = np.array([(0, 1), (0, 2), (1, 2)])
    effects_m = np.tile([[-0.7, 0.7]], (n, 1))
    term = SharedAtEpoch(np.repeat(np.arange(N), 3), np.tile(stations, (N, 1)), effects_m)
    return ObservationCovariance((White(np.ones(n)), term))


def test_without_a_group():
    linear, order, fit, binned = problem(1, ObservationCovariance.from_sigma(0.9, 3 * N))
    for code in range(3):
        verdict = binned.test(binned.removal({code: 1.0}))
        reference = fit_least_squares(linear, fit.parameters, fit.noise, used=order.code != code)
        shift = fit.factor.root_covariance() @ verdict.shift
        np.testing.assert_allclose(shift, reference.x - fit.x, atol=STOPPED)
        # Of efficient estimates the covariance of the difference is the difference of the covariances
        root = fit.factor.root_covariance() @ verdict.shift_root_covariance
        np.testing.assert_allclose(root @ root.T, reference.covariance - fit.covariance, atol=1e-9)
        assert verdict.dof == 4


def test_a_group_is_removed_by_no_more_columns_than_points():
    linear, order, fit, binned = problem(1, ObservationCovariance.from_sigma(0.9, 3 * N))
    columns = binned.removal({1: 1.0}, (0.0, 60.0))
    assert columns.shape[1] == columns.toarray().any(axis=1).sum() == 2
    reference = fit_least_squares(
        linear, fit.parameters, fit.noise, used=(order.code != 1) | (order.time_s > 60.0)
    )
    shift = fit.factor.root_covariance() @ binned.test(columns).shift
    np.testing.assert_allclose(shift, reference.x - fit.x, atol=STOPPED)


@pytest.mark.parametrize(
    "noise", [ObservationCovariance.from_sigma(0.9, 3 * N), shared()], ids=["alone", "shared"]
)
def test_added_columns(noise):
    """A step of a station, with its sign in two baselines, is what a fit with the step estimates."""
    linear, order, fit, binned = problem(2, noise)
    signs = {0: -1.0, 1: -1.0}
    column = np.where(order.time_s >= 600.0, np.array([signs.get(c, 0.0) for c in order.code.tolist()]), 0.0)
    larger = ParameterSet([*fit.parameters, Parameter("step", "m", "step")])

    def with_step(at):
        residual_m, matrix = linear(at[:-1])
        return residual_m - column * at[-1], np.column_stack([matrix, column])

    refit = fit_least_squares(with_step, larger, noise)
    verdict = binned.test(binned.columns(signs, (600.0, np.inf)))
    assert verdict.estimate[0] == pytest.approx(refit.x[-1], abs=STOPPED)
    np.testing.assert_allclose(
        fit.factor.root_covariance() @ verdict.shift, refit.x[:-1] - fit.x, atol=STOPPED
    )
    assert verdict.chi2 == pytest.approx(fit.chi2 - refit.chi2, rel=1e-4)
    edges_s = 60.0 * np.arange(3, N - 3)
    chi2 = binned.chi2_of_steps(signs, edges_s)
    assert chi2[7] == pytest.approx(verdict.chi2)
    of_each = [binned.test(binned.columns(signs, (edge_s, np.inf))).chi2 for edge_s in edges_s]
    np.testing.assert_allclose(chi2, of_each, rtol=1e-9)


def test_a_column_that_the_parameters_hold_already():
    *_, fit, binned = problem(3, ObservationCovariance.from_sigma(1.0, 3 * N))
    clock = np.linalg.inv(fit.factor.root_covariance())[:, 3:]  # it has no a-priori sigma
    held = np.concatenate([binned.points.unit @ clock, np.zeros((2, 1))])
    assert binned.test(csc_array(held)) is None


def test_estimate_does_not_depend_on_the_size_of_a_column():
    """A scale factor of 1e8 m beside noise of as much, as of halved ranges, is a small column after whitening."""
    *_, binned = problem(3, ObservationCovariance.from_sigma(1.0, 3 * N))
    step = binned.columns({1: 1.0}, (600.0, np.inf))
    estimate, small = (binned.with_parameters(size * step).estimate[-1] for size in (1.0, 1e-9))
    assert small == pytest.approx(1e9 * estimate, rel=1e-6)


@pytest.mark.study
def test_chance_is_uniform():
    """Chi-square of 200 problems without misfit: the mean of -log of the chance is one, to 3 / sqrt(200)."""
    logs = []
    for seed in range(200):
        *_, binned = problem(seed, ObservationCovariance.from_sigma(1.0, 3 * N))
        logs.append(binned.test(binned.removal({1: 1.0})).log_p_value)
    assert -np.mean(logs) == pytest.approx(1.0, abs=0.22)


def test_chances_far_below_what_floats_hold():
    assert chi2_log_p_value(3.841, 1) == pytest.approx(np.log(0.05), rel=1e-3)
    below_switch, above_switch = chi2_log_p_value(1280.0, 3), chi2_log_p_value(1300.0, 3)
    assert above_switch - below_switch == pytest.approx(-10.0, abs=0.1)


def test_noise_of_a_series_allows_for_its_redundancy():
    random = np.random.default_rng(8)
    design, noise_m = random.normal(size=(200, 150)), random.normal(size=200)
    parameters = ParameterSet([Parameter(f"night.{k}", "m", "night") for k in range(150)])
    covariance = ObservationCovariance.from_sigma(1.0, 200)
    result = fit_least_squares(lambda x: (noise_m - design @ x, design), parameters, covariance)
    codes = np.zeros(200, dtype=np.int32)
    order = SeriesOrder.from_labels(
        Labels(codes, ("range",)), Labels(codes, ("A>x>A",)), 60.0 * np.arange(200.0)
    )
    [variance] = BinnedProblem.from_fit(result, order, lambda points: {}).white
    assert variance == pytest.approx(1.0, abs=0.6)  # three standard deviations of 50 degrees of freedom
