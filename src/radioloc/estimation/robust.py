"""Start of a fit that gross errors in a minority of the observations move by little.

Huber's loss (1964) is convex: far from the solution a linear model has no false minimum, and no scale has to be
guessed. Gross errors on one side can still move it far where geometry is weak; random subsets then show the estimate
that most observations agree with.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    root_of_rows,
    smooth_partials,
    times,
)
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, RowsOf
from radioloc.parameters.parameter import ParameterSet
from radioloc.vectors import Floats

_MAX_LINEARIZATIONS = 15
_MAX_REWEIGHTINGS = 100
_MAX_ROWS = 5000  # a sample of about so many is off by a fiftieth of one sigma, where five decide
_MAX_REPEATED_ROWS = 1000  # where one problem is fitted again and again
_DRAWS_FRACTION = 0.04  # smallest number of draws for each parameter over that of rows
_SEED = 20201201
_MAX_HUBER_SPREAD_SIGMAS = 3.0  # above which random subsets are tried
_MAX_SPREAD_RATIO = 0.1
"""Largest ratio of the spread about their estimate to that about Huber's: a few observations can always be left out so
that the rest agree somewhat better, of weakly determined positions several times better."""
_CONSENSUS_PASSES = 3  # linearizations: where geometry is weak, gross errors carry far away
# The fitted values have settled when none moves by more than this many (robust) sigmas.
_SETTLED_SIGMAS = 0.01
_SETTLED_LINEAR_SIGMAS = 0.1  # of linear problems, which all start from the same linearization
_SUBSET_COUNT = 500
_AGREEMENT_SPREADS = 5.0  # an observation agrees with an estimate within so many spreads
_RIDGE = 1e-9


def robust_start(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: Floats,
    usable: NDArray[np.bool_],
    linearization: Linearization,
    start: Floats | None = None,
) -> tuple[Floats, Linearization]:
    """Robust estimate with its linearization, from `start` or the a-priori values.

    Minimizes Huber's loss with its corner at one stated sigma by iteratively reweighted least squares; where residuals
    spread beyond their sigmas, :func:`_consensus` is tried. `whole` is the linearization at the start.

    Without it the 24 studies of `tests/unit/estimation/test_editing.py` with 30 % of the ranges 20 to 60 m too long end
    up to 900 km off; with Huber's loss alone 12 of them do.
    """
    x = parameters.prior_values if start is None else start
    free, q = parameters.free, int(parameters.free.sum())
    check_residuals(linearization, usable)
    prepared = linearization.problem if isinstance(linearization, OrthonormalLinearization) else None
    rows = sample(linearization, sigma_m, usable, parameters) if prepared is None else prepared.start_rows
    sigma_m = sigma_m[rows]
    root = np.zeros((q, 0)) if prepared is None else prepared.to_free
    tolerance = _SETTLED_SIGMAS if prepared is None else _SETTLED_LINEAR_SIGMAS

    def at_step(x: Floats, step: Floats) -> tuple[Floats, Linearization, Floats]:
        trial_x = x.copy()
        trial_x[free] += step
        trial_linearization = evaluate_step(residual_function, trial_x, linearization)
        return trial_x, trial_linearization, trial_linearization.residual_m[rows] / sigma_m

    normalized = linearization.residual_m[rows] / sigma_m
    for _ in range(_MAX_LINEARIZATIONS if prepared is None else 1):  # a linear problem needs one step
        partials = linearization.partials(rows)
        if prepared is None:
            dense = DenseLinearization(linearization.residual_m[rows], partials)
            factor = factorize(
                dense, ObservationCovariance.from_sigma(sigma_m, len(sigma_m)).whitener(), parameters, x
            )
            if factor is None:
                break
            root = factor.root_covariance()
        basis = times(partials[:, free], root) / sigma_m[:, None]
        y = _huber_estimate(basis, normalized, *_prior_terms(parameters, x, root), tolerance)
        if np.abs(basis @ y).max(initial=0.0) < tolerance * max(1.0, robust_scale(normalized, q)):
            break
        loss = _huber_loss(normalized, parameters, x)
        for step_fraction in 0.5 ** np.arange(10.0):
            trial, trial_linearization, trial_left = at_step(x, step_fraction * (root @ y))
            if _huber_loss(trial_left, parameters, trial) < loss:
                break
        else:
            break
        x, linearization, normalized = trial, trial_linearization, trial_left
    spread = robust_scale(normalized, q)
    trial, trial_linearization, trial_left = x, linearization, normalized
    # Subsets as small as the number of estimated parameters are free of gross errors often enough; considered errors
    # stay as they are.
    is_estimated = ~parameters.considered[free]
    if not is_estimated.all():
        root_of_estimated = root_of_rows(root[is_estimated])
        root = np.zeros((q, root_of_estimated.shape[1]))
        root[is_estimated] = root_of_estimated
    for _ in range(_CONSENSUS_PASSES if spread > _MAX_HUBER_SPREAD_SIGMAS else 0):
        basis = times(trial_linearization.partials(rows)[:, free], root) / sigma_m[:, None]
        y = _consensus(basis, trial_left, *_prior_terms(parameters, trial, root))
        trial, trial_linearization, trial_left = at_step(trial, root @ y)
        if robust_scale(trial_left, q) < _MAX_SPREAD_RATIO * spread:
            return trial, trial_linearization
    return x, linearization


def linear_problem(
    partials: Floats,
    parameters: ParameterSet,
    x: Floats,
    noise: ObservationCovariance,
    usable: NDArray[np.bool_],
) -> LinearProblem | None:
    """Linear problem with partials (n, p) at x; none where the usable observations do not determine every parameter."""
    dense = DenseLinearization(np.zeros(len(partials)), partials)
    factor = factorize(
        dense, ObservationCovariance.from_sigma(noise.sigma_m, len(noise)).whitener(usable), parameters, x
    )
    if factor is None or not parameters.free.any() or not factor.determined.all():
        return None
    to_free = factor.root_covariance()
    basis = times(partials[:, parameters.free], to_free)
    from_free = factor.singular_values[:, None] * factor.vectors.T * factor.column_norms
    start_rows = sample(dense, noise.sigma_m, usable, parameters, _MAX_REPEATED_ROWS)
    return LinearProblem(partials, x, basis, from_free, to_free, start_rows)


def sample(
    linearization: Linearization,
    sigma_m: Floats,
    usable: NDArray[np.bool_],
    parameters: ParameterSet,
    max_rows: int = _MAX_ROWS,
) -> Rows:
    """Sample of the usable rows, ascending, of at most about a given number."""
    # Each free parameter has the same number of draws. Half the chance of an observation is the same for all that the
    # parameter acts on, so a bias of one rare station has its observations in the sample; half is in proportion to
    # (partial / sigma)^2 (Drineas, Mahoney and Muthukrishnan 2006). Draws are spread evenly over the order of the rows.
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
    draws = max(max_rows // max(len(free), 1), round(_DRAWS_FRACTION * max_rows))
    random = np.random.Generator(np.random.PCG64(_SEED))
    places = (np.arange(draws) + random.random((len(free), draws))) / draws
    drawn = np.zeros(len(usable), dtype=bool)
    cumulative = np.zeros(len(free))
    for rows in parts:
        row_squares = squares(rows)
        chances = (
            np.cumsum(0.5 * (row_squares > 0.0) / counts + 0.5 * row_squares / sums, axis=0) + cumulative
        )
        for k, place in enumerate(places):
            row_places = place[(place >= cumulative[k]) & (place < chances[-1, k])]
            drawn[rows[np.searchsorted(chances[:, k], row_places, side="right")]] = True
        cumulative = chances[-1]
    return np.flatnonzero(drawn)


def _huber_estimate(
    basis: Floats, normalized: Floats, prior_normal: Floats, prior_side: Floats, tolerance: float
) -> Floats:
    """Minimum of Huber's loss of normalized residuals (n,) in orthonormal coordinates, shape (q,)."""
    y: Floats = np.zeros(basis.shape[1])
    remaining = normalized
    for _ in range(_MAX_REWEIGHTINGS):
        weighted = basis * _huber_weight(remaining)[:, None]
        side = gram(weighted, normalized[:, None])[:, 0]
        previous = y
        y = np.linalg.solve(prior_normal + gram(weighted, basis), prior_side + side).astype(np.float64)
        change = np.abs(np.einsum("nq,q->n", basis, y - previous)).max(initial=0.0)
        remaining = normalized - np.einsum("nq,q->n", basis, y)
        if change < tolerance or change < tolerance * robust_scale(remaining, len(y)):
            break
    return y


