"""Noise beyond the stated sigmas: none where they suffice, the right size where they do not, always an end."""

import math

import numpy as np
import pytest
from delay_network import DelayNetwork

from radioloc.estimation import USED, Labels, Parameter, ParameterSet, variance_components
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import additive_sigma_m, fit_with_variance_components


def line(n, sigma_m, excess_m, seed):
    """A straight line with two parameters, its noise, and the sigmas that are stated."""
    rng = np.random.default_rng(seed)
    partials = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n)])
    stated_m = np.broadcast_to(sigma_m, n) * np.exp(0.3 * rng.standard_normal(n))
    observed_m = partials @ [2.0, -3.0] + rng.standard_normal(n) * np.hypot(stated_m, excess_m)
    return partials, observed_m, stated_m


def fit(partials, observed_m, stated_m, **options):
    parameters = ParameterSet(Parameter(f"slope.{k}", "m", "slope") for k in range(partials.shape[1]))
    return fit_with_variance_components(
        lambda x: (observed_m - partials @ x, partials), parameters, stated_m, **options
    )


def reduced(result, excess_m, stated_m):
    used = result.fit.used
    residual_m = result.fit.residual_m[used]
    return float((residual_m**2 / (stated_m[used] ** 2 + excess_m**2)).sum() / (used.sum() - 2))


def test_nothing_is_added_to_sigmas_that_suffice():
    problem = line(200, 0.01, 0.0, 1)
    result = fit(*problem)
    assert result.additive_sigma_m["all"] == 0.0
    assert result.converged
    parameters = ParameterSet(Parameter(f"slope.{k}", "m", "slope") for k in range(2))
    plain = fit_with_editing(lambda x: (problem[1] - problem[0] @ x, problem[0]), parameters, problem[2])
    assert np.array_equal(result.fit.x, plain.fit.x)


def test_components_that_do_not_settle_are_told(monkeypatch):
    monkeypatch.setattr(variance_components, "_MAX_ROUND_COUNT", 1)
    result = fit(*line(400, 0.005, 0.05, 2))
    assert result.message == "the additive variance components did not settle"
    assert result.fit.converged
    assert not result.converged


def test_excess_makes_the_residuals_fit():
    problem = line(400, 0.005, 0.05, 2)
    result = fit(*problem)
    assert result.converged
    assert result.message == ""
    assert result.additive_sigma_m["all"] == pytest.approx(
        0.05, rel=0.1
    )  # its own sigma is 1 / sqrt(2 * 400) = 3.5 %
    assert reduced(result, result.additive_sigma_m["all"], problem[2]) == pytest.approx(1.0, abs=5e-3)
    assert result.fit.sigma_m == pytest.approx(np.hypot(problem[2], result.additive_sigma_m["all"]))


@pytest.mark.parametrize("n", [1, 2])
def test_no_redundancy_no_excess(n):
    result = fit(*line(n, 0.01, 5.0, 7))
    assert result.additive_sigma_m["all"] == 0.0
    assert result.converged == (n == 2)


@pytest.mark.parametrize("seed", range(40))
def test_comes_to_an_end_that_holds_together(seed):
    rng = np.random.default_rng(seed)
    partials, observed_m, stated_m = line(int(rng.integers(5, 60)), 0.005, rng.choice([0.0, 0.01, 0.1]), seed)
    stated_m = stated_m * np.exp(rng.uniform(0.0, 2.5) * rng.standard_normal(len(stated_m)))
    hit = rng.random(len(observed_m)) < 0.12
    observed_m = observed_m + hit * rng.choice([-1.0, 1.0], len(hit)) * np.exp(
        rng.uniform(-4.0, 3.0, len(hit))
    )
    result = fit(partials, observed_m, stated_m)
    assert result.converged
    if result.additive_sigma_m["all"] > 0.0 and not result.message:
        assert reduced(result, result.additive_sigma_m["all"], stated_m) == pytest.approx(1.0, abs=5e-3)


