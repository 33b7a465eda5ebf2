"""Weighted batch least squares with a-priori information, by orthogonal factorization.

Minimizes, over the parameters x, ``|(o - c(x)) / sigma|^2 + |(x - x_prior) / sigma_prior|^2``; independent
combinations take the place of observations that share errors. Each Gauss-Newton step reduces the whitened
partials, the a-priori rows and the right side to a triangle by Householder reflections (Bierman 1977,
chapters IV and V; Lawson and Hanson 1974) and solves that by its singular values, so the condition number is
never squared by normal equations. Rows are reduced some hundred at a time, and the triangles of these again
(Demmel et al. 2012): they stay in the processor's cache, and never are all partials held at once. A step
that does not lower the sum of squares is damped (Levenberg 1944, Marquardt 1963) in the same singular basis,
at no cost in further factorizations.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.linearization import (
    Linearization,
    ResidualFunction,
    Rows,
    check_finite,
    check_residuals,
    evaluate,
)
from radioloc.estimation.observation_noise import Combinations, ObservationNoise
from radioloc.estimation.parameters import ParameterSet

# Damping given up at, in largest singular values: the step is then a millionth of the plain one.
_MAX_DAMPING = 1e3

_SHORT = 0.1
"""Steps below so many standard deviations are not asked to lower the sum of squares."""
_ROUNDED = 1e-4
"""What rounding may add to the sum, in parts of its root: 1e-7 m in residuals of millimetres."""

_NEAR = 1.0
"""A step of so many parameter scales (metres) changes the partials by less than 1e-6 of themselves: their triangle
stays."""

_NEGLIGIBLE = 1e-3
"""A next step below this part of the tolerance is not taken any more."""

_LEAF_ELEMENTS = 8192
"""Numbers in the matrices that rows are reduced in: they fit a processor's own cache, and are too few for linear
algebra libraries to share them out, so the result does not depend on the number of threads."""


class FitStatus(enum.Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "not converged: iteration limit reached"
    DIVERGED = "not converged: no step lowers the sum of squares"
    UNOBSERVABLE = "not observable: the data do not determine every parameter"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """When to stop and what counts as determined.

    Parameters
    ----------
    max_iterations : int
        Limit of Gauss-Newton iterations.
    step_tolerance : float
        Converged when a step is shorter, in standard deviations over all parameters together (formal ones,
        or scaled up to what the residuals show). Such a step lowers the sum of squares by its square, so
        this bounds that too.
    rank_tolerance : float
        A combination of parameters is undetermined when its singular value, with all columns scaled to
        length one, is below this part of the largest. Partials carry rounding of about 1e-13 and light-time
        cut-offs of 1e-11; what they tell beneath 1e-10 is not information.
    max_sigma : float
        A combination is undetermined too when its standard deviation exceeds this many parameter scales
        (metres): beyond about the Moon's radius the linear model that the figure rests on means nothing.
    """

    max_iterations: int = 30
    step_tolerance: float = 1e-3
    rank_tolerance: float = 1e-10
    max_sigma: float = 1e6


@dataclass(frozen=True, slots=True)
class Iteration:
    """One Gauss-Newton iteration: what the step was and what it did.

    Parameters
    ----------
    chi2_before, chi2_after : float
        Weighted sum of squares, a-priori rows included.
    step_sigmas : float
        Length of the undamped step in formal standard deviations.
    damping : float
        Levenberg-Marquardt parameter of the step taken; 0 is a plain Gauss-Newton step.
    """

    chi2_before: float
    chi2_after: float
    step_sigmas: float
    damping: float


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """The whitened linear problem reduced to its singular values.

    The free parameters are multiplied by ``column_norms`` so that every column has length one.

    Parameters
    ----------
    column_norms : ndarray, shape (q,)
        Length of each whitened column with its a-priori row; 1/scale for a column of zeros.
    singular_values : ndarray, shape (q,)
        Of the matrix with columns of length one, descending.
    vectors : ndarray, shape (q, q)
        Right singular vectors in columns.
    right_side : ndarray, shape (q,)
        Whitened residuals in the singular basis.
    determined : ndarray of bool, shape (q,)
        Which singular directions the data and the a-priori rows determine.
    """

    column_norms: NDArray[np.float64]
    singular_values: NDArray[np.float64]
    vectors: NDArray[np.float64]
    right_side: NDArray[np.float64]
    determined: NDArray[np.bool_]

    @property
    def step_sigmas(self) -> float:
        """Length of the undamped step in formal standard deviations."""
        return float(np.linalg.norm(self.right_side[self.determined]))

    def step(self, damping: float = 0.0) -> NDArray[np.float64]:
        """Change of the free parameters, none of it along undetermined directions, shape (q,)."""
        s = self.singular_values[self.determined]
        along = s * self.right_side[self.determined] / (s**2 + damping**2)
        return (self.vectors[:, self.determined] @ along) / self.column_norms

    def root_covariance(self) -> NDArray[np.float64]:
        """Square root of the covariance: times its transpose it is the determined part's, shape (q, r)."""
        root: NDArray[np.float64] = self.vectors[:, self.determined] / self.singular_values[self.determined]
        return root / self.column_norms[:, None]

    def undetermined_directions(self) -> NDArray[np.float64]:
        """Undetermined directions in parameter units, one per row, shape (q - r, q)."""
        directions: NDArray[np.float64] = self.vectors[:, ~self.determined].T / self.column_norms
        return directions


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The outcome of one least squares fit.

    Parameters
    ----------
    parameters : ParameterSet
        What was solved for.
    x : ndarray, shape (p,)
        Estimated values; undetermined directions stay where they started.
    covariance : ndarray, shape (p, p)
        Formal covariance from the stated sigmas. Fixed parameters have zeros; a parameter that takes part
        in an undetermined direction has infinite variance and, as no number is right there, zero
        covariances.
    linearization : Linearization
        Residuals of all observations, used or not, at `x`, and their partials.
    noise : ObservationNoise
        Stated noise of all observations.
    used : ndarray of bool, shape (n,)
        Which observations took part.
    chi2 : float
        Weighted sum of squares over the used observations and the a-priori values.
    dof : int
        Used observations plus a-priori values less estimated parameters (or determined directions, if fewer).
    status : FitStatus
        How it ended.
    iterations : tuple of Iteration
        History.
    factor : Factor
        Singular values and directions over the free parameters, at `x` or less than a last, converged step from it; of
        the problem as it was weighed.
    sigma_factor : ndarray, shape (n,), or None
        Factor on the stated sigmas that the observations were weighed with; 1 where ``None``. One for all observations
        that share errors.
    """

    parameters: ParameterSet
    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    linearization: Linearization
    noise: ObservationNoise
    used: NDArray[np.bool_]
    chi2: float
    dof: int
    status: FitStatus
    iterations: tuple[Iteration, ...]
    factor: Factor
    sigma_factor: NDArray[np.float64] | None = None

    @property
    def converged(self) -> bool:
        """Whether the fit converged and every free parameter is determined."""
        return self.status is FitStatus.CONVERGED

    @property
    def residual_m(self) -> NDArray[np.float64]:
        """Observed - computed at `x`, for all observations, used or not, m, shape (n,)."""
        return self.linearization.residual_m

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Formal standard deviations of the parameters, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sigma_m(self) -> NDArray[np.float64]:
        """Stated standard deviation of each observation, all its errors together, m, shape (n,)."""
        return self.noise.sigma_m

    @property
    def normalized_residuals(self) -> NDArray[np.float64]:
        """Residuals over their stated sigmas, all observations, each seen alone, shape (n,)."""
        return self.residual_m / self.sigma_m

    @property
    def chi2_per_dof(self) -> float | None:
        """Reduced chi-square; None without redundancy."""
        return self.chi2 / self.dof if self.dof > 0 else None


def factorize(
    linearization: Linearization,
    combinations: Combinations,
    parameters: ParameterSet,
    x: NDArray[np.float64],
    settings: FitSettings,
) -> Factor | None:
    """Reduce one linearized problem, a-priori rows included, to its singular values.

    Parameters
    ----------
    linearization : Linearization
        Of all observations.
    combinations : Combinations
        The observations to use, with their noise.
    parameters : ParameterSet
        Gives the a-priori rows and which columns are free.
    x : ndarray, shape (p,)
        Where the problem was linearized.
    settings : FitSettings
        The tolerances of rank.

    Returns
    -------
    Factor or None
        None where a residual or a partial is not finite.
    """
    free = np.flatnonzero(parameters.free)
    q = len(free)
    with_prior = np.flatnonzero(np.isfinite(parameters.prior_sigmas[free]))
    prior_sigmas = parameters.prior_sigmas[free][with_prior]
    triangle = np.zeros((len(with_prior), q + 1))
    triangle[np.arange(len(with_prior)), with_prior] = 1.0 / prior_sigmas
    triangle[:, q] = (parameters.prior_values - x)[free][with_prior] / prior_sigmas

    # The triangle carries over from part to part, so no copy of all whitened rows is made.
    for whitened in _whitened_rows(linearization, combinations, free) if q else ():
        triangle = reduced(triangle, whitened)
    if not np.isfinite(triangle).all():
        return None

    # Fewer rows than columns leave a trapezoid; rows of zeros complete it and show up as zero singular
    # values.
    matrix = np.zeros((q, q))
    right_side = np.zeros(q)
    height = min(q, len(triangle))
    matrix[:height], right_side[:height] = triangle[:height, :q], triangle[:height, q]

    scales = parameters.scales[free]
    norms = np.linalg.norm(matrix, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0 / scales)
    left, s, right = np.linalg.svd(matrix / norms)
    sizes = np.linalg.norm(right / norms / scales, axis=1)
    determined = (s > settings.rank_tolerance * s.max(initial=0.0)) & (s * settings.max_sigma > sizes)
    return Factor(norms, s, right.T, left.T @ right_side, determined)


def _whitened_rows(
    linearization: Linearization, combinations: Combinations, free: NDArray[np.intp]
) -> Iterator[NDArray[np.float64]]:
    """Whitened partials by the free parameters with the residuals as last column, part by part."""
    q = len(free)

    def rows_of(rows: Rows) -> NDArray[np.float64]:
        partials = linearization.partials(rows)
        out = np.empty((len(rows), q + 1))
        out[:, :q] = partials if partials.shape[1] == q else partials[:, free]
        out[:, q] = linearization.residual_m[rows]
        return out

    return combinations.whitened(rows_of)


def refreshed(
    factor: Factor,
    linearization: Linearization,
    combinations: Combinations,
    parameters: ParameterSet,
    x: NDArray[np.float64],
) -> Factor:
    """Factor of a neighbouring point: its right side from the gradient here, its triangle as it was there.

    Notes
    -----
    Corrected seminormal equations (Bjorck 1987): with the triangle R of an orthogonal factorization, R^-T A^T r is the
    right side but for rounding of the condition number, not of its square, times that of the residuals. It tells
    whether another step is worth taking, at a third of the cost of another factorization.
    """
    free = np.flatnonzero(parameters.free)
    gradient = (parameters.prior_values - x)[free] / parameters.prior_sigmas[free] ** 2
    for rows in _whitened_rows(linearization, combinations, free):
        # Summed by numpy itself: the result does not depend on the number of threads.
        gradient += np.einsum("nq,n->q", rows[:, :-1], rows[:, -1])
    along = factor.vectors.T @ (gradient / factor.column_norms)
    s = factor.singular_values
    right_side = np.divide(along, s, out=np.zeros_like(along), where=factor.determined)
    return replace(factor, right_side=right_side)


def reduced(triangle: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Triangle of a triangle (k, c) with more rows (m, c) beneath it, shape (min(k + m, c), c)."""
    columns = rows.shape[1]
    leaf = max(2 * columns, _LEAF_ELEMENTS // columns)
    while len(rows) > 2 * leaf:
        count = len(rows) // leaf
        tops = np.asarray(np.linalg.qr(rows[: count * leaf].reshape(count, leaf, columns), mode="r"))
        rows = np.concatenate([tops.reshape(-1, columns), rows[count * leaf :]])
    return np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def fit_least_squares(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationNoise,
    *,
    used: ArrayLike | None = None,
    start: ArrayLike | None = None,
    linearization: Linearization | None = None,
    settings: FitSettings | None = None,
) -> FitResult:
    """Fit parameters to observations.

    Parameters
    ----------
    residual_function : callable
        From x (p,) to a :class:`~radioloc.estimation.linearization.Linearization`; or to the pair of residuals
        observed - computed (n,), m, and partials d(computed)/dx (n, p).
    parameters : ParameterSet
        What is solved for, with a-priori values.
    sigma_m : array_like, shape (n,) or (), or ObservationNoise
        Standard deviations of the observations, m; or their noise where they share errors.
    used : array_like of bool, shape (n,), optional
        Observations that take part; all by default. Residuals are returned for the others too.
    start : array_like, shape (p,), optional
        Where to start; the a-priori values by default. Fixed parameters stay at their a-priori values.
    linearization : Linearization, optional
        The one at `start`, where it is known already.
    settings : FitSettings, optional
        Limits and tolerances.

    Returns
    -------
    FitResult
        The status says whether it converged and everything is determined; neither raises.

    Raises
    ------
    InputError
        Shapes do not agree, a sigma is not positive and finite, or the residuals or partials at the start
        are not finite.
    """
    settings = settings or FitSettings()
    x = parameters.prior_values if start is None else np.array(start, dtype=np.float64)
    if x.shape != (len(parameters),):
        raise InputError(f"start has shape {x.shape}; {len(parameters)} parameters need ({len(parameters)},)")
    x = np.where(parameters.free, x, parameters.prior_values)

    at_start = evaluate(residual_function, x) if linearization is None else linearization
    n = len(at_start.residual_m)
    noise = ObservationNoise.of(sigma_m, n)
    mask = np.ones(n, dtype=bool) if used is None else np.array(used, dtype=bool)
    if mask.shape != (n,):
        raise InputError(f"used has shape {mask.shape}; {n} observations need ({n},)")
    check_residuals(at_start, mask)
    combinations = noise.among(mask)
    n_used = int(mask.sum())

    def point(x: NDArray[np.float64], linearization: Linearization) -> _Point:
        return _Point(x, linearization, sum_of_squares(linearization.residual_m, combinations, parameters, x))

    def reduce(at: _Point) -> Factor | None:
        return factorize(at.linearization, combinations, parameters, at.x, settings)

    def stepped(at: _Point, factor: Factor, damping: float) -> _Point:
        x = at.x.copy()
        x[parameters.free] += factor.step(damping)
        return point(x, evaluate(residual_function, x))

    def next_factor(here: _Point, trial: _Point, factor: Factor) -> Factor | None:
        moved = np.abs(trial.x - here.x) / parameters.scales
        if moved.max() <= _NEAR:
            near = refreshed(factor, trial.linearization, combinations, parameters, trial.x)
            if near.step_sigmas < tolerance(trial):
                return near
        return reduce(trial)

    def tolerance(at: _Point) -> float:
        return settings.step_tolerance * max(1.0, float(np.sqrt(at.chi2 / max(1, n_used))))

    here = point(x, at_start)
    first = reduce(here)
    if first is None:
        check_finite(at_start, mask, parameters)
        raise InputError("the whitened partials overflow at the start; check the sigmas")
    factor = first
    iterations: list[Iteration] = []
    # With every parameter fixed there is nothing to do but to report the residuals.
    status = FitStatus.MAX_ITERATIONS if parameters.free.any() else FitStatus.CONVERGED
    damping = 0.0
    while len(iterations) < settings.max_iterations and parameters.free.any():
        length = factor.step_sigmas
        if iterations and length < _NEGLIGIBLE * tolerance(here):
            status = FitStatus.CONVERGED
            break
        small = length < tolerance(here)
        lowest = float(factor.singular_values[factor.determined].min(initial=1.0))
        after: Factor | None = None
        while damping <= _MAX_DAMPING * factor.singular_values[0]:
            trial = stepped(here, factor, damping)
            # A step this small changes the sum by less than its rounding may: it is taken as it is, and the partials
            # change by no more than the step in parts of the distances, which are thousands of kilometres.
            if small:
                after = factor
                break
            if np.isfinite(trial.chi2):
                after = next_factor(here, trial, factor)
                # Ranges are rounded to 1e-7 m, and the sum with them: it cannot tell a short step's gain.
                short = damping == 0.0 and length <= _SHORT
                if after is not None and trial.chi2 <= here.chi2 + short * _ROUNDED * np.sqrt(here.chi2):
                    break
                # A long step in a weak direction leaves the curved valley of low sums; a second one leads back.
                if after is not None:
                    trial = stepped(trial, after, 0.0)
                    after = reduce(trial) if trial.chi2 <= here.chi2 else None
                    if after is not None:
                        break
            damping = 3.0 * damping if damping > 0.0 else lowest
        if after is None:
            # Nothing lowers the sum: either it is at its floor to rounding (ranges are rounded to 1e-7 m),
            # or the partials point the wrong way.
            at_floor = length <= max(_SHORT, 1e-3 * np.sqrt(here.chi2))
            status = FitStatus.CONVERGED if at_floor else FitStatus.DIVERGED
            break
        iterations.append(Iteration(here.chi2, trial.chi2, length, damping))
        damping = 0.0 if damping <= lowest else damping / 3.0
        here, factor = trial, after
        if small:
            status = FitStatus.CONVERGED
            break

    if not factor.determined.all() and status is FitStatus.CONVERGED:
        status = FitStatus.UNOBSERVABLE
    n_prior = int((np.isfinite(parameters.prior_sigmas) & parameters.free).sum())
    return FitResult(
        parameters=parameters,
        x=here.x,
        covariance=covariance_of(factor, parameters),
        linearization=here.linearization,
        noise=noise,
        used=mask,
        chi2=here.chi2,
        dof=n_used + n_prior - int(factor.determined.sum()),
        status=status,
        iterations=tuple(iterations),
        factor=factor,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """The model at one set of values."""

    x: NDArray[np.float64]
    linearization: Linearization
    chi2: float


def sum_of_squares(
    residual_m: NDArray[np.float64],
    combinations: Combinations,
    parameters: ParameterSet,
    x: NDArray[np.float64],
) -> float:
    """Weighted sum of squares with the a-priori rows; infinite where the model gives no finite number."""
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    total = float((prior * prior).sum())
    for part in combinations.whitened(lambda rows: residual_m[rows, None]):
        total += float(np.square(part, out=part).sum())
    return total if np.isfinite(total) else np.inf


def covariance_of(
    factor: Factor, parameters: ParameterSet, unit: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Covariance over all parameters, shape (p, p).

    Parameters
    ----------
    factor : Factor
        Of the free ones.
    parameters : ParameterSet
    unit : ndarray, shape (r, r), optional
        Covariance along the determined directions in units of their sigmas, where it is not the identity.
    """
    root = factor.root_covariance()
    covariance_free = root @ root.T if unit is None else root @ unit @ root.T
    # A parameter takes part in an undetermined direction if its share, in units of its scale, is more than
    # rounding.
    directions = factor.undetermined_directions() / parameters.scales[parameters.free]
    if len(directions):
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        lost = (np.abs(directions) > 1e-6).any(axis=0)
        covariance_free[lost, :] = 0.0
        covariance_free[:, lost] = 0.0
        covariance_free[lost, lost] = np.inf
    p = len(parameters)
    covariance = np.zeros((p, p))
    covariance[np.ix_(parameters.free, parameters.free)] = covariance_free
    return covariance
