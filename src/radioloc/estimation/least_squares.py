"""Weighted batch least squares with a-priori information: the Gauss-Newton iterations of a fit, and its result.

Minimizes, over the parameters x, ``|(o - c(x)) / sigma|^2 + |(x - x_prior) / sigma_prior|^2``; independent
combinations take the place of observations that share errors. Each step solves the problem linearized where the last
one led (:mod:`~radioloc.estimation.linearization`). A step that does not lower the sum of squares is damped (Levenberg
1944, Marquardt 1963) in the same singular basis, at no cost in further factorizations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.information_filter import InformationFilter, Smoothed
from radioloc.estimation.linearization import (
    Factor,
    Linearization,
    OrthonormalLinearization,
    ResidualFunction,
    check_partials,
    check_residuals,
    covariance_of,
    evaluate,
    evaluate_step,
    factorize,
    nonzero_partials,
    refreshed,
    row_order,
    times,
)
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, RowsOf, StructuredWhitener, Whitener, column
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.targets.doubts import FitStatus
from radioloc.vectors import Floats

_MAX_ITERATIONS = 30

_STEP_TOLERANCE = 1e-3
"""A fit has converged when a step is shorter, in standard deviations over all parameters together (formal ones, or
scaled up to what the residuals show). Such a step lowers the sum of squares by its square, so this bounds that too."""

_MIN_STEP_TOLERANCES = 1e-3  # a next step below this part of the tolerance is not taken any more

# Damping given up at, in largest singular values: the step is then a millionth of the plain one.
_MAX_DAMPING = 1e3

_SHORT_STEP_SIGMAS = 0.1  # steps below are not asked to lower the sum of squares
_ROUNDING_OF_ROOT = 1e-4  # in parts of the root of the sum: 1e-7 m in residuals of millimetres

_FLOOR_TOLERANCES = 10.0  # steps below that do not become shorter are rounding

_TRIANGLE_REUSE_SCALES = 1.0  # a step of a metre changes the partials by less than 1e-6: their triangle stays


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """Outcome of one least squares fit."""

    parameters: ParameterSet
    x: Floats  # (p,), undetermined directions stay where they started
    # (p, p), formal, from the stated sigmas. Fixed parameters have zeros; one that takes part in an undetermined
    # direction has infinite variance and, as no number is right there, zero covariances.
    covariance: Floats
    linearization: Linearization  # at x, of all observations, used or not
    noise: ObservationCovariance  # as stated, of all observations
    used: NDArray[np.bool_]  # (n,)
    chi2: float  # weighted sum of squares over the used observations and the a-priori values
    dof: int  # used observations and a-priori values less estimated parameters (or determined directions, if fewer)
    status: FitStatus
    iterations: int  # Gauss-Newton steps that were taken
    factor: Factor  # of the problem as weighed, at x or less than a last, converged step from it
    whitening: Whitener  # by which the used observations were brought to independent ones
    time_correlation: TimeCorrelation | None = None  # where it is known already, as with correlated weights
    smoothed: Smoothed | None = None  # stochastic accelerations

    @property
    def converged(self) -> bool:
        """Whether the fit converged and every free parameter is determined."""
        return self.status is FitStatus.CONVERGED

    @property
    def residual_m(self) -> Floats:
        """Observed - computed at `x`, for all observations, used or not, m, shape (n,)."""
        return self.linearization.residual_m if self.smoothed is None else self.smoothed.residual_m

    @property
    def sigmas(self) -> Floats:
        """Formal standard deviations of the parameters, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sigma_m(self) -> Floats:
        """Stated standard deviation of each observation, all its errors together, m, shape (n,)."""
        return self.noise.sigma_m

    @property
    def chi2_per_dof(self) -> float | None:
        """Reduced chi-square; None without redundancy."""
        return self.chi2 / self.dof if self.dof > 0 else None

    @property
    def noise_scale(self) -> float:
        """Factor from stated sigmas to those that the residuals show; 1 unless significantly more.

        Correlated weights have theirs from the residuals. Without it two ranges 20 sigmas apart claim the mean to 0.7
        sigma (`tests/unit/estimation/test_least_squares.py`).
        """
        significant = self.dof > 0 and self.chi2 > chi2_quantile(SCALING_PROBABILITY, self.dof)
        return math.sqrt(self.chi2 / self.dof) if significant and self.independent_weights else 1.0

    def unit_partials(self) -> RowsOf:
        """From rows (m,) to partials by parameters of unit formal covariance, (m, q)."""
        free, root = self.parameters.free, self.factor.root_covariance()
        turned = np.zeros((len(free), root.shape[1]))
        turned[free] = root

        def unit_partials(rows: Rows) -> Floats:
            parameters, partials = nonzero_partials(self.linearization, rows)
            return times(partials, turned[parameters])

        return unit_partials

    def whitened_unit_partials(self) -> Iterator[Floats]:
        """Those of the used observations by its weights, part by part, (m, q)."""
        if self.factor.whitened is None:
            return self.whitening.whitened(self.unit_partials())
        return self.factor.whitened.by(self.factor.root_covariance())

    @property
    def independent_weights(self) -> bool:
        """Whether observations were weighed by their stated noise, not by what they are found to share in time."""
        return isinstance(self.whitening, StructuredWhitener)


