"""Additive variance components: noise that the residuals show beyond the stated sigmas.

Normal points state what the detector knows: millimetres. The error of a model is centimetres and the same
for a strong and a weak point, so scaling all sigmas by one factor would let the few strongest points
decide. What is missing is therefore taken as one more independent error of the same size in every
observation, added in quadrature, just so large that the residuals fit the sigmas (reduced chi-square of
one).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.estimation.editing import THRESHOLD, EditedFit, fit_with_editing
from radioloc.estimation.least_squares import FitResult, FitStatus
from radioloc.estimation.linearization import ResidualFunction
from radioloc.estimation.noise_structure import noise_with_shared, split
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.labels import Labels
from radioloc.noise.covariance import ObservationCovariance, White
from radioloc.noise.whitening import column
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

_MAX_PASSES = 15
_MAX_SPLIT_COUNT = 10  # stations and links that may have a component of their own
_SETTLED_FRACTION = 1e-3  # change of a sigma below which a component has settled; it is known far worse


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
    """Fit with editing, adding noise to the stated sigmas where the residuals ask for it.

    Parameters and errors as :func:`~radioloc.estimation.editing.fit_with_editing`, and `order`, types, paths and times
    of the observations: each type (ranges, delays) has its own component, and so has a station or a link whose
    residuals are significantly larger or smaller than those of the rest of its type
    (:mod:`~radioloc.estimation.noise_structure`); all have the same without it. With `groups`, each of these has its
    own, and there are no others.

    Notes
    -----
    Nothing is added unless the reduced chi-square exceeds what chance allows in 999 of 1000 fits. Fit and
    excess alternate until the components settle; observations left out take no part in it and may come back.
    Without it the few strongest laser ranges decide: with stated millimetres and errors of the model of centimetres,
    errors exceed their sigmas tenfold (`tests/statistics/test_variance_components.py`).

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.estimation import Parameter, ParameterSet, fit_with_variance_components
    >>> parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m/h", "bias")])
    >>> hours = np.arange(20.0)
    >>> design = np.column_stack([np.ones(20), hours])
    >>> observed = 3.0 + 0.5 * hours + np.cos(2.0 * hours)
    >>> edited = fit_with_variance_components(lambda x: (observed - design @ x, design), parameters, 0.01)
    >>> {kind: round(sigma_m, 1) for kind, sigma_m in edited.additive_sigma_m.items()}
    {'all': 0.8}
    """
    edited = fit_with_editing(
        residual_function, parameters, sigma_m, status=status, threshold=threshold, start=start
    )
    problem = _Problem(residual_function, parameters, edited.fit.noise, edited.initial_status, threshold)
    if order is None:
        return problem.settled(edited, Labels(np.zeros(len(edited.initial_status), dtype=np.int32), ("all",)))
    if groups is not None:
        return problem.with_shared(problem.settled(edited, groups), order, groups)
    groups = order.types
    edited = problem.settled(edited, groups)
    for _ in range(_MAX_SPLIT_COUNT):
        divided = split(edited.fit, order, groups, edited.additive_sigma_m) if edited.ended else None
        if divided is None:
            break
        groups, edited = divided, problem.settled(edited, divided)
    return problem.with_shared(edited, order, groups)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """What stays the same while components change."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    stated: ObservationCovariance
    given: Labels
    threshold: float | None

    def fit_with(self, added_m: Floats, previous: EditedFit) -> EditedFit:
        """Fit with components (n,), m; a fit that did not come to its end is nothing to start from."""
        return fit_with_editing(
            self.residual_function,
            self.parameters,
            self.stated.plus(White(added_m)),
            status=self.given,
            threshold=self.threshold,
            previous=previous if previous.converged else None,
        )

    def with_shared(self, edited: EditedFit, order: SeriesOrder, groups: Labels) -> EditedFit:
        """Fit in which delays share the errors of their stations, where the residuals show such."""
        if not edited.converged:
            return edited
        least_m = dict.fromkeys(order.types.texts, np.inf)
        for text, added_m in edited.additive_sigma_m.items():
            kind = text.partition(" of ")[0]
            least_m[kind] = min(least_m[kind], added_m)
        # A noisier station's own component is among what its delays share.
        type_m = np.array([least_m[text] for text in order.types.texts])
        own_m = np.hypot(self.stated.white_m, type_m[order.types.codes])
        found = noise_with_shared(edited.fit, order, own_m)
        if found is None:
            return edited
        again = replace(self, stated=found[0]).fit_with(np.zeros(len(own_m)), edited)
        return replace(again, additive_sigma_m=edited.additive_sigma_m, shared_sigma_m=found[1])

    def settled(self, edited: EditedFit, groups: Labels) -> EditedFit:
        """Fit with the components of groups, from a fit with others or none on."""
        labels, group = groups.texts, groups.codes
        tried_m = [np.array([edited.additive_sigma_m.get(name, 0.0) for name in labels])]
        for _ in range(_MAX_PASSES):
            if edited.fit.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
                break
            # Significance is asked for once; asked again, it would take away what it had just found to be there.
            probability = SCALING_PROBABILITY if len(tried_m) == 1 else None
            wanted_m = _wanted_m(edited, self.stated, group, len(labels), probability)
            if probability is None:
                # A group that was explained by its stated sigmas at first stays without.
                wanted_m = np.where(tried_m[1] > 0.0, wanted_m, 0.0)
            if _same(wanted_m, tried_m[-1]):
                break
            tried_m.append(wanted_m)
            edited = self.fit_with(wanted_m[group], edited)
        else:
            message = "; ".join(
                filter(None, ("the additive variance components did not settle", edited.message))
            )
            edited = replace(edited, complete=False, message=message)
        found = dict(zip(labels, tried_m[-1].tolist(), strict=True))
        return replace(edited, additive_sigma_m={name: found[name] for name in groups.present()})


