"""Weights that allow for residuals that stay alike: a series that says what a few observations do counts as those.

Least squares that weigh observations as independent have the right expectation whatever the errors, but not the least
variance: a dense series whose errors last outweighs a-priori values and other series that know better. With the
covariance V of a series' errors in units of the stated ones, the best estimate (generalized least squares, Aitken
1935) has the information a^T V^-1 a of a column a of whitened partials. Where a changes little while errors stay
alike, V a is nearly a times the number of observations that count as one, and so is

    a^T V^-1 a = |a|^2 n_effective / n:

the stated sigmas times sqrt(n / n_effective) weigh nearly as V^-1 does, and observations stay independent to the fit.
What changes faster than the errors is weighed as if it were known no better; its sigma says how well it is known all
the same, as the covariance is the sandwich of these weights and of V, not the inverse of the information.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.factorization import covariance_of
from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import (
    FitResult,
    FitSettings,
    FitStatus,
    fit_least_squares,
    sum_of_squares,
)
from radioloc.estimation.linearization import ResidualFunction, Rows
from radioloc.estimation.observation_noise import ALONE
from radioloc.estimation.series_stretches import shared_series
from radioloc.estimation.time_correlation import TimeCorrelation, assess_time_correlation

MAX_PASSES = 10
SETTLED = 0.02
"""Factors have settled when none changes by more than this part: they are known to some ten per cent, and a part of
two hundredths costs less than a part in a thousand of the sigma."""


@dataclass(frozen=True, slots=True)
class SeriesWeight:
    """How a series is weighed whose residuals stay alike.

    Parameters
    ----------
    name : str
        The series; observations of a type that share errors are one.
    count : int
        Its used observations.
    sigma_factor : float
        Factor on their stated sigmas, 1 or more.
    """

    name: str
    count: int
    sigma_factor: float

    @property
    def weighed_as(self) -> float:
        """How many independent observations have the same weight together."""
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
        Series that do not count in full; none where no residuals stay alike.
    """

    edited: EditedFit
    weights: tuple[SeriesWeight, ...]


def fit_with_correlated_weights(
    residual_function: ResidualFunction,
    edited: EditedFit,
    types: Labels,
    paths: Labels,
    time_s: NDArray[np.float64],
    settings: FitSettings | None = None,
) -> CorrelatedFit:
    """Fit again, with each series whose residuals stay alike weighed as the independent observations it is worth.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    edited : EditedFit
        The fit with all observations weighed as independent; its selection stays, as outliers are judged by the stated
        sigmas.
    types, paths, time_s
        As for :func:`~radioloc.estimation.time_correlation.assess_time_correlation`.
    settings : FitSettings, optional
        Limits and tolerances of the fit.

    Notes
    -----
    Fit and factors alternate until the factors settle. A series that was found once keeps its last factor where a
    later fit does not find it any more. Where factors do not settle in :data:`MAX_PASSES` fits the message says so, and
    the last fit stands: no weights are wrong, only less good than others, and the covariance is that of the weights.
    """
    series = _Series(edited.fit, types, paths)
    factors: dict[str, float] = {}
    fit = edited.fit
    settled = False
    for _ in range(MAX_PASSES):
        if not edited.complete or fit.status not in (FitStatus.CONVERGED, FitStatus.UNOBSERVABLE):
            settled = True  # the fit says itself what is wrong with it
            break
        wanted = factors | series.factors(assess_time_correlation(fit, types, paths, time_s))
        before = [factors.get(name, 1.0) for name in wanted]
        if all(abs(new / old - 1.0) <= SETTLED for new, old in zip(wanted.values(), before, strict=True)):
            settled = True
            break
        factors = wanted
        fit = _weighed(residual_function, edited.fit, fit, series.of_observations(factors), settings)
    weights = tuple(
        SeriesWeight(name, series.counts[name], factor) for name, factor in factors.items() if factor > 1.0
    )
    message = edited.message
    if not settled:
        more = f"the weights of correlated series did not settle in {MAX_PASSES} fits: the last are used"
        message = "; ".join(text for text in (message, more) if text)
    return CorrelatedFit(replace(edited, fit=fit, message=message), weights)


def _weighed(
    residual_function: ResidualFunction,
    stated: FitResult,
    start: FitResult,
    factor: NDArray[np.float64],
    settings: FitSettings | None,
) -> FitResult:
    """Fit with sigmas larger by a factor (n,); what it says of the noise is of the stated sigmas."""
    noise = stated.noise.inflated(factor)
    fit = fit_least_squares(
        residual_function,
        stated.parameters,
        noise,
        used=stated.used,
        start=start.x,
        linearization=start.linearization,
        settings=settings,
    )
    free = np.flatnonzero(fit.parameters.free)
    root = fit.factor.root_covariance()

    def by_unit_parameters(rows: Rows) -> NDArray[np.float64]:
        unit: NDArray[np.float64] = fit.linearization.partials(rows)[:, free] @ root
        return unit * np.sqrt(1.0 - factor[rows] ** -2.0)[:, None]

    # Errors as stated are smaller than those weighed with: from each observation the difference is taken off.
    unit_covariance = np.eye(root.shape[1])
    for part in noise.among(fit.used).whitened(by_unit_parameters):
        unit_covariance -= np.einsum("ni,nj->ij", part, part)
    return replace(
        fit,
        covariance=covariance_of(fit.factor, fit.parameters, unit_covariance),
        noise=stated.noise,
        chi2=sum_of_squares(fit.residual_m, stated.noise.among(fit.used), fit.parameters, fit.x),
        sigma_factor=factor,
    )


class _Series:
    """Which series an observation is weighed with: its type and path, or its type alone if it shares errors."""

    def __init__(self, fit: FitResult, types: Labels, paths: Labels) -> None:
        shared = fit.noise.shared
        sharing = np.zeros(len(fit.used), dtype=bool) if shared is None else shared.group != ALONE
        each = len(paths.texts) + 1
        both = types.codes.astype(np.intp) * each + np.where(sharing, len(paths.texts), paths.codes)
        kinds, self._codes = np.unique(both, return_inverse=True)
        self._names = []
        self._begins: dict[str, str] = {}
        for kind in kinds.tolist():
            type_text, path = types.texts[kind // each], kind % each
            if path < len(paths.texts):
                self._names.append(f"{type_text} {paths.texts[path]}")
            else:
                self._names.append(f"{type_text} that share errors")
                self._begins[self._names[-1]] = shared_series(type_text)
        used = np.bincount(self._codes[fit.used], minlength=len(self._names))
        self.counts = dict(zip(self._names, used.tolist(), strict=True))

    def factors(self, found: TimeCorrelation | None) -> dict[str, float]:
        """Factor on the sigmas of each series that was found."""
        factors = {}
        items = () if found is None else found.series
        for name in self.counts:
            begins = self._begins.get(name)
            mine = [i for i in items if (i.name == name if begins is None else i.name.startswith(begins))]
            if mine:
                # Combinations in which errors cancel, such as around triangles of stations, need not be alike.
                growth = [item.count**2 / max(item.effective_count, 1.0) for item in mine]
                factors[name] = math.sqrt(max(1.0, sum(growth) / sum(item.count for item in mine)))
        return factors

    def of_observations(self, factors: dict[str, float]) -> NDArray[np.float64]:
        """Factor of each observation, shape (n,)."""
        return np.array([factors.get(name, 1.0) for name in self._names])[self._codes]
