"""Stations that are 100 m from their catalogue places, which is what their places are considered to be good to."""

from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc.parameters.considered import considered_choices
from radioloc.simulation.truth import TruthSigma
from radioloc.study import HeightPrior

pytestmark = pytest.mark.slow

STATION_SIGMA_M = 100.0
HEIGHT_SIGMA_M = 5.0
TRIALS = 150
STATIONS = ("JIAMUSI", "KASHI", "NEUQUEN", "MIYUN50")


@pytest.fixture(scope="module")
def study():
    """Two days of ranges and VLBI delays; the height and the places of the rounded stations are drawn."""
    planned = radioloc.read_study("examples/change5/simulation.toml")
    places = dict.fromkeys(STATIONS, (STATION_SIGMA_M,) * 3)
    drawn = TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_SIGMA_M), station_position_m=places)
    considered = {"station_position": list(STATIONS), "station_position_sigma_m": dict(places)}
    estimate = replace(planned.estimate, height_prior=HeightPrior(-2550.4, HEIGHT_SIGMA_M), parameters={})
    return replace(
        planned,
        estimate=estimate,
        consider=considered_choices(considered),
        consider_defaults=False,
        simulation=replace(planned.simulation, truth=type(planned.simulation.truth)(), truth_sigma=drawn),
    )


def test_displaced_stations_converge_within_their_sigmas(study):
    result = radioloc.monte_carlo(study, TRIALS, 48.0, seed=3)
    assert result.linear
    assert result["converged"].all()
    # Three degrees of freedom a trial: the mean of 150 is known to 0.067.
    assert result["nees"].mean() / 3.0 == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / (3.0 * TRIALS)))
    assert (result["sigma_up_m"] <= HEIGHT_SIGMA_M).all()


def test_no_sigma_exceeds_its_prior_and_the_budget_adds_up(study):
    solution = radioloc.locate(study, radioloc.simulate(study).observations)
    assert solution.sigma_enu_m()[2] <= HEIGHT_SIGMA_M
    total_m2 = sum(item.total_m**2 for item in solution.budget)
    assert np.sqrt(total_m2) == pytest.approx(np.linalg.norm(solution.sigma_enu_m()), rel=1e-9)
    fixed_stations = radioloc.locate(
        replace(study, suboptimal=("station_position",)), radioloc.simulate(study).observations
    )
    assert np.linalg.norm(fixed_stations.sigma_enu_m()) > 5.0 * np.linalg.norm(solution.sigma_enu_m())
