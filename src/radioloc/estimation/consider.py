"""Considered parameters: held at their a-priori values, whose errors are carried into the covariance of the estimate.

With the design matrix A of the estimated and B of the considered parameters, the weights W and the formal covariance
P, an error d of the considered parameters changes the estimate by S d, S = P A^T W B (Tapley, Schutz and Born 2004,
section 6.2; Montenbruck and Gill 2000, section 8.1.4). To the covariance comes S C S^T with their a-priori covariance
C.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.factorization import gram
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.parameters.parameter import ParameterSet

_NEGLIGIBLE = 0.1
"""Length of errors, in the sigmas of the observations, that move no combination of parameters by more of its sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredErrors:
    """Considered parameters, each with its sigma, and their columns of the design matrix.

    The partials are those of some observations, from their indices (m,) to d(computed)/d(parameter), shape (m, c).
    """

    parameters: ParameterSet
    partials: Callable[[Rows], NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class Consider:
    """What considered parameters do to an estimate.

    The sensitivity is the change of the estimate (rows) by an error of one sigma of each considered parameter
    (columns).
    """

    parameters: ParameterSet  # the considered ones, c
    sensitivity: NDArray[np.float64]  # (p, c)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """What they add to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def to_list(self, enu_by_parameters: NDArray[np.float64] | None) -> list[dict[str, Any]]:
        """One record for each, the one that moves the position most first; no displacements without partials (3, p)."""
        records: list[dict[str, Any]] = []
        for k, item in enumerate(self.parameters):
            records.append({"name": item.name, "unit": item.unit, "sigma": item.prior_sigma})
            if enu_by_parameters is not None:
                records[-1]["position_enu_m"] = (enu_by_parameters @ self.sensitivity[:, k]).tolist()
        return sorted(records, key=lambda record: -float(np.linalg.norm(record.get("position_enu_m", 0.0))))


def consider(fit: FitResult, errors: ConsideredErrors) -> Consider:
    """What considered parameters do to the estimate of a fit."""
    moved = moved_by(fit, errors.partials, len(errors.parameters))
    return Consider(errors.parameters, moved * errors.parameters.prior_sigmas)


def moved_by(
    fit: FitResult, effects_m: Callable[[Rows], NDArray[np.float64]], count: int
) -> NDArray[np.float64]:
    """By how much errors move the estimate, shape (p, count), from their effects on observations (m,), (m, count).

    Directions that the data do not determine have no part in it: their variance is infinite already.
    """
    free = np.flatnonzero(fit.parameters.free)
    root = fit.factor.root_covariance()

    def both(rows: Rows) -> NDArray[np.float64]:
        return np.column_stack([fit.linearization.partials(rows)[:, free] @ root, effects_m(rows)])

    along = np.zeros((root.shape[1], count))
    for whitened in fit.whitening.whitened(both):
        along += gram(whitened[:, : len(along)], whitened[:, len(along) :])
    moved = np.zeros((len(fit.parameters), count))
    moved[free] = root @ along
    return moved


def few_errors(errors: ConsideredErrors, sigma_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Independent errors of unit variance that stand for all of them: their effects on observations, m, shape (n, r).

    What is left out of a variance is below 1 % of that which observations of `sigma_m` (n,) would leave.
    """
    effects = errors.partials(np.arange(len(sigma_m))) * errors.parameters.prior_sigmas
    weighted = effects / sigma_m[:, None]
    squares, axes = np.linalg.eigh(gram(weighted, weighted))
    kept = np.cumsum(squares) > _NEGLIGIBLE**2
    return np.asarray(effects @ axes[:, kept])
