"""Time-correlated residuals, and what they do to the covariance of the estimate.

A fit that weighs observations as independent still has the right expectation when their errors are correlated for
hours, but its formal sigmas are too small: a thousand observations of an hour say what a few do. The estimate is left
as it is; its covariance is taken with the errors as the residuals show them (the sandwich of Huber 1967 and White
1980),

    (A^T W A + P)^-1 (A^T W V W A + P) (A^T W A + P)^-1,

with the whitened design matrix A, the information P of the a-priori values, the weights W (the identity, or with
:mod:`~radioloc.estimation.correlated_weights` the inverse of a covariance) and V the covariance of the whitened errors:
in each series (the residuals of one link and type) white noise and a first-order Gauss-Markov process
(:mod:`~radioloc.estimation.gauss_markov`). Errors of different series count as independent. Delays that share errors
of stations are brought to independent combinations first (:mod:`~radioloc.estimation.series`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import Effects
from radioloc.estimation.gauss_markov import (
    Points,
    SeriesCorrelation,
    SeriesNoise,
    TimeCorrelation,
    noise_of_series,
)
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.series import Batch, SeriesOrder, points_of, series_of

_Floats = NDArray[np.float64]

_FREE = 300.0
"""Formal sigmas that parameters have a priori where noise is found jointly: as good as free, no column is singular."""
ABSORBED = 30.0
"""Likewise for a series by itself: what the estimate, off by so much, takes out of it is left out of the likelihood."""


def assess_time_correlation(
    fit: FitResult,
    order: SeriesOrder,
    common: Effects | None = None,
    batches: Sequence[Batch] | None = None,
) -> TimeCorrelation:
    """Find series whose residuals are significantly correlated in time, and what that does to the covariance.

    Parameters
    ----------
    fit : FitResult
        Its noise should explain the size of the residuals.
    order : SeriesOrder
        Types, paths and times of the observations.
    common : callable, optional
        Effects of known errors of unit variance (:data:`~radioloc.estimation.consider.Effects`): their traces in the
        residuals are no noise.
    batches : sequence of Batch, optional
        The series of the fit, where they are known already.

    Returns
    -------
    TimeCorrelation
        Without series where no type shows more correlation than chance does in one fit of a hundred.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.estimation import Labels, Parameter, ParameterSet, assess_time_correlation, fit_least_squares
    >>> parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m/h", "bias")])
    >>> hours = np.arange(400) / 10
    >>> design = np.column_stack([np.ones(400), hours])
    >>> from radioloc.estimation.series import SeriesOrder
    >>> lasting = np.convolve(np.random.default_rng(1).normal(size=420), np.exp(-np.arange(21) / 7), "valid")
    >>> observed = 3.0 + 0.5 * hours + 0.1 * lasting
    >>> order = SeriesOrder.of(Labels.of(["range"] * 400), Labels.of(["KASHI>lander>KASHI"] * 400), 3600.0 * hours)
    >>> fit = fit_least_squares(lambda x: (observed - design @ x, design), parameters, sigma_m=0.2)
    >>> [found.count for found in assess_time_correlation(fit, order).series]
    [400]
    """
    if fit.time_correlation is not None:  # assessed already
        return fit.time_correlation
    nothing = TimeCorrelation((), np.zeros_like(fit.covariance), {})
    if not fit.factor.determined.any() or not fit.used.any():
        return nothing
    root = fit.factor.root_covariance()
    batches = series_of(order, fit.noise, fit.used) if batches is None else batches
    if common is None:
        points, sigmas = points_of(batches, rows_of(fit), root), np.full(root.shape[1], _FREE)
    else:
        points, sigmas = _with_errors(batches, fit, root, common)
    noise = noise_of_series(points, sigmas)
    if not noise:
        return nothing
    unit = points.unit[:, : root.shape[1]]
    added = np.zeros((root.shape[1],) * 2)
    found: dict[str, SeriesCorrelation] = {}
    for k, one in enumerate(points.series):
        errors = noise.get(one.key)
        if errors is None:
            continue
        part, count = points.of(k), int(points.count[k])
        points_of_one = (points.step_s[part], points.gain[part])
        width_s = float(points.width_s[k])
        added += errors.products(*points_of_one, unit[part], width_s, less=1.0)
        of_sum = float(errors.products(*points_of_one, points.gain[part, None], width_s)[0, 0])
        effective = count**2 * (errors.white + float(errors.coloured.sum())) / of_sum
        found[one.key] = SeriesCorrelation(
            one.name, count, effective, errors.correlation_time_s, errors.share
        )
    noise = {key: noise[key] for key in found}
    return TimeCorrelation(tuple(found.values()), in_parameters(added, fit), noise)


def noise_of_each(fit: FitResult, order: SeriesOrder) -> dict[str, SeriesNoise]:
    """Noise that each series shows by itself: an offset of one of them is none."""
    points = points_of(series_of(order, fit.noise, fit.used), rows_of(fit), fit.factor.root_covariance())
    return noise_of_series(points, ABSORBED, jointly=False)


def _with_errors(
    batches: Sequence[Batch], fit: FitResult, root: _Floats, common: Effects
) -> tuple[Points, _Floats]:
    """Points with effects of common errors as further parameters, and sigmas of all."""
    count = common(np.zeros(1, dtype=np.intp)).shape[1]
    both = np.zeros((root.shape[0] + count, root.shape[1] + count))
    both[: root.shape[0], : root.shape[1]] = root
    both[root.shape[0] :, root.shape[1] :] = np.eye(count)
    points = points_of(batches, rows_of(fit, common), both)
    return points, np.repeat([_FREE, 1.0], [root.shape[1], count])


def rows_of(fit: FitResult, common: Effects | None = None) -> Callable[[Rows], _Floats]:
    """Residuals, partials by the free parameters and effects side by side, of rows (m,), shape (m, 1 + q + c)."""
    free = fit.parameters.free

    def values(rows: Rows) -> _Floats:
        partials = fit.linearization.partials(rows)
        columns = [fit.residual_m[rows, None], partials if free.all() else partials[:, free]]
        return np.hstack(columns if common is None else [*columns, common(rows)])

    return values


def in_parameters(added: _Floats, fit: FitResult) -> _Floats:
    """What is added to the covariance of parameters of unit formal covariance, in the parameters, shape (p, p).

    A direction in which the errors happen to cancel keeps its white sigma; parameters that are lost have none.
    """
    root, free = fit.factor.root_covariance(), fit.parameters.free
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    half = np.zeros((len(free), root.shape[1]))
    half[free] = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    half[np.isinf(np.diag(fit.covariance))] = 0.0
    return np.asarray(half @ half.T)
