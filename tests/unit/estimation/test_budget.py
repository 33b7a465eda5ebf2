"""The error budget of a position: sources that add up, against the sums by hand and against the whole of solutions."""

from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc.estimation.consider import prior_effects, sum_by_source
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.parameters.considered import considered_choices
from radioloc.parameters.parameter import Parameter, ParameterSet

RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def study():
    """The example with clocks considered, not estimated."""
    study = radioloc.read_study("examples/change5/change5.toml")
    biases = {"range_bias": study.estimate.parameters["range_bias"]}
    return replace(
        study,
        estimate=replace(study.estimate, parameters=biases),
        consider=considered_choices({"station_position_sigma_m": 0.05}),
    )


@pytest.fixture(scope="module")
def solution(study):
    return radioloc.locate(study)


def squares(items):
    return sum(item.sigma_m**2 for item in items)


def test_a_priori_values_and_noise_are_told_apart():
    """Return errors of refits with one wrong observation or a-priori value at a time."""
    design, sigma = RNG.normal(size=(40, 3)), 0.5 + RNG.random(40)
    items = [
        Parameter(name, "m", "position", 0.0, prior)
        for name, prior in zip("abc", (0.1, 0.2, np.inf), strict=True)
    ]

    def fitted(values_m, priors=(0.0, 0.0, 0.0)):
        parameters = ParameterSet([replace(p, prior_value=v) for p, v in zip(items, priors, strict=True)])
        return fit_least_squares(lambda x: (values_m - design @ x, design), parameters, sigma)

    fit = fitted(np.zeros(40))
    effects = prior_effects(fit)
    for k, prior in enumerate((0.1, 0.2)):
        wrong = np.where(np.arange(3) == k, prior, 0.0)
        assert effects[:, k] == pytest.approx(fitted(np.zeros(40), wrong).x, abs=1e-12)
    assert not effects[:, 2].any()
    of_noise = np.array([fitted(sigma * entry).x for entry in np.eye(40)]).T
    assert of_noise @ of_noise.T == pytest.approx(fit.covariance - effects @ effects.T, abs=1e-12)


@pytest.mark.study
def test_the_budget_adds_up(solution):
    budget = solution.budget
    np.testing.assert_allclose(squares(budget), solution.sigma_enu_m() ** 2, rtol=1e-9)
    totals = [item.total_m for item in budget]
    assert totals == sorted(totals, reverse=True)
    sources = [(item.source, item.name) for item in budget]
    assert len(set(sources)) == len(sources)
    assert {("clock", "URUMQI"), ("a priori", "position.height"), ("measurement noise", "")} < set(sources)
    assert ("ephemeris", "") in sources
    assert not {"moon_position", "libration"} & {source for source, _ in sources}
    # Passes and components of a station are one.
    kashi = [r for r in solution.to_dict()["considered"] if r["name"].startswith("zenith_delay.KASHI ")]
    assert len(kashi) > 1
    [item] = [item for item in budget if (item.source, item.name) == ("zenith_delay", "KASHI")]
    assert item.total_m**2 == pytest.approx(np.sum([np.square(r["position_enu_m"]) for r in kashi]))
    wholes = sum_by_source(budget)
    assert sum(total.total_m**2 for total in wholes) == pytest.approx(np.sum(np.square(totals)))
