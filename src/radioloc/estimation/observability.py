"""Observability: combinations of parameters that the observations determine poorly or not at all.

Parameters are counted in their scales D, which change an observation by about one metre. With the covariance P of the
estimated parameters, the combination of unit vector v has the standard deviation

    sigma(v) = sqrt(v^T D^-1 P D^-1 v).

Directions of zero singular values are *undetermined*; eigenvectors of D^-1 P D^-1 with sigma(v) above 100 median
observation sigmas are *weak*. The *common part* of a kind is the mean of its parameters if the data determine only
their differences.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import covariance_matrix
from radioloc.estimation.statistics import finite_or_none
from radioloc.parameters.parameter import ParameterSet, Role
from radioloc.vectors import Floats, Mask

WEAK_FACTOR = 100.0
"""Sigma of a weak combination over the median observation sigma: errors of the model, centimetres, become metres."""

STRONG_CORRELATION = 0.95  # bound of listed correlations: more than 90 % of the variance is common
MIN_SIGMA_RATIO = 0.7  # least ratio of the sigma of a common part to its prior: the data improve it little
_MIN_POSITION_FRACTION = 0.3  # least shift of the position by one sigma of a common part, in its own sigmas
_MIN_WEIGHT = 0.05  # smallest component of a direction in its text


@dataclass(frozen=True, slots=True)
class Direction:
    """Combination of parameters as a unit vector in parameter scales."""

    weights: dict[str, float]  #: components by parameter, the largest first; the first is positive
    sigma: float  #: formal standard deviation in parameter scales, by the weights of the fit; infinite if undetermined
    unit: str  #: unit of `sigma`: ``"m"`` if all parameters are in metres, otherwise ``"scales"``
    changes: tuple[str, ...]  #: change of each parameter along one sigma, with its unit

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters of the combination, the largest component first."""
        return tuple(self.weights)

    def to_dict(self) -> dict[str, Any]:
        """Return the components by parameter in types of JSON."""
        return {"weights": self.weights, "sigma": finite_or_none(self.sigma), "unit": self.unit}

    def __str__(self) -> str:
        if len(self.weights) == 1:
            return self.names[0]
        terms = (
            f"{'-' if weight < 0.0 else '+'} {abs(weight):.2f} {name}"
            for name, weight in self.weights.items()
        )
        return " ".join(terms).removeprefix("+ ")


@dataclass(frozen=True, slots=True)
class CommonPart:
    """Mean of the parameters of a kind of which the data determine little more than the differences."""

    kind: str
    count: int  # number of parameters, two or more
    sigma: float  # of their mean, in `unit`
    prior_sigma: float  # of the mean a priori; infinite if a parameter has no a-priori sigma
    unit: str
    position_m: float  # shift of the position by one sigma of the mean
    correlation: float  # largest correlation of the mean with a parameter of the position
    correlated_with: str  # that parameter; empty if the position is fixed

    def __str__(self) -> str:
        prior = f", prior {self.prior_sigma:.3g} {self.unit}" if math.isfinite(self.prior_sigma) else ""
        text = (
            f"the data do not resolve the mean {self.kind.replace('_', ' ')} of {self.count} "
            f"(sigma {self.sigma:.3g} {self.unit}{prior})"
        )
        if self.position_m > 0.0:
            text += f"; one sigma of it shifts the position by {self.position_m:.3g} m"
        if self.correlated_with:
            name = self.correlated_with.removeprefix("position.")
            text += f" (correlation {self.correlation:.2f} with the {name})"
        return text


