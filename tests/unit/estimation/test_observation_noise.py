"""Shared errors against dense algebra: weights, editing, additive noise, whatever the order of the rows."""

import math

import numpy as np
import pytest
from delay_network import OWN_M, STATION_M, DelayNetwork

from radioloc.estimation import USED, Labels
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.noise import ALONE
from radioloc.noise.whitening import column

ROUNDING = 1e-9
"""Two ways of the same algebra, relative; the covariance has a condition of 100."""
SAME_ANSWER_SIGMAS = 0.01
"""Where two fits of the same data end: the step tolerance, a thousandth of a sigma, and some reserve."""


@pytest.fixture
def network():
    return DelayNetwork.make(ranges=5)


def errors_m(network, seed=1):
    return network.errors_m(np.random.default_rng(seed))


def fit(network, observed_m, **additional):
    return fit_least_squares(
        network.residual_function(observed_m), network.parameters(), network.noise, **additional
    )


def assert_generalized(result, network, observed_m):
    x, covariance, chi2 = network.generalized(observed_m)
    np.testing.assert_allclose(result.covariance, covariance, rtol=ROUNDING, atol=ROUNDING * covariance.max())
    np.testing.assert_allclose(result.x, x, rtol=0.0, atol=1e-6 * math.sqrt(covariance.max()))
    assert result.chi2 == pytest.approx(chi2, rel=ROUNDING)
    assert result.dof == len(observed_m) - len(x)


def test_fit_is_generalized_least_squares(network):
    observed_m = errors_m(network)
    result = fit(network, observed_m)
    assert result.converged
    assert_generalized(result, network, observed_m)
    assert result.sigma_m == pytest.approx(np.sqrt(np.diag(network.covariance)), rel=1e-14)


def test_six_baselines_of_four_stations_carry_three_delays():
    """Without noise of the baselines, three baselines of one station have the information of all six."""
    network = DelayNetwork.make(own_m=1e-4, station_m=1.0)
    observed_m = np.zeros(len(network.epoch))
    six = fit(network, observed_m)
    believed = fit_least_squares(
        network.residual_function(observed_m), network.parameters(), network.noise.sigma_m
    )
    small = 1e-6  # square of own over station
    assert six.sigmas / believed.sigmas == pytest.approx(math.sqrt(6 / 3), rel=small)
    three = fit(network, observed_m, used=network.first == 0)
    assert six.sigmas == pytest.approx(three.sigmas, rel=small)


def test_a_blunder_is_taken_out_of_its_block(network):
    observed_m = errors_m(network)
    observed_m[[7, 33]] += [8.0, -5.0]
    selected = ~np.isin(np.arange(len(observed_m)), [7, 33])
    edited = fit_with_editing(network.residual_function(observed_m), network.parameters(), network.noise)
    assert edited.converged
    np.testing.assert_array_equal(edited.status.are(USED), selected)
    x, covariance, chi2 = network.select(selected).generalized(observed_m[selected])
    sigmas = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(edited.fit.x, x, rtol=0.0, atol=SAME_ANSWER_SIGMAS * sigmas.min())
    assert edited.fit.chi2 == pytest.approx(chi2, rel=1e-4)


def test_excess_noise_is_on_the_diagonal():
    network = DelayNetwork.make(epochs=300, ranges=200)
    more_m = 0.3
    delays, n = network.epoch != ALONE, len(network.epoch)
    observed_m = errors_m(network)
    observed_m[delays] += more_m * np.random.default_rng(5).normal(size=int(delays.sum()))
    result = fit_with_variance_components(
        network.residual_function(observed_m),
        network.parameters(),
        network.noise,
        order=SeriesOrder.from_labels(
            Labels.from_texts(np.where(delays, "delay", "range")),
            Labels.from_texts(np.full(n, "A")),
            1.0 * np.arange(n),
        ),
    )
    assert result.additive_sigma_m["range"] == 0.0
    excess_m = result.additive_sigma_m["delay"]
    # Half of 1800 squares show it: 3 % of scatter.
    assert excess_m == pytest.approx(more_m, rel=0.1)
    fit = result.fit
    expected_m = np.sqrt(OWN_M**2 + delays * (excess_m**2 + 2.0 * STATION_M**2))
    assert fit.sigma_m == pytest.approx(expected_m, rel=1e-12)
    assert fit.noise.white_m == pytest.approx(np.hypot(OWN_M, excess_m * delays), rel=1e-12)
    of_delays = fit.noise.whitener(delays).whitened(column(fit.residual_m))
    dof = round(delays.sum() * (1.0 - 3.0 / len(delays)))
    assert sum(float(np.square(part).sum()) for part in of_delays) == pytest.approx(dof, rel=5e-3)
