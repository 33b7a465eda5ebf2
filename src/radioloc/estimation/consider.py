"""Considered parameters: held at their a-priori values, whose errors are carried into the covariance of the estimate.

With the design matrix A of the estimated and B of the considered parameters, the weights W and the formal covariance
P, an error d of the considered parameters changes the estimate by S d, S = P A^T W B (Tapley, Schutz and Born 2004,
section 6.2; Montenbruck and Gill 2000, section 8.1.4). To the covariance comes S C S^T with their a-priori covariance
C.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.least_squares import FitResult
from radioloc.parameters.parameter import ParameterSet


@dataclass(frozen=True, slots=True, eq=False)
class Consider:
    """What considered parameters do to an estimate.

    Parameters
    ----------
    parameters : ParameterSet
        All of the fit, p.
    sensitivity : ndarray, shape (p, p)
        Change of the estimate (rows) by an error of one sigma of each considered parameter (columns, zeros for others);
        of a considered parameter itself its sigma.
    """

    parameters: ParameterSet
    sensitivity: NDArray[np.float64]

    @property
    def covariance(self) -> NDArray[np.float64]:
        """What they add to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def position_m(self, enu_by_parameters: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Displacement of the position by one sigma of each considered parameter, m, from d(position)/d(parameters)."""
        considered = np.flatnonzero(self.parameters.considered)
        return {self.parameters.names[k]: enu_by_parameters @ self.sensitivity[:, k] for k in considered}

    def to_list(self, enu_by_parameters: NDArray[np.float64] | None) -> list[dict[str, Any]]:
        """One record for each, the one that moves the position most first."""
        moved = {} if enu_by_parameters is None else self.position_m(enu_by_parameters)
        records = []
        for item in self.parameters:
            if item.name in moved or (not moved and item.role.value == "considered"):
                record: dict[str, Any] = {"name": item.name, "unit": item.unit, "sigma": item.prior_sigma}
                if item.name in moved:
                    record["position_enu_m"] = moved[item.name].tolist()
                records.append(record)
        return sorted(records, key=lambda record: -float(np.linalg.norm(record.get("position_enu_m", 0.0))))


def consider(fit: FitResult) -> Consider | None:
    """What the considered parameters of a fit do to its estimate; None where there are none.

    Directions that the data do not determine have no part in it: their variance is infinite already.
    """
    parameters = fit.parameters
    considered = np.flatnonzero(parameters.considered)
    if not len(considered):
        return None
    free = np.flatnonzero(parameters.free)
    normal = np.zeros((len(free), len(considered)))

    def rows_of(rows: NDArray[np.intp]) -> NDArray[np.float64]:
        return fit.linearization.partials(rows)

    for whitened in fit.whitening.whitened(rows_of):
        normal += np.einsum("nf,nc->fc", whitened[:, free], whitened[:, considered])
    root = fit.factor.root_covariance()
    sigmas = parameters.prior_sigmas[considered]
    sensitivity = np.zeros((len(parameters), len(parameters)))
    sensitivity[np.ix_(free, considered)] = root @ (root.T @ normal) * sigmas
    sensitivity[considered, considered] = sigmas
    return Consider(parameters, sensitivity)
