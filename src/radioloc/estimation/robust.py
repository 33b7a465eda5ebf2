"""A start that gross errors cannot carry away: Huber's loss, and a majority that agrees whatever the others say."""

from __future__ import annotations

import math
from collections.abc import Callable

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
    times,
)
from radioloc.estimation.observation_noise import ObservationNoise, Rows
from radioloc.estimation.statistics import robust_scale
from radioloc.labels import Labels
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.parameters.parameter import ParameterSet

_Floats = NDArray[np.float64]
_Choice = Callable[[_Floats], NDArray[np.bool_]]

_MAX_LINEARIZATIONS = 15
_MAX_REWEIGHTINGS = 100
_MOST_ROWS = 20000
"""Of more observations a sample of about so many makes the start: it is then off by a hundredth of one observation's
sigma, where five decide."""
_REPEATED_ROWS = 1000
"""The same where one problem is fitted again and again: the start only has to tell outliers from the rest."""
_FEWEST_DRAWS = 200  # for each parameter
_SEED = 20201201
_CLEAN = 3.0
"""Spread, in stated sigmas, above which a majority is looked for that agrees much better."""
_MUCH_LESS = 0.1
"""Part of the spread of all that it is then to have: a few observations can always be left out so that the rest agree
somewhat better, of weakly determined positions several times better."""
_MOST_TRIMMED = 3
"""Times that least trimmed squares are linearized anew: where geometry is weak, gross errors carry far away."""
_SETTLED = 0.1  # the fitted values have settled when none moves by more than this many (robust) sigmas
_KEPT = 0.6
"""Part of the observations that least trimmed squares keep: up to 40 % may be wrong."""
_SUBSETS, _ENDS = 500, 5
"""Draws of least trimmed squares, and of each way how many are followed to their end."""
_FEW, OF_EACH = 3, 20
"""Observations of each group that are kept beside the best of all, and those that are looked at in any case."""
_AGREES = 5.0
"""Spreads within which an observation agrees with an estimate."""
_TRIMMED_ROWS = 1000
"""Of more observations so many are looked at."""
_RIDGE = 1e-9


def robust_start(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: _Floats,
    usable: NDArray[np.bool_],
    whole: Linearization,
    groups: Labels | None = None,
    start: _Floats | None = None,
) -> tuple[_Floats, Linearization]:
    """Estimate that gross errors in a minority of the observations move by little, from `start` on.

    Minimizes Huber's loss (1964) with its corner at one stated sigma, so that far from the solution it is
    the sum of absolute residuals, by iteratively reweighted least squares on each linearization. The loss
    is convex: far from the solution there is no false minimum of a linear model to fall into, and no scale
    has to be guessed. Where its residuals spread beyond their sigmas, gross errors on one side may have carried
    it away, in all observations or in one of `groups`: least trimmed squares (Rousseeuw 1984) then look for a majority
    that agrees much better. Of more than :data:`_MOST_ROWS` observations a sample makes the start (:func:`sample`).
    `whole` is the linearization at the start, or without one at the a-priori values; returned is that at the estimate.
    """
    x = parameters.prior_values if start is None else start
    free, q = parameters.free, int(parameters.free.sum())
    check_residuals(whole, usable)
    prepared = whole.problem if isinstance(whole, OrthonormalLinearization) else None
    rows = sample(whole, sigma_m, usable, parameters) if prepared is None else prepared.start_rows
    group = np.zeros(len(rows), dtype=np.intp) if groups is None else groups.codes[rows].astype(np.intp)
    sigma_m = sigma_m[rows]
    root = np.zeros((q, 0)) if prepared is None else prepared.to_free

    def after(x: _Floats, step: _Floats) -> tuple[_Floats, Linearization, _Floats]:
        moved = x.copy()
        moved[free] += step
        there = evaluate_step(residual_function, moved, whole)
        return moved, there, there.residual_m[rows] / sigma_m

    left = whole.residual_m[rows] / sigma_m
    for _ in range(_MAX_LINEARIZATIONS if prepared is None else 1):  # a linear problem needs one step
        partials = whole.partials(rows)
        if prepared is None:
            dense = DenseLinearization(whole.residual_m[rows], partials)
            factor = factorize(dense, ObservationNoise(sigma_m).among(), parameters, x)
            if factor is None:
                break
            root = factor.root_covariance()
        basis = times(partials[:, free], root) / sigma_m[:, None]
        y = _huber_estimate(basis, left, *_prior_terms(parameters, x, root))
        if np.abs(basis @ y).max(initial=0.0) < _SETTLED * max(1.0, robust_scale(left, q)):
            break
        loss = _huber_loss(left, parameters, x)
        for part in 0.5 ** np.arange(10.0):
            trial, there, trial_left = after(x, part * (root @ y))
            if _huber_loss(trial_left, parameters, trial) < loss:
                break
        else:
            break
        x, whole, left = trial, there, trial_left
    spreads = _spreads(left, group, q)
    trial, there, trial_left = x, whole, left
    for _ in range(_MOST_TRIMMED if max(spreads) > _CLEAN else 0):
        basis = times(there.partials(rows)[:, free], root) / sigma_m[:, None]
        found = least_trimmed(basis, trial_left, *_prior_terms(parameters, trial, root), group)
        if found is None:
            break
        trial, there, trial_left = after(trial, root @ found)
        trimmed = _spreads(trial_left, group, q)
        if any(new < _MUCH_LESS * old and old > _CLEAN for new, old in zip(trimmed, spreads, strict=True)):
            return trial, there
    return x, whole