@dataclass(frozen=True, slots=True)
class Correlation:
    """Strong correlation of two parameters."""

    first: str
    second: str
    coefficient: float

    def __str__(self) -> str:
        return f"{self.first} and {self.second} {self.coefficient:+.4f}"


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """Determination of the parameters by the observations and a-priori values."""

    singular_values: Floats  #: (q,), of the whitened design matrix with columns of length one, descending
    undetermined: tuple[Direction, ...]  #: combinations without information
    weak: tuple[Direction, ...]  #: poorly determined combinations (:data:`WEAK_FACTOR`), the worst first
    correlations: tuple[Correlation, ...]  #: pairs above :data:`STRONG_CORRELATION`, the strongest first
    #: Median stated sigma of used observations other than counts, m; 0 without any.
    observation_sigma_m: float
    #: Kinds of parameters whose differences are determined, and whose mean is not.
    common: tuple[CommonPart, ...]

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value; infinite with undetermined directions, 1 if all is fixed."""
        if self.undetermined:
            return math.inf
        return float(self.singular_values[0] / self.singular_values[-1]) if len(self.singular_values) else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON, with the sentences as ``text``."""
        return {
            "complete": not self.undetermined,
            "text": list(self.describe()),
            "singular_values": self.singular_values.tolist(),
            "condition_number": finite_or_none(self.condition_number),
            "undetermined": [item.to_dict() for item in self.undetermined],
            "weak": [item.to_dict() for item in self.weak],
            "common": [
                {**asdict(item), "prior_sigma": finite_or_none(item.prior_sigma)} for item in self.common
            ],
            "correlations": [[item.first, item.second, item.coefficient] for item in self.correlations],
        }

    def describe(self) -> tuple[str, ...]:
        """Return the results in sentences, empty if all parameters are well determined."""
        lines = [f"the data do not determine {direction}" for direction in self.undetermined]
        lines += [str(part) for part in self.common]
        for direction in self.weak:
            changes = map(" ".join, zip(direction.names, direction.changes, strict=True))
            text = f"{', '.join(changes)} together (1 sigma)"
            if len(direction.names) == 1:
                text = f"{direction.names[0]}, sigma {direction.changes[0].removeprefix('+')}"
            if direction.unit == "m":
                ratio = direction.sigma / self.observation_sigma_m
                text += f", {ratio:.0f} times the sigma of one observation ({self.observation_sigma_m:.3g} m)"
            lines.append(f"poorly determined: {text}")
        if advice := self.advice():
            lines.append(advice)
        if self.correlations:
            count = len(self.correlations)
            subject = "correlation" if count == 1 else f"{count} correlations"
            largest = "" if count == 1 else ", the largest"
            lines.append(f"{subject} beyond {STRONG_CORRELATION}{largest}: {self.correlations[0]}")
        return tuple(lines)

    def advice(self) -> str:
        """Name data that would determine the parameters better; empty if all are well determined."""
        names = {name for direction in self.undetermined or self.weak for name in direction.names}
        other_names = sorted(name for name in names if not name.startswith("position."))
        remedies = [f"an a-priori sigma for {', '.join(other_names)}"] if other_names else []
        if len(other_names) < len(names):
            remedies.append("a longer arc, more stations, or an a-priori height")
        return "would help: " + ", or ".join(remedies) if remedies else ""


def assess_observability(fit: FitResult, counted: Mask | None = None) -> Observability:
    """Find undetermined and weak combinations, common parts and strong correlations of the estimated parameters.

    `counted` (n,) marks observations over a count interval, whose sigmas do not compare with those of a position. The
    basis of undetermined directions is in reduced echelon form, so that each has as few parameters as possible.
    """
    adjusted, considered = fit.parameters.free, fit.parameters.considered
    is_estimated = ~considered[adjusted]
    parameters = ParameterSet([item for item in fit.parameters if item.role is not Role.CONSIDERED])
    scales = parameters.scales[parameters.free]
    undetermined = _simple_basis(fit.factor.undetermined_directions()[:, is_estimated] / scales)
    lengths = fit.used if counted is None else fit.used & ~counted
    sigma_m = float(np.median(fit.sigma_m[lengths])) if lengths.any() else 0.0
    root = fit.factor.root_covariance()[is_estimated]
    vectors, sigmas, _ = np.linalg.svd(root / scales[:, None], full_matrices=False)
    covariance = (
        fit.covariance if fit.has_independent_weights else covariance_matrix(fit.factor, fit.parameters)
    )
    covariance = covariance[np.ix_(~considered, ~considered)]
    return Observability(
        singular_values=fit.factor.singular_values,
        undetermined=tuple(_direction(vector, math.inf, parameters) for vector in undetermined),
        weak=tuple(
            _direction(vector, float(sigma), parameters)
            for vector, sigma in zip(vectors.T, sigmas, strict=True)
            if sigma > WEAK_FACTOR * sigma_m > 0.0
        ),
        correlations=_strong_correlations(covariance, parameters.names),
        observation_sigma_m=sigma_m,
        common=_common_parts(parameters, covariance, sigma_m),
    )


