"""The linearized model of the observations at one set of values: residuals of all, partials of those asked for.

Partials of millions of observations by a dozen parameters are gigabytes. They are therefore never all there: a fit
asks for those of some ten thousand rows, reduces them to a triangle and asks for the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, RadiolocError
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.parameters.parameter import ParameterSet

Rows = NDArray[np.intp]
"""Indices of observations, in any order."""


class Linearization(Protocol):
    """What a model says of its observations at one set of parameters."""

    @property
    def residual_m(self) -> NDArray[np.float64]:
        """Observed - computed, m, shape (n,)."""

    def partials(self, rows: Rows) -> NDArray[np.float64]:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""


ResidualFunction = Callable[[NDArray[np.float64]], Any]
"""From parameters (p,) to a :class:`Linearization`; or, where there is room, to the pair of residuals observed -
computed (n,), m, and partials d(computed)/d(parameter) (n, p)."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseLinearization:
    """A linearization that holds all its partials."""

    residual_m: NDArray[np.float64]  # (n,)
    matrix: NDArray[np.float64]  # (n, p)

    def partials(self, rows: Rows) -> NDArray[np.float64]:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        return self.matrix[rows]


def evaluate(residual_function: ResidualFunction, x: NDArray[np.float64]) -> Linearization:
    """Linearization at x; :class:`InputError` if its shapes do not agree."""
    given = residual_function(x)
    if not isinstance(given, tuple):
        if given.residual_m.ndim != 1:
            raise InputError(f"residuals have shape {given.residual_m.shape}; (n,) is needed")
        linearization: Linearization = given
        return linearization
    residual_m, partials = (np.asarray(part, dtype=np.float64) for part in given)
    if residual_m.ndim != 1 or partials.shape != (len(residual_m), len(x)):
        raise InputError(
            f"residuals of shape {residual_m.shape} and partials of shape {partials.shape} do not belong to "
            f"{len(x)} parameters; (n,) and (n, {len(x)}) are needed"
        )
    return DenseLinearization(residual_m, partials)


def evaluate_step(
    residual_function: ResidualFunction, x: NDArray[np.float64], before: Linearization
) -> Linearization:
    """Linearization where a step leads to; of infinite residuals where that is beyond what the model can compute."""
    try:
        return evaluate(residual_function, x)
    except RadiolocError:
        n = len(before.residual_m)
        return DenseLinearization(np.full(n, np.inf), np.full((n, len(x)), np.nan))


def check_partials(linearization: Linearization, used: NDArray[np.bool_], parameters: ParameterSet) -> None:
    """Raise :class:`InputError` if partials of the used observations are not finite."""
    rows = np.flatnonzero(used)
    for start in range(0, len(rows), ROWS_AT_ONCE):
        finite = np.isfinite(linearization.partials(rows[start : start + ROWS_AT_ONCE])).all(axis=0)
        if not finite.all():
            name = parameters.names[int(np.flatnonzero(~finite)[0])]
            raise InputError(f"the partials with respect to {name} are not finite at the start")


def check_residuals(linearization: Linearization, used: NDArray[np.bool_]) -> None:
    """Raise :class:`InputError` if a residual of the used observations is not finite."""
    bad = np.flatnonzero(used & ~np.isfinite(linearization.residual_m))
    if len(bad):
        raise InputError(
            f"{len(bad)} of {int(used.sum())} residuals are not finite at the start, the first at {bad[0]}"
        )
