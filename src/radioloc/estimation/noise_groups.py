"""Which station or link is noisier or quieter than the others of its type, and so has a variance component of its own.

The squares of the residuals over their sigmas are compared between each station (each link) and the rest of its type.
Two tests must agree: Fisher's, of the ratio of two variances, which is exact for few normal residuals; and Welch's
(1947), of the logarithms of their means, each against the scatter of the means of tenths of the time, which holds as
well where residuals are correlated in time, shared by the baselines of an epoch, or not normal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile

_Floats = NDArray[np.float64]

_BATCHES = 10
"""Parts of the time whose means are compared: of two days each is longer than errors of a link stay alike."""


def split(fit: FitResult, order: SeriesOrder, groups: Labels, added_m: Mapping[str, float]) -> Labels | None:
    """Groups less the station or link that differs most clearly from the rest of its group, which becomes one; or none.

    Each group is of whole series of one type and has an additive component, m. Without one it is divided only where the
    noisier part is noisier than stated. The chance allows for all that are compared.
    """
    squares, counts = _of_batches(fit, order)
    candidates = list(_candidates(order, groups, np.flatnonzero(counts.any(axis=1))))
    limit = 0.5 * (1.0 - SCALING_PROBABILITY) / max(len(candidates), 1)  # noisier or quieter
    tried = []
    for name, mine, rest in candidates:
        sides = sorted((mine, rest), key=lambda codes: -squares[codes].sum() / counts[codes].sum())
        tried.append((_chance(squares, counts, sides), name, mine, sides))
    for chance, name, mine, sides in sorted(tried, key=lambda one: one[0]):
        if chance > limit:
            return None
        taken = np.isin(order.code, mine)
        # What parameters take out of residuals is looked at last, as it takes the partials of all
        dof = [_dof(fit, np.isin(order.code, codes)) for codes in sides]
        stated = not added_m[groups.texts[groups.codes[taken.argmax()]]] > 0.0
        enough = stated and squares[sides[0]].sum() <= chi2_quantile(SCALING_PROBABILITY, round(dof[0]))
        if _chance(squares, counts, sides, dof) < limit and not enough:
            return Labels.coded((*groups.texts, name), np.where(taken, len(groups.texts), groups.codes))
    return None


def _candidates(
    order: SeriesOrder, groups: Labels, codes: NDArray[np.intp]
) -> Iterator[tuple[str, list[int], list[int]]]:
    """Name, its series and the other ones of its group, of each station that receives and each link."""
    group_of = np.zeros(order.code.max(initial=0) + 1, dtype=np.intp)
    group_of[order.code] = groups.codes
    found: dict[tuple[int, tuple[int, ...]], str] = {}
    for group in np.unique(group_of[codes]).tolist():
        whole = codes[group_of[codes] == group].tolist()
        members: dict[str, list[int]] = {}
        for code in whole:
            for station, sign in order.stations_of(code).items():
                if sign:
                    members.setdefault(station, []).append(code)
        members |= {order.path_of(code): [code] for code in whole}
        for name, mine in members.items():
            if len(mine) < len(whole):
                found.setdefault((group, tuple(mine)), f"{order.type_of(mine[0])} of {name}")
    for (group, chosen), name in found.items():
        rest = codes[group_of[codes] == group]
        yield name, list(chosen), rest[~np.isin(rest, chosen)].tolist()


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


def _chance(
    squares: _Floats, counts: _Floats, sides: Sequence[list[int]], dof: Sequence[float] | None = None
) -> float:
    """Larger of both chances that the series of the first side are as much noisier than those of the second."""
    from scipy.special import fdtrc, stdtr

    sums = [squares[codes].sum(axis=0) for codes in sides]
    numbers = [counts[codes].sum(axis=0) for codes in sides]
    dof = [float(number.sum()) for number in numbers] if dof is None else dof
    if min(dof) < 1.0:
        return 1.0
    means = [float(one.sum()) / of for one, of in zip(sums, dof, strict=True)]
    if not means[0] > means[1] > 0.0:
        return 1.0
    variances, freedom = [], []
    for one, number in zip(sums, numbers, strict=True):
        batches = int((number > 0).sum())
        if batches < 2:
            return 1.0
        off = one - one.sum() / number.sum() * number
        variances.append(batches / (batches - 1.0) * float(off @ off) / float(one.sum()) ** 2)
        freedom.append(batches - 1.0)
    variance = sum(variances)
    of_both = variance**2 / sum(v**2 / f for v, f in zip(variances, freedom, strict=True))
    of_scatter = float(stdtr(of_both, -np.log(means[0] / means[1]) / np.sqrt(variance)))
    return max(of_scatter, float(fdtrc(*dof, means[0] / means[1])))


def _dof(fit: FitResult, mine: NDArray[np.bool_]) -> float:
    """Used observations of a group less what the parameters take of them, the trace of the hat matrix over them."""
    root, free = fit.factor.root_covariance(), fit.parameters.free

    def partials(rows: Rows) -> _Floats:
        return fit.linearization.partials(rows)[:, free] @ root

    used = fit.used & mine
    taken = sum(float(np.square(part).sum()) for part in fit.noise.among(used).whitened(partials))
    return float(used.sum()) - taken
