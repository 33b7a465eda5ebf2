"""Huber's M-estimator: a last fit in which residuals beyond 1.345 sigmas count in proportion, not by their squares.

Editing leaves gross errors out at five sigmas; what is worse than normal below that still draws least squares aside.
Huber's loss (1964) of the whitened residuals u, its corner at k, is the least for an estimate with

    sum_i psi(u_i) a_i + P (x_prior - x) = 0,    psi(u) = max(-k, min(k, u)),

for the whitened partials a and the information P of the a-priori values. At k = 1.345 it has 95 % of the efficiency of
least squares where errors are normal, and an observation moves it by no more than k sigmas of its own. It is found by
least squares that are weighed again and again (Holland and Welsch 1977), and nothing is left out beyond the editing.
The covariance is the sandwich (Huber 1967)

    H^-1 (sum_i E[psi_i^2] a_i a_i^T + P) H^-1,    H = sum_i psi'(u_i) a_i a_i^T + P.

With correlated weights u are the innovations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.least_squares import FitResult, fit_least_squares
from radioloc.estimation.linearization import ResidualFunction, covariance_of, gram, times
from radioloc.estimation.observation_noise import Rows, RowsOf, Whitening, column
from radioloc.estimation.robust import huber_weight
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import assess_time_correlation, in_parameters, rows_of

_Floats = NDArray[np.float64]

CORNER = 1.345
"""Residual in sigmas from which the loss is linear: 95 % efficient where errors are normal."""
_MOST = 100
_SETTLED = 1e-3
"""Length of the last step in formal standard deviations."""
_LEAST_SLOPE = 0.05
"""Least part of the information that is left of a direction of which nearly all residuals are beyond the corner."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reweighted:
    """Independent combinations times the roots of weights."""

    whitening: Whitening
    weights: Sequence[_Floats]  # part by part

    def whitened(self, rows_of: RowsOf) -> Iterator[_Floats]:
        for part, weight in zip(self.whitening.whitened(rows_of), self.weights, strict=True):
            yield part * np.sqrt(weight)[:, None]


def fit_with_huber(residual_function: ResidualFunction, edited: EditedFit, order: SeriesOrder) -> EditedFit:
    """Fit again by Huber's loss, from a fit with its editing, its noise and its weights on.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    edited : EditedFit
        The least squares; its selection, noise and weights stay.
    order : SeriesOrder
        Types, paths and times of the observations.

    Returns
    -------
    EditedFit
        Its formal covariance is the sandwich; with correlated weights what that has beyond least squares is in what
        time correlation adds.
    """
    first = edited.fit
    if not edited.ended or not first.factor.determined.any():
        return edited
    found, fit = assess_time_correlation(first, order), first
    for _ in range(_MOST):
        before = fit
        left = first.whitening.whitened(column(before.residual_m))
        whitening = _Reweighted(first.whitening, [huber_weight(part[:, 0], CORNER) for part in left])
        fit = fit_least_squares(
            residual_function,
            first.parameters,
            first.noise,
            used=first.used,
            start=before.x,
            linearization=before.linearization,
            whitening=whitening,
        )
        moved = (fit.x - before.x)[first.parameters.free]
        step = first.factor.vectors.T @ (first.factor.column_norms * moved)
        if float(np.linalg.norm(first.factor.singular_values * step)) < _SETTLED:
            break
    else:
        message = f"the weights of Huber's loss did not settle in {_MOST} fits"
        edited = replace(edited, complete=False, message="; ".join(filter(None, (edited.message, message))))
    unit = _unit_covariance(first, fit)
    if first.independent_weights:
        fit = replace(fit, covariance=covariance_of(first.factor, first.parameters, unit))
    else:
        more = in_parameters(unit - np.eye(len(unit)), first)
        found = replace(found, added_covariance=found.added_covariance + more)
        fit = replace(fit, covariance=first.covariance)
    return replace(edited, fit=replace(fit, time_correlation=found))


def _unit_covariance(first: FitResult, fit: FitResult) -> _Floats:
    """Sandwich in coordinates in which that of the least squares is the identity, shape (r, r).

    The square of psi is less than expected by the part of an observation that the parameters take, its leverage, which
    is made up for by the mean: one that alone determines a parameter has no residual, and yet an error.
    """
    root = first.factor.root_covariance()
    values_of = rows_of(fit)
    prior = root / first.parameters.prior_sigmas[first.parameters.free, None]
    slope = squares = from_leverage = prior.T @ prior
    total, dof = 0.0, 0.0

    def columns(rows: Rows) -> _Floats:
        values = values_of(rows)
        return np.column_stack([values[:, 0], times(values[:, 1:], root)])

    for part in first.whitening.whitened(columns):
        size, partials = np.abs(part[:, 0]), part[:, 1:]
        psi, leverage = np.minimum(size, CORNER), np.square(partials).sum(axis=1)
        slope = slope + gram(partials * (size < CORNER)[:, None], partials)
        squares = squares + gram(partials * np.square(psi)[:, None], partials)
        from_leverage = from_leverage + gram(partials * leverage[:, None], partials)
        total, dof = total + float(psi @ psi), dof + float((1.0 - leverage).sum())
    mean = total / dof if dof > 0.5 else 1.0
    values, axes = np.linalg.eigh(slope)
    inverse = axes / np.maximum(values, _LEAST_SLOPE) @ axes.T
    middle = squares + mean * (from_leverage - prior.T @ prior)
    return np.asarray(inverse @ middle @ inverse)
