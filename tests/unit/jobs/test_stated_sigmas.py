"""Stated sigmas that are wrong by one factor: the noise is that of the residuals, and the finding names the series."""

from dataclasses import replace

import change5_case
import numpy as np
import pytest

import radioloc
from radioloc.estimation import FitStatus, Labels, Parameter, ParameterSet
from radioloc.estimation.consider import NO_ERRORS, UnestimatedErrors
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.noise_structure import Differences, noise_ratios
from radioloc.estimation.series import SeriesOrder
from radioloc.jobs.verdict import misfits, with_considered
from radioloc.measurements import PhysicalModel
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice

STUDY = radioloc.Study(
    change5_case.NEAR, ObservationChoice(), EstimateChoice(), ModelChoice(off=["ionosphere"])
)


@pytest.fixture(scope="module")
def tracking():
    return change5_case.observations(PhysicalModel.build(), 1200.0)


def with_sigmas(observations, factor, part=slice(None)):
    sigma_m = observations.sigma_m.copy()
    sigma_m[part] *= factor
    return replace(observations, sigma_m=sigma_m)


def findings(solution):
    return [(item.kind, item.name) for item in solution.consistency.findings]


@pytest.mark.study
def test_a_station_with_a_hundredth_of_its_sigmas_is_named_and_used(tracking):
    of_station = np.array([link.receiver == "NEUQUEN" for link in tracking.links])[tracking.link]
    good = radioloc.locate(STUDY, tracking)
    solution = radioloc.locate(STUDY, with_sigmas(tracking, 0.01, of_station))
    assert solution.status is FitStatus.CONVERGED
    assert solution.residuals.used.all()
    assert findings(solution) == [("sigma", "NEUQUEN")]
    assert solution.consistency.findings[0].amounts[""] == pytest.approx(100.0, rel=0.2)
    difference_m = solution.position_pa_m - good.position_pa_m
    assert np.linalg.norm(difference_m) < np.linalg.norm(good.sigma_enu_m())


@pytest.mark.study
@pytest.mark.parametrize(("factor", "word"), [(1.0 / 30.0, "30 times too small"), (8.0, "times too large")])
def test_one_factor_of_all_sigmas_is_one_finding(tracking, factor, word):
    solution = radioloc.locate(STUDY, with_sigmas(tracking, factor))
    assert solution.status is FitStatus.CONVERGED
    assert findings(solution) == [("sigma", "")]
    assert solution.consistency.findings[0].amounts[""] == pytest.approx(1.0 / factor, rel=0.15)
    assert word.partition(" ")[2] in str(solution.consistency.findings[0])


@pytest.mark.study
def test_right_sigmas_give_no_finding(tracking):
    assert findings(radioloc.locate(STUDY, tracking)) == []


@pytest.mark.parametrize("fault", ["none", "outliers", "step", "drift"])
def test_differences_show_noise_and_neither_outliers_nor_errors_of_the_model(fault):
    n = 400
    rng = np.random.default_rng(2)
    time_s, noise = 300.0 * np.arange(n), rng.normal(size=n)
    error_m = {
        "none": np.zeros(n),
        "outliers": 100.0 * (rng.random(n) < 0.1),
        "step": 300.0 * (time_s > time_s[200]),
        "drift": 1000.0 * np.sin(7.3e-5 * time_s),
    }[fault]
    order = SeriesOrder.from_labels(Labels.from_texts(["range"] * n), Labels.from_texts(["A"] * n), time_s)
    differences = Differences.from_residuals(5.0 * noise + error_m, np.ones(n), np.ones(n, dtype=bool), order)
    [ratio] = noise_ratios(differences, 1)
    assert ratio == pytest.approx(5.0, rel=1.0 if fault == "outliers" else 0.2)


def test_residuals_are_compared_with_stated_and_considered_variance():
    """A considered error outside the weights, of 30 m over a day, is in residuals of 1 m noise."""
    n = 300
    time_s, rng = 600.0 * np.arange(n), np.random.default_rng(4)
    effect_m = 30.0 * np.sin(7.3e-5 * time_s)
    observed_m, design = effect_m + rng.normal(size=n), np.ones((n, 1))
    parameters = ParameterSet([Parameter("offset", "m", "bias")])
    edited = fit_with_editing(lambda x: (observed_m - design @ x, design), parameters, 1.0, threshold=None)
    order = SeriesOrder.from_labels(Labels.from_texts(["range"] * n), Labels.from_texts(["A"] * n), time_s)
    errors = UnestimatedErrors(
        ParameterSet([Parameter("error", "1", "error", prior_sigma=1.0)]), lambda rows: effect_m[rows, None]
    )
    assert [*misfits(edited, with_considered(np.ones(n), NO_ERRORS), order)]
    assert not [*misfits(edited, with_considered(np.ones(n), errors), order)]
