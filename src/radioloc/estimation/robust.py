"""Robust start of a fit, which gross errors in a minority of the observations change little.

1. Huber's loss (1964) of the normalized residuals u = r/s and of the a-priori values is minimized by iteratively
   reweighted least squares with the weights 1 / max(1, |u|). The loss is convex: a linear model has one minimum.
2. Gross errors of one sign can move this estimate far where geometry is weak. If residuals spread beyond 3 sigmas,
   q residuals are drawn at random many times (q estimated parameters). Of the estimates from these subsets, the one
   with the smallest sum of truncated squares is taken (MSAC, Torr and Zisserman 2000).

Both steps use a sample of the observations, drawn in proportion to the information that they contain (Drineas, Mahoney
and Muthukrishnan 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from radioloc.estimation.linearization import (
    DenseLinearization,
    Linearization,
    LinearProblem,
    OrthonormalLinearization,
    ResidualFunction,
    check_residuals,
    evaluate_step,
    factorize,
    gram,
    matrix_product,
    root_of_rows,
    smooth_partials,
)
from radioloc.estimation.series import SeriesOrder, StatedSeries
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, RowsOf
from radioloc.parameters.parameter import ParameterSet
from radioloc.vectors import Floats, Mask

_MAX_LINEARIZATIONS = 15
_MAX_REWEIGHTINGS = 100
_MAX_STEP_HALVINGS = 10
_MAX_ROWS = 5000  # sample size that changes an estimate of five parameters by a fiftieth of one sigma
_MAX_REPEATED_ROWS = 1000  # of problems that are fitted again and again
MAX_DENSE_PARAMETERS = 400  # of normal equations; of more parameters, most act on few observations
_MIN_DRAWS_FRACTION = 0.04  # number of draws for each parameter over that of rows
_SEED = 20201201
_TOLERANCE_SIGMAS = 0.01  # change of fitted values at convergence, in (robust) sigmas
_LINEAR_TOLERANCE_SIGMAS = 0.1  # of linear problems, which all start from the same linearization
_MAX_HUBER_SPREAD_SIGMAS = 3.0  # spread of residuals above which random subsets are drawn
_MAX_SPREAD_RATIO = 0.1
"""Largest ratio of the spread about the estimate of a subset to that about Huber's. A few observations can always be
rejected so that the others agree somewhat better, of weakly determined positions several times better."""
_CONSENSUS_ROUND_COUNT = 3  # linearizations: where geometry is weak, gross errors move the first estimate far
_SUBSET_COUNT = 500
_TRUNCATION_SPREADS = 5.0  # residual, in spreads, above which squares are truncated
_RIDGE = 1e-9  # a subset need not determine every parameter


def robust_start(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: Floats,
    usable: Mask,
    linearization: Linearization,
    start: Floats | None = None,
) -> tuple[Floats, Linearization]:
    """Return a robust estimate with its linearization; `linearization` is that at `start` or the a-priori values.

    Without it the 24 studies of `tests/unit/estimation/test_editing.py` with 30 % of the ranges 20 to 60 m too long end
    up to 900 km off; with Huber's loss alone 12 of them do.
    """
    check_residuals(linearization, usable)
    problem = linearization.problem if isinstance(linearization, OrthonormalLinearization) else None
    rows = sample(linearization, sigma_m, usable, parameters) if problem is None else problem.start_rows
    x = parameters.prior_values if start is None else start
    search = _RobustSearch(residual_function, parameters, rows, sigma_m[rows], problem)
    estimate, root = search.minimize_huber_loss(search.iterate(x, linearization))
    if robust_scale(estimate.normalized, root.shape[0]) > _MAX_HUBER_SPREAD_SIGMAS:
        estimate = search.find_consensus(estimate, root)
    return estimate.x, estimate.linearization


class _Iterate(NamedTuple):
    """Parameters with the residuals of the sample in stated sigmas."""

    x: Floats
    linearization: Linearization
    normalized: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _RobustSearch:
    """Robust estimates from a sample of the observations."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    rows: Rows
    sigma_m: Floats  # of the rows
    problem: LinearProblem | None

    def iterate(self, x: Floats, linearization: Linearization) -> _Iterate:
        return _Iterate(x, linearization, linearization.residual_m[self.rows] / self.sigma_m)

    def step(self, iterate: _Iterate, change: Floats) -> _Iterate:
        """Evaluate the model after a change of the free parameters."""
        x = iterate.x.copy()
        x[self.parameters.free] += change
        return self.iterate(x, evaluate_step(self.residual_function, x, iterate.linearization))

    def minimize_huber_loss(self, iterate: _Iterate) -> tuple[_Iterate, Any]:
        """Return the minimum of Huber's loss, and the root of its least-squares covariance (q, r).

        The root of many parameters is sparse, with their a-priori sigmas or scales.
        """
        free, q = self.parameters.free, int(self.parameters.free.sum())
        is_linear = self.problem is not None
        root = np.zeros((q, 0)) if self.problem is None else self.problem.to_free
        tolerance = _LINEAR_TOLERANCE_SIGMAS if is_linear else _TOLERANCE_SIGMAS
        for _ in range(1 if is_linear else _MAX_LINEARIZATIONS):
            x, linearization, normalized = iterate
            if self.problem is not None:
                basis = self.problem.basis[self.rows] / self.sigma_m[:, None]
            else:
                partials = linearization.partials(self.rows)
                if q > MAX_DENSE_PARAMETERS:
                    root = _sparse_scales(self.parameters)
                else:
                    dense = DenseLinearization(linearization.residual_m[self.rows], partials)
                    noise = ObservationCovariance.from_sigma(self.sigma_m, len(self.rows))
                    factor = factorize(dense, noise.whitener(), self.parameters, x)
                    if factor is None:
                        break
                    root = factor.root_covariance()
                basis = _coordinates(partials[:, free], root, self.sigma_m)
            y = _huber_estimate(basis, normalized, *_prior_terms(self.parameters, x, root), tolerance)
            if np.abs(basis @ y).max(initial=0.0) < tolerance * max(1.0, robust_scale(normalized, q)):
                break
            trials = (
                self.step(iterate, fraction * (root @ y)) for fraction in 0.5 ** np.arange(_MAX_STEP_HALVINGS)
            )
            loss = self.huber_loss(iterate)
            descent = next((trial for trial in trials if self.huber_loss(trial) < loss), None)
            if descent is None:
                break
            iterate = descent
        return iterate, root

    def huber_loss(self, iterate: _Iterate) -> float:
        """Return Huber's loss of the residuals and of the a-priori values; infinite unless finite."""
        parameters = self.parameters
        prior = ((iterate.x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
        size = np.abs(iterate.normalized)
        losses = np.where(size < 1.0, 0.5 * size**2, size - 0.5)
        loss = float(losses.sum() + 0.5 * prior @ prior)
        return loss if np.isfinite(loss) else np.inf

    def find_consensus(self, start: _Iterate, root: Any) -> _Iterate:
        """Return the estimate of random subsets if the residuals agree much better with it, or else the start.

        Subsets as small as the number of estimated parameters are free of gross errors often enough; considered
        parameters stay as they are.
        """
        free, q = self.parameters.free, root.shape[0]
        if not isinstance(root, np.ndarray):
            root = root.toarray()
        is_estimated = ~self.parameters.considered[free]
        if not is_estimated.all():
            estimated_root = root_of_rows(root[is_estimated])
            root = np.zeros((q, estimated_root.shape[1]))
            root[is_estimated] = estimated_root
        iterate, max_spread = start, _MAX_SPREAD_RATIO * robust_scale(start.normalized, q)
        for _ in range(_CONSENSUS_ROUND_COUNT):
            basis = _coordinates(iterate.linearization.partials(self.rows)[:, free], root, self.sigma_m)
            y = _consensus(basis, iterate.normalized, *_prior_terms(self.parameters, iterate.x, root))
            iterate = self.step(iterate, root @ y)
            if robust_scale(iterate.normalized, q) < max_spread:
                return iterate
        return start


def linear_problem(
    partials: Floats,
    parameters: ParameterSet,
    x: Floats,
    noise: ObservationCovariance,
    usable: Mask,
    order: SeriesOrder | None = None,
) -> LinearProblem | None:
    """Return the linear problem of partials (n, p) at x; None if the observations do not determine all parameters.

    With the order of the observations, fits of their stated noise start from whitened partials.
    """
    dense = DenseLinearization(np.zeros(len(partials)), partials)
    factor = factorize(
        dense, ObservationCovariance.from_sigma(noise.sigma_m, len(noise)).whitener(usable), parameters, x
    )
    if factor is None or not parameters.free.any() or not factor.determined.all():
        return None
    to_free = factor.root_covariance()
    basis = matrix_product(partials[:, parameters.free], to_free)
    from_free = factor.inverse_root()
    start_rows = sample(dense, noise.sigma_m, usable, parameters, _MAX_REPEATED_ROWS)
    stated = None if order is None else StatedSeries.from_basis(order, noise, usable, basis, from_free)
    return LinearProblem(partials, x, basis, from_free, to_free, start_rows, stated)


def sample(
    linearization: Linearization,
    sigma_m: Floats,
    usable: Mask,
    parameters: ParameterSet,
    max_rows: int = _MAX_ROWS,
) -> Rows:
    """Draw a sample of at most about `max_rows` usable rows, ascending.

    Each free parameter has the same number of draws, spread evenly over the order of the rows. Half the probability of
    an observation is the same for all that the parameter acts on, so that the sample contains the observations of a
    bias of a rare station; half is in proportion to (partial / sigma)^2.
    """
    free, smooth = np.flatnonzero(parameters.free & ~parameters.considered), smooth_partials(linearization)
    if smooth is not None:  # the nodes of its cells represent a dense series
        usable = usable & ((smooth.cell < 0) | np.isin(np.arange(len(usable)), smooth.cells.nodes))
    candidates = np.flatnonzero(usable)
    if len(candidates) <= max_rows:
        return candidates
    parts = [candidates[k : k + ROWS_AT_ONCE] for k in range(0, len(candidates), ROWS_AT_ONCE)]

    partials: RowsOf = getattr(linearization, "estimated_partials", linearization.partials)

    def squares(rows: Rows) -> Floats:
        return np.asarray(np.square(partials(rows)[:, free] / sigma_m[rows, None]))

    counts, sums = np.zeros(len(free)), np.zeros(len(free))
    for rows in parts:
        row_squares = squares(rows)
        counts += (row_squares > 0.0).sum(axis=0)
        sums += row_squares.sum(axis=0)
    counts, sums = np.maximum(counts, 1.0), np.where(sums > 0.0, sums, 1.0)
    draws = max(max_rows // max(len(free), 1), round(_MIN_DRAWS_FRACTION * max_rows))
    random = np.random.Generator(np.random.PCG64(_SEED))
    places = (np.arange(draws) + random.random((len(free), draws))) / draws
    drawn = np.zeros(len(usable), dtype=bool)
    cumulative = np.zeros(len(free))
    for rows in parts:
        row_squares = squares(rows)
        probabilities = 0.5 * (row_squares > 0.0) / counts + 0.5 * row_squares / sums
        ends = np.cumsum(probabilities, axis=0) + cumulative
        for k, place in enumerate(places):
            row_places = place[(place >= cumulative[k]) & (place < ends[-1, k])]
            drawn[rows[np.searchsorted(ends[:, k], row_places, side="right")]] = True
        cumulative = ends[-1]
    return np.flatnonzero(drawn)


def _sparse_scales(parameters: ParameterSet) -> Any:
    """Return the a-priori sigmas of the free parameters, or their scales, as a sparse diagonal matrix (q, q)."""
    from scipy.sparse import csr_array, diags_array

    sigmas = np.where(np.isfinite(parameters.prior_sigmas), parameters.prior_sigmas, parameters.scales)
    return csr_array(diags_array(sigmas[parameters.free]))


def _coordinates(partials: Floats, root: Any, sigma_m: Floats) -> Any:
    """Return partials (n, q) over sigmas (n,) with respect to the coordinates of a root, sparse as the root."""
    if isinstance(root, np.ndarray):
        return matrix_product(partials, root) / sigma_m[:, None]
    return type(root)(partials / sigma_m[:, None]) @ root


def _huber_estimate(
    basis: Any, normalized: Floats, prior_normal: Any, prior_side: Floats, tolerance: float
) -> Floats:
    """Minimize Huber's loss of normalized residuals (n,) over coordinates with partials (n, q), return (q,)."""
    y: Floats = np.zeros(basis.shape[1])
    remaining = normalized
    for _ in range(_MAX_REWEIGHTINGS):
        weights = 1.0 / np.maximum(1.0, np.abs(remaining))
        previous = y
        y = _weighted_estimate(basis, weights, normalized, prior_normal, prior_side)
        change = np.abs(_effect(basis, y - previous)).max(initial=0.0)
        remaining = normalized - _effect(basis, y)
        if change < tolerance or change < tolerance * robust_scale(remaining, len(y)):
            break
    return y


def _weighted_estimate(
    basis: Any, weights: Floats, normalized: Floats, prior_normal: Any, prior_side: Floats
) -> Floats:
    """Solve the normal equations of weighted rows, which are sparse if the partials are."""
    if isinstance(basis, np.ndarray):
        weighted = basis * weights[:, None]
        side = gram(weighted, normalized[:, None])[:, 0]
        return np.linalg.solve(prior_normal + gram(weighted, basis), prior_side + side).astype(np.float64)
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    weighted = (basis.T * weights).tocsr()
    normal = prior_normal + weighted @ basis + _RIDGE * eye_array(basis.shape[1])
    return np.asarray(splu(normal.tocsc()).solve(prior_side + weighted @ normalized))


def _effect(basis: Any, y: Floats) -> Floats:
    """Return the effect of coordinates (q,) on the observations, (n,)."""
    # Summed by numpy itself: the result does not depend on the number of threads
    return np.einsum("nq,q->n", basis, y) if isinstance(basis, np.ndarray) else basis @ y


def _prior_terms(parameters: ParameterSet, x: Floats, root: Any) -> tuple[Any, Floats]:
    """Return the normal matrix and right-hand side of the a-priori values, in the coordinates of `root`."""
    sigmas = parameters.prior_sigmas[parameters.free]
    rows = root / sigmas[:, None]
    return rows.T @ rows, rows.T @ ((parameters.prior_values - x)[parameters.free] / sigmas)


def _consensus(basis: Floats, normalized: Floats, prior_normal: Floats, prior_side: Floats) -> Floats:
    """Return the estimate (q,) from random subsets with the smallest sum of truncated squares; zeros for few residuals.

    The sum includes the squares of the a-priori values.
    """
    random = np.random.Generator(np.random.PCG64(_SEED))
    rows = random.permutation(len(normalized))[:_MAX_REPEATED_ROWS]
    n, q = len(rows), basis.shape[1]
    if n < 3 * q or not q:
        return np.zeros(q)
    basis, normalized = basis[rows], normalized[rows]
    subsets = np.argpartition(random.random((_SUBSET_COUNT, n)), q, axis=1)[:, :q]
    columns = np.swapaxes(basis[subsets], 1, 2)
    normal = columns @ basis[subsets] + prior_normal + _RIDGE * np.eye(q)
    estimates = np.linalg.solve(normal, columns @ normalized[subsets][..., None] + prior_side[:, None])[
        ..., 0
    ]
    size = np.abs(normalized - estimates @ basis.T)
    limit = _TRUNCATION_SPREADS * max(1.0, min(robust_scale(residuals, q) for residuals in size))
    prior = np.einsum("kp,pq,kq->k", estimates, prior_normal, estimates) - 2.0 * estimates @ prior_side
    loss = np.square(np.minimum(size, limit)).sum(axis=1) + prior
    return np.asarray(estimates[np.argmin(loss)])
