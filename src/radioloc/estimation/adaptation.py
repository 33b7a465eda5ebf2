"""Estimate with the errors that the consistency tests find as additional parameters, from the binned problem.

Detection and identification of an error are followed by adaptation (Teunissen 1990): the columns of the findings join
the design matrix, and the noise is that of the new residuals. The estimate of the study stays the reported one. Its
difference d from the adapted estimate becomes an error of its own with one sigma of d, so that the regions of the total
covariance P + d d^T contain both estimates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radioloc.estimation.group_tests import BinnedProblem
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.time_correlation import mixed_units
from radioloc.vectors import Floats

MAX_SHIFT_SIGMAS = 3.0
"""Largest difference between the reported and the adapted position of a usable estimate, in total sigmas of either:
exceeded by chance in less than 3 % of correct cases in three dimensions."""


@dataclass(frozen=True, slots=True, eq=False)
class AdaptedEstimate:
    """Estimate of p reported parameters with the findings as parameters."""

    shift: Floats  # (p,), change of the reported parameters
    covariance: Floats  # (p, p), with the errors of the considered parameters
    # Length of the target's shift by the total covariance of the reported or this estimate.
    shift_sigmas: float = 0.0


def adapted_estimate(problem: BinnedProblem, fit: FitResult) -> AdaptedEstimate:
    """Return the estimate of a problem that has the findings as its last parameters."""
    units = mixed_units(fit)[0]
    reported = ~fit.parameters.considered
    by_unit = np.zeros((len(fit.parameters), units.shape[1]))
    by_unit[fit.parameters.free] = units
    by_unit, count = by_unit[reported], units.shape[1]
    return AdaptedEstimate(
        by_unit @ problem.estimate[:count], by_unit @ problem.inverse[:count, :count] @ by_unit.T
    )