def test_significance_can_be_asked_for_or_not():
    # Chi-square 6 with 4 degrees of freedom is nothing unusual, but it is above one per degree.
    residual_m, sigma_m = np.full(6, 0.01), np.full(6, 0.01)
    assert additive_sigma_m(residual_m, sigma_m, 4) == 0.0
    assert additive_sigma_m(residual_m, sigma_m, 4, None) == pytest.approx(0.01 * math.sqrt(0.5), rel=1e-9)
    assert additive_sigma_m(0.1 * residual_m, sigma_m, 4, None) == 0.0
    assert additive_sigma_m(np.zeros(6), sigma_m, 4, None) == 0.0
    assert additive_sigma_m(residual_m * 1e6, sigma_m, 0) == 0.0


def test_parameters_with_a_priori_values_take_only_what_these_leave_open():
    """Three offsets of each night, known to 5 cm, outnumber the observations: noise and a blunder are found."""
    nights, noise_m, offset_sigma_m = 120, 0.02, 0.05
    of_night = np.repeat(np.eye(nights), 3, axis=0)
    partials = np.column_stack([np.tile([-1.0, 0.0, 1.0], nights), of_night, of_night, of_night])
    offsets = [Parameter(f"offset.{k}", "m", "offset", 0.0, offset_sigma_m) for k in range(3 * nights)]
    parameters = ParameterSet([Parameter("slope", "m", "slope"), *offsets])
    rng = np.random.default_rng(5)
    truth = np.concatenate([[2.0], offset_sigma_m * rng.standard_normal(3 * nights)])
    observed_m = partials @ truth + noise_m * rng.standard_normal(len(partials))
    observed_m[100] += 1.0
    result = fit_with_variance_components(lambda x: (observed_m - partials @ x, partials), parameters, 0.002)
    assert np.flatnonzero(~result.status.are(USED)).tolist() == [100]
    # Two of three observations of a night are redundant: the sigma of what is found is 1 / sqrt(2 * 240), 5 %.
    assert result.additive_sigma_m["all"] == pytest.approx(noise_m, rel=0.15)


@pytest.mark.parametrize("usable", [12, 6])
def test_parameters_beyond_what_is_determined_take_no_redundancy(usable):
    """A rate whose a-priori sigma is too large to be determined, and a group without usable observations."""
    n, rng = 12, np.random.default_rng(1)
    partials = np.column_stack([np.ones(n), 1e-9 * np.linspace(-1.0, 1.0, n)])
    observed_m = rng.standard_normal(n)
    parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("rate", "1/s", "bias", 0.0, 1e12)])
    status = Labels.coded((USED, "not used"), (np.arange(n) >= usable).astype(int))
    order = SeriesOrder.from_labels(
        Labels.coded(("range",), np.zeros(n, dtype=int)),
        Labels.coded(("A", "B"), np.arange(n) // 6),
        60.0 * np.arange(n),
    )
    result = fit_with_variance_components(
        lambda x: (observed_m - partials @ x, partials),
        parameters,
        0.01,
        order=order,
        groups=Labels.coded(("first", "second"), np.arange(n) // 6),
        status=status,
    )
    assert np.isinf(result.fit.covariance[1, 1])
    assert result.additive_sigma_m["first"] > 0.1
    assert (result.additive_sigma_m["second"] == 0.0) == (usable == 6)


@pytest.mark.parametrize("stations_m", [(0.0, 0.0, 0.0, 1e6), (1e-6, 1.0, 1e3, 1e6)])
@pytest.mark.parametrize("stated_m", [1e-6, 0.3])
def test_errors_of_stations_far_beyond_those_of_delays_are_no_noise(stated_m, stations_m):
    """Delays that close but for rounding: what their stations are off by is to be seen in the residuals."""
    network = DelayNetwork.make(epochs=60)
    errors_m = np.tile(stations_m, 60) * np.random.default_rng(1).normal(size=240)
    paths = Labels.from_texts([f"{a}<x>{b}" for a, b in zip(network.first, network.second, strict=True)])
    result = fit_with_variance_components(
        network.residual_function(network.incidence @ errors_m),
        network.parameters(),
        stated_m,
        order=SeriesOrder.from_labels(Labels.from_texts(["vlbi_delay"] * 360), paths, 600.0 * network.epoch),
        threshold=None,
    )
    assert result.shared_sigma_m == {}
    assert result.additive_sigma_m
    assert np.isfinite(result.fit.x).all()
