"""Series weighed by the inverse covariance of their noise: generalized least squares, honest sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from radioloc.estimation import Labels, Parameter, ParameterSet, observability
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.gauss_markov import SeriesNoise
from radioloc.estimation.linearization import (
    DenseLinearization,
    covariance_matrix,
    factorize,
    with_new_right_side,
)
from radioloc.estimation.series import CorrelatedWhitener, SeriesOrder, independent_series
from radioloc.estimation.smooth_partials import Cells, SmoothPartials
from radioloc.estimation.time_correlation import assess_time_correlation, fit_with_correlated_weights
from radioloc.noise import ObservationCovariance, SharedAtEpoch, White
from radioloc.simulation.noise import gauss_markov

STEP_S, TAU_S, N = 60.0, 3600.0, 1200
ROUNDING = 1e-8


def assessed(fit, types, paths, time_s):
    return assess_time_correlation(fit, SeriesOrder.from_labels(types, paths, time_s))


def weighed(residual_function, edited, types, paths, time_s):
    return fit_with_correlated_weights(
        residual_function, edited, SeriesOrder.from_labels(types, paths, time_s)
    )


def labels(n, text):
    return Labels(np.zeros(n, dtype=np.int32), (text,))


class TwoSeries:
    """Observations whose errors last and that have a bias in common, and as many white, less certain ones without."""

    def __init__(self, coloured=1.0, seed=0, bias_sigma=0.05):
        rng = np.random.default_rng(seed)
        self.time_s = np.tile(STEP_S * np.arange(N), 2)
        self.types = Labels(np.repeat(np.arange(2, dtype=np.int32), N), ("range", "delay"))
        lasting, slope = np.repeat([1.0, 0.0], N), np.tile(np.linspace(-1.0, 1.0, N), 2)
        self.design = np.column_stack([np.ones(2 * N), slope, lasting])
        self.sigma = np.where(lasting == 1.0, np.hypot(1.0, coloured), 8.0)
        error = self.sigma * rng.normal(size=2 * N)
        error[:N] = rng.normal(size=N) + coloured * gauss_markov(rng.normal(size=N), np.exp(-STEP_S / TAU_S))
        self.parameters = ParameterSet(
            [Parameter("a", "m", "p"), Parameter("b", "m", "p"), Parameter("bias", "m", "p", 0.0, bias_sigma)]
        )
        lag_s = np.abs(self.time_s[:N, None] - self.time_s[None, :N])
        self.covariance = np.diag(self.sigma**2)
        self.covariance[:N, :N] = np.eye(N) + coloured**2 * np.exp(-lag_s / TAU_S)
        self.observed = error
        self.prior = np.diag([0.0, 0.0, bias_sigma**-2.0])

    def residuals(self, x):
        return self.observed - self.design @ x, self.design

    def fits(self, status=None):
        edited = fit_with_editing(self.residuals, self.parameters, self.sigma, status=status)
        result = weighed(self.residuals, edited, self.types, labels(2 * N, "A"), self.time_s)
        return edited, result

    def model(self, fit):
        """Covariance that a fit weighs with, dense."""
        noise = fit.time_correlation.noise["range A"]
        lag_s = np.abs(self.time_s[:N, None] - self.time_s[None, :N])
        correlated = noise.ratio * np.exp(-lag_s / noise.correlation_time_s)
        covariance = np.diag(self.sigma**2)
        covariance[:N, :N] = noise.white * (np.eye(N) + correlated) * self.sigma[:N, None] * self.sigma[:N]
        return covariance

    def covariances(self, model, errors):
        """Inverse information with the inverse of a model as weights, and the estimate's covariance for some errors."""
        weighted = np.linalg.solve(model, self.design)
        inverse = np.linalg.inv(self.design.T @ weighted + self.prior)
        return inverse, inverse @ (weighted.T @ errors @ weighted + self.prior) @ inverse


@pytest.mark.study
def test_estimate_and_covariance_are_those_of_the_weights():
    case = TwoSeries()
    fit = case.fits()[1].fit
    model = case.model(fit)
    inverse, formal = case.covariances(model, np.diag(case.sigma**2))
    # Formal: errors as stated, weighed otherwise.
    np.testing.assert_allclose(fit.covariance, formal, rtol=0.0, atol=ROUNDING)
    expected = inverse @ case.design.T @ np.linalg.solve(model, case.observed)
    np.testing.assert_allclose(fit.x, expected, rtol=0.0, atol=1e-6)
    added = assessed(fit, case.types, labels(2 * N, "A"), case.time_s).added_covariance
    claimed = np.sqrt(np.diag(fit.covariance + added))
    true = np.sqrt(np.diag(case.covariances(model, case.covariance)[1]))
    # Twenty correlation times of noise tell its size to some thirty per cent.
    np.testing.assert_allclose(claimed, true, rtol=0.3)
    assert np.linalg.eigvalsh(added).min() > -ROUNDING


