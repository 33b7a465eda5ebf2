import numpy as np
import pytest
from toy_moon import LANDER_M, ToyMoon

from radioloc.errors import ConvergenceError, InputError
from radioloc.estimation import FitStatus, Parameter, ParameterSet, least_squares
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.parameters.parameter import Role

# Solving 5 well-conditioned unknowns in double precision; the closed form itself loses about 1e-12.
LINEAR_RTOL = 1e-10
# Ranges of 4e8 m are rounded to 1e-7 m; solving for three biases over 12 h magnifies that up to 1000 times.
ZERO_NOISE_TOLERANCE_M = 1e-3


def linear(n=40, p=5, seed=0):
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(n, p))
    observed = design @ rng.normal(size=p) + rng.normal(size=n)
    sigma = rng.uniform(0.5, 2.0, size=n)
    return design, observed, sigma


def function(design, observed):
    return lambda x: (observed - design @ x, design)


def free_parameters(p, **kwargs):
    return ParameterSet([Parameter(f"p.{k}", "m", "p", **kwargs) for k in range(p)])


def test_linear_problem_against_closed_form():
    design, observed, sigma = linear()
    fit = fit_least_squares(function(design, observed), free_parameters(5), sigma)
    weighted = design / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    x = covariance @ weighted.T @ (observed / sigma)
    np.testing.assert_allclose(fit.x, x, rtol=LINEAR_RTOL)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=LINEAR_RTOL, atol=1e-14)
    np.testing.assert_allclose(fit.residual_m, observed - design @ x, rtol=LINEAR_RTOL, atol=1e-12)
    assert fit.chi2 == pytest.approx((((observed - design @ x) / sigma) ** 2).sum(), rel=LINEAR_RTOL)
    assert (fit.dof, fit.status) == (35, FitStatus.CONVERGED)
    assert fit.chi2_per_dof == fit.chi2 / 35


def test_priors_act_like_observations():
    design, observed, sigma = linear()
    values, sigmas = np.array([3.0, -1.0]), np.array([0.2, 0.7])
    parameters = free_parameters(5)
    for k in range(2):
        parameters = parameters.changed(f"p.{k}", prior_value=values[k], prior_sigma=sigmas[k])
    with_priors = fit_least_squares(function(design, observed), parameters, sigma)
    more_design, more_observed = np.vstack([design, np.eye(5)[:2]]), np.concatenate([observed, values])
    as_data = fit_least_squares(
        function(more_design, more_observed), free_parameters(5), np.concatenate([sigma, sigmas])
    )
    np.testing.assert_allclose(with_priors.x, as_data.x, rtol=LINEAR_RTOL)
    np.testing.assert_allclose(with_priors.covariance, as_data.covariance, rtol=LINEAR_RTOL, atol=1e-14)
    assert with_priors.chi2 == pytest.approx(as_data.chi2, rel=LINEAR_RTOL)
    assert with_priors.dof == as_data.dof


def test_fixed_parameters_stay():
    design, observed, sigma = linear()
    parameters = free_parameters(5).changed("p.2", prior_value=0.4, role=Role.FIXED)
    fit = fit_least_squares(function(design, observed), parameters, sigma, start=np.full(5, 9.0))
    remaining = [0, 1, 3, 4]
    reduced = fit_least_squares(
        function(design[:, remaining], observed - 0.4 * design[:, 2]), free_parameters(4), sigma
    )
    assert fit.x[2] == 0.4
    np.testing.assert_allclose(fit.x[remaining], reduced.x, rtol=LINEAR_RTOL)
    np.testing.assert_allclose(
        fit.covariance[np.ix_(remaining, remaining)], reduced.covariance, rtol=LINEAR_RTOL
    )
    np.testing.assert_array_equal(fit.covariance[2], 0.0)
    assert fit.dof == reduced.dof