@accepts_quantities
def fit_least_squares(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationCovariance,
    *,
    used: ArrayLike | None = None,
    start: ArrayLike | None = None,
    linearization: Linearization | None = None,
    whitening: Whitener | None = None,
) -> FitResult:
    """Fit parameters to the `used` observations, from `start` (the a-priori values by default) on.

    `residual_function` leads from x (p,) to a :class:`~radioloc.estimation.linearization.Linearization`, or to the pair
    of residuals observed - computed (n,), m, and partials d(computed)/dx (n, p). The status of the result says whether
    it converged and determined everything. Wrong shapes and numbers that are not finite raise :class:`InputError`.
    """
    x = parameters.prior_values if start is None else np.array(start, dtype=np.float64)
    if x.shape != (len(parameters),):
        raise InputError(f"start has shape {x.shape}; {len(parameters)} parameters need ({len(parameters)},)")
    x = np.where(parameters.free, x, parameters.prior_values)

    at_start = evaluate(residual_function, x) if linearization is None else linearization
    n = len(at_start.residual_m)
    noise = ObservationCovariance.of(sigma_m, n)
    mask = np.ones(n, dtype=bool) if used is None else np.array(used, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"used has shape {mask.shape}; {n} observations need ({n},)")
    check_residuals(at_start, mask)
    n_used = int(mask.sum())
    stated = noise.whitener(mask, row_order(at_start))
    process = getattr(at_start, "process", None)
    if process is not None and whitening is None:
        whitening = InformationFilter.of(process, noise, mask)
    problem = _Problem(residual_function, parameters, whitening or stated, n_used)
    here = problem.point(x, at_start)
    first = problem.factor(here)
    if first is None:
        check_partials(at_start, mask, parameters)
        raise InputError("the whitened partials overflow at the start; check the sigmas")
    here, factor, status, iterations = problem.iterated(here, first)
    if not factor.determined.all() and status is FitStatus.CONVERGED:
        status = FitStatus.UNOBSERVABLE
    # That of the noise as stated; a linear problem is solved without any.
    chi2 = here.chi2
    if (whitening is not None and process is None) or math.isnan(chi2):
        chi2 = sum_of_squares(here.linearization.residual_m, stated, parameters, here.x)
    n_prior = int((np.isfinite(parameters.prior_sigmas) & parameters.free).sum())
    return FitResult(
        parameters=parameters,
        x=here.x,
        covariance=covariance_of(factor, parameters),
        linearization=here.linearization,
        noise=noise,
        used=mask,
        chi2=chi2,
        dof=n_used + n_prior - int(factor.determined.sum()),
        status=status,
        iterations=iterations,
        factor=factor,
        whitening=problem.whitening,
        time_correlation=None if process is None else TimeCorrelation((), np.zeros((len(x),) * 2), {}),
        smoothed=_smoothed(problem, here, factor),
    )


