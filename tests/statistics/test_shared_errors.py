"""Delays that share the errors of stations: the stated uncertainty is true only if the fit knows of them."""

import numpy as np
import pytest
from delay_network import DelayNetwork
from quick import some

from radioloc.estimation import Labels
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.simulation.noise import gauss_markov

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


@pytest.mark.study
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


EPOCHS, STEP_S = 60, 600.0
STATIONS_M = {"none": (0.0,) * 4, "all": (0.3,) * 4, "one": (0.05, 0.05, 1.0, 0.05)}


def found_in(stations_m, seed, lasting=0.0):
    """A fit of delays of 0.3 m and of errors of stations that are not stated; own errors may last for an hour."""
    network = DelayNetwork.make(epochs=EPOCHS, own_m=0.4, seed=seed)
    rng = np.random.default_rng([seed, 11])
    drive = rng.normal(size=(6, EPOCHS))
    delay_noise_m = drive if not lasting else np.sqrt(1.0 - lasting) * drive
    if lasting:
        delay_noise_m = delay_noise_m + np.sqrt(lasting) * gauss_markov(
            rng.normal(size=(6, EPOCHS)), np.exp(-STEP_S / 3600.0)
        )
    of_stations = network.incidence @ (np.tile(stations_m, EPOCHS) * rng.normal(size=4 * EPOCHS))
    observed_m = 0.3 * delay_noise_m.T.ravel() + of_stations  # the truth is zero
    paths = Labels.from_texts([f"{a}<x>{b}" for a, b in zip(network.first, network.second, strict=True)])
    types = Labels(np.zeros(len(observed_m), dtype=np.int32), ("vlbi_delay",))
    edited = fit_with_variance_components(
        network.residual_function(observed_m),
        network.parameters(),
        np.full(len(observed_m), 0.3),
        order=SeriesOrder.from_labels(types, paths, STEP_S * network.epoch),
    )
    assert edited.converged
    return edited


@pytest.mark.parametrize(("lasting", "runs"), some([(0.0, 300), (0.7, 300), (0.7, 30)], [(0.7, 30)]))
def test_shared_errors_are_seldom_found_where_there_are_none(lasting, runs):
    result = sum(bool(found_in(STATIONS_M["none"], seed, lasting).shared_sigma_m) for seed in range(runs))
    assert result <= runs // 100  # one of a thousand is meant; four of 300 have a chance of 3e-4


@pytest.mark.study
@pytest.mark.parametrize(("which", "runs"), some([("all", RUNS), ("one", RUNS), ("one", 30)], [("one", 30)]))
def test_shared_errors_are_found_and_the_covariance_is_right(which, runs):
    nees, sigmas_m = [], []
    for seed in range(runs):
        edited = found_in(STATIONS_M[which], seed)
        sigmas_m.append(list(edited.shared_sigma_m.values()))
        nees.append(edited.fit.x @ np.linalg.solve(edited.fit.covariance, edited.fit.x))
    assert np.mean(sigmas_m, axis=0) == pytest.approx(np.array(STATIONS_M[which]), abs=0.06)
    # Chi-square of 3 degrees of freedom: its mean has a standard error of the root of 6 over the runs.
    assert abs(np.mean(nees) - 3.0) < 3.0 * np.sqrt(6.0 / runs)