def test_curved_valley_of_a_short_arc():
    # Ten minutes of one station leave 12 km along one direction, far enough for the model to bend: plain
    # Gauss-Newton steps raise the sum of squares, damped ones alone crawl.
    model = ToyMoon(200, 1.0 / 6.0, ("A",), biases=False)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        observed_m = model.ranges(LANDER_M)[0] + 0.3 * rng.normal(size=200)
        parameters = model.parameters(LANDER_M + rng.normal(size=3) * 2e4)
        fit = fit_least_squares(model.residual_function(observed_m), parameters, 0.3)
        assert fit.converged
        assert fit.iterations <= 6
        gradient = (fit.linearization.partials(np.arange(len(fit.residual_m))) / 0.3).T @ (
            fit.residual_m / 0.3
        )
        # Stationary to a hundredth of a sigma in every direction.
        assert np.sqrt(gradient @ fit.covariance @ gradient) < 1e-2


@pytest.mark.parametrize("threshold", [None, 5.0])
def test_steps_to_where_there_is_no_model_are_shortened(threshold):
    """The first would lead from 20 to about -500, with the robust start before the fit as without."""

    def arctangent(x):
        if abs(x[0]) > 30.0:
            raise ConvergenceError("no light time out there")
        return np.full(9, -np.arctan(x[0])), np.full((9, 1), 1.0 / (1.0 + x[0] ** 2))

    parameters = ParameterSet([Parameter("a", "m", "p", 20.0)])
    fit = fit_with_editing(arctangent, parameters, 0.01, threshold=threshold).fit
    assert fit.converged
    assert abs(fit.x[0]) < 1e-6


def test_wrong_partials_diverge_and_say_so():
    design, observed, sigma = linear()
    fit = fit_least_squares(lambda x: (observed - design @ x, -design), free_parameters(5), sigma)
    assert fit.status is FitStatus.DIVERGED
    assert not fit.converged


def test_iteration_limit_is_reported(monkeypatch):
    monkeypatch.setattr(least_squares, "_MAX_ITERATIONS", 1)
    model = ToyMoon(50, 12.0, biases=False)
    fit = fit_least_squares(
        model.residual_function(model.ranges(LANDER_M)[0]), model.parameters(LANDER_M + 3e4), 0.3
    )
    assert fit.status is FitStatus.MAX_ITERATIONS
    assert fit.iterations == 1


def test_what_is_undetermined_is_told_whatever_the_units():
    """A rate (1e-6 s) that acts as a bias does, and another that does nothing at all."""
    design, observed, sigma = linear()
    design[:, 3], design[:, 4] = 1e6 * design[:, 2], 0.0
    parameters = free_parameters(5)
    for name in ("p.3", "p.4"):
        parameters = parameters.changed(name, scale=1e-6)
    fit = fit_least_squares(function(design, observed), parameters, sigma)
    reduced = fit_least_squares(function(design[:, :3], observed), free_parameters(3), sigma)
    assert fit.status is FitStatus.UNOBSERVABLE
    assert np.isinf(fit.sigmas).tolist() == [False, False, True, True, True]
    np.testing.assert_allclose(fit.sigmas[:2], reduced.sigmas[:2], rtol=LINEAR_RTOL)


@pytest.mark.parametrize(
    ("observed", "scale"), [([0.0, 20.0], 200.0**0.5), ([0.0, 4.0], 1.0), ([20.0], 1.0), ([0.0] * 9, 1.0)]
)
def test_noise_is_scaled_up_where_residuals_leave_no_doubt(observed, scale):
    """Two observations 20 sigmas apart are enough, 4 sigmas are chance, and one alone says nothing."""
    n = len(observed)
    fit = fit_least_squares(function(np.ones((n, 1)), np.array(observed)), free_parameters(1), 1.0)
    assert fit.noise_scale == pytest.approx(scale)


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [({"sigma_m": 0.0}, "sigma of observation 0 is 0.0 m"), ({"used": np.ones(3, dtype=bool)}, "^used: ")],
)
def test_unusable_input_is_refused(kwargs, words):
    design, observed, sigma = linear()
    with pytest.raises(InputError, match=words):
        fit_least_squares(function(design, observed), free_parameters(5), **({"sigma_m": sigma} | kwargs))
