"""Least trimmed squares: the estimate that a majority of the observations agrees with, whatever the others say."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.statistics import robust_scale

_Floats = NDArray[np.float64]
_Choice = Callable[[_Floats], NDArray[np.bool_]]

_KEPT = 0.6
"""Part of the observations that least trimmed squares keep: up to 40 % may be wrong."""
_SUBSETS, _ENDS = 500, 5
"""Draws of least trimmed squares, and of each way how many are followed to their end."""
_FEW, OF_EACH = 3, 20
"""Observations of each group that are kept beside the best of all, and those that are looked at in any case."""
_AGREES = 5.0
"""Spreads within which an observation agrees with an estimate."""
_MOST_ROWS = 1000
"""Of more observations so many are looked at."""
_SEED = 20201201
_RIDGE = 1e-9


def least_trimmed(
    basis: _Floats, normalized: _Floats, prior_normal: _Floats, prior_side: _Floats, group: NDArray[np.intp]
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


def _some_of_each(group: NDArray[np.intp], random: np.random.Generator) -> NDArray[np.intp]:
    """About as many rows as one problem takes at a time, some of each group among them, in order of groups."""
    order = random.permutation(len(group))
    order = order[np.argsort(group[order], kind="stable")]
    count = np.bincount(group)
    rank = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count)
    share = np.maximum(OF_EACH, count * _MOST_ROWS // len(group))
    return order[rank < np.repeat(share, count)]
