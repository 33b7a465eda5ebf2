"""What the data determine, what they determine weakly, and what they do not determine, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.least_squares import FitResult

WEAK_FACTOR = 100.0
"""A combination is weak when its formal sigma is this many times the median sigma of one observation:
errors of the
model (centimetres) then stand in the answer as metres, whatever the formal sigma says."""

STRONG_CORRELATION = 0.95
"""Correlations above this are listed; the two parameters share more than 90 % of their variance."""

_SMALLEST_WEIGHT = 0.05  # parts of a direction below this are left out of its text


@dataclass(frozen=True, slots=True)
class Direction:
    """A combination of parameters: a unit vector, each part counted in its parameter's scale.

    Parameters
    ----------
    names : tuple of str
        Parameters that take part, the largest part first.
    weights : tuple of float
        Their parts; the squares add up to nearly one, the first is positive.
    sigma : float
        Formal standard deviation along it, in parameter scales; infinite where undetermined.
    unit : str
        Unit of `sigma`: ``"m"`` if all parts are in metres, otherwise ``"scales"``.
    """

    names: tuple[str, ...]
    weights: tuple[float, ...]
    sigma: float
    unit: str

    def __str__(self) -> str:
        if len(self.names) == 1:
            return self.names[0]
        text = f"{self.weights[0]:.2f} {self.names[0]}"
        for weight, name in zip(self.weights[1:], self.names[1:], strict=True):
            text += f" {'-' if weight < 0 else '+'} {abs(weight):.2f} {name}"
        return text


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two parameters that the data hardly tell apart."""

    first: str
    second: str
    coefficient: float

    def __str__(self) -> str:
        return f"{self.first} with {self.second} {self.coefficient:+.4f}"


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """How well the observations and the a-priori values determine the parameters.

    Parameters
    ----------
    singular_values : ndarray, shape (q,)
        Of the whitened partials and a-priori rows with columns scaled to length one, descending.
    undetermined : tuple of Direction
        Combinations on which there is no information.
    weak : tuple of Direction
        Combinations that are determined, but poorly (:data:`WEAK_FACTOR`), the worst first.
    correlations : tuple of Correlation
        Pairs above :data:`STRONG_CORRELATION`, the strongest first.
    observation_sigma_m : float
        Median stated sigma of the used observations, m; 0 if there are none.
    """

    singular_values: NDArray[np.float64]
    undetermined: tuple[Direction, ...]
    weak: tuple[Direction, ...]
    correlations: tuple[Correlation, ...]
    observation_sigma_m: float

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value; infinite if something is undetermined, 1 if all is fixed."""
        if self.undetermined:
            return math.inf
        if not len(self.singular_values):
            return 1.0
        return float(self.singular_values[0] / self.singular_values[-1])

    def describe(self) -> tuple[str, ...]:
        """Sentences for people; none if all is well determined."""
        lines = [f"the data do not determine {direction}" for direction in self.undetermined]
        for direction in self.weak:
            unit = direction.unit
            line = f"{direction} is known to {direction.sigma:.3g} {unit} only (1 sigma)"
            if unit == "m":
                ratio = direction.sigma / self.observation_sigma_m
                line += f", {ratio:.0f} times one observation's {self.observation_sigma_m:.3g} m"
            lines.append(line)
        if advice := self.advice():
            lines.append(advice)
        if self.correlations:
            pairs = "1 pair" if len(self.correlations) == 1 else f"{len(self.correlations)} pairs"
            worst = "" if len(self.correlations) == 1 else "most of all "
            lines.append(
                f"{pairs} of parameters correlated beyond {STRONG_CORRELATION}: {worst}{self.correlations[0]}"
            )
        return tuple(lines)

    def advice(self) -> str:
        """Say what is missing for a better determination; empty if nothing is."""
        directions = self.undetermined or self.weak
        if not directions:
            return ""
        names = {name for direction in directions for name in direction.names}
        remedies = []
        if any(not name.startswith("position.") for name in names):
            others = sorted(name for name in names if not name.startswith("position."))
            remedies.append(f"an a-priori sigma for {', '.join(others)}")
        if any(name.startswith("position.") for name in names):
            remedies.append("a longer arc, more stations, or an a-priori height")
        return "what is missing: " + ", or ".join(remedies)


def assess_observability(fit: FitResult) -> Observability:
    """Name what a fit determines poorly or not at all.

    Parameters
    ----------
    fit : FitResult
        The fit; its tolerances of rank have been applied already.

    Returns
    -------
    Observability

    Notes
    -----
    Weak directions are the eigenvectors of the formal covariance in parameter scales, so of all
    combinations of unit length they are those of largest sigma. Undetermined directions span a space; its
    basis is brought to reduced echelon form, so that each direction names as few parameters as it can.
    """
    parameters = fit.parameters
    free = parameters.free
    names = tuple(name for name, is_free in zip(parameters.names, free, strict=True) if is_free)
    units = tuple(item.unit for item in parameters if not item.fixed)
    scales = parameters.scales[free]

    lost = _simple_basis(fit.factor.undetermined_directions() / scales)
    undetermined = tuple(_direction(row, math.inf, names, units) for row in lost)

    sigma_m = float(np.median(fit.sigma_m[fit.used])) if fit.used.any() else 0.0
    vectors, sigmas, _ = np.linalg.svd(fit.factor.root_covariance() / scales[:, None], full_matrices=False)
    weak = tuple(
        _direction(vector, float(sigma), names, units)
        for vector, sigma in zip(vectors.T, sigmas, strict=True)
        if sigma > WEAK_FACTOR * sigma_m > 0.0
    )
    return Observability(
        singular_values=fit.factor.singular_values,
        undetermined=undetermined,
        weak=weak,
        correlations=_strong_correlations(fit.covariance, parameters.names),
        observation_sigma_m=sigma_m,
    )


def correlation_matrix(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlations of a covariance, shape (p, p); zero beside fixed and undetermined parameters."""
    sigmas = np.sqrt(np.diag(covariance))
    known = np.isfinite(sigmas) & (sigmas > 0.0)
    correlations = np.eye(len(sigmas))
    block = np.ix_(known, known)
    correlations[block] = covariance[block] / np.outer(sigmas[known], sigmas[known])
    return correlations


