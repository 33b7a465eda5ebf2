"""What considered parameters add to the covariance, against fits of data that their errors have changed."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.estimation.consider import CommonErrors, ConsideredErrors, consider, few_errors, moved_by
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.observation_noise import ObservationNoise
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
ERRORS = ConsideredErrors(
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
    found = consider(fit, ERRORS)
    for k, sigma in ((0, 0.7), (1, 3.0)):
        moved = fitted(observed + sigma * EFFECTS[:, k]).x - fit.x
        assert found.sensitivity[:2, k] == pytest.approx(moved[:2], abs=1e-12)
    assert not found.sensitivity[2].any()
    assert found.covariance == pytest.approx(found.sensitivity @ found.sensitivity.T)
    north = np.array([[0.0, 1.0, 0.0]])
    moved = {record["name"]: record["position_enu_m"] for record in found.to_list(north)}
    assert list(moved) == sorted(moved, key=lambda name: -abs(moved[name][0]))
    assert set(moved) == {"c", "d"}
    assert moved["d"] == pytest.approx([found.sensitivity[1, 1]])


@pytest.mark.study
def test_covariance_of_drawn_errors():
    """1000 sets of data whose considered parameters are wrong by their sigmas: the whole covariance."""
    fit = fitted(np.zeros(60))
    total = (fit.covariance + consider(fit, ERRORS).covariance)[:2, :2]
    errors = []
    for draw in RNG.normal(size=(1000, 63)):
        truth = np.array([0.0, 1.0 + 0.5 * draw[60], 0.0])
        observed = DESIGN @ truth + EFFECTS @ (draw[61:] * [0.7, 3.0]) + SIGMA * draw[:60]
        errors.append(fitted(observed).x[:2] - truth[:2])
    # A variance from 1000 draws is known to 4.5 %.
    assert np.var(errors, axis=0) == pytest.approx(np.diag(total), rel=0.18)


def test_few_errors_stand_for_many():
    """Errors that are alike, and one too small to matter, are one; to 1 % of the sigma of the observations."""
    effects = np.column_stack([EFFECTS[:, 0], EFFECTS[:, 0], 1e-4 * EFFECTS[:, 1]])
    alike = [Parameter(name, "m", "bias", 0.0, 0.5, Role.CONSIDERED) for name in "xyz"]
    errors = ConsideredErrors(ParameterSet(alike), lambda rows: effects[rows])
    few, at_stations = few_errors(errors, SIGMA)
    assert few.shape == (60, 1)
    assert at_stations == 1
    fit = fitted(np.zeros(60))
    moved = moved_by(fit, lambda rows: few[rows], 1)
    left_out = np.diag(consider(fit, errors).covariance - moved @ moved.T)
    assert (np.abs(left_out) < (0.01 * fit.sigmas) ** 2 + 1e-15).all()


def test_what_matters_is_told_by_the_sigma_of_each_observation():
    """One error is 0.2 % of the sigma of the observation that it is of, the other 20 %."""
    both = ParameterSet([Parameter(name, "m", "bias", 0.0, 1.0, Role.CONSIDERED) for name in "xy"])
    errors = ConsideredErrors(both, lambda rows: np.diag([0.02, 0.02])[rows])
    few, _ = few_errors(errors, np.array([10.0, 0.1]))
    np.testing.assert_allclose(np.abs(few), [[0.0], [0.02]], rtol=0, atol=1e-15)


def test_weights_allow_for_errors_at_stations():
    """Generalized least squares with the dense covariance; errors of frames are not in it."""
    third = Parameter("m", "m", "moon_position", 0.0, 5.0, Role.CONSIDERED)
    effects = np.column_stack([EFFECTS, DESIGN[:, 0] ** 2])
    errors = ConsideredErrors(ParameterSet([*ERRORS.parameters, third]), lambda rows: effects[rows])
    observed = DESIGN @ np.array([3.0, 1.2, 0.0]) + SIGMA * RNG.normal(size=60)
    whitening = CommonErrors.of(ObservationNoise.of(SIGMA, 60).among(np.ones(60, bool)), errors.at_stations)
    fit = fit_least_squares(lambda x: (observed - DESIGN @ x, DESIGN), PARAMETERS, SIGMA, whitening=whitening)
    known = EFFECTS * [0.7, 3.0]
    inverse = np.linalg.inv(np.diag(SIGMA**2) + known @ known.T)
    free = DESIGN[:, :2]
    covariance = np.linalg.inv(free.T @ inverse @ free + np.diag([0.0, 0.5**-2.0]))
    expected = covariance @ (free.T @ inverse @ observed + [0.0, 1.0 * 0.5**-2.0])
    np.testing.assert_allclose(fit.x[:2], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(fit.covariance[:2, :2], covariance, rtol=1e-9)
    moved = consider(fit, errors).sensitivity[:2]
    np.testing.assert_allclose(moved, covariance @ free.T @ inverse @ (effects * [0.7, 3.0, 5.0]), atol=1e-9)
    assert ConsideredErrors(ParameterSet([third]), lambda rows: effects[rows, 2:]).at_stations is None


def test_what_is_considered_needs_a_sigma():
    with pytest.raises(InputError, match="which needs the sigma"):
        Parameter("c", "m", "bias", role=Role.CONSIDERED)
