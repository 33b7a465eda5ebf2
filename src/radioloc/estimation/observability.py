"""Observability: undetermined and weakly determined combinations of parameters, in words."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import covariance_matrix
from radioloc.estimation.statistics import finite_or_none
from radioloc.parameters.parameter import ParameterSet, Role
from radioloc.vectors import Floats

WEAK_FACTOR = 100.0
"""A combination is weak when its sigma is this many times the median sigma of one observation: errors of the model
(centimetres) then stand in the answer as metres, whatever the sigma says."""

STRONG_CORRELATION = 0.95  # listed above: the two parameters share more than 90 % of their variance

MIN_SIGMA_RATIO = 0.7  # of a common part to the a-priori one, to be named: the data improve it little

_MIN_POSITION_SIGMAS = 0.3  # that the position moves with one sigma of a common part, to be named

_SMALLEST_WEIGHT = 0.05  # parts of a direction below this are left out of its text


@dataclass(frozen=True, slots=True)
class Direction:
    """A combination of parameters: a unit vector, each part counted in its parameter's scale."""

    #: Parts by parameter, the largest first; the squares add up to nearly one, the first is positive.
    weights: dict[str, float]
    #: Standard deviation along it, in parameter scales; infinite where undetermined. Formal, or with correlated
    #: weights that of the weights.
    sigma: float
    unit: str  #: unit of `sigma`: ``"m"`` if all parts are in metres, otherwise ``"scales"``
    changes: tuple[str, ...]  #: how far each parameter moves along one sigma, with its unit

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that take part, the largest part first."""
        return tuple(self.weights)

    def to_dict(self) -> dict[str, Any]:
        """Return the parts by parameter in types of JSON."""
        return {"weights": self.weights, "sigma": finite_or_none(self.sigma), "unit": self.unit}

    def __str__(self) -> str:
        if len(self.weights) == 1:
            return self.names[0]
        signs = ("- " if weight < 0.0 else "+ " for weight in self.weights.values())
        parts = (f"{abs(weight):.2f} {name}" for name, weight in self.weights.items())
        return " ".join(map("".join, zip(signs, parts, strict=True))).removeprefix("+ ")


@dataclass(frozen=True, slots=True)
class CommonPart:
    """The mean of all parameters of a kind, where the data determine little more than their differences."""

    kind: str
    count: int  # of the parameters, two or more
    sigma: float  # of their mean, in `unit`
    prior_sigma: float  # before there were data; infinite where one of them has no a-priori sigma
    unit: str
    position_m: float  # how far the position moves with one sigma of the mean
    correlation: float  # of the mean with the position's parameter that it is correlated with most
    correlated_with: str  # that parameter; empty where the position is held

    def __str__(self) -> str:
        text = f"common {self.kind.replace('_', ' ')} of {self.count}: sigma {self.sigma:.3g} {self.unit}"
        if math.isfinite(self.prior_sigma):
            text += f" ({self.prior_sigma:.3g} {self.unit} a priori)"
        if self.correlated_with:
            text += (
                f", correlated {self.correlation:.2f} with {self.correlated_with.removeprefix('position.')}"
            )
        return text + (f"; {self.position_m:.3g} m of position per sigma" if self.position_m > 0.0 else "")


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

    #: (q,), of the whitened partials and a-priori rows with columns scaled to length one, descending.
    singular_values: Floats
    undetermined: tuple[Direction, ...]  #: combinations without information
    #: Combinations that are determined, but poorly (:data:`WEAK_FACTOR`), the worst first.
    weak: tuple[Direction, ...]
    correlations: tuple[Correlation, ...]  #: pairs above :data:`STRONG_CORRELATION`, the strongest first
    #: Median stated sigma of the used observations other than counts, m; 0 without any.
    observation_sigma_m: float
    #: Kinds of parameters whose differences are determined, and whose mean is not.
    common: tuple[CommonPart, ...]

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value; infinite if something is undetermined, 1 if all is fixed."""
        if self.undetermined:
            return math.inf
        return float(self.singular_values[0] / self.singular_values[-1]) if len(self.singular_values) else 1.0

    def to_dict(self) -> dict[str, Any]:
        """All of it in types that JSON has, with the sentences as ``text``."""
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
        """Sentences for people; none if all is well determined."""
        lines = [f"the data do not determine {direction}" for direction in self.undetermined]
        lines += [str(part) for part in self.common]
        for direction in self.weak:
            if len(direction.names) == 1:
                text = f"{direction.names[0]}, sigma {direction.changes[0].removeprefix('+')}"
            else:
                changes = map(" ".join, zip(direction.names, direction.changes, strict=True))
                text = f"{', '.join(changes)} together (1 sigma)"
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


