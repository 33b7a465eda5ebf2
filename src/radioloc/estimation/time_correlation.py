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

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.factorization import gram
from radioloc.estimation.gauss_markov import Points, SeriesNoise, noise_of_series
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.series import Batch, SeriesOrder, series_of

_Floats = NDArray[np.float64]

ABSORBED = 30.0
"""Sigmas that the estimate may be off by: what it then takes out of a series is left out of the likelihood."""


@dataclass(frozen=True, slots=True)
class SeriesCorrelation:
    """A series whose residuals are correlated in time.

    Parameters
    ----------
    name : str
        The series.
    count : int
        Its used observations.
    effective_count : float
        How many independent ones would give their mean as well.
    correlation_time_s : float
        Time in which the correlation of the Gauss-Markov process falls to 1/e, s.
    share : float
        Part of the residuals' variance that the process has, 0 to 1.
    """

    name: str
    count: int
    effective_count: float
    correlation_time_s: float
    share: float

    def __str__(self) -> str:
        time_s = self.correlation_time_s
        if time_s < 3600.0:
            text = f"{time_s / 60.0:.2g} min"
        else:
            text = f"{time_s / 3600.0:.2g} h" if time_s < 3.0 * 86400.0 else f"{time_s / 86400.0:.2g} days"
        return (
            f"residuals of {self.name} are correlated in time over {text}: {self.count} observations count as "
            f"{max(self.effective_count, 1.0):.0f}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class TimeCorrelation:
    """What correlation in time adds to the uncertainty.

    Parameters
    ----------
    series : tuple of SeriesCorrelation
        Series with significant correlation.
    added_covariance : ndarray, shape (p, p)
        To add to the covariance of the parameters; no variance becomes smaller by it.
    keys : tuple of str
        Of those series.
    noise : mapping of str to SeriesNoise
        Of those series by their keys, in units of the stated noise.
    """

    series: tuple[SeriesCorrelation, ...]
    added_covariance: NDArray[np.float64]
    keys: tuple[str, ...]
    noise: Mapping[str, SeriesNoise]


def assess_time_correlation(fit: FitResult, order: SeriesOrder) -> TimeCorrelation | None:
    """Find series whose residuals are significantly correlated in time, and what that does to the covariance.

    Parameters
    ----------
    fit : FitResult
        Its noise should explain the size of the residuals. One with correlated weights has its noise model already.
    order : SeriesOrder
        Types, paths and times of the observations.

    Returns
    -------
    TimeCorrelation or None
        None where no type shows more correlation than chance does in one fit of a hundred.
    """
    if not fit.factor.determined.any() or not fit.used.any():
        return None
    root = fit.factor.root_covariance()
    batches = series_of(order, fit.noise, fit.used)
    if fit.series_noise is None:
        series = [one for batch in batches for one in batch.points(_rows_of(fit), root)]
        noise = noise_of_series(series, ABSORBED)
    else:
        noise = dict(fit.series_noise)
        series = [
            one for batch in batches for one in weighted_series(batch, fit, root, fit.weight_noise or {})
        ]
    if not noise:
        return None
    added = np.zeros((root.shape[1],) * 2)
    found: dict[str, SeriesCorrelation] = {}
    for one in series:
        errors = noise.get(one.key)
        if errors is None:
            continue
        products = errors.products(one.step_s, one.gain, np.column_stack([one.unit, one.gain]), one.width_s)
        added += products[:-1, :-1] - gram(one.unit, one.unit)
        effective = one.count**2 * (errors.white + float(errors.coloured.sum())) / float(products[-1, -1])
        found[one.key] = SeriesCorrelation(
            one.name, one.count, effective, errors.correlation_time_s, errors.share
        )
    lost = np.isinf(np.diag(fit.covariance))
    added = _in_parameters(added, root, fit.parameters.free, lost)
    return TimeCorrelation(tuple(found.values()), added, tuple(found), noise)


def _rows_of(fit: FitResult) -> Callable[[Rows], _Floats]:
    """Residuals and partials by the free parameters side by side, of rows (m,), shape (m, 1 + q)."""
    free = fit.parameters.free

    def rows_of(rows: Rows) -> _Floats:
        partials = fit.linearization.partials(rows)
        out = np.empty((len(rows), 1 + int(free.sum())))
        out[:, 0] = fit.residual_m[rows]
        out[:, 1:] = partials if free.all() else partials[:, free]
        return out

    return rows_of


def weighted_series(
    batch: Batch, fit: FitResult, root: _Floats, noise: Mapping[str, SeriesNoise]
) -> list[Points]:
    """Series of a batch that are weighted by the inverse of their covariance, with W A in place of A."""
    if not any(key in noise for key in batch.keys):
        return []
    series = batch.points(_rows_of(fit), root, len(batch.rows))
    return [
        replace(one, unit=noise[one.key].weighted(one.step_s, one.unit)) for one in series if one.key in noise
    ]


def _in_parameters(
    added: _Floats, root: _Floats, free: NDArray[np.bool_], lost: NDArray[np.bool_]
) -> _Floats:
    """What is added to a unit covariance (q, q), in the parameters by their root (f, q), shape (p, p).

    A direction in which the errors happen to cancel keeps its white sigma; parameters that are lost have none.
    """
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    half = np.zeros((len(free), root.shape[1]))
    half[free] = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    half[lost] = 0.0
    return np.asarray(half @ half.T)
