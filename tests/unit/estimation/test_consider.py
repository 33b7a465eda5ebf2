"""What considered parameters add to the covariance, against fits of data that their errors have changed."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.estimation.consider import consider
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.parameters.parameter import Parameter, ParameterSet, Role

RNG = np.random.default_rng(4)
DESIGN = RNG.normal(size=(60, 5))
SIGMA = 0.3 + RNG.random(60)
PARAMETERS = ParameterSet(
    [
        Parameter("a", "m", "position"),
        Parameter("b", "m", "position", 1.0, 0.5),
        Parameter("c", "m", "bias", 2.0, 0.7, Role.CONSIDERED),
        Parameter("d", "s", "clock", 0.0, 3.0, Role.CONSIDERED),
        Parameter("e", "m", "bias", role=Role.FIXED),
    ]
)


def fitted(observed):
    return fit_least_squares(lambda x: (observed - DESIGN @ x, DESIGN), PARAMETERS, SIGMA)


def test_sensitivity_is_what_the_estimate_does():
    observed = DESIGN @ np.array([3.0, 1.2, 2.0, 0.0, 0.0])
    fit = fitted(observed)
    found = consider(fit)
    for k, sigma in ((2, 0.7), (3, 3.0)):
        moved = fitted(observed + sigma * DESIGN[:, k]).x - fit.x
        assert found.sensitivity[:2, k] == pytest.approx(moved[:2], abs=1e-12)
        assert found.sensitivity[k, k] == sigma
    assert not found.sensitivity[:, [0, 1, 4]].any()
    assert found.covariance == pytest.approx(found.sensitivity @ found.sensitivity.T)
    north = np.array([[0.0, 1.0, 0.0, 0.0, 0.0]])
    moved = {record["name"]: record["position_enu_m"] for record in found.to_list(north)}
    assert sorted(moved) == ["c", "d"]
    assert moved["d"] == pytest.approx([found.sensitivity[1, 3]])


def test_covariance_of_drawn_errors():
    """1000 sets of data whose considered parameters are wrong by their sigmas: the whole covariance."""
    draws = RNG.normal(size=(1000, 62))
    fit = fitted(np.zeros(60))
    total = (fit.covariance + consider(fit).covariance)[:2, :2]
    errors = []
    for draw in draws:
        truth = np.array([0.0, 1.0 + 0.5 * draw[61], 2.0 + 0.7 * draw[60], 0.0, 0.0])
        truth[3] = 3.0 * RNG.normal()
        observed = DESIGN @ truth + SIGMA * draw[:60]
        errors.append(fitted(observed).x[:2] - truth[:2])
    # A variance from 1000 draws is known to 4.5 %.
    assert np.var(errors, axis=0) == pytest.approx(np.diag(total), rel=0.18)


def test_without_considered_parameters_there_is_nothing():
    held = ParameterSet([Parameter("a", "m", "position")])
    fit = fit_least_squares(lambda x: (np.ones(3) - x, np.ones((3, 1))), held, 1.0)
    assert consider(fit) is None
    with pytest.raises(InputError, match="which needs the sigma"):
        Parameter("c", "m", "bias", role=Role.CONSIDERED)