class Tracking:
    """Two links for an hour at 1 Hz, some epochs missing, with partials that jump in one of the links."""

    time_s = np.repeat(np.arange(3600.0), 2)
    link = np.tile(np.arange(2), 3600)
    used = np.random.default_rng(3).random(7200) > 0.01

    def __init__(self):
        angle = 2.0 * np.pi * self.time_s / 86164.0 + self.link
        jump = (self.link == 1) & (self.time_s > 1000.0)
        self.design = np.column_stack(
            [np.cos(angle), np.sin(angle), self.link == 0, jump, self.time_s / 3600.0]
        )
        self.residual_m = np.random.default_rng(4).normal(size=7200)
        self.smooth = SmoothPartials.from_nodes(Cells.from_keys((self.link,), self.time_s), self.partials)

    def partials(self, rows):
        return self.design[rows]


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("correlated", [False, True])
def test_polynomials_give_the_factor_of_all_rows(shared, correlated):
    tracking, n = Tracking(), 7200
    noise = ObservationCovariance((White(np.where(tracking.time_s < 2000.0, 1.0, 2.0)),))
    if shared:
        sources = np.zeros((n, 1), dtype=np.intp)
        noise = noise.plus(SharedAtEpoch(tracking.time_s.astype(np.intp), sources, np.ones((n, 1))))
    order = SeriesOrder.from_labels(
        labels(n, "range"), Labels(tracking.link.astype(np.int32), ("A", "B")), tracking.time_s
    )
    series = independent_series(order, noise, tracking.used)
    process = SeriesNoise(1.0, *((np.ones(1), np.zeros(1)) if shared else (np.array([TAU_S]), np.ones(1))))
    keys = [item.key for item in series.series]
    whitening = CorrelatedWhitener.from_noise(
        series, {keys[0]: process, keys[-1]: replace(process, white=4.0)}
    )
    whitening = whitening if correlated else noise.whitener(tracking.used)
    parameters = ParameterSet([Parameter(f"p{k}", "m", "p", 0.0, 10.0) for k in range(5)])
    dense = factorize(
        DenseLinearization(tracking.residual_m, tracking.design), whitening, parameters, np.zeros(5)
    )
    smooth = factorize(tracking, whitening, parameters, np.zeros(5))
    assert 0 < np.count_nonzero(tracking.smooth.cell < 0) < 1000
    for result in (smooth, with_new_right_side(smooth, tracking, whitening, parameters, np.zeros(5))):
        expected = covariance_matrix(dense, parameters)
        np.testing.assert_allclose(covariance_matrix(result, parameters), expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(result.step(0.0), dense.step(0.0), rtol=1e-8, atol=1e-10)
    rows = np.arange(0, n, 7)
    np.testing.assert_allclose(tracking.smooth.combined(np.eye(5))(rows), tracking.design[rows], atol=1e-9)


def test_white_residuals_change_nothing():
    edited, result = TwoSeries(coloured=0.0).fits()
    assert result.series_weights == ()
    assert result.fit.x is edited.fit.x
    assert result.fit.whitening is edited.fit.whitening
    # What was looked for once is not looked for again.
    assert result.fit.time_correlation.series == ()


def test_observability_is_that_of_the_weights(monkeypatch):
    """Weak directions and correlations are of one covariance, that of the weights, which is above the formal one."""
    monkeypatch.setattr(observability, "WEAK_FACTOR", 1e-4)
    monkeypatch.setattr(observability, "STRONG_CORRELATION", 0.01)
    case = TwoSeries(bias_sigma=1.0)
    fit = case.fits()[1].fit
    covariance, _ = case.covariances(case.model(fit), np.diag(case.sigma**2))
    assert (np.diag(covariance) > 1.5 * np.diag(fit.covariance)).any()
    result = observability.assess_observability(fit)
    sigmas = np.sqrt(np.linalg.eigvalsh(covariance))[::-1]
    np.testing.assert_allclose([item.sigma for item in result.weak], sigmas, rtol=ROUNDING)
    expected = observability.correlation_matrix(covariance)
    assert result.correlations
    for item in result.correlations:
        i, j = (["a", "b", "bias"].index(name) for name in (item.first, item.second))
        assert item.coefficient == pytest.approx(expected[i, j], abs=ROUNDING)
