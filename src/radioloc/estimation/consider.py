"""Consider parameters and the error budget of a position.

Consider parameters are adjusted with their a-priori covariance C and not reported. The weights thus contain C:
observations that an error affects in common are down-weighted, and no posterior sigma exceeds its prior. With the
covariance P of all adjusted parameters, the gain of an a-priori value is K = P C^-1, and P is the sum of K_i C_i K_i^T
over the independent sources: the error budget.

Two kinds of errors stay out of the weights: those that a study names as `suboptimal`, and errors of the gravity field.
The latter are a dozen draws that do not span a covariance of thousands of coefficients, so that an estimate that
adjusted them would fit the draws. With their design matrix B, an error b changes the estimate by S b, and S C S^T is
added to P:

    S = P A^T W B    (sensitivity matrix)

References: Tapley, Schutz and Born (2004), section 6.2; Montenbruck and Gill (2000), section 8.1.4.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import gram, matrix_product
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.noise.whitening import RowsOf, TransposableWhitener, slices
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.vectors import Floats, Mask

NOISE, A_PRIORI, EPHEMERIS = "measurement noise", "a priori", "ephemeris"
"""Sources of error other than consider parameters."""
UNMODELLED_ERROR = "unmodelled_error"
"""Kind of the difference between the estimates without and with the errors that the consistency tests find."""

# Smallest effect on the estimate: its square is the relative change of a variance, 1 %.
_MIN_EFFECT_SIGMAS = 0.1
_MIN_EFFECT_VARIANCE = 1e-4  # smallest variance of an effect relative to that of the residuals
_EFFECT_COLUMN_COUNT = 16  # number of columns above which parts have fewer rows


@dataclass(frozen=True, slots=True, eq=False)
class UnestimatedErrors:
    """Errors that a fit does not estimate, as parameters with their columns of the design matrix by rows, (m, c)."""

    parameters: ParameterSet
    partials: RowsOf

    def joined(self, other: UnestimatedErrors) -> UnestimatedErrors:
        """Return two sets of errors as one."""
        if not (self.parameters and other.parameters):
            return self if self.parameters else other
        return UnestimatedErrors(
            ParameterSet([*self.parameters, *other.parameters]),
            lambda rows: np.hstack([self.partials(rows), other.partials(rows)]),
        )


NO_ERRORS = UnestimatedErrors(ParameterSet([]), lambda rows: np.zeros((len(rows), 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Consider:
    """Considered parameters, and the change of an estimate (rows) by one sigma of each (columns)."""

    parameters: ParameterSet  # the considered ones, c
    sensitivity: Floats  # (p, c)
    in_weights: tuple[str, ...] = ()  # kinds of them that are in the weights of the estimate

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(item.kind for item in self.parameters))
        return f"<Consider {len(self.parameters)} parameters: {kinds}>"

    @property
    def covariance(self) -> Floats:
        """Contribution to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def joined(self, effects: Consider) -> Consider:
        """Return the effects of both sets of parameters."""
        return Consider(
            ParameterSet([*self.parameters, *effects.parameters]),
            np.hstack([self.sensitivity, effects.sensitivity]),
            (*self.in_weights, *effects.in_weights),
        )

    def to_list(self, enu_partials: Floats | None) -> list[dict[str, Any]]:
        """Return records for JSON by descending effect on the position, which needs its partials (3, p)."""
        records: list[dict[str, Any]] = []
        for k, item in enumerate(self.parameters):
            records.append(
                {"name": item.name, "unit": item.unit, "sigma": item.prior_sigma} | span_record(item)
            )
            records[-1]["in_weights"] = item.kind in self.in_weights
            if enu_partials is not None:
                records[-1]["position_enu_m"] = (enu_partials @ self.sensitivity[:, k]).tolist()
        return sorted(records, key=lambda record: -float(np.linalg.norm(record.get("position_enu_m", 0.0))))