def _common_parts(parameters: ParameterSet, covariance: Floats, sigma_m: float) -> tuple[CommonPart, ...]:
    """Find the kinds whose mean has nearly its a-priori sigma, or is weak without a-priori sigmas."""
    free = {
        kind: [k for k in parameters.of_kind(kind) if parameters.free[k]]
        for kind in dict.fromkeys(item.kind for item in parameters)
    }
    position, parts = free.pop("position", []), []
    for kind, rows in free.items():
        count, units = len(rows), {parameters.parameters[k].unit for k in rows}
        finite = np.isfinite(np.diag(covariance)[rows + position]).all()
        if count < 2 or len(units) > 1 or not finite:  # position and velocity have no mean
            continue
        first = parameters.parameters[rows[0]]
        sigma = math.sqrt(float(covariance[np.ix_(rows, rows)].sum())) / count
        prior_sigma = float(np.linalg.norm(parameters.prior_sigmas[rows])) / count
        has_prior = math.isfinite(prior_sigma)
        min_sigma = MIN_SIGMA_RATIO * prior_sigma if has_prior else WEAK_FACTOR * sigma_m * first.scale
        if not sigma > min_sigma > 0.0:
            continue
        shift = covariance[np.ix_(position, rows)].mean(axis=1) / sigma / parameters.scales[position]
        position_m = float(np.linalg.norm(shift))
        sigmas_m = np.sqrt(np.diag(covariance)[position]) / parameters.scales[position]
        if position_m >= _MIN_POSITION_FRACTION * float(np.linalg.norm(sigmas_m)):
            correlation, name = 0.0, ""
            if position:
                index = int(np.argmax(np.abs(shift / sigmas_m)))
                correlation, name = float((shift / sigmas_m)[index]), parameters.names[position[index]]
            parts.append(
                CommonPart(kind, count, sigma, prior_sigma, first.unit, position_m, correlation, name)
            )
    return tuple(parts)


def correlation_matrix(covariance: Floats) -> Floats:
    """Return the correlations of a covariance, (p, p); zero for fixed and undetermined parameters."""
    sigmas = np.sqrt(np.diag(covariance))
    determined = np.isfinite(sigmas) & (sigmas > 0.0)
    correlations = np.eye(len(sigmas))
    block = np.ix_(determined, determined)
    correlations[block] = covariance[block] / np.outer(sigmas[determined], sigmas[determined])
    return correlations


def _strong_correlations(covariance: Floats, names: tuple[str, ...]) -> tuple[Correlation, ...]:
    matrix = correlation_matrix(covariance)
    pairs = np.argwhere(np.triu(np.abs(matrix) > STRONG_CORRELATION, k=1))
    correlations = [Correlation(names[i], names[j], float(matrix[i, j])) for i, j in pairs]
    return tuple(sorted(correlations, key=lambda item: -abs(item.coefficient)))


def _direction(vector: Floats, sigma: float, parameters: ParameterSet) -> Direction:
    """Return the combination of a unit vector over the free parameters in their scales."""
    free = np.flatnonzero(parameters.free)
    order = [int(k) for k in np.argsort(-np.abs(vector), kind="stable") if abs(vector[k]) >= _MIN_WEIGHT]
    vector = vector * np.sign(vector[order[0]])
    items = {k: parameters.parameters[free[k]] for k in order}
    return Direction(
        {item.name: float(vector[k]) for k, item in items.items()},
        sigma,
        "m" if all(item.unit == "m" for item in items.values()) else "scales",
        tuple(_change(float(vector[k]) * item.scale * sigma, item.unit) for k, item in items.items()),
    )


def _change(value: float, unit: str) -> str:
    """Format a change with its sign and unit; the unit "1" is omitted."""
    text = f"{value:+.0f}" if 1e3 <= abs(value) < 1e15 else f"{value:+.3g}"
    return text if unit == "1" else f"{text} {unit}"


def _simple_basis(rows: Floats) -> Floats:
    """Reduce independent rows to echelon form, largest pivot first, and scale each to length one."""
    basis = np.array(rows)
    if not len(basis):
        return basis
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    for k in range(len(basis)):
        i, j = divmod(int(np.argmax(np.abs(basis[k:]))), basis.shape[1])
        basis[[k, k + i], :] = basis[[k + i, k], :]
        basis[k] /= basis[k, j]
        other_rows = np.arange(len(basis)) != k
        basis[other_rows] -= np.outer(basis[other_rows, j], basis[k])
    return np.asarray(basis / np.linalg.norm(basis, axis=1, keepdims=True))
