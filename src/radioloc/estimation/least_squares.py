"""Weighted batch least squares with a-priori information: Gauss-Newton with Levenberg-Marquardt damping.

The estimate minimizes the sum of squares

    J(x) = |L (y - c(x))|^2 + |P_0^-1/2 (x_0 - x)|^2

of the observations y with computed values c(x) and of the a-priori values x_0 with covariance P_0. The whitener L has
L^T L = R^-1, with the covariance R of the observations. Each iteration reduces the whitened residuals and partials
A = dc/dx with the a-priori rows by orthogonal transformations, with the singular value decomposition

    [L A; P_0^-1/2] = U S V^T,    dx = V (S^2 + mu^2)^-1 S U^T [L (y - c); P_0^-1/2 (x_0 - x)].

A step with mu = 0 that does not lower J is repeated with larger damping mu from the same decomposition. The covariance
of the estimate is P = V S^-2 V^T. Directions of negligible singular values are undetermined: parameters keep their
start values there.

The iterations have converged

- after a step below the tolerance,
- if the next step would be negligible, or
- if short steps no longer shrink or do not lower J with any damping, since rounding errors then dominate.

If a long step does not lower J with any damping, the fit has diverged.

References: Tapley, Schutz and Born (2004), sections 4.3 and 5.6; Bierman (1977), chapters IV and V; Levenberg (1944);
Marquardt (1963).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.information_filter import InformationFilters, Smoothed
from radioloc.estimation.linearization import (
    Factor,
    Linearization,
    OrthonormalLinearization,
    ResidualFunction,
    check_partials,
    check_residuals,
    covariance_matrix,
    evaluate,
    evaluate_step,
    factorize,
    matrix_product,
    process_noise,
    smooth_partials,
    with_new_right_side,
)
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.estimation.status import FitStatus
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import (
    LinkedWhitener,
    Rows,
    RowsOf,
    StructuredWhitener,
    Whitener,
    column,
    slices,
)
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats, Mask

_MAX_ITERATIONS = 30
# The length of a step is that of dx in formal standard deviations; a step of s sigmas lowers J by s^2.
_STEP_TOLERANCE = 1e-3  # length at convergence divided by sqrt(J/n)
_NEGLIGIBLE_STEP = 1e-3  # length divided by the tolerance; iterations end before such a step
_MAX_ROUNDING_STEP = (
    10.0  # length divided by the tolerance; rounding errors dominate shorter steps that are not halved
)
_SHORT_STEP_SIGMAS = 0.1  # length; rounding errors may increase J after shorter steps
_MAX_FUTILE_STEP = 1e-3  # length divided by sqrt(J); such a step would lower J by a millionth
# Accepted increase of J divided by sqrt(J). Ranges are rounded to 1e-7 m, which is 1e-4 of a residual of 1 mm.
_ROUNDING_INCREASE = 1e-4
_MAX_DAMPING = 1e3  # damping divided by the largest singular value: the step is then 1e-6 of the undamped one
_MAX_FACTOR_REUSE_STEP = (
    1.0  # step divided by the scales of the parameters; changes the partials by less than 1e-6
)


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """Result of a least-squares fit of p parameters to n observations."""

    parameters: ParameterSet
    x: Floats  # (p,), estimate; undetermined directions keep their start values
    # (p, p), formal covariance: zeros for fixed parameters, infinite variances and zero covariances for parameters of
    # undetermined directions.
    covariance: Floats
    linearization: Linearization  # at x, of all observations
    noise: ObservationCovariance  # stated R of all observations
    used: Mask  # (n,)
    chi2: float  # weighted sum of squares of used observations and a-priori values
    dof: int  # used observations and a-priori values less determined directions
    status: FitStatus
    iterations: int  # number of Gauss-Newton steps
    factor: Factor  # decomposition of the whitened problem, at x or at the preceding iterate, a negligible step away
    whitening: Whitener  # of the used observations, by the weights of the fit
    time_correlation: TimeCorrelation | None = None  # noise model of fits with correlated weights
    smoothed: tuple[Smoothed, ...] = ()  # stochastic accelerations of each orbit

    @property
    def converged(self) -> bool:
        """True if the fit converged and every free parameter is determined."""
        return self.status is FitStatus.CONVERGED

    @property
    def residual_m(self) -> Floats:
        """Observed less computed values of all observations at `x`, m, shape (n,)."""
        residual_m = self.linearization.residual_m
        for item in self.smoothed:
            residual_m = residual_m - item.effects_m
        return residual_m

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
    def has_independent_weights(self) -> bool:
        """True if the weights are those of the stated noise, without correlation in time."""
        return isinstance(self.whitening, StructuredWhitener)

    @property
    def noise_scale(self) -> float:
        """Scale factor of the stated sigmas, sqrt(chi2/dof) if chi2 is significantly too large, otherwise 1.

        Without it, for example, the mean of two ranges that are 20 sigmas apart would have 0.7 of the sigma of one
        range, although the ranges contradict each other. Correlated weights include the scale already.
        """
        significant = self.dof > 0 and self.chi2 > chi2_quantile(SCALING_PROBABILITY, self.dof)
        return math.sqrt(self.chi2 / self.dof) if significant and self.has_independent_weights else 1.0

    def unit_partials(self, directions: Floats | None = None) -> RowsOf:
        """Return a function that gives some rows of A P^(1/2), the partials for parameters scaled to unit covariance.

        It maps rows (m,) to an array (m, q); with orthonormal `directions` D, (q, w), to A P^(1/2) D, (m, w).
        """
        root, polynomials = self._root_covariance(directions), smooth_partials(self.linearization)
        if polynomials is not None:
            return polynomials.combined(root)
        return lambda rows: matrix_product(self.linearization.partials(rows), root)

    def _root_covariance(self, directions: Floats | None = None) -> Floats:
        """Return P^(1/2) D with rows of zeros for fixed parameters, (p, w)."""
        root = self.factor.root_covariance()
        root = root if directions is None else root @ directions
        root_covariance = np.zeros((len(self.parameters), root.shape[1]))
        root_covariance[self.parameters.free] = root
        return root_covariance

    def leverage(self, rows: Rows) -> Floats:
        """Return the leverages of some observations (m,) by their stated sigmas, shape (m,)."""
        unit_partials = self.unit_partials()
        squares = [np.square(unit_partials(rows[part])).sum(axis=1) for part in slices(len(rows))]
        return np.concatenate([np.zeros(0), *squares]) / self.sigma_m[rows] ** 2

    def whitened_unit_partials(self, directions: Floats | None = None) -> Iterator[Floats]:
        """Yield L A P^(1/2) D of the used observations, part by part, as :meth:`unit_partials`."""
        if self.factor.whitened is None:
            return self.whitening.whitened(self.unit_partials(directions))
        root = self.factor.root_covariance()
        return self.factor.whitened.combined(root if directions is None else root @ directions)


@accepts_quantities
def fit_least_squares(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationCovariance,
    *,
    used: ArrayLike | None = None,
    start: ArrayLike | None = None,
    linearization: Linearization | None = None,
    whitening: LinkedWhitener | None = None,
) -> FitResult:
    """Estimate parameters from the used observations, by default all, starting from the a-priori values.

    The residual function maps parameters (p,) to a :class:`~radioloc.estimation.linearization.Linearization`, or to
    residuals (n,), m, and partials d(computed)/d(parameter), (n, p). `linearization` is that at the start, if it is
    available; `whitening` replaces the weights of the stated noise.
    """
    x = parameters.prior_values if start is None else np.array(start, dtype=np.float64)
    if x.shape != (len(parameters),):
        raise InputError(f"start: expected shape ({len(parameters)},), got {x.shape}")
    x = np.where(parameters.free, x, parameters.prior_values)
    if linearization is None:
        linearization = evaluate(residual_function, x)
    n = len(linearization.residual_m)
    noise = ObservationCovariance.from_sigma(sigma_m, n)
    mask = np.ones(n, dtype=bool) if used is None else np.array(used, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"used: expected shape ({n},), got {mask.shape}")
    check_residuals(linearization, mask)

    # Weights: given ones, those of the process noise, or those of the stated noise.
    stated: Whitener = noise.whitener(mask) if whitening is None else whitening.stated
    processes, weights = process_noise(linearization), whitening or stated
    if processes and whitening is None:
        weights = InformationFilters.from_observations(processes, noise, mask)
    solver = _GaussNewton(residual_function, parameters, weights, int(mask.sum()))

    factor = factorize(linearization, solver.whitening, parameters, x)
    if factor is None:
        check_partials(linearization, mask, parameters)
        raise InputError("the whitened partials overflow at the start; check the sigmas")
    initial = _Iterate(x, linearization, factor, solver.sum_of_squares(linearization, x))
    iterate, status = solver.solve(initial)
    factor, linearization = iterate.factor, iterate.linearization
    if not factor.determined.all() and status is FitStatus.CONVERGED:
        status = FitStatus.UNOBSERVABLE

    # Chi-square refers to the stated noise, with the process noise of orbits, and not to other weights.
    chi2 = iterate.sum_of_squares
    if (whitening is not None and not processes) or math.isnan(chi2):
        chi2 = _sum_of_squares(linearization.residual_m, stated, parameters, iterate.x)
    prior_count = int((np.isfinite(parameters.prior_sigmas) & parameters.free).sum())
    smoothed, correlation = tuple[Smoothed, ...](), None
    if processes:  # the weights allow for the correlation by process noise, and no other is sought
        correlation = TimeCorrelation((), np.zeros((len(x),) * 2), {})
    if isinstance(solver.whitening, InformationFilters):
        free, root = parameters.free, factor.root_covariance()
        smoothed = solver.whitening.smoothed(
            lambda rows: linearization.partials(rows)[:, free], linearization.residual_m, root @ root.T
        )
    return FitResult(
        parameters=parameters,
        x=iterate.x,
        covariance=covariance_matrix(factor, parameters),
        linearization=linearization,
        noise=noise,
        used=mask,
        chi2=chi2,
        dof=solver.used_count + prior_count - int(factor.determined.sum()),
        status=status,
        iterations=iterate.step_count,
        factor=factor,
        whitening=solver.whitening,
        time_correlation=correlation,
        smoothed=smoothed,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """Parameters of an iteration with their linearized and factorized problem."""

    x: Floats
    linearization: Linearization
    factor: Factor  # at x, or at the preceding iterate
    sum_of_squares: float
    step_count: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _GaussNewton:
    """Damped Gauss-Newton iterations of one problem."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    whitening: Whitener
    used_count: int

    def solve(self, iterate: _Iterate) -> tuple[_Iterate, FitStatus]:
        """Iterate to convergence; return the last iterate and the status."""
        if not self.parameters.free.any():
            return iterate, FitStatus.CONVERGED
        if isinstance(iterate.linearization, OrthonormalLinearization):  # a linear problem needs one step
            solution = self.step(iterate, 0.0)
            solved = replace(iterate.factor, right_side=np.zeros_like(iterate.factor.right_side))
            return replace(solution, factor=solved), FitStatus.CONVERGED
        damping, previous_length = 0.0, math.inf
        while iterate.step_count < _MAX_ITERATIONS:
            length, tolerance = iterate.factor.step_sigmas, self.step_tolerance(iterate)
            is_negligible = iterate.step_count > 0 and length < _NEGLIGIBLE_STEP * tolerance
            is_rounding = 0.5 * previous_length < length < _MAX_ROUNDING_STEP * tolerance
            if is_negligible or is_rounding:
                return iterate, FitStatus.CONVERGED
            descended = self.descend(iterate, damping)
            if descended is None:
                # The sum of squares is at its minimum to rounding errors, or it overflows, or the partials are wrong.
                max_step = max(_SHORT_STEP_SIGMAS, _MAX_FUTILE_STEP * math.sqrt(iterate.sum_of_squares))
                is_minimum = length <= max_step < math.inf
                return iterate, FitStatus.CONVERGED if is_minimum else FitStatus.DIVERGED
            previous_length, factor = length, iterate.factor
            iterate, damping = descended
            damping = damping / 3.0 if damping > 0.0 and damping > factor.least_damping else 0.0
            if length < tolerance:
                return iterate, FitStatus.CONVERGED
        return iterate, FitStatus.MAX_ITERATIONS

    def descend(self, iterate: _Iterate, damping: float) -> tuple[_Iterate, float] | None:
        """Increase the damping until a step lowers the sum of squares; None if no step does.

        Undamped steps can overshoot to parameters at which the model cannot be evaluated.
        """
        factor, length = iterate.factor, iterate.factor.step_sigmas
        while damping == 0.0 or damping <= _MAX_DAMPING * factor.singular_values[0]:
            trial = self.step(iterate, damping)
            # A step below the tolerance changes the sum of squares by less than its rounding errors, and the partials
            # by less than 1e-6: it needs neither a test nor a new factorization.
            if length < self.step_tolerance(iterate):
                return trial, damping
            bound = iterate.sum_of_squares
            if damping == 0.0 and length <= _SHORT_STEP_SIGMAS:
                bound += _ROUNDING_INCREASE * math.sqrt(bound)
            if np.isfinite(trial.sum_of_squares) and trial.sum_of_squares <= bound:
                accepted = self.update_factor(trial, iterate.x)
                if accepted is not None:
                    return accepted, damping
            damping = 3.0 * damping if damping > 0.0 else factor.least_damping
        return None

    def step(self, iterate: _Iterate, damping: float) -> _Iterate:
        """Take a step and evaluate the model; the factor stays that of the preceding iterate."""
        x = iterate.x.copy()
        x[self.parameters.free] += iterate.factor.step(damping)
        linearization = evaluate_step(self.residual_function, x, iterate.linearization)
        sum_of_squares = self.sum_of_squares(linearization, x)
        return _Iterate(x, linearization, iterate.factor, sum_of_squares, iterate.step_count + 1)

    def update_factor(self, trial: _Iterate, previous_x: Floats) -> _Iterate | None:
        """Factorize at a new iterate, or only renew the right side if the fit is about to converge."""
        problem = trial.linearization, self.whitening, self.parameters, trial.x
        if (np.abs(trial.x - previous_x) / self.parameters.scales).max() <= _MAX_FACTOR_REUSE_STEP:
            factor = with_new_right_side(trial.factor, *problem)
            if factor.step_sigmas < self.step_tolerance(trial):
                return replace(trial, factor=factor)
        new_factor = factorize(*problem)
        return None if new_factor is None else replace(trial, factor=new_factor)

    def step_tolerance(self, iterate: _Iterate) -> float:
        """Step length at convergence, in formal standard deviations."""
        reduced_chi2 = iterate.sum_of_squares / max(1, self.used_count)
        return _STEP_TOLERANCE * max(1.0, float(np.sqrt(reduced_chi2)))

    def sum_of_squares(self, linearization: Linearization, x: Floats) -> float:
        """Sum of squares J(x); NaN for linear problems, which need none."""
        if isinstance(linearization, OrthonormalLinearization):
            return math.nan
        return _sum_of_squares(linearization.residual_m, self.whitening, self.parameters, x)


def _sum_of_squares(residual_m: Floats, whitening: Whitener, parameters: ParameterSet, x: Floats) -> float:
    """Sum of squares of whitened residuals and a-priori values; infinite if it overflows or is not a number."""
    free = parameters.free
    prior = (x - parameters.prior_values)[free] / parameters.prior_sigmas[free]
    total = float((prior * prior).sum())
    for part in whitening.whitened(column(residual_m)):
        total += float(np.square(part).sum())
    return total if np.isfinite(total) else np.inf
