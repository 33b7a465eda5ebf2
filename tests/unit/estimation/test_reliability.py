"""Reliability: minimal detectable biases against draws with such a bias, and external reliability against refits."""

import math

import numpy as np
import pytest
from scipy.sparse import csc_array, hstack

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.adaptation import adapted_estimate
from radioloc.estimation.gauss_markov import SeriesNoise
from radioloc.estimation.group_tests import BinnedProblem
from radioloc.estimation.hypotheses import Family, Hypothesis
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.reliability import assess_reliability, noncentrality
from radioloc.estimation.series import SeriesOrder
from radioloc.noise import ObservationCovariance

PATHS = ("A>x>A", "B>x>B")
EPOCH_COUNT = 30
LOG_LEVEL = math.log(1e-4)
PARAMETERS = ParameterSet(
    [
        Parameter("position.x", "m", "position", prior_sigma=5.0),
        Parameter("position.y", "m", "position"),
        Parameter("range_bias.A", "m", "range_bias", prior_sigma=0.5),
    ]
)
DESIGN = np.random.default_rng(5).normal(size=(2 * EPOCH_COUNT, 3))
DESIGN[:, 2] = np.tile([1.0, 0.0], EPOCH_COUNT)
OF_B = np.tile([0.0, 1.0], EPOCH_COUNT)


def fit(residual_m):
    return fit_least_squares(
        lambda x: (residual_m - DESIGN @ x, DESIGN),
        PARAMETERS,
        ObservationCovariance.from_sigma(1.0, len(DESIGN)),
    )


def binned(residual_m):
    paths = Labels(np.tile(np.arange(2, dtype=np.int32), EPOCH_COUNT), PATHS)
    types = Labels(np.zeros(len(DESIGN), dtype=np.int32), ("range",))
    order = SeriesOrder.from_labels(types, paths, np.repeat(60.0 * np.arange(EPOCH_COUNT), 2))

    def white(points):
        return {item.key: SeriesNoise(1.0, np.ones(1), np.zeros(1)) for item in points.series}

    result = fit(residual_m)
    return result, BinnedProblem.from_fit(result, order, white)


def hypothesis(columns, *, sigma=1.0):
    width = columns.shape[1]
    return Hypothesis(
        Family.PARAMETER, "parameter", "test", columns, np.full(width, sigma), "m", ("",) * width
    )


def reliability(result, problem, columns, *, sigma=1.0):
    position_by_unit = result.factor.root_covariance()[:2]
    item = hypothesis(columns * sigma, sigma=sigma)
    [assessed] = assess_reliability(problem, [item], {Family.PARAMETER: LOG_LEVEL}, position_by_unit)
    return assessed


def test_noncentrality_of_baarda():
    """Square root 4.13 for a level of 0.1 % and a power of 80 % (Baarda 1968)."""
    assert math.sqrt(noncentrality(math.log(1e-3), 1)) == pytest.approx(4.13, abs=0.005)


def test_a_minimal_detectable_bias_is_found_in_80_percent_of_draws():
    rng, trial_count = np.random.default_rng(8), 200
    result, problem = binned(np.zeros(len(DESIGN)))
    minimal_m = reliability(result, problem, problem.columns({1: 1.0}), sigma=3.0).minimal
    detected = 0
    for _ in range(trial_count):
        noise_m = rng.normal(size=len(DESIGN))
        noise_m += DESIGN[:, [0, 2]] @ (np.array([5.0, 0.5]) * rng.normal(size=2))
        _, problem = binned(noise_m + minimal_m * OF_B)
        detected += problem.test(problem.columns({1: 1.0})).log_p_value < LOG_LEVEL
    assert detected / trial_count == pytest.approx(0.8, abs=3.0 * math.sqrt(0.8 * 0.2 / trial_count))


def test_external_reliability_is_the_shift_of_a_refit():
    result, problem = binned(np.zeros(len(DESIGN)))
    assessed = reliability(result, problem, problem.columns({1: 1.0}), sigma=3.0)
    shift_m = (fit(assessed.minimal * OF_B).x - result.x)[:2]
    assert assessed.shift_m == pytest.approx(np.linalg.norm(shift_m), rel=1e-6)
    assert assessed.shift_per_unit_m == pytest.approx(np.linalg.norm(shift_m) / assessed.minimal, rel=1e-6)


def test_several_columns_have_the_extremes_over_all_directions():
    result, problem = binned(np.zeros(len(DESIGN)))
    step = problem.columns({1: 1.0}, (900.0, np.inf))
    columns = hstack([problem.columns({1: 1.0}), step], format="csc")
    assessed = reliability(result, problem, columns)
    length = math.sqrt(noncentrality(LOG_LEVEL, 2))
    effects = np.column_stack([OF_B, OF_B * (np.arange(len(DESIGN)) >= 30)])  # epochs of 900 s and later
    sizes_m, shifts_m = [], []
    for angle in np.linspace(0.0, np.pi, 100):
        effect = effects @ np.array([math.cos(angle), math.sin(angle)])
        shifted, shifted_problem = binned(effect)
        size_m = length / math.sqrt(shifted_problem.test(columns).chi2)
        sizes_m.append(size_m)
        shifts_m.append(size_m * np.linalg.norm((shifted.x - result.x)[:2]))
    assert assessed.minimal == pytest.approx(min(sizes_m), rel=1e-3)
    assert assessed.shift_m == pytest.approx(max(shifts_m), rel=1e-3)


def test_an_error_that_a_parameter_absorbs_is_not_revealed():
    result, problem = binned(np.zeros(len(DESIGN)))
    columns = np.zeros((len(problem.whitened), 1))
    columns[: len(DESIGN), 0] = np.concatenate([DESIGN[::2, 1], DESIGN[1::2, 1]])  # points of A, then of B
    columns = csc_array(columns)
    assessed = reliability(result, problem, columns)
    assert not assessed.revealed
    assert assessed.to_dict()["minimal_detectable"] is assessed.to_dict()["shift_m"] is None
    assert assessed.shift_per_unit_m == pytest.approx(1.0, rel=1e-6)
    east_by_unit = result.factor.root_covariance()[:1]
    [of_east] = assess_reliability(
        problem, [hypothesis(columns)], {Family.PARAMETER: LOG_LEVEL}, east_by_unit
    )
    assert of_east.shift_per_unit_m == 0.0  # not rounding


def test_the_adapted_estimate_is_that_of_a_fit_with_the_finding_as_a_parameter():
    residual_m = np.random.default_rng(2).normal(size=len(DESIGN)) + 4.0 * OF_B
    result, problem = binned(residual_m)
    adapted = adapted_estimate(problem.with_parameters(problem.columns({1: 1.0})), result)
    design = np.column_stack([DESIGN, OF_B])
    parameters = ParameterSet([*PARAMETERS, Parameter("range_bias.B", "m", "range_bias")])
    refit = fit_least_squares(lambda x: (residual_m - design @ x, design), parameters, result.noise)
    assert adapted.shift == pytest.approx(refit.x[:3] - result.x, abs=2e-3)
    np.testing.assert_allclose(adapted.covariance, refit.covariance[:3, :3], rtol=1e-6)
