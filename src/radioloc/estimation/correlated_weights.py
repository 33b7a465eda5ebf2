"""Weights that allow for time-correlated residuals: generalized least squares.

Least squares that weigh observations as independent have the right expectation whatever the errors, but not the least
variance: a dense series whose errors are correlated outweighs a-priori values and other series that know better. With
the covariance V of white noise and a Gauss-Markov process in each series the best linear estimate weighs by the inverse
of V (Aitken 1935). A Kalman filter whitens residuals and design matrix of each series
(:mod:`~radioloc.estimation.gauss_markov`); what it leaves are independent observations to the fit. The noise model is
found once, from the fit with independent weights: a restricted likelihood does not depend on the estimate.

Delays that share errors of stations are weighed as the independent observations that they are worth: their sigmas are
multiplied by the root of n / n_effective, the mean over the combinations of baselines whose errors are correlated. In
any case the covariance of the estimate is the sandwich of the weights and of the errors as they are
(:mod:`~radioloc.estimation.time_correlation`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.factorization import covariance_of, gram
from radioloc.estimation.gauss_markov import SeriesNoise
from radioloc.estimation.least_squares import FitResult, fit_least_squares, sum_of_squares
from radioloc.estimation.linearization import ResidualFunction, Rows
from radioloc.estimation.series import Batch, SeriesOrder, series_of
from radioloc.estimation.time_correlation import (
    SeriesCorrelation,
    TimeCorrelation,
    assess_time_correlation,
    weighted_series,
)


@dataclass(frozen=True, slots=True)
class SeriesWeight:
    """What a series with time-correlated residuals weighs.

    Parameters
    ----------
    name : str
        The series; observations of a type that share errors are one.
    count : int
        Its used observations.
    sigma_factor : float
        Factor on the stated sigmas by which independent observations would tell the mean of the series as well, 1 or
        more.
    """

    name: str
    count: int
    sigma_factor: float

    @property
    def weighed_as(self) -> float:
        """How many independent observations would have the same weight together."""
        return self.count / self.sigma_factor**2


@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedFit:
    """A fit weighed as its residuals ask for.

    Parameters
    ----------
    edited : EditedFit
        Its noise, sum of squares and formal covariance are those of the stated sigmas; its estimate and factor those of
        the weights.
    weights : tuple of SeriesWeight
        Series with time-correlated residuals.
    """

    edited: EditedFit
    weights: tuple[SeriesWeight, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Whitening:
    """How used observations are brought to independent ones where series have noise of their own."""

    batches: Sequence[Batch]
    noise: dict[str, SeriesNoise]

    def whitened(self, rows_of: Callable[[Rows], NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
        """Independent combinations of unit variance, from indices of rows (m,) to numbers (m, c), series by series."""
        for batch in self.batches:
            values = batch.whitened(rows_of)
            step_s = np.diff(batch.time_s, prepend=batch.time_s[0])
            for k, key in enumerate(batch.keys):
                errors = self.noise.get(key)
                yield values[:, k] if errors is None else errors.whitened(step_s, values[:, k])


def fit_with_correlated_weights(
    residual_function: ResidualFunction, edited: EditedFit, order: SeriesOrder
) -> CorrelatedFit:
    """Fit again, each series with time-correlated residuals weighed by the inverse of their covariance.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    edited : EditedFit
        The fit with all observations weighed as independent; its selection stays, as outliers are judged by the stated
        sigmas.
    order : SeriesOrder
        Types, paths and times of the observations.
    """
    stated = edited.fit
    # A fit that did not come to its end says itself what is wrong with it.
    if not edited.ended:
        return CorrelatedFit(edited, ())
    found = assess_time_correlation(stated, order)
    if found is None:
        return CorrelatedFit(edited, ())
    batches = series_of(order, stated.noise, stated.used)
    weights = _weights(batches, found)
    weight_noise = _weight_noise(batches, found, weights)
    fit = fit_least_squares(
        residual_function,
        stated.parameters,
        stated.noise,
        used=stated.used,
        start=stated.x,
        linearization=stated.linearization,
        whitening=_Whitening(batches, weight_noise),
    )
    fit = replace(
        fit,
        covariance=_formal_covariance(fit, batches, weight_noise),
        chi2=sum_of_squares(fit.residual_m, stated.noise.among(fit.used), fit.parameters, fit.x),
        series_noise=dict(found.noise),
        weight_noise=weight_noise,
    )
    return CorrelatedFit(replace(edited, fit=fit), weights)


def _formal_covariance(
    fit: FitResult, batches: Sequence[Batch], weight_noise: dict[str, SeriesNoise]
) -> NDArray[np.float64]:
    """Covariance of the estimate by these weights were errors independent and as stated, shape (p, p)."""
    root = fit.factor.root_covariance()
    unit = np.eye(root.shape[1])
    for batch in batches:
        for one in weighted_series(batch, fit, root, weight_noise):
            unit += gram(one.unit, one.unit)
            unit -= weight_noise[one.key].products(one.step_s, one.gain, one.unit)
    return covariance_of(fit.factor, fit.parameters, unit)


def _weight_noise(
    batches: Sequence[Batch], found: TimeCorrelation, weights: Sequence[SeriesWeight]
) -> dict[str, SeriesNoise]:
    """Noise by whose inverse covariance series are weighed, by key.

    Errors of stations go on where a baseline drops out and the combinations become others, which a filter for each
    combination does not know. Observations that share errors have one factor on their sigmas instead.
    """
    factors = {weight.name: weight.sigma_factor for weight in weights}
    noise: dict[str, SeriesNoise] = {}
    for batch in batches:
        if batch.shared in factors:
            inflated = SeriesNoise(factors[batch.shared] ** 2, np.ones(1), np.zeros(1))
            noise |= dict.fromkeys(batch.keys, inflated)
        elif not batch.shared and batch.keys[0] in found.noise:
            errors = found.noise[batch.keys[0]]
            tau_s, coloured = np.array([errors.correlation_time_s]), np.array([errors.coloured.sum()])
            noise[batch.keys[0]] = SeriesNoise(errors.white, tau_s, coloured)
    return noise


def _weights(batches: Sequence[Batch], found: TimeCorrelation) -> tuple[SeriesWeight, ...]:
    """What the series weigh; combinations of observations that share errors together."""
    items = dict(zip(found.keys, found.series, strict=True))
    counts: dict[str, int] = {}
    mine: dict[str, list[SeriesCorrelation]] = {}
    for batch in batches:
        name = batch.shared or batch.names[0]
        counts[name] = counts.get(name, 0) + batch.rows.size
        mine.setdefault(name, []).extend(items[key] for key in batch.keys if key in items)
    weights = []
    for name, found_in in mine.items():
        # Combinations in which the errors of stations cancel, around triangles, need not be correlated.
        enlarged = sum(item.count**2 / item.effective_count for item in found_in)
        factor = math.sqrt(max(1.0, enlarged / max(sum(item.count for item in found_in), 1)))
        if factor > 1.0:
            weights.append(SeriesWeight(name, counts[name], factor))
    return tuple(weights)