def _smoothed(problem: _Problem, here: _Point, factor: Factor) -> Smoothed | None:
    if not isinstance(problem.whitening, InformationFilter):
        return None
    free, root = problem.parameters.free, factor.root_covariance()
    at = here.linearization
    return problem.whitening.smoothed(lambda rows: at.partials(rows)[:, free], at.residual_m, root @ root.T)


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """The model at one set of values."""

    x: Floats
    linearization: Linearization
    chi2: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """What stays the same while a fit goes from point to point."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    whitening: Whitener
    n_used: int

    def point(self, x: Floats, linearization: Linearization) -> _Point:
        if isinstance(linearization, OrthonormalLinearization):
            return _Point(x, linearization, math.nan)
        chi2 = sum_of_squares(linearization.residual_m, self.whitening, self.parameters, x)
        return _Point(x, linearization, chi2)

    def factor(self, at: _Point) -> Factor | None:
        return factorize(at.linearization, self.whitening, self.parameters, at.x)

    def stepped(self, at: _Point, factor: Factor, damping: float) -> _Point:
        x = at.x.copy()
        x[self.parameters.free] += factor.step(damping)
        return self.point(x, evaluate_step(self.residual_function, x, at.linearization))

    def factor_after(self, here: _Point, trial: _Point, factor: Factor) -> Factor | None:
        """That of the point a step led to: at the end of a fit the one it has serves on."""
        moved = np.abs(trial.x - here.x) / self.parameters.scales
        if moved.max() <= _TRIANGLE_REUSE_SCALES:
            near = refreshed(factor, trial.linearization, self.whitening, self.parameters, trial.x)
            if near.step_sigmas < self.tolerance(trial):
                return near
        return self.factor(trial)

    def tolerance(self, at: _Point) -> float:
        """Length of a step at which a fit has converged, in formal standard deviations."""
        return _STEP_TOLERANCE * max(1.0, float(np.sqrt(at.chi2 / max(1, self.n_used))))

    def descend(self, here: _Point, factor: Factor, damping: float) -> tuple[_Point, Factor, float] | None:
        """Point, factor and damping of a step that lowers the sum; None where none does.

        Undamped, steps overshoot to where there is no model (`tests/unit/estimation/test_least_squares.py`).
        """
        length = factor.step_sigmas
        while damping <= _MAX_DAMPING * factor.singular_values[0]:
            trial = self.stepped(here, factor, damping)
            # A step this small changes the sum by less than its rounding may: it is taken as it is, and the partials
            # change by no more than the step in parts of the distances, which are thousands of kilometres.
            if length < self.tolerance(here):
                return trial, factor, damping
            after = self.factor_after(here, trial, factor) if np.isfinite(trial.chi2) else None
            if after is not None:
                # Ranges are rounded to 1e-7 m, and the sum with them: it cannot tell a short step's gain.
                short = damping == 0.0 and length <= _SHORT_STEP_SIGMAS
                if trial.chi2 <= here.chi2 + short * _ROUNDING_OF_ROOT * np.sqrt(here.chi2):
                    return trial, after, damping
            damping = 3.0 * damping if damping > 0.0 else factor.least_damping
        return None

    def iterated(self, here: _Point, factor: Factor) -> tuple[_Point, Factor, FitStatus, int]:
        """Where the iterations end, the factor there, why, and how many they were."""
        # With every parameter fixed there is nothing to do but to report the residuals.
        if not self.parameters.free.any():
            return here, factor, FitStatus.CONVERGED, 0
        if isinstance(here.linearization, OrthonormalLinearization):  # linear: another step would be none
            there = self.stepped(here, factor, 0.0)
            return there, replace(factor, right_side=np.zeros_like(factor.right_side)), FitStatus.CONVERGED, 1
        damping, before = 0.0, math.inf
        for count in range(_MAX_ITERATIONS):
            length, tolerance = factor.step_sigmas, self.tolerance(here)
            if count and length < _MIN_STEP_TOLERANCES * tolerance:
                return here, factor, FitStatus.CONVERGED, count
            if 0.5 * before < length < _FLOOR_TOLERANCES * tolerance:
                return here, factor, FitStatus.CONVERGED, count
            before = length
            found = self.descend(here, factor, damping)
            if found is None:
                # Nothing lowers the sum: either it is at its floor to rounding (ranges are rounded to 1e-7 m),
                # or the partials point the wrong way.
                at_floor = length <= max(_SHORT_STEP_SIGMAS, 1e-3 * np.sqrt(here.chi2))
                return here, factor, FitStatus.CONVERGED if at_floor else FitStatus.DIVERGED, count
            least = factor.least_damping
            here, factor, damping = found
            damping = 0.0 if damping <= least else damping / 3.0
            if length < tolerance:
                return here, factor, FitStatus.CONVERGED, count + 1
        return here, factor, FitStatus.MAX_ITERATIONS, _MAX_ITERATIONS


def sum_of_squares(residual_m: Floats, whitening: Whitener, parameters: ParameterSet, x: Floats) -> float:
    """Weighted sum of squares with the a-priori rows; infinite where the model gives no finite number."""
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    total = float((prior * prior).sum())
    for part in whitening.whitened(column(residual_m)):
        total += float(np.square(part, out=part).sum())
    return total if np.isfinite(total) else np.inf
