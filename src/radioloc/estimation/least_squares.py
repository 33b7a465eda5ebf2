"""Weighted batch least squares with a-priori information: the Gauss-Newton iterations of a fit, and its result.

Minimizes, over the parameters x, ``|(o - c(x)) / sigma|^2 + |(x - x_prior) / sigma_prior|^2``; independent
combinations take the place of observations that share errors. Each iteration solves the problem linearized at the
current estimate (:mod:`~radioloc.estimation.linearization`). A step that does not lower the sum of squares is
damped (Levenberg 1944, Marquardt 1963) in the same singular basis, without another factorization.
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
from radioloc.estimation.status import FitStatus
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, RowsOf, StructuredWhitener, Whitener, column
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

_MAX_ITERATIONS = 30

_STEP_TOLERANCE = 1e-3
"""Step length at convergence, in formal standard deviations of all parameters together, scaled by the reduced
chi-square. The step lowers the sum of squares by its square."""

_MIN_STEP_TOLERANCES = 1e-3  # next step, in tolerances, below which the iterations end without it
_MAX_DAMPING = 1e3  # largest damping in largest singular values: the step is then 1e-6 of the undamped one
_SHORT_STEP_SIGMAS = 0.1  # step length below which rounding may raise the sum of squares
_ROUNDING_OF_ROOT = 1e-4  # relative to the root of the sum: 1e-7 m in residuals of millimetres
_FLOOR_TOLERANCES = 10.0  # step length, in tolerances, below which steps that do not shrink are rounding
_TRIANGLE_REUSE_SCALES = 1.0  # step, in parameter scales, that changes the partials by less than 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """Result of a least-squares fit."""

    parameters: ParameterSet
    x: Floats  # (p,), estimate; undetermined directions keep their start values
    # (p, p), formal covariance by the stated noise: zeros for fixed parameters, infinite variances and zero covariances
    # for parameters of undetermined directions.
    covariance: Floats
    linearization: Linearization  # at x, of all observations
    noise: ObservationCovariance  # stated R of all observations
    used: NDArray[np.bool_]  # (n,)
    chi2: float  # weighted sum of squares of used observations and a-priori values
    dof: int  # used observations and a-priori values less determined directions
    status: FitStatus
    iterations: int  # number of Gauss-Newton steps
    factor: Factor  # of the weighted problem, at x or within a converged step of it
    whitening: Whitener  # of the used observations, by the weights of the fit
    time_correlation: TimeCorrelation | None = None  # noise model of fits with correlated weights
    smoothed: Smoothed | None = None  # stochastic accelerations

    @property
    def converged(self) -> bool:
        """True if the fit converged and every free parameter is determined."""
        return self.status is FitStatus.CONVERGED

    @property
    def residual_m(self) -> Floats:
        """Observed less computed values of all observations at `x`, m, shape (n,)."""
        return self.linearization.residual_m if self.smoothed is None else self.smoothed.residual_m

    @property
    def sigmas(self) -> Floats:
        """Formal standard deviations of the parameters, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sigma_m(self) -> Floats:
        """Stated total standard deviation of each observation, m, shape (n,)."""
        return self.noise.sigma_m

    @property
    def chi2_per_dof(self) -> float | None:
        """Reduced chi-square; None without redundancy."""
        return self.chi2 / self.dof if self.dof > 0 else None

    @property
    def noise_scale(self) -> float:
        """Scale factor of the stated sigmas from the reduced chi-square; 1 unless that is significantly larger.

        Correlated weights are scaled already. Unscaled, the mean of two ranges 20 sigmas apart would have a sigma of
        0.7 (`tests/unit/estimation/test_least_squares.py`).
        """
        significant = self.dof > 0 and self.chi2 > chi2_quantile(SCALING_PROBABILITY, self.dof)
        return math.sqrt(self.chi2 / self.dof) if significant and self.independent_weights else 1.0

    def unit_partials(self, directions: Floats | None = None) -> RowsOf:
        """Return the function from rows (m,) to partials with respect to parameters of unit formal covariance, (m, q).

        With `directions` (q, w), partials with respect to these orthonormal combinations, (m, w).
        """
        free, root = self.parameters.free, self.factor.root_covariance()
        root = root if directions is None else root @ directions
        root_of_all = np.zeros((len(free), root.shape[1]))
        root_of_all[free] = root

        def unit_partials(rows: Rows) -> Floats:
            parameters, partials = nonzero_partials(self.linearization, rows)
            return times(partials, root_of_all[parameters])

        return unit_partials

    def whitened_unit_partials(self, directions: Floats | None = None) -> Iterator[Floats]:
        """Yield the whitened :meth:`unit_partials` of the used observations, part by part."""
        if self.factor.whitened is None:
            return self.whitening.whitened(self.unit_partials(directions))
        root = self.factor.root_covariance()
        return self.factor.whitened.by(root if directions is None else root @ directions)

    @property
    def independent_weights(self) -> bool:
        """True if the weights are those of the stated noise, without correlation in time."""
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
    """Fit parameters to the used observations, by default all, by damped Gauss-Newton iterations.

    The residual function maps parameters (p,) to a :class:`~radioloc.estimation.linearization.Linearization`, or to a
    pair of residuals (n,), m, and partials (n, p). `whitening` replaces the weights of the stated noise.
    """
    x = parameters.prior_values if start is None else np.array(start, dtype=np.float64)
    if x.shape != (len(parameters),):
        raise InputError(f"start: expected shape ({len(parameters)},), got {x.shape}")
    x = np.where(parameters.free, x, parameters.prior_values)

    at_start = evaluate(residual_function, x) if linearization is None else linearization
    n = len(at_start.residual_m)
    noise = ObservationCovariance.of(sigma_m, n)
    mask = np.ones(n, dtype=bool) if used is None else np.array(used, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"used: expected shape ({n},), got {mask.shape}")
    check_residuals(at_start, mask)
    n_used = int(mask.sum())
    stated = noise.whitener(mask, row_order(at_start))
    process = getattr(at_start, "process", None)
    if process is not None and whitening is None:
        whitening = InformationFilter.of(process, noise, mask)
    problem = _Problem(residual_function, parameters, whitening or stated, n_used)
    point = problem.point(x, at_start)
    factor_at_start = problem.factor(point)
    if factor_at_start is None:
        check_partials(at_start, mask, parameters)
        raise InputError("the whitened partials overflow at the start; check the sigmas")
    point, factor, status, iterations = problem.iterated(point, factor_at_start)
    if not factor.determined.all() and status is FitStatus.CONVERGED:
        status = FitStatus.UNOBSERVABLE
    # Chi-square refers to the stated noise, whatever the weights.
    chi2 = point.chi2
    if (whitening is not None and process is None) or math.isnan(chi2):
        chi2 = sum_of_squares(point.linearization.residual_m, stated, parameters, point.x)
    n_prior = int((np.isfinite(parameters.prior_sigmas) & parameters.free).sum())
    return FitResult(
        parameters=parameters,
        x=point.x,
        covariance=covariance_of(factor, parameters),
        linearization=point.linearization,
        noise=noise,
        used=mask,
        chi2=chi2,
        dof=n_used + n_prior - int(factor.determined.sum()),
        status=status,
        iterations=iterations,
        factor=factor,
        whitening=problem.whitening,
        time_correlation=None if process is None else TimeCorrelation((), np.zeros((len(x),) * 2), {}),
        smoothed=_smoothed(problem, point, factor),
    )


