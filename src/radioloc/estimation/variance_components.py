"""Additive variance components: noise of the residuals beyond the stated sigmas.

Laser normal points state the millimetres of the detector. Errors of the model are centimetres for strong and weak
points alike: one scale factor of all sigmas would leave most of the weight to a few points. Each group therefore has an
additional independent error, added in quadrature, with which the reduced chi-square of its residuals is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from radioloc.estimation.editing import THRESHOLD, EditedFit, fit_with_editing
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import ResidualFunction
from radioloc.estimation.noise_structure import noise_with_shared, noisy_groups, split
from radioloc.estimation.series import IndependentSeries, SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile, root_between
from radioloc.estimation.status import FitStatus
from radioloc.labels import Labels
from radioloc.noise.covariance import ObservationCovariance, White
from radioloc.noise.whitening import column
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats, Indices, Mask

_MAX_ROUND_COUNT = 60  # the components of a biased station of strong weight settle slowly, within 30
_MAX_SPLIT_COUNT = 10  # largest number of stations and links with a component of their own
_SETTLED_FRACTION = 1e-3  # relative change of a settled sigma, far below its uncertainty


@accepts_quantities
def fit_with_variance_components(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationCovariance,
    *,
    order: SeriesOrder | None = None,
    groups: Labels | None = None,
    status: ArrayLike | Labels | None = None,
    threshold: float | None = THRESHOLD,
    start: Floats | None = None,
) -> EditedFit:
    """Fit with editing and estimate additive variance components of types, stations and links, or of given groups.

    A component is zero unless the reduced chi-square exceeds its 99.9 % quantile. Fits and components alternate until
    the components settle; rejected observations do not contribute and may be re-admitted. Without it a few strong laser
    ranges, of stated millimetres, determine the estimate, and errors of the model of centimetres exceed the sigmas
    tenfold (`tests/statistics/test_variance_components.py`).
    """
    edited = fit_with_editing(
        residual_function,
        parameters,
        sigma_m,
        status=status,
        threshold=threshold,
        start=start,
        order=order,
    )
    problem = _Problem(
        residual_function, parameters, edited.fit.noise, edited.initial_status, threshold, start, order
    )
    if order is None:
        return problem.settled(edited, Labels(np.zeros(len(edited.initial_status), dtype=np.int32), ("all",)))
    if groups is not None:
        return problem.with_shared(problem.settled(edited, groups), order, groups)
    groups = order.types
    noisy = noisy_groups(edited, order)
    if noisy is not None:
        groups, noise_m = noisy
        edited = problem.fit_with(noise_m, None)
    edited = problem.settled(edited, groups)
    for _ in range(_MAX_SPLIT_COUNT):
        divided = split(edited.fit, order, groups, edited.additive_sigma_m) if edited.is_at_minimum else None
        if divided is None:
            break
        groups, edited = divided, problem.settled(edited, divided)
    return problem.with_shared(edited, order, groups)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Constant inputs of the fits with changing components."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    stated: ObservationCovariance
    initial_status: Labels
    threshold: float | None
    start: Floats | None
    order: SeriesOrder | None

    def fit_with(self, added_m: Floats, previous: EditedFit | None) -> EditedFit:
        """Fit with components (n,), m, from a previous fit if that converged and its outliers were rejected."""
        return fit_with_editing(
            self.residual_function,
            self.parameters,
            self.stated.plus(White(added_m)),
            status=self.initial_status,
            threshold=self.threshold,
            previous=previous if previous is not None and previous.can_continue else None,
            start=self.start,
            order=self.order,
        )

    def with_shared(self, edited: EditedFit, order: SeriesOrder, groups: Labels) -> EditedFit:
        """Fit with shared errors of stations in delays, if the residuals show them."""
        if not edited.converged:
            return edited
        least_m = dict.fromkeys(order.types.texts, np.inf)
        for text, added_m in edited.additive_sigma_m.items():
            kind = text.partition(" of ")[0]
            least_m[kind] = min(least_m[kind], added_m)
        # A noisier station's own component is among what its delays share.
        type_m = np.array([least_m[text] for text in order.types.texts])
        delay_sigma_m = np.hypot(self.stated.white_m, type_m[order.types.codes])
        shared_noise = noise_with_shared(edited.fit, order, delay_sigma_m)
        if shared_noise is None:
            return edited
        shared_fit = replace(self, stated=shared_noise[0]).fit_with(np.zeros(len(delay_sigma_m)), edited)
        return replace(shared_fit, additive_sigma_m=edited.additive_sigma_m, shared_sigma_m=shared_noise[1])

    def testable(self, fit: FitResult, groups: Labels) -> Indices:
        """Groups with residuals above their stated sigmas; all if groups share errors, or the fit has other noise."""
        every, whitening = np.arange(len(groups.texts)), fit.whitening
        if not (isinstance(whitening, IndependentSeries) and whitening.is_local and fit.noise is self.stated):
            return every
        codes = [groups.codes[item.rows].reshape(len(item.rows), -1) for item in whitening.structures]
        if any((code != code[:, :1]).any() for code in codes):
            return every
        squares = np.square(np.concatenate(list(whitening.whitened(column(fit.residual_m)))))[:, 0]
        code = np.concatenate([code.ravel() for code in codes])
        sums, counts = (np.bincount(code, weight, len(every)) for weight in (squares, whitening.intact))
        return np.flatnonzero(sums > (1.0 - mean_leverage(fit)) * counts)

    def settled(self, edited: EditedFit, groups: Labels) -> EditedFit:
        """Iterate fits and components of groups from a first fit until the components settle."""
        labels, group = groups.texts, groups.codes
        tried_m = [np.array([edited.additive_sigma_m.get(name, 0.0) for name in labels])]
        for _ in range(_MAX_ROUND_COUNT):
            if edited.fit.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
                break
            # Significance is tested once: with its component a group is no longer significant.
            probability = SCALING_PROBABILITY if len(tried_m) == 1 else None
            # A group that is consistent with its stated sigmas keeps a component of zero.
            sought = self.testable(edited.fit, groups) if probability else np.flatnonzero(tried_m[1])
            wanted_m = _wanted_m(edited, self.stated, groups, sought, probability)
            if (np.abs(wanted_m - tried_m[-1]) <= _SETTLED_FRACTION * wanted_m).all():
                break
            tried_m.append(wanted_m)
            edited = self.fit_with(wanted_m[group], edited)
        else:
            message = "; ".join(
                filter(None, ("the additive variance components did not settle", edited.message))
            )
            edited = replace(edited, is_settled=False, message=message)
        sigma_of_group = dict(zip(labels, tried_m[-1].tolist(), strict=True))
        return replace(edited, additive_sigma_m={name: sigma_of_group[name] for name in groups.present()})


def _wanted_m(
    edited: EditedFit,
    stated: ObservationCovariance,
    groups: Labels,
    sought: Indices,
    probability: float | None,
) -> Floats:
    """Component of each group by its residuals, m, zero for groups that are not sought."""
    # White noise in a block is the same in each combination.
    fit = edited.fit
    leverage = mean_leverage(fit)
    wanted_m = np.zeros(len(groups.texts))
    for k in sought.tolist():
        members = fit.used & (groups.codes == k)
        dof = float(members.sum() * (1.0 - leverage))
        if dof < 1.0:
            continue
        whitener = stated.whitener(members)
        sigma_m = whitener.sigma_m
        if sigma_m is None:
            # The combinations of counts depend on the added variance
            squares = partial(_squares_of, fit, stated, members)
            residual_m = fit.residual_m[members]
            wanted_m[k] = _sufficient_sigma_m(
                squares, residual_m, dof, probability, precision=0.1 * _SETTLED_FRACTION
            )
        else:
            parts = whitener.whitened(column(fit.residual_m))
            residual_m = sigma_m * np.concatenate([np.zeros(0), *(part[:, 0] for part in parts)])
            wanted_m[k] = additive_sigma_m(residual_m, sigma_m, dof, probability)
    return wanted_m


def _squares_of(fit: FitResult, stated: ObservationCovariance, members: Mask, added_m: float) -> float:
    """Sum of squares of some observations with an added error."""
    whitened = stated.plus(White(np.where(members, added_m, 0.0))).whitener(members).whitened
    return sum(float(np.square(part).sum()) for part in whitened(column(fit.residual_m)))


def mean_leverage(fit: FitResult) -> float:
    """Mean leverage of the used observations, the trace of the hat matrix over their number."""
    # A parameter of variance C and a-priori variance s^2 contributes 1 - C / s^2, an undetermined direction zero.
    free = fit.parameters.free
    prior_sigmas = fit.parameters.prior_sigmas[free]
    has_prior = np.isfinite(prior_sigmas)
    a_priori = (fit.factor.root_covariance()[has_prior] / prior_sigmas[has_prior, None]) ** 2
    absorbed = sum(item.absorbed for item in fit.smoothed)
    return float(fit.factor.determined.sum() - a_priori.sum() + absorbed) / max(int(fit.used.sum()), 1)


def additive_sigma_m(
    residual_m: Floats, sigma_m: Floats, dof: float, probability: float | None = SCALING_PROBABILITY
) -> float:
    """Additive noise with which the residuals have a reduced chi-square of one, m."""
    squares_m2, variances_m2 = residual_m**2, sigma_m**2

    def squares(added_m: float) -> float:
        return float((squares_m2 / (variances_m2 + added_m**2)).sum())

    return _sufficient_sigma_m(squares, residual_m, dof, probability)


def _sufficient_sigma_m(
    squares: Callable[[float], float],
    residual_m: Floats,
    dof: float,
    probability: float | None,
    precision: float = 1e-12,
) -> float:
    """Additive noise at which the sum of squares is the degrees of freedom, m; zero if it is not significant."""
    if dof < 1 or squares(0.0) <= (dof if probability is None else chi2_quantile(probability, dof)):
        return 0.0
    # With errors of this size alone it would be half of that
    most_m = math.sqrt(2.0 * float(np.square(residual_m).sum()) / dof)
    return root_between(lambda m: squares(m) - dof, 0.0, most_m, precision * most_m)