def span_record(item: Parameter) -> dict[str, str]:
    """Begin and end of the interval of a parameter, for JSON; empty for parameters of the whole arc."""
    return {} if item.span_utc is None else dict(zip(("first_utc", "last_utc"), item.span_utc, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class ReportedEstimate:
    """Estimated and fixed parameters of a fit, p of them, without the considered ones."""

    parameters: ParameterSet
    values: Floats  # (p,)
    formal_covariance: Floats  # (p, p), by noise and a-priori values
    covariance: Floats  # (p, p), with the noise determined from the residuals
    prior_effects: Floats  # (p, p), change by one sigma of each a-priori value (columns)
    consider: Consider


def reported_estimate(fit: FitResult, covariance: Floats, unadjusted: UnestimatedErrors) -> ReportedEstimate:
    """Separate the estimate from the considered parameters, whose errors are a part of `covariance` (all, all)."""
    considered = fit.parameters.considered
    estimated, considered_indices = np.flatnonzero(~considered).tolist(), np.flatnonzero(considered).tolist()
    effects = prior_effects(fit)
    block = np.ix_(estimated, estimated)
    formal, scaled = fit.covariance[block], covariance[block]
    items = [fit.parameters.parameters[k] for k in considered_indices]
    # An estimate follows an a-priori value, and goes against the error of one.
    shifts = -effects[np.ix_(estimated, considered_indices)]
    shifts[np.isinf(np.diag(formal))] = 0.0
    formal, scaled = (_subtract(matrix, shifts @ shifts.T) for matrix in (formal, scaled))
    in_weights = tuple(dict.fromkeys(item.kind for item in items))
    shifts = np.hstack([shifts, sensitivity(fit, unadjusted).sensitivity[estimated]])
    items += unadjusted.parameters
    return ReportedEstimate(
        ParameterSet([fit.parameters.parameters[k] for k in estimated]),
        fit.x[estimated],
        formal,
        scaled,
        effects[block],
        Consider(ParameterSet(items), shifts, in_weights),
    )


def sensitivity(fit: FitResult, unadjusted: UnestimatedErrors) -> Consider:
    """Return the effect on all parameters of a fit of errors that are not in its weights, S = P A^T W B."""
    shifts = consider_sensitivity(fit, unadjusted.partials, len(unadjusted.parameters))
    return Consider(unadjusted.parameters, shifts * unadjusted.parameters.prior_sigmas)


def _subtract(covariance: Floats, part: Floats) -> Floats:
    """Subtract a part of a covariance; variances that rounding makes negative are zero."""
    difference = covariance - part
    np.fill_diagonal(difference, np.maximum(np.diag(difference), 0.0))
    return difference


def consider_sensitivity(fit: FitResult, effects_m: RowsOf, count: int) -> Floats:
    """Return the sensitivity S, (p, count), to errors with partials B, `effects_m` from rows (m,) to (m, count)."""
    # Undetermined directions have an infinite variance already.
    root, sensitivity_matrix = fit.factor.root_covariance(), np.zeros((len(fit.parameters), count))
    if not count:
        return sensitivity_matrix
    products = np.zeros((root.shape[1], count))  # (L A P^1/2)^T L B
    whitened = fit.whitened_unit_partials()
    if isinstance(fit.whitening, TransposableWhitener):
        # Weighting the few partials costs less than whitening many effects.
        for rows, weights in fit.whitening.transposed(whitened):
            for rows_at_once in slices(len(rows), 1 + count // _EFFECT_COLUMN_COUNT):
                products += gram(weights[rows_at_once], effects_m(rows[rows_at_once]))
    else:
        for partials, effects in zip(whitened, fit.whitening.whitened(effects_m), strict=True):
            products += gram(partials, effects)
    sensitivity_matrix[fit.parameters.free] = root @ products
    return sensitivity_matrix


def principal_errors(effects: Floats, sigma_m: Floats, unit_partials: Floats, usable: Mask) -> Floats:
    """Replace independent errors of unit variance by fewer, from effects (n, c) to effects (n, r), m.

    The errors kept are the principal axes with a significant effect on the residuals or on the estimate, whose partials
    (n, q) are in units of its sigmas.
    """
    weights = (usable / sigma_m)[:, None]
    weighted, partials = effects * weights, unit_partials * weights
    shifts = gram(partials, weighted)
    residual_squares = gram(weighted, weighted) / (_MIN_EFFECT_VARIANCE * len(effects))
    squares = shifts.T @ shifts + _MIN_EFFECT_SIGMAS**2 * residual_squares
    values, axes = np.linalg.eigh(squares)
    return matrix_product(effects, axes[:, np.cumsum(values) > _MIN_EFFECT_SIGMAS**2])


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """Part of the covariance of a position, m^2, (3, 3); `name` is the parameter or its owner, or empty."""

    source: str
    name: str
    covariance_m2: Floats

    @property
    def label(self) -> str:
        """Source and name in one text."""
        return f"{self.source} {self.name}".strip()

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations along the axes, shape (3,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance_m2), 0.0))

    @property
    def total_m(self) -> float:
        """Standard deviation in space."""
        return float(np.linalg.norm(self.sigma_m))

    def to_dict(self, axes: Iterable[str] = EAST_NORTH_UP) -> dict[str, Any]:
        """Return source, name and standard deviations for JSON."""
        sigmas_m = zip((*axes, "total"), (*self.sigma_m.tolist(), self.total_m), strict=True)
        return {"source": self.source, "name": self.name} | {f"{axis}_m": sigma for axis, sigma in sigmas_m}


def prior_effects(fit: FitResult) -> Floats:
    """Return the change of the estimate by one sigma of each a-priori value (columns), shape (p, p)."""
    free = np.flatnonzero(fit.parameters.free)
    root = fit.factor.root_covariance()
    effects = np.zeros((len(fit.parameters),) * 2)
    effects[np.ix_(free, free)] = root @ root.T / fit.parameters.prior_sigmas[free]
    return effects


def shared_prior_effects(parameters: ParameterSet, effects: Floats) -> dict[str, Floats]:
    """Return the change of the estimate (p,) by one sigma of each error that a-priori values share, by its name."""
    names = dict.fromkeys(name for item in parameters for name in item.prior_errors)
    return {
        name: effects
        @ (np.array([item.prior_errors.get(name, 0.0) for item in parameters]) / parameters.prior_sigmas)
        for name in names
    }


def error_budget(
    parameters: ParameterSet,
    enu_partials: Floats,
    enu_covariance_m2: Floats,
    effects: Floats,
    considered: Consider,
    ephemeris_sigma_enu_m: Floats,
    direct_m: Floats | float = 0.0,
) -> tuple[ErrorSource, ...]:
    """Divide the covariance of a position into independent sources, the largest first.

    Partials (..., 3, p) and the covariance by noise and a-priori values (..., 3, 3) may be at several epochs of an
    orbit, whose mean is given. `effects` are those of :func:`prior_effects`. Errors of one sigma of considered
    parameters add `direct_m` (..., 3, c) to the position itself.
    """

    def outer(shift_m: Floats) -> Floats:
        return np.asarray(shift_m[..., :, None] * shift_m[..., None, :])

    prior_effects_m = enu_partials @ effects
    covariances = defaultdict[tuple[str, str], Any](float)
    covariances[NOISE, ""] = enu_covariance_m2 - prior_effects_m @ np.swapaxes(prior_effects_m, -1, -2)
    prior_keys: dict[str, tuple[str, str]] = {}
    for k, item in enumerate(parameters):
        # A-priori values that share errors are one source, less these errors.
        key = A_PRIORI, item.name.partition(".")[0] if item.prior_errors else item.name
        if item.role is Role.CONSIDERED:
            key = item.kind, owner(item)
        covariances[key] = covariances[key] + outer(prior_effects_m[..., k])
        prior_keys |= dict.fromkeys(item.prior_errors, key)
    for name, effect in shared_prior_effects(parameters, effects).items():
        kind, _, label = name.partition(".")
        error_m2 = outer(enu_partials @ effect)
        prior_key, error_key = prior_keys[name], (kind, label.rpartition(".")[0] or label)
        covariances[prior_key] = covariances[prior_key] - error_m2
        covariances[error_key] = covariances[error_key] + error_m2
    considered_effects_m = enu_partials @ considered.sensitivity + direct_m
    for k, item in enumerate(considered.parameters):
        key = item.kind, owner(item)
        covariances[key] = covariances[key] + outer(considered_effects_m[..., k])
    covariances[EPHEMERIS, ""] = np.diag(ephemeris_sigma_enu_m**2)
    items = (ErrorSource(*key, part.reshape(-1, 3, 3).mean(axis=0)) for key, part in covariances.items())
    nonzero = (item for item in items if item.source not in (A_PRIORI, EPHEMERIS) or item.covariance_m2.any())
    return tuple(sorted(nonzero, key=lambda item: -item.total_m))


def owner(item: Parameter) -> str:
    """Return the name of a parameter without kind, component and number of the pass; empty for a drawn error."""
    if item.kind not in PARAMETERS:
        return ""
    _, _, name = item.name.partition(".")
    for component in PARAMETERS[item.kind].components:
        name = name.removesuffix(component).removesuffix(".") if component else name
    return name.rpartition(" ")[0] if item.span_utc is not None else name


def sum_by_source(items: Iterable[ErrorSource]) -> list[ErrorSource]:
    """Sum the parts of each source, the largest first."""
    groups: dict[str, list[Floats]] = {}
    for item in items:
        groups.setdefault(item.source, []).append(item.covariance_m2)
    totals = (ErrorSource(source, "", np.sum(parts, axis=0)) for source, parts in groups.items())
    return sorted(totals, key=lambda total: -total.total_m)
