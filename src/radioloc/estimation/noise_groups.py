"""Which station or link is noisier or quieter than the others of its type, and so has a variance component of its own.

The squares of the residuals over their sigmas are compared between each station (each link) and the rest of its type.
Two tests must agree: Fisher's, of the ratio of two variances, which is exact for few normal residuals; and Welch's
(1947), of the logarithms of their means, each against the scatter of the means of tenths of the time, which holds as
well where residuals are correlated in time, shared by the baselines of an epoch, or not normal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile

_Floats = NDArray[np.float64]

FEWEST = 10
"""Observations that tell a variance of their own, to a quarter of the standard deviation."""
_BATCHES = 10
"""Parts of the time whose means are compared: of two days each is longer than errors of a link stay alike."""


def by_link(order: SeriesOrder, gap_s: float = np.inf) -> Labels:
    """Each link of each type as a group of its own, or each of its passes, which begin after a silence of `gap_s`.

    Those with fewer than :data:`FEWEST` observations are the group of their type.
    """
    code, time_s = order.code[order.order], order.time_s[order.order]
    first = np.diff(code, prepend=-1) != 0
    run = np.cumsum(first | (np.diff(time_s, prepend=-np.inf) > gap_s)) - 1
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    texts, number = [], 0
    for start, count in zip(starts.tolist(), np.bincount(run).tolist(), strict=True):
        number = 1 if first[start] else number + 1
        kind, path = order.type_of(code[start]), order.path_of(code[start])
        name = f"{kind} of {path}" + (f" {number}" if np.isfinite(gap_s) else "")
        texts.append(name if count >= FEWEST else kind)
    group = np.empty(len(code), dtype=np.intp)
    group[order.order] = run
    return Labels.coded(texts, group)


def split(fit: FitResult, order: SeriesOrder, groups: Labels, added_m: Mapping[str, float]) -> Labels | None:
    """Groups less the station or link that differs most clearly from the rest of its group, which becomes one; or none.

    Each group is of whole series of one type and has an additive component, m. Without one it is divided only where the
    noisier part is noisier than stated. The chance allows for all that are compared.
    """
    squares, counts = _of_batches(fit, order)
    candidates = list(_candidates(order, groups, np.flatnonzero(counts.any(axis=1))))
    if not candidates:
        return None
    limit = 0.5 * (1.0 - SCALING_PROBABILITY) / len(candidates)  # noisier or quieter
    sides = np.array([one[1] for one in candidates], dtype=np.float64)
    mean = (sides @ squares).sum(axis=2) / (sides @ counts).sum(axis=2)
    sides = np.take_along_axis(sides, np.argsort(-mean, axis=1, kind="stable")[:, :, None], axis=1)
    sums, numbers = sides @ squares, sides @ counts
    chances = chances_of_noisier(sums, numbers, numbers.sum(axis=2))
    for k in np.argsort(chances, kind="stable").tolist():
        if chances[k] > limit:
            return None
        name, (mine, _) = candidates[k]
        taken = mine[order.code]
        # What parameters take out of residuals is looked at last, as it takes the partials of all
        dof = np.array([_dof(fit, side[order.code] > 0.0) for side in sides[k]])
        stated = not added_m[groups.texts[groups.codes[taken.argmax()]]] > 0.0
        enough = stated and sums[k, 0].sum() <= chi2_quantile(SCALING_PROBABILITY, round(dof[0]))
        if chances_of_noisier(sums[k], numbers[k], dof) < limit and not enough:
            return Labels.coded((*groups.texts, name), np.where(taken, len(groups.texts), groups.codes))
    return None


def _candidates(
    order: SeriesOrder, groups: Labels, codes: NDArray[np.intp]
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Name of each station that receives and each link; which series are its, and which the others of its group.

    They are rows of the second, shape (2, series).
    """
    count = order.code.max(initial=0) + 1
    group_of = np.full(count, -1)
    group_of[order.code] = groups.codes
    found: dict[tuple[int, tuple[int, ...]], str] = {}
    for group in np.unique(group_of[codes]).tolist():
        whole = codes[group_of[codes] == group].tolist()
        members: dict[str, list[int]] = {}
        for code in whole:
            for station, sign in order.stations[code].items():
                if sign:
                    members.setdefault(station, []).append(code)
        members |= {order.path_of(code): [code] for code in whole}
        for name, mine in members.items():
            if len(mine) < len(whole):
                found.setdefault((group, tuple(mine)), f"{order.type_of(mine[0])} of {name}")
    present = np.zeros(count, dtype=bool)
    present[codes] = True
    for (group, chosen), name in found.items():
        inside = np.zeros(count, dtype=bool)
        inside[list(chosen)] = True
        yield name, np.stack([inside, present & (group_of == group) & ~inside])


def _of_batches(fit: FitResult, order: SeriesOrder) -> tuple[_Floats, _Floats]:
    """Sums of squares over the sigmas, and numbers of used observations, by series and tenth of it in time."""
    code = order.code[order.order]
    count = np.bincount(code)
    rank = np.arange(len(code)) - (np.cumsum(count) - count)[code]
    place = code * _BATCHES + rank * _BATCHES // count[code]
    used = fit.used[order.order]
    square = np.where(used, fit.residual_m[order.order] / fit.sigma_m[order.order], 0.0) ** 2
    length = len(count) * _BATCHES
    squares, counts = (np.bincount(place, of, length).astype(np.float64) for of in (square, used))
    return squares.reshape(-1, _BATCHES), counts.reshape(-1, _BATCHES)


def chances_of_noisier(sums: _Floats, numbers: _Floats, dof: _Floats) -> _Floats:
    """Larger of both chances that the first side of each pair is as much noisier than the second, one where it is not.

    Sums and numbers of the batches have shape (..., 2, batches), degrees of freedom (..., 2).
    """
    from scipy.special import fdtrc, stdtr

    total, batches = sums.sum(axis=-1), (numbers > 0.0).sum(axis=-1)
    tell = (dof >= 1.0).all(axis=-1) & (batches >= 2).all(axis=-1) & (total > 0.0).all(axis=-1)
    sums, numbers, dof, total = (
        np.where(tell.reshape(tell.shape + (1,) * (one.ndim - tell.ndim)), one, 1.0)
        for one in (sums, numbers, dof, total)
    )
    freedom = np.maximum(batches - 1.0, 1.0)
    off = sums - (total / numbers.sum(axis=-1))[..., None] * numbers
    variances = (1.0 + 1.0 / freedom) * np.square(off / total[..., None]).sum(axis=-1)
    variances = np.maximum(variances, 1e-99)  # residuals that are nothing but rounding may be exactly alike
    variance = variances.sum(axis=-1)
    means = total / dof
    ratio = means[..., 0] / means[..., 1]
    of_both = variance**2 / (variances**2 / freedom).sum(axis=-1)
    of_scatter = stdtr(of_both, -np.log(ratio) / np.sqrt(variance))
    chance = np.maximum(of_scatter, fdtrc(dof[..., 0], dof[..., 1], ratio))
    return np.asarray(np.where(tell & (ratio > 1.0), chance, 1.0))


def _dof(fit: FitResult, mine: NDArray[np.bool_]) -> float:
    """Used observations of a group less what the parameters take of them, the trace of the hat matrix over them."""
    used = fit.used & mine
    taken = sum(float(np.square(part).sum()) for part in fit.noise.among(used).whitened(fit.unit_partials()))
    return float(used.sum()) - taken