def _smoothed(problem: _Problem, point: _Point, factor: Factor) -> Smoothed | None:
    if not isinstance(problem.whitening, InformationFilter):
        return None
    free, root = problem.parameters.free, factor.root_covariance()
    linearization = point.linearization
    return problem.whitening.smoothed(
        lambda rows: linearization.partials(rows)[:, free], linearization.residual_m, root @ root.T
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """Linearization and sum of squares at parameters x."""

    x: Floats
    linearization: Linearization
    chi2: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Constant inputs of the iterations, with the steps between points."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    whitening: Whitener
    n_used: int

    def point(self, x: Floats, linearization: Linearization) -> _Point:
        if isinstance(linearization, OrthonormalLinearization):
            return _Point(x, linearization, math.nan)
        chi2 = sum_of_squares(linearization.residual_m, self.whitening, self.parameters, x)
        return _Point(x, linearization, chi2)

    def factor(self, point: _Point) -> Factor | None:
        return factorize(point.linearization, self.whitening, self.parameters, point.x)

    def stepped(self, point: _Point, factor: Factor, damping: float) -> _Point:
        x = point.x.copy()
        x[self.parameters.free] += factor.step(damping)
        return self.point(x, evaluate_step(self.residual_function, x, point.linearization))

    def factor_after(self, point: _Point, trial: _Point, factor: Factor) -> Factor | None:
        """Factor at the end of a step; the present one, with a new right side, if the fit is about to converge."""
        moved = np.abs(trial.x - point.x) / self.parameters.scales
        if moved.max() <= _TRIANGLE_REUSE_SCALES:
            refreshed_factor = refreshed(
                factor, trial.linearization, self.whitening, self.parameters, trial.x
            )
            if refreshed_factor.step_sigmas < self.tolerance(trial):
                return refreshed_factor
        return self.factor(trial)

    def tolerance(self, point: _Point) -> float:
        """Step length at convergence, in formal standard deviations."""
        return _STEP_TOLERANCE * max(1.0, float(np.sqrt(point.chi2 / max(1, self.n_used))))

    def descend(self, point: _Point, factor: Factor, damping: float) -> tuple[_Point, Factor, float] | None:
        """Point, factor and damping of a step that lowers the sum of squares; None if no step does.

        Undamped steps overshoot to positions without a model (`tests/unit/estimation/test_least_squares.py`).
        """
        length = factor.step_sigmas
        while damping <= _MAX_DAMPING * factor.singular_values[0]:
            trial = self.stepped(point, factor, damping)
            # So short a step changes the sum of squares by less than its rounding: it is accepted without a test, and
            # the partials stay, as they change by the step over distances of thousands of kilometres.
            if length < self.tolerance(point):
                return trial, factor, damping
            trial_factor = self.factor_after(point, trial, factor) if np.isfinite(trial.chi2) else None
            if trial_factor is not None:
                # Rounding of ranges to 1e-7 m hides the decrease of the sum by a short step.
                is_short = damping == 0.0 and length <= _SHORT_STEP_SIGMAS
                if trial.chi2 <= point.chi2 + is_short * _ROUNDING_OF_ROOT * np.sqrt(point.chi2):
                    return trial, trial_factor, damping
            damping = 3.0 * damping if damping > 0.0 else factor.least_damping
        return None

    def iterated(self, point: _Point, factor: Factor) -> tuple[_Point, Factor, FitStatus, int]:
        """Return the final point of the iterations with its factor, the status and the number of steps."""
        if not self.parameters.free.any():
            return point, factor, FitStatus.CONVERGED, 0
        if isinstance(point.linearization, OrthonormalLinearization):  # linear: one step
            solution = self.stepped(point, factor, 0.0)
            return (
                solution,
                replace(factor, right_side=np.zeros_like(factor.right_side)),
                FitStatus.CONVERGED,
                1,
            )
        damping, previous_length = 0.0, math.inf
        for count in range(_MAX_ITERATIONS):
            length, tolerance = factor.step_sigmas, self.tolerance(point)
            if count and length < _MIN_STEP_TOLERANCES * tolerance:
                return point, factor, FitStatus.CONVERGED, count
            if 0.5 * previous_length < length < _FLOOR_TOLERANCES * tolerance:
                return point, factor, FitStatus.CONVERGED, count
            previous_length = length
            descent = self.descend(point, factor, damping)
            if descent is None:
                # Nothing lowers the sum: either it is at its floor to rounding (ranges are rounded to 1e-7 m),
                # or the partials point the wrong way.
                at_floor = length <= max(_SHORT_STEP_SIGMAS, 1e-3 * np.sqrt(point.chi2))
                return point, factor, FitStatus.CONVERGED if at_floor else FitStatus.DIVERGED, count
            least = factor.least_damping
            point, factor, damping = descent
            damping = 0.0 if damping <= least else damping / 3.0
            if length < tolerance:
                return point, factor, FitStatus.CONVERGED, count + 1
        return point, factor, FitStatus.MAX_ITERATIONS, _MAX_ITERATIONS


def sum_of_squares(residual_m: Floats, whitening: Whitener, parameters: ParameterSet, x: Floats) -> float:
    """Weighted sum of squares with the a-priori rows; infinite if the model is not finite."""
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    total = float((prior * prior).sum())
    for part in whitening.whitened(column(residual_m)):
        total += float(np.square(part, out=part).sum())
    return total if np.isfinite(total) else np.inf
