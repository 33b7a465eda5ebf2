"""Residuals that stay alike for a while, and what that does to the covariance.

A fit that weighs observations as independent still has the right expectation when their errors last for hours, but its
formal sigmas are too small: a thousand observations of an hour say what a few do. The estimate is left as it is; its
covariance is taken with the errors as the residuals show them (the sandwich of Huber 1967 and White 1980),

    (A^T A + P)^-1 (A^T V A + P) (A^T A + P)^-1,

with the whitened partials A, the information P of the a-priori values, and V the covariance of the whitened errors.
In each series (the residuals of one link and type) V is that of white noise and a first-order Gauss-Markov process,

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau),

found from the residuals (:mod:`~radioloc.estimation.lasting_errors`) by a likelihood that allows for what the estimated
parameters have taken out of them. All series of a type have one tau and one ratio c / w, unless a series says
otherwise. The covariance is averaged over the likelihood of these, so it holds how badly they are known. Errors of
different series count as independent.

Where the estimate weighs a series with larger sigmas (:mod:`~radioloc.estimation.correlated_weights`), A and V are over
the stated ones as before, and its part of the middle is divided by the fourth power of the factor on them.

All is done with sums over some fifty stretches of time in each series
(:mod:`~radioloc.estimation.series_stretches`), so the cost is linear in the observations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.lasting_errors import AveragedErrors, LastingErrors
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series_stretches import PartialSums, Stretches, StretchSums, WhitenedSeries

ABSORBED, _ABSORBED_WEIGHED = 30.0, 3.0
"""Sigmas that the estimate may be off by: what it then takes out of a series is left out of the likelihood. Sigmas by
weights that allow for correlation are nearly those that the estimate has."""


@dataclass(frozen=True, slots=True)
class SeriesCorrelation:
    """A series whose residuals stay alike.

    Parameters
    ----------
    name : str
        The series.
    count : int
        Its used observations.
    effective_count : float
        How many independent ones would give their mean as well.
    correlation_time_s : float
        How long the errors stay alike, s: their correlation falls to 1/e.
    share : float
        Part of the residuals' variance that does so, 0 to 1.
    """

    name: str
    count: int
    effective_count: float
    correlation_time_s: float
    share: float

    def __str__(self) -> str:
        time_s = self.correlation_time_s
        if time_s < 3600.0:
            lasting = f"{time_s / 60.0:.2g} min"
        else:
            lasting = f"{time_s / 3600.0:.2g} h" if time_s < 3.0 * 86400.0 else f"{time_s / 86400.0:.2g} days"
        return (
            f"residuals of {self.name} stay alike for {lasting}: {self.count} observations count as "
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
    """

    series: tuple[SeriesCorrelation, ...]
    added_covariance: NDArray[np.float64]


def assess_time_correlation(
    fit: FitResult, types: Labels, paths: Labels, time_s: NDArray[np.float64]
) -> TimeCorrelation | None:
    """Find series whose residuals are significantly alike in time, and what that does to the covariance.

    Parameters
    ----------
    fit : FitResult
        Its noise should explain the size of the residuals.
    types, paths : Labels
        Kind and light path of the n observations; those of one kind and path are a series.
    time_s : ndarray, shape (n,)
        When each was made, s from any instant.

    Returns
    -------
    TimeCorrelation or None
        None where no type shows more correlation than chance does in one fit of a hundred.
    """
    if not fit.factor.determined.any() or not fit.used.any():
        return None
    series = WhitenedSeries(fit, types, paths)
    stretches = Stretches.of(series, time_s)
    sums = StretchSums.of(series, stretches, time_s)
    tried = sums.worth_a_look(series.groups)
    if not tried:
        return None
    root = fit.factor.root_covariance()
    partials = PartialSums.of(series, stretches, time_s, root, tried)
    lasting = LastingErrors.of(sums, partials, ABSORBED if fit.sigma_factor is None else _ABSORBED_WEIGHED)
    if lasting is None:
        return None
    errors = AveragedErrors.of(lasting, sums, series.groups)
    if errors is None:
        return None
    # The partials are over the stated sigmas; those and the errors count by the weights, which are smaller.
    weight = np.array([series.sigma_factor[code] for code in errors.codes]) ** -4.0
    each = weight[:, None, None] * errors.added(partials.of_series(errors.codes))
    return TimeCorrelation(
        tuple(
            _series_correlation(series.names[code], sums, code, errors, k, lasting.taus_s)
            for k, code in enumerate(errors.codes)
        ),
        in_parameters(each.sum(axis=0), root, fit.parameters.free, np.isinf(np.diag(fit.covariance))),
    )


def in_parameters(
    added: NDArray[np.float64],
    root: NDArray[np.float64],
    free: NDArray[np.bool_],
    lost: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """What is added to a unit covariance, in the parameters, shape (p, p).

    A direction in which the errors happen to cancel keeps its white sigma.

    Parameters
    ----------
    added : ndarray, shape (q, q)
    root : ndarray, shape (f, q)
        Free parameters by those of unit covariance.
    free, lost : ndarray of bool, shape (p,)
        Parameters that are solved for, and those that the data say nothing of.
    """
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    half = np.zeros((len(free), root.shape[1]))
    half[free] = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    half[lost] = 0.0
    return np.asarray(half @ half.T)


def _series_correlation(
    name: str,
    sums: StretchSums,
    code: int,
    errors: AveragedErrors,
    k: int,
    taus_s: NDArray[np.float64],
) -> SeriesCorrelation:
    """In words of its own: the k-th of some averaged errors."""
    count = sums.count[sums.stretches.part(code)]
    n, by_tau = float(count.sum()), errors.coloured[k]
    kernel = errors.kernel[k, : len(count), : len(count)]
    white, coloured = float(errors.white[k]), float(by_tau.sum())
    of_mean = white + float(count @ kernel @ count) / n
    tau_s = float(np.exp((by_tau * np.log(taus_s)).sum() / coloured))
    return SeriesCorrelation(
        name, round(n), n * (white + coloured) / of_mean, tau_s, coloured / (white + coloured)
    )