def _spreads(normalized: _Floats, group: Rows, n_parameters: int) -> tuple[float, float]:
    """Spread of all residuals, and that of the group which has the largest of those with some observations."""
    groups = (normalized[group == k] for k in np.flatnonzero(np.bincount(group) >= OF_EACH))
    return robust_scale(normalized, n_parameters), max((robust_scale(one, 1) for one in groups), default=0.0)


def linear_problem(
    partials: _Floats,
    parameters: ParameterSet,
    x: _Floats,
    noise: ObservationNoise,
    usable: NDArray[np.bool_],
) -> LinearProblem | None:
    """Linear problem with partials (n, p) at x; none where the usable observations do not determine every parameter."""
    dense = DenseLinearization(np.zeros(len(partials)), partials)
    factor = factorize(dense, ObservationNoise(noise.sigma_m).among(usable), parameters, x)
    if factor is None or not parameters.free.any() or not factor.determined.all():
        return None
    to_free = factor.root_covariance()
    basis = times(partials[:, parameters.free], to_free)
    from_free = factor.singular_values[:, None] * factor.vectors.T * factor.column_norms
    start_rows = sample(dense, noise.sigma_m, usable, parameters, _REPEATED_ROWS)
    return LinearProblem(partials, x, basis, from_free, to_free, start_rows)


