"""Trials by the defaults alone draw the errors that the fit considers, so that its covariance is that of the errors."""

from dataclasses import replace

import pytest
from change5_case import LANDER, NEAR, NOISE, START

import radioloc
from radioloc import Study
from radioloc.simulation import Scenario, Schedule, Session, TruthSigma, two_way
from radioloc.study import EstimateChoice, ModelChoice

pytestmark = pytest.mark.slow

TRIALS = 100
TOLERANCE = 3.0 / TRIALS**0.5 + 0.05


@pytest.fixture(scope="module")
def study():
    session = Session(
        "range", two_way("DSS-14", "DSS-43", "DSS-63"), START, "2020-12-02T15:11:00", 1200.0, 1.0
    )
    return Study(
        target=NEAR,
        estimate=EstimateChoice(),
        model=ModelChoice(off=["ionosphere"]),
        simulation=Scenario(Schedule([session]), LANDER, noise=NOISE, seed=11),
    )


def test_drawn_defaults_have_the_claimed_covariance(study):
    [arc] = radioloc.monte_carlo(study, TRIALS, (24.0,)).arcs
    assert abs(arc.nees.mean - 1.0) < TOLERANCE


def test_trials_without_the_considered_errors_scatter_less_than_claimed(study):
    scenario = replace(study.simulation, truth_sigma=TruthSigma(considered=False))
    [arc] = radioloc.monte_carlo(replace(study, simulation=scenario), TRIALS, (24.0,)).arcs
    assert arc.nees.mean < 1.0 - TOLERANCE