def assess_observability(fit: FitResult, counted: NDArray[np.bool_] | None = None) -> Observability:
    """Name poorly determined parameters and combinations; `counted` (n,) are observations over a count interval.

    Weak directions are eigenvectors of the covariance in parameter scales, so of all combinations of unit length those
    of largest sigma. The basis of undetermined directions is in reduced echelon form, so that each names as few
    parameters as it can.
    """
    # Metres of a Doppler count do not compare with those of a position. Consider parameters are not reported.
    adjusted, considered = fit.parameters.free, fit.parameters.considered
    is_estimated = ~considered[adjusted]
    parameters = ParameterSet([item for item in fit.parameters if item.role is not Role.CONSIDERED])
    scales = parameters.scales[parameters.free]
    undetermined = _simple_basis(fit.factor.undetermined_directions()[:, is_estimated] / scales)
    lengths = fit.used if counted is None else fit.used & ~counted
    sigma_m = float(np.median(fit.sigma_m[lengths])) if lengths.any() else 0.0
    root = fit.factor.root_covariance()[is_estimated]
    vectors, sigmas, _ = np.linalg.svd(root / scales[:, None], full_matrices=False)
    covariance = fit.covariance if fit.independent_weights else covariance_matrix(fit.factor, fit.parameters)
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
    """Kinds whose mean is hardly better known than a priori, or, without a-priori sigmas, weak."""

    def rows_of(kind: str) -> list[int]:
        return [k for k in parameters.of_kind(kind) if not parameters.parameters[k].fixed]

    parts, position = [], rows_of("position")
    for kind in dict.fromkeys(item.kind for item in parameters if item.kind != "position"):
        rows = rows_of(kind)
        if len({parameters.parameters[k].unit for k in rows}) > 1:
            continue  # position and velocity have no mean
        variances = np.diag(covariance)[rows + position]
        if len(rows) < 2 or not np.isfinite(variances).all():
            continue
        count = len(rows)
        first = parameters.parameters[rows[0]]
        sigma = math.sqrt(float(covariance[np.ix_(rows, rows)].sum())) / count
        prior_sigma = float(np.linalg.norm(parameters.prior_sigmas[rows])) / count
        min_sigma = (
            MIN_SIGMA_RATIO * prior_sigma
            if math.isfinite(prior_sigma)
            else WEAK_FACTOR * sigma_m * first.scale
        )
        if not sigma > min_sigma > 0.0:
            continue
        shift = covariance[np.ix_(position, rows)].mean(axis=1) / sigma / parameters.scales[position]
        position_m = float(np.linalg.norm(shift))
        sigmas_m = np.sqrt(np.diag(covariance)[position]) / parameters.scales[position]
        if position_m >= _MIN_POSITION_SIGMAS * float(np.linalg.norm(sigmas_m)):
            correlated = 0.0, ""
            if position:
                index = int(np.argmax(np.abs(shift / sigmas_m)))
                correlated = float((shift / sigmas_m)[index]), parameters.names[position[index]]
            parts.append(CommonPart(kind, count, sigma, prior_sigma, first.unit, position_m, *correlated))
    return tuple(parts)


def correlation_matrix(covariance: Floats) -> Floats:
    """Correlations of a covariance, shape (p, p); zero beside fixed and undetermined parameters."""
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
    """Direction of a unit vector over the free parameters in their scales."""
    free = np.flatnonzero(parameters.free)
    order = [int(k) for k in np.argsort(-np.abs(vector), kind="stable") if abs(vector[k]) >= _SMALLEST_WEIGHT]
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
    """Reduced echelon form of independent rows (largest pivot first), each then scaled to length one."""
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
