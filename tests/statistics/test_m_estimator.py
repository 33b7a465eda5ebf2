"""Huber's estimate over seeded draws: efficient where errors are normal, hardly moved by gross ones, honest sigmas."""

import numpy as np
import pytest

from radioloc.estimation import Labels, Parameter, ParameterSet, fit_with_editing
from radioloc.estimation.m_estimator import CORNER, fit_with_huber
from radioloc.estimation.robust import huber
from radioloc.estimation.series import SeriesOrder

TRIALS = 400
PARTIALS = np.random.default_rng(12).normal(size=(60, 2))


def fits(errors, station, prior_sigma=np.inf):
    """Least squares and Huber's, of two parameters and a bias of each station, all zero in truth."""
    n = len(errors)
    matrix = np.column_stack([np.resize(PARTIALS, (n, 2)), station[:, None] == np.unique(station)])
    parameters = ParameterSet(
        Parameter(f"a.{k}", "m", "a", prior_sigma=prior_sigma) for k in range(matrix.shape[1])
    )

    def linear(x):
        return errors - matrix @ x, matrix

    paths = Labels.of(np.array([f"U>x>{k}" for k in station]))
    order = SeriesOrder.of(Labels.of(np.full(n, "range")), paths, 60.0 * np.arange(n))
    # Nothing is left out, so that the estimate alone has to withstand what is wrong
    edited = fit_with_editing(linear, parameters, 1.0, threshold=None)
    return edited.fit, fit_with_huber(linear, edited, order).fit, matrix


@pytest.mark.parametrize("prior_sigma", [np.inf, 0.3])
def test_the_estimate_has_the_least_loss(prior_sigma):
    from scipy.optimize import minimize

    errors = np.random.default_rng(1).standard_t(2, 60)
    _, fit, matrix = fits(errors, np.arange(60) % 3, prior_sigma)

    def loss(x):
        return float(huber(errors - matrix @ x, CORNER).sum() + 0.5 * np.square(x / prior_sigma).sum())

    best = minimize(loss, fit.x, method="BFGS", options={"gtol": 1e-9})
    # The last step is a thousandth of a sigma, 0.15 here; of reweighting each is a third of the one before
    np.testing.assert_allclose(fit.x, best.x, atol=3e-4)


@pytest.mark.slow
def test_efficiency_under_normal_errors():
    squares = np.zeros(2)
    for seed in range(TRIALS):
        errors = np.random.default_rng([2, seed]).normal(size=60)
        plain, fit, _ = fits(errors, np.arange(60) % 3)
        root = np.linalg.cholesky(np.linalg.inv(plain.covariance)).T
        squares += [np.square(root @ one.x).sum() for one in (plain, fit)]
    # The two are correlated by 0.97: the ratio of 2000 squares each scatters by 0.7 %.
    assert squares[0] / squares[1] == pytest.approx(0.95, abs=0.025)


@pytest.mark.slow
def test_a_tenth_of_gross_errors_on_one_side():
    """Asymptotically they move a mean by e k / ((1 - e) (2 Phi(k) - 1)) = 0.18 sigmas, however large they are."""
    moved = {}
    for size in (50.0, 5000.0):
        estimates = []
        for seed in range(50):
            rng = np.random.default_rng([3, seed])
            errors = rng.normal(size=200)
            errors[rng.choice(200, 20, replace=False)] += size
            _, fit, _ = fits(errors, np.zeros(200, dtype=int))
            estimates.append(fit.x[2])
        moved[size] = np.mean(estimates)
    assert moved[50.0] == pytest.approx(0.18, abs=0.04)  # of 50 means of 200: 0.011
    assert moved[5000.0] == pytest.approx(moved[50.0], abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["normal", "all", "one station", "few"])
def test_sigmas_are_those_of_the_draws(case):
    """Errors four times as large in a tenth of all, or in a third of one station's; or eight for each station."""
    errors_by_sigma = []
    station = np.repeat(np.arange(3), 8 if case == "few" else 20)
    for seed in range(TRIALS):
        rng = np.random.default_rng([4, seed])
        errors, drawn = rng.normal(size=len(station)), rng.random(len(station))
        if case != "normal":
            errors[(drawn < 0.3) & (station == 0) if case == "one station" else drawn < 0.1] *= 4.0
        _, fit, _ = fits(errors, station)
        errors_by_sigma.append(fit.x / fit.sigmas)
    found = np.abs(np.array(errors_by_sigma))
    # 2000 errors, of 5 parameters: standard errors of 1.0 and 0.5 %; one parameter 1.1 %
    assert np.mean(found < 1.0) == pytest.approx(0.683, abs=0.04)
    assert np.mean(found < 2.0) == pytest.approx(0.954, abs=0.02 if case != "few" else 0.035)
    assert np.mean(found < 2.0, axis=0).min() > 0.90


def test_what_no_other_observation_tells_keeps_its_sigma():
    """The bias of a station with one observation: it leaves no residual."""
    errors = np.random.default_rng(5).normal(size=61)
    plain, fit, _ = fits(errors, np.append(np.zeros(60, dtype=int), 1))
    assert fit.sigmas[3] == pytest.approx(plain.sigmas[3], rel=0.25)