def _prior_terms(parameters: ParameterSet, x: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Return the normal matrix and right-hand side of the a-priori values, in the coordinates of `root`."""
    sigmas = parameters.prior_sigmas[parameters.free]
    rows = root / sigmas[:, None]
    return rows.T @ rows, rows.T @ ((parameters.prior_values - x)[parameters.free] / sigmas)


def _huber_loss(normalized: Floats, parameters: ParameterSet, x: Floats) -> float:
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    loss = float(huber(normalized).sum() + 0.5 * prior @ prior)
    return loss if np.isfinite(loss) else np.inf


def huber(normalized: Floats) -> Floats:
    """Huber's loss (1964) of each residual, quadratic up to one sigma."""
    size = np.abs(normalized)
    return np.where(size < 1.0, 0.5 * size**2, size - 0.5)


def _huber_weight(normalized: Floats) -> Floats:
    """Weight of the square of each residual whose gradient is that of Huber's loss."""
    return 1.0 / np.maximum(1.0, np.abs(normalized))


def _consensus(basis: Floats, normalized: Floats, prior_normal: Floats, prior_side: Floats) -> Floats:
    """Estimate (q,) from a subset of the normalized residuals (n,) that most of them agree with; zeros where few.

    Of the estimates from random subsets of q residuals, the one with the least sum of truncated squares, with those of
    the a-priori values (Torr and Zisserman 2000).
    """
    random = np.random.Generator(np.random.PCG64(_SEED))
    rows = random.permutation(len(normalized))[:_MAX_REPEATED_ROWS]
    n, q = len(rows), basis.shape[1]
    if n < 3 * q or not q:
        return np.zeros(q)
    basis, normalized = basis[rows], normalized[rows]
    subsets = np.argpartition(random.random((_SUBSET_COUNT, n)), q, axis=1)[:, :q]
    columns = np.swapaxes(basis[subsets], 1, 2)
    # A subset need not determine every parameter.
    normal = columns @ basis[subsets] + prior_normal + _RIDGE * np.eye(q)
    estimates = np.linalg.solve(normal, columns @ normalized[subsets][..., None] + prior_side[:, None])[
        ..., 0
    ]
    size = np.abs(normalized - estimates @ basis.T)
    limit = _AGREEMENT_SPREADS * max(1.0, min(robust_scale(residuals, q) for residuals in size))
    prior = np.einsum("kp,pq,kq->k", estimates, prior_normal, estimates) - 2.0 * estimates @ prior_side
    loss = np.square(np.minimum(size, limit)).sum(axis=1) + prior
    return np.asarray(estimates[np.argmin(loss)])
