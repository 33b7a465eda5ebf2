"""The square-root information filter and smoother against a batch fit with all its accelerations as parameters."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from radioloc.dynamics.stochastic import ACROSS, AFTER, BEFORE, StochasticAccelerations
from radioloc.errors import InputError
from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.linearization import DenseLinearization
from radioloc.estimation.variance_components import mean_leverage
from radioloc.noise import ALONE, ObservationCovariance, SharedAtEpoch, White

N, INTERVALS, OTHER_COUNT = 120, (7, 4), 8
SIGMA_M = 0.3
TRUE = np.linspace(-1.0, 1.0, OTHER_COUNT)
IDENTICAL = 1e-9
"""Of a sigma: both are Householder reflections of the same numbers, in other orders."""


def process_of(persistence, sigma=1.0):
    """Observations of all intervals but one on either side of the epoch, and three across it, in no order."""
    random = np.random.default_rng(11)
    chain = random.choice([AFTER, AFTER, BEFORE], N).astype(np.int8)
    chain[:3] = ACROSS
    step = np.where(chain == AFTER, random.integers(0, 6, N), random.integers(0, 4, N))
    step[step == 2] = 1
    step[:3] = 0
    moved = tuple(sigma * random.normal(size=(count, 6, 3)) for count in INTERVALS)
    near_partials, far_partials = sigma * random.normal(size=(2, N, 3))
    zero = tuple(np.zeros((count + 1, 3)) for count in INTERVALS)
    return StochasticAccelerations(
        chain, step, random.normal(size=(N, 6)), near_partials, far_partials, moved, persistence, zero
    )


def written_out(process):
    """Partials of the observations by all u in the order of time, shape (n, m)."""
    counts = [count + 1 for count in INTERVALS]
    columns = []
    for chain, count in reversed(list(enumerate(counts))):
        for k in range(count)[:: 1 if chain == AFTER else -1]:
            for axis in range(3):
                values = [np.zeros((item, 3)) for item in counts]
                values[chain][k, axis] = 1.0
                columns.append(process.effects_m(tuple(values)))
    return np.array(columns).T


@dataclass(frozen=True)
class Model(DenseLinearization):
    processes: tuple[StochasticAccelerations, ...] = ()


def design():
    return np.random.default_rng(3).normal(size=(N, OTHER_COUNT))


def observed(process, persistence):
    """Observations of a drawn process, with noise."""
    random = np.random.default_rng(5)
    count = sum(INTERVALS) + 2
    covariance = persistence ** abs(np.subtract.outer(np.arange(count), np.arange(count)))
    u = np.linalg.cholesky(covariance) @ random.normal(size=(count, 3))
    noise_m = SIGMA_M * random.normal(size=N)
    return design() @ TRUE + written_out(process) @ u.ravel() + noise_m


PRIORS = [np.inf] * (OTHER_COUNT - 1) + [0.5]
PARAMETERS = ParameterSet([Parameter(f"p.{k}", "m", "p", 0.0, prior) for k, prior in enumerate(PRIORS)])


def model_of(processes, values_m):
    return lambda x: Model(values_m - design() @ x, design(), processes)


@pytest.mark.parametrize("persistence", [0.0, 0.6])
def test_the_filter_is_a_batch_fit_with_the_accelerations_as_parameters(persistence):
    process = process_of(persistence)
    values_m = observed(process, persistence)
    used = np.random.default_rng(9).random(N) > 0.1
    fit = fit_least_squares(model_of((process,), values_m), PARAMETERS, SIGMA_M, used=used)

    count = sum(INTERVALS) + 2
    a_priori = np.kron(persistence ** abs(np.subtract.outer(np.arange(count), np.arange(count))), np.eye(3))
    total = np.hstack([design(), written_out(process)])
    information = total[used].T @ total[used] / SIGMA_M**2
    information[OTHER_COUNT - 1, OTHER_COUNT - 1] += 0.5**-2
    information[OTHER_COUNT:, OTHER_COUNT:] += np.linalg.inv(a_priori)
    covariance = np.linalg.inv(information)
    estimate = covariance @ total[used].T @ values_m[used] / SIGMA_M**2
    sigma = np.sqrt(np.diag(covariance))

    assert fit.converged
    np.testing.assert_allclose((fit.x - estimate[:OTHER_COUNT]) / sigma[:OTHER_COUNT], 0.0, atol=IDENTICAL)
    np.testing.assert_allclose(
        fit.covariance, covariance[:OTHER_COUNT, :OTHER_COUNT], rtol=IDENTICAL, atol=1e-13
    )
    [smoothed] = fit.smoothed
    u = np.concatenate([smoothed.values[BEFORE][::-1], smoothed.values[AFTER]]).ravel()
    np.testing.assert_allclose((u - estimate[OTHER_COUNT:]) / sigma[OTHER_COUNT:], 0.0, atol=IDENTICAL)
    left_m = values_m - total @ estimate
    np.testing.assert_allclose(fit.residual_m, left_m, atol=IDENTICAL)
    prior = (
        estimate[OTHER_COUNT:] @ np.linalg.solve(a_priori, estimate[OTHER_COUNT:])
        + (estimate[OTHER_COUNT - 1] / 0.5) ** 2
    )
    assert fit.chi2 == pytest.approx((left_m[used] ** 2).sum() / SIGMA_M**2 + prior, rel=1e-9)
    assert fit.dof == used.sum() + 1 - OTHER_COUNT
    hat = np.trace(information @ covariance) - np.trace(
        np.linalg.solve(a_priori, covariance[OTHER_COUNT:, OTHER_COUNT:])
    )
    hat -= covariance[OTHER_COUNT - 1, OTHER_COUNT - 1] / 0.5**2
    assert mean_leverage(fit) * used.sum() == pytest.approx(hat, rel=1e-9)

    # Errors of the others, of the deviation and of u, together, at each interval.
    for chain, moved in enumerate(process.moved):
        for k in range(len(moved) + 1):
            onto = np.zeros((OTHER_COUNT + 9, OTHER_COUNT + 3 * count))
            onto[:OTHER_COUNT, :OTHER_COUNT] = np.eye(OTHER_COUNT)
            for j in range(k + 1):
                first = OTHER_COUNT + 3 * (INTERVALS[1] + 1 + j if chain == AFTER else INTERVALS[1] - j)
                if j < k:
                    onto[OTHER_COUNT : OTHER_COUNT + 6, first : first + 3] = moved[j]
                else:
                    onto[OTHER_COUNT + 6 :, first : first + 3] = np.eye(3)
            expected = onto @ covariance @ onto.T
            np.testing.assert_allclose(smoothed.covariance[chain][k], expected, rtol=1e-8, atol=1e-11)


def test_the_filters_of_two_orbits_are_a_batch_fit_with_both_accelerations():
    first = process_of(0.6)
    is_second, second = np.arange(N) % 3 == 0, replace(process_of(0.2), step=np.roll(first.step, 3))
    second = replace(second, chain=np.roll(first.chain, 3))
    zeroed = ("by_state", "near", "far")
    first = replace(first, **{key: getattr(first, key) * ~is_second[:, None] for key in zeroed})
    second = replace(second, **{key: getattr(second, key) * is_second[:, None] for key in zeroed})
    values_m = observed(first, 0.6)
    fit = fit_least_squares(model_of((first, second), values_m), PARAMETERS, SIGMA_M)
    count = sum(INTERVALS) + 2
    steps = abs(np.subtract.outer(np.arange(count), np.arange(count)))
    a_priori = block_diag(*(np.kron(m**steps, np.eye(3)) for m in (0.6, 0.2)))
    total = np.hstack([design(), written_out(first), written_out(second)])
    information = total.T @ total / SIGMA_M**2
    information[OTHER_COUNT - 1, OTHER_COUNT - 1] += 0.5**-2
    information[OTHER_COUNT:, OTHER_COUNT:] += np.linalg.inv(a_priori)
    covariance = np.linalg.inv(information)
    estimate = covariance @ total.T @ values_m / SIGMA_M**2
    accelerations = [np.concatenate([u.values[BEFORE][::-1], u.values[AFTER]]).ravel() for u in fit.smoothed]
    estimated = np.concatenate([fit.x, *accelerations])
    np.testing.assert_allclose((estimated - estimate) / np.sqrt(np.diag(covariance)), 0.0, atol=IDENTICAL)
    np.testing.assert_allclose(
        fit.covariance, covariance[:OTHER_COUNT, :OTHER_COUNT], rtol=IDENTICAL, atol=1e-13
    )
    np.testing.assert_allclose(fit.residual_m, values_m - total @ estimate, atol=IDENTICAL)


def test_errors_that_observations_of_two_orbits_share_are_refused():
    first = process_of(0.3)
    is_second = np.arange(N) % 2 == 0
    second = replace(first, by_state=first.by_state * is_second[:, None])
    first = replace(first, by_state=first.by_state * ~is_second[:, None])
    shared = SharedAtEpoch(np.arange(N) // 2, np.zeros((N, 1), dtype=np.intp), np.ones((N, 1)))
    noise = ObservationCovariance((White(np.full(N, SIGMA_M)), shared))
    with pytest.raises(InputError, match="several orbits"):
        fit_least_squares(model_of((first, second), np.zeros(N)), PARAMETERS, noise)


def test_observations_that_share_errors_are_weighed_together():
    """Three of one interval and one station's error: the filter's information is that of the covariance written out."""
    process = process_of(0.3)
    first = np.flatnonzero((process.chain == AFTER) & (process.step == 1))[:3]
    group = np.full(N, ALONE)
    group[first] = 0
    effect_m = np.zeros((N, 1))
    effect_m[first, 0] = [1.0, -1.0, 2.0]
    shared = SharedAtEpoch(group, np.zeros((N, 1), dtype=np.intp), effect_m)
    noise = ObservationCovariance((White(np.full(N, SIGMA_M)), shared))
    fit = fit_least_squares(model_of((process,), observed(process, 0.3)), PARAMETERS, noise)
    count = sum(INTERVALS) + 2
    a_priori = np.kron(0.3 ** abs(np.subtract.outer(np.arange(count), np.arange(count))), np.eye(3))
    by_u = written_out(process)
    covariance_m2 = np.diag(np.full(N, SIGMA_M**2)) + effect_m @ effect_m.T + by_u @ a_priori @ by_u.T
    information = design().T @ np.linalg.solve(covariance_m2, design())
    information[-1, -1] += 0.5**-2
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(information), rtol=1e-8, atol=1e-12)


def test_an_outlier_is_told_from_what_the_process_does():
    process = process_of(0.0, sigma=30.0)
    values_m = observed(process, 0.0)
    values_m[50] += 100.0 * SIGMA_M
    edited = fit_with_editing(model_of((process,), values_m), PARAMETERS, SIGMA_M)
    assert np.flatnonzero(~edited.fit.used).tolist() == [50]
    reference = fit_with_editing(model_of((), values_m), PARAMETERS, SIGMA_M)
    assert reference.robust_scale > 20.0