def sample(
    whole: Linearization,
    sigma_m: _Floats,
    usable: NDArray[np.bool_],
    parameters: ParameterSet,
    most: int = _MOST_ROWS,
) -> Rows:
    """Rows that stand for all usable ones, in order, about as many as `most` or fewer.

    Each free parameter has the same number of draws. Half the chance of an observation is the same for all that the
    parameter acts on, so a bias of one rare station has its observations in the sample; half is in proportion to
    (partial / sigma)^2, so those that say most are in it (Drineas, Mahoney and Muthukrishnan 2006). The draws are
    spread evenly over the order of the rows, each at random in its stretch, from a fixed seed.
    """
    free = np.flatnonzero(parameters.free)
    candidates = np.flatnonzero(usable)
    if len(candidates) <= most:
        return candidates
    parts = [candidates[k : k + ROWS_AT_ONCE] for k in range(0, len(candidates), ROWS_AT_ONCE)]

    def squares(rows: Rows) -> _Floats:
        return np.asarray(np.square(whole.partials(rows)[:, free] / sigma_m[rows, None]))

    counts, sums = np.zeros(len(free)), np.zeros(len(free))
    for rows in parts:
        found = squares(rows)
        counts += (found > 0.0).sum(axis=0)
        sums += found.sum(axis=0)
    counts, sums = np.maximum(counts, 1.0), np.where(sums > 0.0, sums, 1.0)
    draws = max(most // max(len(free), 1), _FEWEST_DRAWS)
    random = np.random.Generator(np.random.PCG64(_SEED))
    places = (np.arange(draws) + random.random((len(free), draws))) / draws
    drawn = np.zeros(len(usable), dtype=bool)
    before = np.zeros(len(free))
    for rows in parts:
        found = squares(rows)
        chances = np.cumsum(0.5 * (found > 0.0) / counts + 0.5 * found / sums, axis=0) + before
        for k, place in enumerate(places):
            mine = place[(place >= before[k]) & (place < chances[-1, k])]
            drawn[rows[np.searchsorted(chances[:, k], mine, side="right")]] = True
        before = chances[-1]
    return np.flatnonzero(drawn)


def _huber_estimate(
    basis: _Floats, normalized: _Floats, prior_normal: _Floats, prior_side: _Floats
) -> _Floats:
    """Where Huber's loss of residuals (n,) is least, in coordinates in which the problem is orthonormal, shape (q,)."""
    y: _Floats = np.zeros(basis.shape[1])
    remaining = normalized
    for _ in range(_MAX_REWEIGHTINGS):
        weighted = basis * _huber_weight(remaining)[:, None]
        side = gram(weighted, normalized[:, None])[:, 0]
        before = y
        y = np.linalg.solve(prior_normal + gram(weighted, basis), prior_side + side).astype(np.float64)
        moved = np.abs(np.einsum("nq,q->n", basis, y - before)).max(initial=0.0)
        remaining = normalized - np.einsum("nq,q->n", basis, y)
        if moved < _SETTLED or moved < _SETTLED * robust_scale(remaining, len(y)):
            break
    return y


def _prior_terms(parameters: ParameterSet, x: _Floats, root: _Floats) -> tuple[_Floats, _Floats]:
    """Normal matrix and right-hand side of the a-priori values, in the coordinates of `root`."""
    sigmas = parameters.prior_sigmas[parameters.free]
    rows = root / sigmas[:, None]
    return rows.T @ rows, rows.T @ ((parameters.prior_values - x)[parameters.free] / sigmas)


def _huber_loss(normalized: _Floats, parameters: ParameterSet, x: _Floats) -> float:
    prior = ((x - parameters.prior_values) / parameters.prior_sigmas)[parameters.free]
    loss = float(huber(normalized).sum() + 0.5 * prior @ prior)
    return loss if np.isfinite(loss) else np.inf


def huber(normalized: _Floats) -> _Floats:
    """Huber's loss (1964) of each residual, quadratic up to one sigma."""
    size = np.abs(normalized)
    return np.where(size < 1.0, 0.5 * size**2, size - 0.5)


def _huber_weight(normalized: _Floats) -> _Floats:
    """Weight of the square of each residual whose gradient is that of Huber's loss."""
    return 1.0 / np.maximum(1.0, np.abs(normalized))


def least_trimmed(
    basis: _Floats, normalized: _Floats, prior_normal: _Floats, prior_side: _Floats, group: Rows
) -> _Floats | None:
    """Least trimmed squares of normalized residuals (n,) with partials (n, q), (q,); none where these are few.

    From subsets that are just large enough, drawn at random, concentration steps lead down: the next estimate is from
    the observations that fit the last one best (Rousseeuw and Van Driessen 2006). These are the best of all, of which
    one group may have none; the best of each group, of which one may be all wrong; or the best of all and a few of each
    group. Of what these lead to that is taken which the most observations agree with.
    """
    random = np.random.Generator(np.random.PCG64(_SEED))
    rows = _some_of_each(group, random)
    n, q = len(rows), basis.shape[1]
    if n < 3 * q or not q:
        return None
    basis, normalized = basis[rows], normalized[rows]
    _, group, in_group = np.unique(group[rows], return_inverse=True, return_counts=True)
    groups = [slice(end - count, end) for end, count in zip(np.cumsum(in_group), in_group, strict=True)]
    products = (basis[:, :, None] * basis[:, None, :]).reshape(n, q * q)

    def left(y: _Floats) -> _Floats:
        return np.asarray(np.abs(normalized - y @ basis.T))

    def of_all(size: _Floats) -> NDArray[np.bool_]:
        return _smallest(size, int(_KEPT * n))

    def of_each(size: _Floats) -> NDArray[np.bool_]:
        parts = [_smallest(size[:, mine], math.ceil(_KEPT * (mine.stop - mine.start))) for mine in groups]
        return np.concatenate(parts, axis=1)

    def of_all_and_each(size: _Floats) -> NDArray[np.bool_]:
        return of_all(size) | np.concatenate([_smallest(size[:, mine], _FEW) for mine in groups], axis=1)

    def fitted(chosen: NDArray[np.bool_]) -> _Floats:
        # As few observations as parameters need not determine all of them
        weights = chosen.astype(np.float64)
        normal = (weights @ products).reshape(-1, q, q) + prior_normal + _RIDGE * np.eye(q)
        side = weights @ (basis * normalized[:, None]) + prior_side
        return np.linalg.solve(normal, side[..., None])[..., 0].astype(np.float64)

    def concentrated(y: _Floats, choose: _Choice, steps: int) -> tuple[_Floats, _Floats]:
        """Sums of squares of what is chosen (k,), and where the steps lead (k, q), from several estimates (k, q)."""
        for _ in range(steps):
            y = fitted(choose(left(y)))
        size = left(y)
        return np.asarray(np.square(size).sum(axis=1, where=choose(size))), y

    # Half of the draws are of any observations, half of any groups
    chance = 0.5 / n + 0.5 / (len(in_group) * in_group[group])
    subsets = _smallest(random.exponential(size=(_SUBSETS, n)) / chance, q)
    ends = []
    ways: tuple[_Choice, ...] = (of_all,) if len(in_group) == 1 else (of_all, of_each, of_all_and_each)
    for k, choose in enumerate(ways):
        sums, tried = concentrated(fitted(subsets[k :: len(ways)]), choose, 2)
        sums, tried = concentrated(tried[np.argsort(sums, kind="stable")[:_ENDS]], choose, 20)
        ends.append(tried[np.argmin(sums)])
    spread = max(1.0, min(robust_scale(left(y), q) for y in ends))
    best = max(ends, key=lambda y: (int((left(y) < _AGREES * spread).sum()), -robust_scale(left(y), q)))
    return np.asarray(best)


def _smallest(size: _Floats, count: int) -> NDArray[np.bool_]:
    """Which are the `count` smallest along the last axis."""
    chosen = np.zeros(size.shape, dtype=bool)
    places = np.argpartition(size, count, axis=-1) if count < size.shape[-1] else np.argsort(size, axis=-1)
    np.put_along_axis(chosen, places[..., :count], True, axis=-1)
    return chosen


def _some_of_each(group: Rows, random: np.random.Generator) -> Rows:
    """About as many rows as one problem takes at a time, some of each group among them, in order of groups."""
    order = random.permutation(len(group))
    order = order[np.argsort(group[order], kind="stable")]
    count = np.bincount(group)
    rank = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count)
    share = np.maximum(OF_EACH, count * _TRIMMED_ROWS // len(group))
    return order[rank < np.repeat(share, count)]
