"""Series weighed by the inverse covariance of their noise: generalized least squares, honest sigmas."""

import numpy as np
import pytest

from radioloc.estimation import Labels, Parameter, ParameterSet, observability
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.gauss_markov import SeriesNoise
from radioloc.estimation.linearization import DenseLinearization, covariance_matrix, factorize, refreshed
from radioloc.estimation.series import CorrelatedWhitener, SeriesOrder, independent_series
from radioloc.estimation.time_correlation import assess_time_correlation, fit_with_correlated_weights
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


class ByPass:
    """Partials of which each column acts in a part of the observations only, as those of passes."""

    def __init__(self, design, residual_m):
        self.design, self.residual_m = design, residual_m

    def partials(self, rows):
        return self.design[rows]

    estimated_partials = partials

    def row_order(self):
        return np.arange(len(self.residual_m))

    def nonzero_partials(self, rows):
        parameters = np.flatnonzero(self.design[rows].any(axis=0))
        return parameters, self.design[np.ix_(rows, parameters)]


def test_filter_continues_over_parts_with_other_columns(monkeypatch):
    monkeypatch.setattr("radioloc.noise.whitening.ROWS_AT_ONCE", 300)
    case = TwoSeries()
    rows = np.arange(2 * N)
    passes = np.stack([(rows // 250) % 5 == k for k in (3, 0, 2, 1)], axis=1) * 1.0
    design = np.hstack([case.design[:, :2], passes])
    parameters = ParameterSet([Parameter(f"p{k}", "m", "p", 0.0, 10.0) for k in range(6)])
    edited = fit_with_editing(lambda x: (case.observed, design), parameters, case.sigma)
    order = SeriesOrder.from_labels(case.types, labels(2 * N, "A"), case.time_s)
    series = independent_series(order, edited.fit.noise, edited.fit.used)
    noise = {item.key: SeriesNoise(1.0, np.array([TAU_S]), np.ones(1)) for item in series.series[:1]}
    whitening = CorrelatedWhitener.from_noise(series, noise)
    items = DenseLinearization(case.observed, design), ByPass(design, case.observed)
    dense, sparse = (factorize(item, whitening, parameters, np.zeros(6)) for item in items)
    np.testing.assert_allclose(
        covariance_matrix(sparse, parameters), covariance_matrix(dense, parameters), rtol=0.0, atol=1e-12
    )
    renewed = refreshed(sparse, items[1], whitening, parameters, np.zeros(6))
    np.testing.assert_allclose(renewed.step(0.0), dense.step(0.0), rtol=0.0, atol=1e-9)


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
