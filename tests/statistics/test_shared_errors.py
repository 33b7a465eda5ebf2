"""Delays that share the errors of stations: the stated uncertainty is true only if the fit knows of them."""

import numpy as np
import pytest
from delay_network import DelayNetwork

from radioloc.estimation import fit_with_editing

RUNS = 400
# Chi-square of 400 * 3 degrees of freedom over 400: 0.025 and 0.975 quantiles.
NEES_3 = (2.765, 3.245)


def runs(network, noise):
    """Mean squared error of the estimate in its own covariance, and the mean of chi-square over its dof."""
    fits = []
    for seed in range(RUNS):
        observed_m = network.errors_m(np.random.default_rng([seed, 7]))  # the truth is zero
        fits.append(fit_with_editing(network.residual_function(observed_m), network.parameters(), noise).fit)
    nees = np.mean([fit.x @ np.linalg.solve(fit.covariance, fit.x) for fit in fits])
    return nees, np.mean([fit.chi2_per_dof for fit in fits])


@pytest.fixture(scope="module")
def network():
    return DelayNetwork.make(epochs=10, own_m=0.05, station_m=0.5)


def test_with_the_model_the_covariance_is_right(network):
    nees, chi2_per_dof = runs(network, network.noise)
    assert NEES_3[0] < nees < NEES_3[1]
    # Of 57 degrees of freedom and 400 runs: five standard deviations.
    assert chi2_per_dof == pytest.approx(1.0, abs=5.0 * (2.0 / (57.0 * RUNS)) ** 0.5)


@pytest.mark.slow
def test_without_it_the_covariance_is_half_of_what_it_should_be(network):
    """The sum of squares does not show it: the sigmas are right, one by one."""
    nees, chi2_per_dof = runs(network, network.noise.sigma_m)
    assert nees > 1.7 * NEES_3[1]
    assert chi2_per_dof == pytest.approx(1.0, abs=0.1)
