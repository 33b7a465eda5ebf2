"""Properties of the estimator that hold whatever the problem: units, order, information."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.observability import assess_observability

# Double precision times the condition of the problems drawn, below 1e4.
RTOL = 1e-9

seeds = st.integers(0, 2**32 - 1)
sizes = st.tuples(st.integers(8, 60), st.integers(1, 5))


def problem(seed, size):
    n, p = size
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(n, p)) + 0.5
    observed = design @ rng.normal(size=p) * 100.0 + rng.normal(size=n)
    return design, observed, rng.uniform(0.5, 2.0, size=n)


def parameters(p, unit_m=None, **changes):
    units = np.ones(p) if unit_m is None else unit_m
    return ParameterSet([Parameter(f"p.{k}", "u", "p", scale=1.0 / units[k], **changes) for k in range(p)])


def fitted(design, observed, sigma, parameter_set):
    return fit_least_squares(lambda x: (observed - design @ x, design), parameter_set, sigma)


@given(seeds, sizes, st.data())
def test_units_of_parameters_do_not_matter(seed, size, data):
    design, observed, sigma = problem(seed, size)
    unit_m = 10.0 ** data.draw(arrays(float, size[1], elements=st.floats(-6.0, 6.0)))
    plain = fitted(design, observed, sigma, parameters(size[1]))
    scaled = fitted(design * unit_m, observed, sigma, parameters(size[1], unit_m))
    assert scaled.converged == plain.converged
    np.testing.assert_allclose(scaled.x * unit_m, plain.x, rtol=RTOL, atol=RTOL * np.abs(plain.x).max())
    np.testing.assert_allclose(scaled.sigmas * unit_m, plain.sigmas, rtol=RTOL)
    np.testing.assert_allclose(scaled.factor.singular_values, plain.factor.singular_values, rtol=RTOL)


@given(seeds, sizes, st.floats(-3.0, 3.0))
def test_units_of_observations_do_not_matter(seed, size, exponent):
    design, observed, sigma = problem(seed, size)
    unit = 10.0**exponent
    plain = fitted(design, observed, sigma, parameters(size[1]))
    scaled = fitted(unit * design, unit * observed, unit * sigma, parameters(size[1]))
    np.testing.assert_allclose(scaled.x, plain.x, rtol=RTOL, atol=RTOL * np.abs(plain.x).max())
    np.testing.assert_allclose(scaled.covariance, plain.covariance, rtol=RTOL, atol=1e-12)


@given(seeds, sizes)
def test_order_of_observations_and_parameters_does_not_matter(seed, size):
    design, observed, sigma = problem(seed, size)
    observed[0] += 1e4
    rng = np.random.default_rng(seed)
    rows, columns = rng.permutation(size[0]), rng.permutation(size[1])
    names = parameters(size[1])
    mixed_names = ParameterSet([names.parameters[k] for k in columns])
    mixed_design = design[rows][:, columns]
    plain = fit_with_editing(lambda x: (observed - design @ x, design), names, sigma)
    mixed = fit_with_editing(
        lambda x: (observed[rows] - mixed_design @ x, mixed_design), mixed_names, sigma[rows]
    )
    assert mixed.converged == plain.converged
    assert list(mixed.fit.used) == list(plain.fit.used[rows])
    np.testing.assert_allclose(
        mixed.fit.x, plain.fit.x[columns], rtol=RTOL, atol=RTOL * np.abs(plain.fit.x).max()
    )
    np.testing.assert_allclose(mixed.fit.sigmas, plain.fit.sigmas[columns], rtol=RTOL)


@given(seeds, sizes)
def test_zero_noise_is_recovered(seed, size):
    design, _, sigma = problem(seed, size)
    truth = np.random.default_rng(seed + 1).normal(size=size[1]) * 1e5
    fit = fitted(design, design @ truth, sigma, parameters(size[1]))
    assert fit.converged
    np.testing.assert_allclose(fit.x, truth, rtol=0.0, atol=RTOL * 1e5)


@given(seeds, sizes)
def test_more_information_never_hurts(seed, size):
    design, observed, sigma = problem(seed, size)
    free = fitted(design, observed, sigma, parameters(size[1]))
    with_prior = fitted(design, observed, sigma, parameters(size[1], prior_sigma=3.0))
    fewer = fitted(design[:-1], observed[:-1], sigma[:-1], parameters(size[1]))
    assert (with_prior.sigmas <= free.sigmas * (1.0 + RTOL)).all()
    assert (free.sigmas <= fewer.sigmas * (1.0 + RTOL)).all()


@given(seeds, sizes)
def test_a_doubled_column_is_always_found_and_named(seed, size):
    design, observed, sigma = problem(seed, size)
    doubled = np.column_stack([design, design[:, 0]])
    fit = fitted(doubled, observed, sigma, parameters(size[1] + 1))
    (direction,) = assess_observability(fit).undetermined
    assert set(direction.names) == {"p.0", f"p.{size[1]}"}
    assert not fit.converged