def _wanted_m(
    edited: EditedFit,
    stated: ObservationCovariance,
    group: NDArray[np.int32],
    count: int,
    probability: float | None,
) -> Floats:
    """Standard deviation that each group asks for, m; one of one size in a block is so in each combination."""
    fit = edited.fit
    free_part = part_of_parameters(fit)
    wanted_m = np.zeros(count)
    for k in range(count):
        mine = fit.used & (group == k)
        dof = float(mine.sum() * (1.0 - free_part))
        whitener = stated.whitener(mine)
        sigma_m = whitener.sigma_m
        if sigma_m is None:
            # The combinations of counts depend on what is added
            squares = partial(_squares_of, fit, stated, mine)
            residual_m = fit.residual_m[mine]
            wanted_m[k] = _enough_m(squares, residual_m, dof, probability, precision=0.1 * _SETTLED_FRACTION)
        else:
            parts = whitener.whitened(column(fit.residual_m))
            residual_m = sigma_m * np.concatenate([np.zeros(0), *(part[:, 0] for part in parts)])
            wanted_m[k] = additive_sigma_m(residual_m, sigma_m, dof, probability)
    return wanted_m


def _squares_of(
    fit: FitResult, stated: ObservationCovariance, mine: NDArray[np.bool_], added_m: float
) -> float:
    """Sum of squares of some observations with an added error."""
    whitened = stated.plus(White(np.where(mine, added_m, 0.0))).whitener(mine).whitened
    return sum(float(np.square(part).sum()) for part in whitened(column(fit.residual_m)))


def part_of_parameters(fit: FitResult) -> float:
    """Mean leverage of the used observations, the trace of the hat matrix over their number."""
    # A parameter takes one less the part C / s^2 that its a-priori value has in it (variance C of the estimate, s of
    # the a-priori value). So do stochastic accelerations. Directions that are not determined take nothing.
    free = fit.parameters.free
    prior_sigmas = fit.parameters.prior_sigmas[free]
    known = np.isfinite(prior_sigmas)
    a_priori = (fit.factor.root_covariance()[known] / prior_sigmas[known, None]) ** 2
    absorbed = 0.0 if fit.smoothed is None else fit.smoothed.absorbed
    return float(fit.factor.determined.sum() - a_priori.sum() + absorbed) / max(int(fit.used.sum()), 1)


def _same(one_m: Floats, other_m: Floats) -> bool:
    return bool((np.abs(one_m - other_m) <= _SETTLED_FRACTION * one_m).all())


def additive_sigma_m(
    residual_m: Floats,
    sigma_m: Floats,
    dof: float,
    probability: float | None = SCALING_PROBABILITY,
) -> float:
    """Noise to add in quadrature so that the residuals have a reduced chi-square of one, m."""
    squares_m2, variances_m2 = residual_m**2, sigma_m**2

    def squares(added_m: float) -> float:
        return float((squares_m2 / (variances_m2 + added_m**2)).sum())

    return _enough_m(squares, residual_m, dof, probability)


def _enough_m(
    squares: Callable[[float], float],
    residual_m: Floats,
    dof: float,
    probability: float | None,
    precision: float = 1e-12,
) -> float:
    """Added error at which the sum of squares is the degrees of freedom, m; zero where chance explains it."""
    from scipy.optimize import brentq

    if dof < 1 or squares(0.0) <= (dof if probability is None else chi2_quantile(probability, dof)):
        return 0.0
    # With errors of this size alone it would be half of that
    most_m = math.sqrt(2.0 * float(np.square(residual_m).sum()) / dof)
    return float(brentq(lambda m: squares(m) - dof, 0.0, most_m, xtol=precision * most_m, rtol=precision))
