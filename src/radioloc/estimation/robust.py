"""A start that gross errors cannot carry away, and a scale that they cannot inflate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.least_squares import (
    FitSettings,
    ResidualFunction,
    check_finite,
    evaluate,
    factorize,
)
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.parameters import ParameterSet

_MAD_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution to its standard deviation
_MAX_LINEARIZATIONS = 15
_MAX_REWEIGHTINGS = 100
_SETTLED = 0.1  # the fitted values have settled when none moves by more than this many (robust) sigmas


def robust_scale(normalized: NDArray[np.float64], n_parameters: int) -> float:
    """Spread of normalized residuals, 1 where the stated sigmas are right, by the median absolute deviation.

    Parameters
    ----------
    normalized : ndarray, shape (n,)
        Residuals over their stated sigmas; up to half of them may be gross errors.
    n_parameters : int
        Number of parameters estimated. A robust fit passes through that many observations, whose residuals of
        zero say nothing and are left out (DuMouchel and O'Brien 1989).

    Notes
    -----
    The deviation is taken from zero, where the residuals of a fit should be centred. Zero if there are no
    residuals.
    """
    if not len(normalized):
        return 0.0
    ordered = np.sort(np.abs(normalized))
    telling = ordered[min(max(0, n_parameters - 1), len(ordered) - 1) :]
    return _MAD_TO_SIGMA * float(np.median(telling))


def robust_start(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: NDArray[np.float64],
    usable: NDArray[np.bool_],
    settings: FitSettings,
) -> NDArray[np.float64]:
    """Estimate that gross errors in a minority of the observations move by little, shape (p,).

    Minimizes Huber's loss (1964) with its corner at one stated sigma, so that far from the solution it is
    the sum of absolute residuals, by iteratively reweighted least squares on each linearization. The loss
    is convex: far from the solution there is no false minimum of a linear model to fall into, and no scale
    has to be guessed.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    parameters : ParameterSet
        What is solved for; starts at the a-priori values.
    sigma_m : ndarray, shape (n,)
        Stated standard deviations, m. Errors that observations share count in each as if it were alone with them: a
        start need not weigh the last bit.
    usable : ndarray of bool, shape (n,)
        Observations that may take part.
    settings : FitSettings
        Tolerances of rank.

    Raises
    ------
    InputError
        Residuals or partials at the start are not finite.
    """
    x = parameters.prior_values
    free = parameters.free
    residual_m, partials = evaluate(residual_function, x)
    check_finite(residual_m[usable], partials[usable], parameters)
    loss = _huber_loss(residual_m[usable] / sigma_m[usable], parameters, x)
    for _ in range(_MAX_LINEARIZATIONS):
        step = _huber_step(residual_m[usable], partials[usable], sigma_m[usable], parameters, x, settings)
        moved = np.abs(partials[usable][:, free] @ step) / sigma_m[usable]
        spread = robust_scale(residual_m[usable] / sigma_m[usable], int(free.sum()))
        if moved.max(initial=0.0) < _SETTLED * max(1.0, spread):
            break
        for _ in range(10):
            trial = x.copy()
            trial[free] += step
            trial_residual_m, trial_partials = evaluate(residual_function, trial)
            trial_loss = _huber_loss(trial_residual_m[usable] / sigma_m[usable], parameters, trial)
            if trial_loss < loss:
                break
            step = 0.5 * step
        else:
            break
        x, residual_m, partials, loss = trial, trial_residual_m, trial_partials, trial_loss
    return x


def _huber_step(
    residual_m: NDArray[np.float64],
    partials: NDArray[np.float64],
    sigma_m: NDArray[np.float64],
    parameters: ParameterSet,
    x: NDArray[np.float64],
    settings: FitSettings,
) -> NDArray[np.float64]:
    """Change of the free parameters that minimizes Huber's loss of the linearized residuals, shape (q,)."""
    free_partials = partials[:, parameters.free]
    step = np.zeros(free_partials.shape[1])
    remaining_m = residual_m
    for _ in range(_MAX_REWEIGHTINGS):
        # A residual of m sigmas, m > 1, weighs like one observed with sqrt(m) times the stated sigma.
        weakened_m = sigma_m * np.sqrt(np.maximum(1.0, np.abs(remaining_m) / sigma_m))
        noise = ObservationNoise(weakened_m)
        new_step = factorize(residual_m, partials, noise, parameters, x, settings).step()
        moved = np.abs(free_partials @ (new_step - step)) / sigma_m
        step = new_step
        remaining_m = residual_m - free_partials @ step
        spread = robust_scale(remaining_m / sigma_m, len(step))
        if moved.max(initial=0.0) < _SETTLED * max(1.0, spread):
            break
    return step


def _huber_loss(normalized: NDArray[np.float64], parameters: ParameterSet, x: NDArray[np.float64]) -> float:
    size = np.abs(normalized)
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    loss = float(np.where(size < 1.0, 0.5 * size**2, size - 0.5).sum() + 0.5 * prior @ prior)
    return loss if np.isfinite(loss) else np.inf
