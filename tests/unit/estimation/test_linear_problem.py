"""Fits of a prepared linear problem are those of the general one, editing and variance components included."""

from dataclasses import replace

import numpy as np
import pytest

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.consider import consider_sensitivity
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.linearization import OrthonormalLinearization
from radioloc.estimation.robust import linear_problem
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.noise import ObservationCovariance, SharedAtEpoch, White
from radioloc.parameters.parameter import Role

SAME_SIGMAS = 1e-8
"""Both solve the same linear problem to rounding; what remains is the conditioning of the random ones."""


def problem(rng, n, *, fixed=False):
    """Ranges, delays of two sigmas; a bias of the ranges with an a-priori value, a parameter of another scale."""
    group = (np.arange(n) % 3 > 0).astype(np.int32)
    sigma_m = np.where(group == 0, 2.0, np.where(np.arange(n) % 2, 0.5, 0.4))
    partials = np.column_stack(
        [rng.standard_normal((n, 3)), group == 0, 1e6 * rng.standard_normal(n) * (group == 1)]
    ).astype(float)
    parameters = ParameterSet(
        [
            *(Parameter(f"position.{axis}", "m", "position", 10.0 * k) for k, axis in enumerate("xyz")),
            Parameter("bias", "m", "bias", 1.0, 3.0),
            Parameter("rate", "s", "rate", 0.0, scale=1e-6, role=Role.FIXED if fixed else Role.ESTIMATED),
        ]
    )
    return partials, parameters, sigma_m, group


def both(seed, *, n=600, excess=1.0, outliers=0, fixed=False, unusable=0):
    rng = np.random.default_rng([20260101, seed])
    partials, parameters, sigma_m, group = problem(rng, n, fixed=fixed)
    x = np.array([1.0, 2.0, 3.0, 4.0, 0.0])
    residual_m = excess * sigma_m * rng.standard_normal(n) + partials @ np.array([0.3, -0.2, 0.1, 0.5, 0.0])
    residual_m[rng.choice(n, outliers, replace=False)] += 40.0
    usable = np.ones(n, dtype=bool)
    usable[:unusable] = False
    calls = linear_problem(partials, parameters, x, ObservationCovariance((White(sigma_m),)), usable)

    def fit(linear):
        return fit_with_variance_components(
            linear,
            parameters,
            sigma_m,
            order=SeriesOrder.from_labels(
                Labels(group.astype(np.int32), ("range", "vlbi_delay")),
                Labels.from_texts(np.full(n, "A")),
                np.arange(n),
            ),
            status=np.where(usable, "used", "below the horizon"),
        )

    return fit(calls.residual_function(residual_m)), fit(
        lambda at: (residual_m - partials @ (at - x), partials)
    )


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"excess": 2.5},
        {"excess": 0.5},
        {"outliers": 30},
        {"outliers": 20, "excess": 3.0},
        {"fixed": True},
        {"unusable": 100, "outliers": 5},
        {"n": 12},
        {"n": 3000, "outliers": 30},
        {"n": 40, "outliers": 3},
        {"outliers": 220},
    ],
    ids=str,
)
def test_the_same_as_the_general_fit(case):
    for seed in range(5):
        result, prior = both(seed, **case)
        item, fit = result.fit, prior.fit
        free = fit.parameters.free
        np.testing.assert_allclose((item.x - fit.x)[free] / fit.sigmas[free], 0.0, atol=SAME_SIGMAS)
        np.testing.assert_allclose(item.covariance, fit.covariance, rtol=1e-6, atol=1e-9 * fit.sigmas.max())
        np.testing.assert_allclose(
            list(result.additive_sigma_m.values()),
            list(prior.additive_sigma_m.values()),
            rtol=1e-8,
            atol=1e-12,
        )
        assert (item.used == fit.used).all()
        np.testing.assert_allclose(item.residual_m[item.used], fit.residual_m[fit.used], rtol=0.0, atol=1e-9)
        root = item.factor.root_covariance()
        np.testing.assert_allclose(root @ root.T, fit.covariance[np.ix_(free, free)], rtol=1e-6)
        assert item.chi2 == pytest.approx(fit.chi2)
        assert result.converged == prior.converged


def test_nothing_is_made_where_not_everything_is_determined():
    partials, parameters, sigma_m, _ = problem(np.random.default_rng(1), 100)
    partials[:, 1] = partials[:, 0]
    usable = np.ones(100, bool)
    assert (
        linear_problem(partials, parameters, np.zeros(5), ObservationCovariance((White(sigma_m),)), usable)
        is None
    )


