"""Contribution of consider parameters to the covariance, against fits of data that their errors have changed."""

from dataclasses import replace

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.estimation.consider import (
    NO_ERRORS,
    UnestimatedErrors,
    consider_sensitivity,
    principal_errors,
    prior_effects,
    reported_estimate,
)
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.parameters.parameter import Parameter, ParameterSet, Role

RNG = np.random.default_rng(4)
DESIGN, EFFECTS = RNG.normal(size=(60, 3)), RNG.normal(size=(60, 2))
SIGMA = 0.3 + RNG.random(60)
PARAMETERS = ParameterSet(
    [
        Parameter("a", "m", "position"),
        Parameter("b", "m", "position", 1.0, 0.5),
        Parameter("e", "m", "bias", role=Role.FIXED),
    ]
)
ERRORS = UnestimatedErrors(
    ParameterSet(
        [
            Parameter("c", "m", "bias", 2.0, 0.7, Role.CONSIDERED),
            Parameter("d", "s", "clock", 0.0, 3.0, Role.CONSIDERED),
        ]
    ),
    lambda rows: EFFECTS[rows],
)


def fitted(observed):
    return fit_least_squares(lambda x: (observed - DESIGN @ x, DESIGN), PARAMETERS, SIGMA)


def test_sensitivity_is_what_the_estimate_does():
    observed = DESIGN @ np.array([3.0, 1.2, 0.0])
    fit = fitted(observed)
    result = reported_estimate(fit, fit.covariance, ERRORS).consider
    for k, sigma in ((0, 0.7), (1, 3.0)):
        moved = fitted(observed + sigma * EFFECTS[:, k]).x - fit.x
        assert result.sensitivity[:2, k] == pytest.approx(moved[:2], abs=1e-12)
    assert not result.sensitivity[2].any()
    assert result.covariance == pytest.approx(result.sensitivity @ result.sensitivity.T)
    north = np.array([[0.0, 1.0, 0.0]])
    moved = {record["name"]: record["position_enu_m"] for record in result.to_list(north)}
    assert list(moved) == sorted(moved, key=lambda name: -abs(moved[name][0]))
    assert set(moved) == {"c", "d"}
    assert moved["d"] == pytest.approx([result.sensitivity[1, 1]])


@pytest.mark.study
def test_covariance_of_drawn_errors():
    """1000 sets of data whose considered parameters are wrong by their sigmas: the whole covariance."""
    fit = fitted(np.zeros(60))
    total = (fit.covariance + reported_estimate(fit, fit.covariance, ERRORS).consider.covariance)[:2, :2]
    errors = []
    for draw in RNG.normal(size=(1000, 63)):
        truth = np.array([0.0, 1.0 + 0.5 * draw[60], 0.0])
        observed = DESIGN @ truth + EFFECTS @ (draw[61:] * [0.7, 3.0]) + SIGMA * draw[:60]
        errors.append(fitted(observed).x[:2] - truth[:2])
    # A variance from 1000 draws is known to 4.5 %.
    assert np.var(errors, axis=0) == pytest.approx(np.diag(total), rel=0.18)


def adjusted(observed, errors=ERRORS.parameters, effects=EFFECTS):
    """A fit with considered parameters in its weights."""
    pair = np.hstack([DESIGN, effects])
    parameters = ParameterSet([*PARAMETERS, *errors])
    return fit_least_squares(lambda x: (observed - pair @ x, pair), parameters, SIGMA)


def test_weights_with_considered_errors_are_those_of_the_dense_covariance():
    """Generalized least squares with the covariance of noise and considered errors."""
    errors = ParameterSet([replace(item, prior_value=0.0) for item in ERRORS.parameters])
    observed = DESIGN @ np.array([3.0, 1.2, 0.0]) + SIGMA * RNG.normal(size=60)
    fit = adjusted(observed, errors)
    prior = EFFECTS * [0.7, 3.0]
    inverse = np.linalg.inv(np.diag(SIGMA**2) + prior @ prior.T)
    free = DESIGN[:, :2]
    covariance = np.linalg.inv(free.T @ inverse @ free + np.diag([0.0, 0.5**-2.0]))
    expected = covariance @ (free.T @ inverse @ observed + [0.0, 1.0 * 0.5**-2.0])
    estimate = reported_estimate(fit, fit.covariance, NO_ERRORS)
    np.testing.assert_allclose(estimate.values[:2], expected, rtol=0.0, atol=1e-9)
    total = estimate.covariance + estimate.consider.covariance
    np.testing.assert_allclose(total[:2, :2], covariance, rtol=1e-9)
    moved = estimate.consider.sensitivity[:2]
    np.testing.assert_allclose(moved, covariance @ free.T @ inverse @ prior, atol=1e-9)
    assert estimate.consider.in_weights == ("bias", "clock")
    assert estimate.parameters.names == PARAMETERS.names


def test_no_sigma_exceeds_its_prior_and_sources_add_up_to_the_covariance():
    fit = adjusted(np.zeros(60))
    assert (fit.sigmas <= fit.parameters.prior_sigmas).all()
    effects = prior_effects(fit)
    gain = fit.covariance @ np.hstack([DESIGN, EFFECTS]).T / SIGMA**2
    np.testing.assert_allclose(
        fit.covariance, gain @ np.diag(SIGMA**2) @ gain.T + effects @ effects.T, rtol=1e-9, atol=1e-15
    )


def test_few_errors_stand_for_many():
    """Errors that are alike, and one too small to matter, are one; a variance changes by less than 1 %."""
    effects = np.column_stack([EFFECTS[:, 0], EFFECTS[:, 0], 1e-4 * EFFECTS[:, 1]]) * 0.5
    unit_partials = DESIGN[:, :2] @ np.linalg.cholesky(fitted(np.zeros(60)).covariance[:2, :2])
    reduced = principal_errors(effects, SIGMA, unit_partials, np.ones(60, dtype=bool))
    assert reduced.shape == (60, 1)
    unit = [Parameter(name, "1", "bias", 0.0, 1.0, Role.CONSIDERED) for name in "xyz"]
    complete = adjusted(np.zeros(60), unit, effects).covariance[:2, :2]
    short = adjusted(np.zeros(60), unit[:1], reduced).covariance[:2, :2]
    np.testing.assert_allclose(short, complete, rtol=1e-3)
    moved = consider_sensitivity(fitted(np.zeros(60)), lambda rows: reduced[rows], 1)
    assert np.linalg.norm(moved) > 0.0


def test_what_is_considered_needs_a_sigma():
    with pytest.raises(InputError, match="needs a finite sigma"):
        Parameter("c", "m", "bias", role=Role.CONSIDERED)
