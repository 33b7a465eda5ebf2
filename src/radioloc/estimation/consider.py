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

    The sensitivity is the change of the estimate (rows) by an error of one sigma of each considered parameter (columns,
    zeros for others); of a considered parameter itself its sigma.
    """

    parameters: ParameterSet  # all of the fit, p
    sensitivity: NDArray[np.float64]  # (p, p)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """What they add to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def to_list(self, enu_by_parameters: NDArray[np.float64] | None) -> list[dict[str, Any]]:
        """One record for each, the one that moves the position most first; no displacements without partials (3, p)."""
        records: list[dict[str, Any]] = []
        for k in np.flatnonzero(self.parameters.considered).tolist():
            item = self.parameters.parameters[k]
            records.append({"name": item.name, "unit": item.unit, "sigma": item.prior_sigma})
            if enu_by_parameters is not None:
                records[-1]["position_enu_m"] = (enu_by_parameters @ self.sensitivity[:, k]).tolist()
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
    for whitened in fit.whitening.whitened(lambda rows: fit.linearization.partials(rows)):
        normal += np.einsum("nf,nc->fc", whitened[:, free], whitened[:, considered])
    root = fit.factor.root_covariance()
    sigmas = parameters.prior_sigmas[considered]
    sensitivity = np.zeros((len(parameters), len(parameters)))
    sensitivity[np.ix_(free, considered)] = root @ (root.T @ normal) * sigmas
    sensitivity[considered, considered] = sigmas
    return Consider(parameters, sensitivity)