@pytest.mark.parametrize("prepared", [False, True])
def test_the_same_where_observations_share_errors(prepared):
    rng = np.random.default_rng(2)
    partials, parameters, sigma_m, _ = problem(rng, 300)
    source = np.stack([np.arange(300) % 3, (np.arange(300) + 1) % 3], axis=-1)
    shared = SharedAtEpoch(np.arange(300) // 3, source, np.tile([-0.3, 0.3], (300, 1)))
    noise = ObservationCovariance((White(sigma_m), shared))
    residual_m, x, used = sigma_m * rng.standard_normal(300), np.zeros(5), rng.random(300) > 0.02
    order = SeriesOrder.from_labels(
        Labels.from_texts(["vlbi_delay"] * 300),
        Labels.from_texts(["B>C", "C>D", "D>B"] * 100),
        np.arange(300.0) // 3,
    )
    calls = linear_problem(partials, parameters, x, noise, np.ones(300, bool), order if prepared else None)
    whitening, linear = None, OrthonormalLinearization(calls, residual_m)
    if prepared:
        whitening, whitened = calls.stated.with_rejections(~used)
        linear = replace(linear, whitened=whitened)
    item = fit_least_squares(
        calls.residual_function(residual_m),
        parameters,
        noise,
        used=used,
        start=x,
        linearization=linear,
        whitening=whitening,
    )
    fit = fit_least_squares(lambda at: (residual_m - partials @ at, partials), parameters, noise, used=used)
    np.testing.assert_allclose((item.x - fit.x) / fit.sigmas, 0.0, atol=SAME_SIGMAS)
    np.testing.assert_allclose(item.covariance, fit.covariance, rtol=1e-6, atol=1e-9 * fit.sigmas.max())
    assert item.chi2 == pytest.approx(fit.chi2)
    effects_m = rng.standard_normal((300, 2))
    sensitivities = (consider_sensitivity(result, lambda rows: effects_m[rows], 2) for result in (item, fit))
    np.testing.assert_allclose(*sensitivities, rtol=1e-6)


@pytest.mark.parametrize("prepared", [False, True])
def test_the_same_with_weights_that_allow_for_correlation(prepared):
    """Errors of ranges and of stations last for hours; a filter whitens ranges, delays have other sigmas."""
    rng, n, tau_s = np.random.default_rng(3), 480, 3600.0
    partials, parameters, _, _ = problem(rng, n)
    partials[:, 4], time_s = 0.0, 300.0 * np.append(np.arange(240), np.repeat(np.arange(80), 3))
    parameters = parameters.changed("rate", role=Role.FIXED)
    partials[:, :3] = np.sin(time_s[:, None] * [1e-5, 2e-5, 3e-5] + np.arange(3.0))
    partials[:, 3] = np.arange(n) < 240
    errors = np.zeros((240, 4))
    for k, drive in enumerate(rng.standard_normal((240, 4))):
        errors[k] = np.exp(-300.0 / tau_s) * errors[k - 1] + np.sqrt(1.0 - np.exp(-600.0 / tau_s)) * drive
    baselines, epoch = np.array([[0, 1], [0, 2], [1, 2]])[np.arange(240) % 3], np.arange(240) // 3
    delay_m = 0.3 * (errors[epoch, 1 + baselines[:, 1]] - errors[epoch, 1 + baselines[:, 0]])
    residual_m = np.append(2.0 * errors[:, 0], delay_m) + 0.2 * rng.standard_normal(n)
    group = np.append(np.full(240, -1), epoch)
    source = np.vstack([np.zeros((240, 2), dtype=np.intp), baselines])
    shared = SharedAtEpoch(group, source, np.outer(np.arange(n) >= 240, [-0.3, 0.3]))
    sigma_m = np.where(np.arange(n) < 240, 2.0, 0.2)
    noise, residual_m[20] = ObservationCovariance((White(sigma_m), shared)), 80.0
    types = Labels((np.arange(n) >= 240).astype(np.int32), ("range", "vlbi_delay"))
    paths = Labels.from_texts(["A"] * 240 + [("B>C", "B>D", "C>D")[k % 3] for k in range(240)])
    order = SeriesOrder.from_labels(types, paths, time_s)
    x = np.zeros(5)
    calls = linear_problem(partials, parameters, x, noise, np.ones(n, bool), order if prepared else None)

    def fit(linear):
        edited = fit_with_variance_components(linear, parameters, noise, order=order)
        return fit_with_correlated_weights(linear, edited, order)

    item = fit(calls.residual_function(residual_m))
    expected = fit(lambda at: (residual_m - partials @ at, partials))
    assert {weight.name.partition(" ")[0] for weight in item.series_weights} == {"range", "vlbi_delay"}
    assert not item.fit.used[20]
    np.testing.assert_allclose((item.fit.x - expected.fit.x)[:4] / expected.fit.sigmas[:4], 0.0, atol=1e-6)
    np.testing.assert_allclose(item.fit.sigmas, expected.fit.sigmas, rtol=1e-6)
    np.testing.assert_allclose(
        item.fit.time_correlation.added_covariance,
        expected.fit.time_correlation.added_covariance,
        rtol=1e-5,
        atol=1e-9,
    )
