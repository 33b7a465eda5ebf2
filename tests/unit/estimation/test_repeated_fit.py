"""Fits of one linear problem to many residuals are those of the general fit, editing and excess noise included."""

import numpy as np
import pytest

from radioloc.estimation import Parameter, ParameterSet, fit_with_excess_noise
from radioloc.estimation.editing import EditingSettings
from radioloc.estimation.repeated_fit import RepeatedFit
from radioloc.parameters.parameter import Role

SAME_SIGMAS = 1e-8
"""Both solve the same linear problem to rounding; what remains is the conditioning of the random ones."""


def problem(rng, n, *, fixed=False):
    """Ranges, delays of two sigmas; a bias of the ranges with an a-priori value, a parameter of another scale."""
    group = (np.arange(n) % 3 > 0).astype(np.int32)
    sigma_m = np.where(group == 0, 2.0, np.where(np.arange(n) % 2, 0.5, 0.4))
    partials = np.column_stack(
        [rng.standard_normal((n, 3)), group == 0, 1e6 * rng.standard_normal(n) * (group == 1)]
    ).astype(float)
    parameters = ParameterSet(
        [
            *(Parameter(f"position.{axis}", "m", "position", 10.0 * k) for k, axis in enumerate("xyz")),
            Parameter("bias", "m", "bias", 1.0, 3.0),
            Parameter("rate", "s", "rate", 0.0, scale=1e-6, role=Role.FIXED if fixed else Role.ESTIMATED),
        ]
    )
    return partials, parameters, sigma_m, group


def both(seed, *, n=600, excess=1.0, outliers=0, fixed=False, unusable=0):
    rng = np.random.default_rng([20260101, seed])
    partials, parameters, sigma_m, group = problem(rng, n, fixed=fixed)
    x = np.array([1.0, 2.0, 3.0, 4.0, 0.0])
    residual_m = excess * sigma_m * rng.standard_normal(n) + partials @ np.array([0.3, -0.2, 0.1, 0.5, 0.0])
    residual_m[rng.choice(n, outliers, replace=False)] += 40.0
    usable = np.ones(n, dtype=bool)
    usable[:unusable] = False
    editing = EditingSettings()
    made = RepeatedFit.of(partials, parameters, x, sigma_m, group, usable, editing)
    known = fit_with_excess_noise(
        lambda at: (residual_m - partials @ (at - x), partials),
        parameters,
        sigma_m,
        groups=np.array(["range", "vlbi_delay"])[group],
        status=np.where(usable, "used", "below the horizon"),
        editing=editing,
    )
    return made.fit(residual_m), known, x


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"excess": 2.5},
        {"excess": 0.5},
        {"outliers": 30},
        {"outliers": 20, "excess": 3.0},
        {"fixed": True},
        {"unusable": 100, "outliers": 5},
        {"n": 12},
        {"n": 40, "outliers": 3},
    ],
    ids=str,
)
def test_the_same_as_the_general_fit(case):
    for seed in range(5):
        found, known, x = both(seed, **case)
        fit = known.edited.fit
        free = fit.parameters.free
        off = (x + found.step - fit.x)[free] / fit.sigmas[free]
        np.testing.assert_allclose(off, 0.0, atol=SAME_SIGMAS)
        np.testing.assert_allclose(found.covariance, fit.covariance, rtol=1e-6, atol=1e-9 * fit.sigmas.max())
        np.testing.assert_allclose(
            found.excess_noise_m, list(known.excess_noise_m.values()), rtol=1e-8, atol=1e-12
        )
        assert (found.used == fit.used).all()
        np.testing.assert_allclose(found.left_m[found.used], fit.residual_m[fit.used], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found.root @ found.root.T, fit.covariance[np.ix_(free, free)], rtol=1e-6)
        assert found.converged == known.edited.converged


def test_too_many_outliers_are_not_left_out():
    found, known, _ = both(1, outliers=220)
    assert (found.used == known.edited.fit.used).all()
    assert found.converged == known.edited.converged
    np.testing.assert_allclose(found.excess_noise_m, list(known.excess_noise_m.values()), rtol=1e-6)
    assert found.excess_noise_m.min() > 5.0


def test_nothing_is_made_where_not_everything_is_determined():
    partials, parameters, sigma_m, group = problem(np.random.default_rng(1), 100)
    partials[:, 1] = partials[:, 0]
    made = RepeatedFit.of(
        partials, parameters, np.zeros(5), sigma_m, group, np.ones(100, bool), EditingSettings()
    )
    assert made is None
