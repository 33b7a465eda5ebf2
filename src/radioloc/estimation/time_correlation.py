"""Time-correlated residuals: covariance of the estimate, and weights that allow for the correlation.

A fit that weighs observations as independent still has the right expectation when their errors are correlated for
hours, but its formal sigmas are too small: a thousand observations of an hour are worth a few. The covariance of an
estimate is therefore taken with the errors as the residuals show them (the sandwich of Huber 1967 and White 1980),

    (A^T W A + P)^-1 (A^T W V W A + P) (A^T W A + P)^-1,

with the whitened design matrix A, the information P of the a-priori values, the weights W and V the covariance of the
whitened errors: in each series (the residuals of one link and type) white noise and first-order Gauss-Markov processes
(:mod:`~radioloc.estimation.gauss_markov`). Errors of different series count as independent. Delays that share errors
of stations are brought to independent combinations first (:mod:`~radioloc.estimation.series`).

Nor do independent weights, the identity, have the least variance: a dense series whose errors are correlated outweighs
more accurate a-priori values and other series. The best linear estimate weighs by the inverse of V (Aitken 1935). A
Kalman filter whitens residuals and design matrix of each series; what it leaves are independent observations to the
fit. The noise is found once, from the fit with independent weights: a restricted likelihood does not depend on the
estimate. Weights allow for significant correlation only, the covariance for all that the residuals leave possible.
Delays that share errors of stations have the weight of their effective number of observations: their sigmas are
multiplied by the root of n / n_effective, the mean over the combinations of baselines.

Weights are themselves estimates. Where the noise of a type is found too small, its weight is too large and
the stated covariance too small. To first order the covariance of the estimate lacks (Kackar and Harville
1984; Kenward and Roger 1997)

    2 sum over weights g of s_g^2 C (I_g - I_g C I_g) C,

with the information I_g of the observations of one weight, the covariance C, and the variance s_g^2, over the noise
models of the average, of the logarithm of the variance that they give to the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.gauss_markov import (
    DENSE,
    NO_NOISE,
    Points,
    SeriesCorrelation,
    SeriesNoise,
    SeriesWeight,
    TimeCorrelation,
    half_products,
    noise_of_series,
)
from radioloc.estimation.least_squares import FitResult, fit_least_squares
from radioloc.estimation.linearization import (
    OrthonormalLinearization,
    ResidualFunction,
    covariance_matrix,
    directions_of_rows,
    free_partials,
    gram,
    matrix_product,
    root_of_rows,
)
from radioloc.estimation.series import (
    CorrelatedWhitener,
    IndependentSeries,
    SeriesOrder,
    binned_partials,
    independent_series,
    points_of,
)
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.whitening import column
from radioloc.vectors import Floats

_FREE_SIGMAS = 300.0  # a priori where noise is found jointly: as good as free, and no column is singular
ABSORBED_SIGMAS = 30.0  # likewise of a series by itself: what the estimate, off by so much, takes is left out


def assess_time_correlation(fit: FitResult, order: SeriesOrder) -> TimeCorrelation:
    """Find series with significantly correlated residuals; their effect on the covariance.

    Without it, 95 % ellipses hold the truth in 2 to 43 % of the cases where errors last for hours
    (`tests/statistics/test_time_correlation.py`).
    """
    if fit.time_correlation is not None:  # assessed already
        return fit.time_correlation
    return _with_added_covariance(fit, *_correlation_of_residuals(fit, series_of(fit, order)))


def _correlation_of_residuals(
    fit: FitResult, series: IndependentSeries
) -> tuple[TimeCorrelation, Points | None]:
    """Time correlation without the addition to the covariance, and points with partials by the free parameters."""
    # The noise should explain the size of the residuals.
    uncorrelated = TimeCorrelation((), np.zeros_like(fit.covariance), {}), None
    if not fit.factor.determined.any() or not fit.used.any():
        return uncorrelated
    points, free = points_of(series, column(fit.residual_m)), fit.parameters.free
    whitened = fit.factor.whitened
    if whitened is not None and series is fit.whitening:
        partials = series.binned(whitened.parts)[0] @ whitened.from_free
    else:
        partials = binned_partials(series, free_partials(fit.linearization, free))
    points = replace(points, unit=partials)
    noise = noise_of_series(*_without_considered(fit, points), significant=False)
    if not noise:
        return uncorrelated
    processes = [noise.get(item.key, NO_NOISE) for item in points.series]
    half = _half_products(points, noise, points.gain[:, None])[:, 0]
    sum_variances = 2.0 * np.add.reduceat(points.gain * half, points.begin[:-1]) + points.count
    correlations = [
        SeriesCorrelation(
            item.name,
            int(count),
            count**2 * process.variance / sum_variance,
            process.correlation_time_s,
            process.share,
        )
        for item, process, count, sum_variance in zip(
            points.series, processes, points.count, sum_variances.tolist(), strict=True
        )
        if process.is_significant
    ]
    noise = {item.key: noise[item.key] for item in points.series if item.key in noise}
    return replace(uncorrelated[0], series=tuple(correlations), noise=noise), points


def _with_added_covariance(
    fit: FitResult, correlation: TimeCorrelation, points: Points | None
) -> TimeCorrelation:
    """Time correlation with its addition to the covariance of a fit with independent weights."""
    if points is None:
        return correlation
    unit = matrix_product(points.unit, fit.factor.root_covariance())
    added = gram(unit, _half_products(points, correlation.noise, unit))
    return replace(correlation, added_covariance=in_parameter_units(added + added.T, fit))


def _half_products(points: Points, noise: Mapping[str, SeriesNoise], columns: Floats) -> Floats:
    """Product of columns (n, m) with half the covariance of points beyond the stated one."""
    excess = [noise.get(item.key, NO_NOISE).excess for item in points.series]
    return half_products(excess, points.begin, points.step_s, points.gain, columns, points.width_s)


def series_of(fit: FitResult, order: SeriesOrder) -> IndependentSeries:
    """Return the series of the used observations, by which trials are weighed."""
    if isinstance(fit.whitening, IndependentSeries):
        return fit.whitening
    return independent_series(order, fit.noise, fit.used)


def _without_considered(fit: FitResult, points: Points) -> tuple[Points, Floats]:
    """Points, considered parameters at their a-priori values, partials in :func:`mixed_units`; and sigmas."""
    units, width = mixed_units(fit)
    sigmas = np.repeat([_FREE_SIGMAS, 1.0], [width, units.shape[1] - width])
    points, parameters = replace(points, unit=matrix_product(points.unit, units)), fit.parameters
    if width == len(sigmas):
        return points, sigmas
    shifts = ((fit.x - parameters.prior_values) / parameters.prior_sigmas)[parameters.considered]
    residual = points.residual + np.einsum("nc,c->n", points.unit[:, width:], shifts)
    changes = np.add.reduceat(residual**2 - points.residual**2, points.begin[:-1])
    return replace(points, residual=residual, squares=points.squares + changes), sigmas


def mixed_units(fit: FitResult) -> tuple[Floats, int]:
    """Units of the adjusted parameters (q, w + c): w of the estimate's own covariance, c of considered a-priori sigmas.

    The estimate is as good as free; considered errors leave traces of their own size in the residuals.
    """
    root, considered = fit.factor.root_covariance(), fit.parameters.considered[fit.parameters.free]
    if not considered.any():
        return root, root.shape[1]
    prior_sigmas = fit.parameters.prior_sigmas[fit.parameters.free][considered]
    estimated_root = root_of_rows(root[~considered])
    width = estimated_root.shape[1]
    units = np.zeros((len(root), width + len(prior_sigmas)))
    units[~considered, :width] = estimated_root
    units[considered, width:] = np.diag(prior_sigmas)
    return units, width


def estimated_covariance(edited: EditedFit, order: SeriesOrder) -> tuple[Floats, TimeCorrelation | None]:
    """Covariance of the estimate with noise as large as the residuals show, and as correlated in time, shape (p, p)."""
    covariance = scaled_covariance(edited.fit, edited.fit.noise_scale)
    correlation = assess_time_correlation(edited.fit, order) if edited.is_at_minimum else None
    if correlation is None:
        return covariance, None
    return covariance + correlation.added_covariance, correlation if correlation.series else None


def scaled_covariance(fit: FitResult, noise_scale: float) -> Floats:
    """Covariance of the estimate, (p, p), if the observation noise is larger than stated by a factor."""
    # Observations are weighed by their stated sigmas and a-priori values by theirs; only the former are found too
    # small. With their information A and P and C = (A + P)^-1, the covariance is C (f^2 A + P) C = f^2 C + (1 - f^2)
    # C P C.
    formal = np.array(fit.covariance)
    undetermined = np.isinf(np.diag(formal))
    if noise_scale == 1.0:
        return formal
    formal[undetermined, undetermined] = 0.0
    prior_information = fit.parameters.prior_sigmas**-2.0
    scaled = noise_scale**2 * formal + (1.0 - noise_scale**2) * (formal * prior_information) @ formal
    scaled[undetermined, undetermined] = np.inf
    return scaled


def in_parameter_units(added: Floats, fit: FitResult) -> Floats:
    """Addition to the covariance of parameters of unit formal covariance in the parameters themselves, (p, p)."""
    # A direction in which the errors happen to cancel keeps its white sigma; parameters that are lost have none.
    root, free = fit.factor.root_covariance(), fit.parameters.free
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    half = np.zeros((len(free), root.shape[1]))
    half[free] = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    half[np.isinf(np.diag(fit.covariance))] = 0.0
    return np.asarray(half @ half.T)


def fit_with_correlated_weights(
    residual_function: ResidualFunction, edited: EditedFit, order: SeriesOrder
) -> EditedFit:
    """Fit again, each dense series with time-correlated residuals weighed by its inverse covariance.

    Without it, errors of positions from a day of ranges and delays are 16.1 m rms in place of 11.2 m
    (`tests/statistics/test_correlated_weights.py`).
    """
    # The selection stays, as outliers are judged by the stated sigmas. Noise, sum of squares and formal covariance of
    # the result are those of the stated sigmas; estimate and factor those of the weights.
    stated = edited.fit
    # A fit that did not end has its own error status.
    if not edited.is_at_minimum or stated.time_correlation is not None:
        return edited
    series = series_of(stated, order)
    correlation, points = _correlation_of_residuals(stated, series)
    weights = _weights(series, correlation)
    if not weights:
        correlation = _with_added_covariance(stated, correlation, points)
        return replace(edited, fit=replace(stated, time_correlation=correlation))
    whitening = CorrelatedWhitener.from_noise(series, _weight_noise(series, correlation, weights))
    linearization = stated.linearization
    if series is stated.whitening and isinstance(linearization, OrthonormalLinearization):
        linearization = replace(linearization, whitened=stated.factor.whitened)
    fit = fit_least_squares(
        residual_function,
        stated.parameters,
        stated.noise,
        used=stated.used,
        start=stated.x,
        linearization=linearization,
        whitening=whitening,
    )
    return replace(
        edited, fit=_with_covariances(fit, whitening, correlation, weights), series_weights=weights
    )


def _with_covariances(
    fit: FitResult, noise: CorrelatedWhitener, correlation: TimeCorrelation, weights: Sequence[SeriesWeight]
) -> FitResult:
    """Fit with its covariance for independent errors as stated, and the additional covariance of the others."""
    # With the weights W, parameters of unit A^T W A + P have the covariance P + A^T W W A for errors of unit variance,
    # and A^T W V W A - A^T W W A more for those of the covariance V.
    # Only directions in which reported parameters vary are computed; the others keep the unit covariance.
    free, root = fit.parameters.free, fit.factor.root_covariance()
    directions = directions_of_rows(root[~fit.parameters.considered[free]])
    prior = (root / fit.parameters.prior_sigmas[free, None]) @ directions
    series, names = noise.series, {weight.name for weight in weights}
    processes = [correlation.noise.get(item.key, NO_NOISE) for item in series.series]
    groups = [item.shared or item.group for item in series.series]
    variances = dict[str, list[float]]()
    for item, process, group in zip(series.series, processes, groups, strict=True):
        if process.is_significant and (item.shared or item.name) in names:
            variances.setdefault(group, []).append(process.log_variance)
    added, unit = np.zeros((directions.shape[1],) * 2), prior.T @ prior
    information = {group: np.zeros_like(added) for group in variances}
    # The columns of all observations would be hundreds of megabytes.
    for part, numbers, whitened in series.sections(fit.whitened_unit_partials(directions)):
        # Small series together, large ones one by one, so that their columns need little memory.
        ends = np.cumsum([len(series.of_each[k]) for k in numbers])
        batches = np.split(np.array(numbers), np.flatnonzero(np.diff(ends // ROWS_AT_ONCE)) + 1)
        rows_of = {k: series.of_each[k] - part.start for k in numbers}
        for batch in batches:
            for group in {groups[k] for k in batch} & variances.keys():
                rows = np.concatenate([rows_of[k] for k in batch if groups[k] == group])
                columns = whitened[rows]
                information[group] += gram(columns, columns)
        weighted = noise.filter.adjoint(whitened, part)
        unit += gram(weighted, weighted)
        for batch in batches:
            rows, lengths = np.concatenate([rows_of[k] for k in batch]), [len(rows_of[k]) for k in batch]
            step_s, begin = np.diff(series.time_s[part][rows], prepend=0.0), np.cumsum([0, *lengths])
            excess, columns = [processes[k].excess for k in batch], weighted[rows]
            added += gram(columns, half_products(excess, begin, step_s, np.ones(len(rows)), columns))
    added += added.T.copy()
    for group, variance in variances.items():
        added += 2.0 * np.mean(variance) * (information[group] - information[group] @ information[group])
    unit = np.eye(len(directions)) + directions @ (unit - np.eye(len(unit))) @ directions.T
    fit = replace(fit, covariance=covariance_matrix(fit.factor, fit.parameters, unit))
    added_covariance = in_parameter_units(directions @ added @ directions.T, fit)
    return replace(fit, time_correlation=replace(correlation, added_covariance=added_covariance))


def _weight_noise(
    series: IndependentSeries, correlation: TimeCorrelation, weights: Sequence[SeriesWeight]
) -> dict[str, SeriesNoise]:
    """Noise by whose inverse covariance series are weighed, by key."""
    # Errors of stations go on where a baseline drops out and the combinations become others, which a filter for each
    # combination does not know. Observations that share errors have one factor on their sigmas instead.
    enlarged = {
        weight.name: SeriesNoise(weight.sigma_factor**2, np.ones(1), np.zeros(1)) for weight in weights
    }
    noise: dict[str, SeriesNoise] = {}
    for item in series.series:
        if item.shared in enlarged:
            noise[item.key] = enlarged[item.shared]
        elif item.name in enlarged:
            noise[item.key] = correlation.noise[item.key]
    return noise


def _weights(series: IndependentSeries, correlation: TimeCorrelation) -> tuple[SeriesWeight, ...]:
    """Weights of the series; combinations of observations with shared errors have one weight."""
    significant = (key for key, noise in correlation.noise.items() if noise.is_significant)
    items = dict(zip(significant, correlation.series, strict=True))
    counts, enlarged = dict[str, int](), dict[str, float]()
    for item, combinations in zip(series.series, series.of_each, strict=True):
        time_s, name = series.time_s[combinations], item.shared or item.name
        series_correlation, count = items.get(item.key), float(series.intact[combinations].sum())
        variance = count
        if series_correlation is not None and count * series_correlation.correlation_time_s >= DENSE * (
            time_s[-1] - time_s[0]
        ):
            variance = count**2 / series_correlation.effective_count
        counts[name] = counts.get(name, 0) + len(time_s)
        enlarged[name] = (
            enlarged.get(name, 0.0) + variance + len(time_s) - count
        )  # the others count as independent
    return tuple(
        SeriesWeight(name, count, math.sqrt(enlarged[name] / count))
        for name, count in counts.items()
        if enlarged[name] > count
    )
