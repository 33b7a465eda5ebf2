"""Reliability of a fit: the smallest errors that its tests find, and the effect of those that they do not find.

With an error d in the columns Z of a hypothesis, the test statistic of :mod:`~radioloc.estimation.group_tests` is
noncentral chi-square with

    lambda = d^T F d,    F = Z^T Z - Z^T A N^-1 A^T Z.

The minimal detectable bias has the lambda_0 for which a test with the significance level of the search has a power of
80 % (Baarda 1968). For one column it is d = sqrt(lambda_0 / F); of several columns, the smallest over all directions is
given (internal reliability). An error of this size moves the estimate by -N^-1 A^T Z d, for several columns by the
maximum over d^T F d = lambda_0 (external reliability).

The data do not reveal errors in directions in which the parameters absorb nearly all of Z d. The change of the position
by a unit of the error describes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from radioloc.estimation.group_tests import BinnedProblem
from radioloc.estimation.hypotheses import FORCES, Family, Hypothesis, hypothesis_products
from radioloc.estimation.statistics import finite_or_none
from radioloc.vectors import Floats

POWER = 0.8  # probability that an error of the minimal detectable size is found (Baarda 1968)
MIN_REVEALED_FRACTION = 1e-3
"""Smallest part of the square of a column outside the span of the design matrix. Below it an error must be 30 times
larger to be found than with known parameters, 150 times its a-priori sigma or more."""

_MAX_ROUNDING_FRACTION = 0.1  # Largest rounding, of itself, of a change of the position that is not zero


@dataclass(frozen=True, slots=True)
class Reliability:
    """Minimal detectable bias of a hypothesis, and its largest effect on the position."""

    kind: str  # as of :class:`~radioloc.estimation.consistency_results.ConsistencyTest`
    name: str
    components: tuple[str, ...]
    unit: str
    minimal: float  # minimal detectable bias, in `unit`; infinite if the data do not reveal the error
    # Changes of the position by the largest error that is found with a probability of less than 80 %, and by one unit
    # of the error; None of a moving target.
    shift_m: float | None = None
    shift_per_unit_m: float | None = None
    prior_sigma: float | None = None  # of a stated or considered a-priori value, in `unit`

    @property
    def revealed(self) -> bool:
        """True if an error of some size is found."""
        return math.isfinite(self.minimal)

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; infinite values as None."""
        content: dict[str, Any] = {"kind": self.kind, "name": self.name, "components": list(self.components)}
        content |= {"minimal_detectable": finite_or_none(self.minimal), "unit": self.unit}
        shift_m = self.shift_m if self.revealed else None
        return content | {
            "shift_m": shift_m,
            "shift_per_unit_m": self.shift_per_unit_m,
            "prior_sigma": self.prior_sigma,
        }


def assess_reliability(
    problem: BinnedProblem,
    hypotheses: Sequence[Hypothesis],
    log_levels: dict[Family, float],
    enu_by_unit: Floats | None,
) -> tuple[Reliability, ...]:
    """Return the reliability of hypotheses on errors that last for the whole arc.

    `log_levels` are logarithms of the significance levels of single tests, `enu_by_unit` (3, w) the partials of a
    position by the first parameters of the problem.
    """
    lasting = [item for item in hypotheses if item.span_s is None and item.kind != FORCES]
    results = []
    if enu_by_unit is not None:
        width = enu_by_unit.shape[1]
        by_point = (enu_by_unit @ problem.inverse[:width]) @ problem.whitened.T
        absorbed = by_point @ problem.whitened
    for item, products, indices in hypothesis_products(problem, lasting):
        sigma = float(item.sigmas[0]) if item.kind == "a priori" and len(item.sigmas) == 1 else None
        result = Reliability(item.kind, item.name, item.components, item.unit, math.inf, prior_sigma=sigma)
        if enu_by_unit is not None:
            columns, gain = products.whitened[:, indices], products.gain[:, indices]
            shift_m = enu_by_unit @ gain[:width]
            # Iterative refinement: the normal equations round the effects of errors that other parameters absorb.
            refinement_m = by_point @ columns - absorbed @ gain
            rounded_m, refined_m = (
                _largest_singular_value(effect_m / item.sigmas)
                for effect_m in (shift_m, shift_m + refinement_m)
            )
            is_rounding = abs(refined_m - rounded_m) > _MAX_ROUNDING_FRACTION * refined_m
            result = replace(result, shift_per_unit_m=0.0 if is_rounding else refined_m)
        test = products.test(indices, item.links)
        if test is not None:
            fractions = 1.0 / np.square(products.size[indices, None] * test.root).sum(axis=0)
            revealed = fractions >= MIN_REVEALED_FRACTION
            if revealed.any():
                length = math.sqrt(noncentrality(log_levels[item.family], test.dof) * test.variance_factor)
                sizes = np.linalg.svd(item.sigmas[:, None] * test.root[:, revealed], compute_uv=False)
                result = replace(result, minimal=length * float(sizes[-1]))
                if enu_by_unit is not None:
                    root_m = enu_by_unit @ test.shift_root_covariance[:, revealed]
                    result = replace(result, shift_m=length * _largest_singular_value(root_m))
        results.append(result)
    return tuple(results)


def _largest_singular_value(matrix: Floats) -> float:
    return float(np.linalg.norm(matrix, 2) if matrix.shape[1] > 1 else np.linalg.norm(matrix))


@cache
def noncentrality(log_level: float, dof: int) -> float:
    """Noncentrality of chi-square that exceeds the bound of a significance level with the probability :data:`POWER`."""
    from scipy.special import chdtri, chndtrinc

    return float(chndtrinc(chdtri(dof, math.exp(log_level)), dof, 1.0 - POWER))