def _strong_correlations(covariance: NDArray[np.float64], names: tuple[str, ...]) -> tuple[Correlation, ...]:
    matrix = correlation_matrix(covariance)
    rows, columns = np.triu_indices(len(names), k=1)
    found = [
        Correlation(names[i], names[j], float(matrix[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if abs(matrix[i, j]) > STRONG_CORRELATION
    ]
    return tuple(sorted(found, key=lambda item: -abs(item.coefficient)))


def _direction(
    vector: NDArray[np.float64], sigma: float, names: tuple[str, ...], units: tuple[str, ...]
) -> Direction:
    order = [int(k) for k in np.argsort(-np.abs(vector), kind="stable") if abs(vector[k]) >= _SMALLEST_WEIGHT]
    sign = 1.0 if vector[order[0]] > 0.0 else -1.0
    metres = all(units[k] == "m" for k in order)
    return Direction(
        tuple(names[k] for k in order),
        tuple(sign * float(vector[k]) for k in order),
        sigma,
        "m" if metres else "scales",
    )


def _simple_basis(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reduced echelon form of independent rows (largest pivot first), each then scaled to length one."""
    basis = np.array(rows)
    if not len(basis):
        return basis
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    for k in range(len(basis)):
        i, j = divmod(int(np.argmax(np.abs(basis[k:]))), basis.shape[1])
        basis[[k, k + i], :] = basis[[k + i, k], :]
        basis[k] /= basis[k, j]
        others = np.arange(len(basis)) != k
        basis[others] -= np.outer(basis[others, j], basis[k])
    normalized: NDArray[np.float64] = basis / np.linalg.norm(basis, axis=1, keepdims=True)
    return normalized
