"""Stated sigmas that the noise of the residuals contradicts.

Errors of the model last for hours. Residuals that are independent from one observation to the next are noise, however
large they are. A series is white if the variance of its second differences is at least a quarter of that of its
residuals (von Neumann 1941); its noise over its stated sigmas is the ratio

    k = sqrt(sum (r / sigma)^2 / (n (1 - h))),

with the mean leverage h. Considered errors are parameters of the fit, so that neither residuals nor leverages contain
them. Series that share one ratio are one finding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.group_tests import chi2_log_p_value
from radioloc.estimation.noise_structure import MIN_DIFFERENCES, Differences
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import mean_leverage
from radioloc.vectors import Floats

_MIN_RATIO = 2.0  # largest ratio, or its inverse, that is within the usual care of stated sigmas
_MIN_WHITE_FRACTION = 0.25
"""Smallest fraction of the variance of white residuals in second differences: three standard deviations below one for
36 residuals. An error of the model with a period of a day has 0.001 in residuals half an hour apart."""
_MAX_SHARED_SPREAD = 1.5  # ratio of the largest to the smallest k of one finding


def white_ratios(edited: EditedFit, stated_m: Floats, order: SeriesOrder) -> Floats:
    """Noise over stated sigmas (n,) of each series with white residuals; NaN of the other series."""
    fit, count, variance = edited.fit, len(order.series), _variances(edited, stated_m, order)
    differences = Differences.from_residuals(fit.residual_m, stated_m, fit.used, order)
    numbers = np.bincount(differences.code, minlength=count)
    white_variance = np.bincount(differences.code, differences.value**2, count) / np.maximum(numbers, 1)
    is_white = (numbers >= MIN_DIFFERENCES) & (white_variance >= _MIN_WHITE_FRACTION * variance)
    return np.where(is_white & (variance > 0.0), np.sqrt(variance), np.nan)


def _variances(edited: EditedFit, stated_m: Floats, order: SeriesOrder) -> Floats:
    """Mean squares of the used residuals of each series over their stated variances and redundancy."""
    fit, count = edited.fit, len(order.series)
    normalized = np.where(fit.used, fit.residual_m / stated_m, 0.0)
    used = np.maximum(np.bincount(order.code, fit.used, count), 1.0)
    return np.asarray(
        np.bincount(order.code, normalized**2, count) / used / max(1.0 - mean_leverage(fit), 1e-3)
    )


def noise_over_stated(edited: EditedFit, stated_m: Floats, order: SeriesOrder) -> Floats:
    """Noise over stated sigmas of each series, 1 or more; 1 where the residuals are errors of the model."""
    ratios = white_ratios(edited, stated_m, order)
    is_short = np.bincount(order.code, edited.fit.used, len(order.series)) < MIN_DIFFERENCES + 2
    kinds = np.array([series.kind for series in order.series])
    for kind in {*kinds[is_short].tolist()}:
        tested = ratios[(kinds == kind) & ~np.isnan(ratios)]
        if len(tested):
            ratios[(kinds == kind) & is_short] = np.median(tested)
    return np.fmax(ratios, 1.0)


def wrong_sigmas(edited: EditedFit, stated_m: Floats, order: SeriesOrder) -> Iterator[ConsistencyTest]:
    """Yield a finding for all series, those of a type or a station whose stated sigmas (n,) are wrong by one factor."""
    variance = _variances(edited, stated_m, order)
    is_wrong = (variance > _MIN_RATIO**2) | (variance < _MIN_RATIO**-2)
    if not (edited.is_at_minimum and is_wrong.any()):
        return
    ratios = white_ratios(edited, stated_m, order)
    open_codes = {int(code) for code in np.flatnonzero(is_wrong & ~np.isnan(ratios))}
    tested = np.flatnonzero(~np.isnan(ratios)).tolist()
    squares = np.where(edited.fit.used, edited.fit.residual_m / stated_m, 0.0) ** 2
    for name, codes in _sets(order, tested):
        if not codes or not open_codes.issuperset(codes):
            continue
        low, high = ratios[codes].min(), ratios[codes].max()
        if high > _MAX_SHARED_SPREAD * low:
            continue
        open_codes -= {*codes}
        members = edited.fit.used & np.isin(order.code, codes)
        chi2, dof, ratio = float(squares[members].sum()), int(members.sum()), math.sqrt(low * high)
        yield ConsistencyTest(
            "sigma",
            name,
            chi2,
            dof,
            _log10_p_value(chi2, dof),
            None,
            None,
            {"": ratio},
            "times the stated sigmas",
        )


def _sets(order: SeriesOrder, tested: list[int]) -> Iterator[tuple[str, list[int]]]:
    """Yield names and tested series of all observations, of each type, station and link."""
    yield "", tested
    for kind in dict.fromkeys(order.series[code].kind for code in tested):
        yield kind, [code for code in tested if order.series[code].kind == kind]
    for station, members in order.of_stations(tested).items():
        yield station, [*members]
    for station, members in order.of_stations(tested).items():
        for kind in dict.fromkeys(order.series[code].kind for code in members):
            yield f"{kind} of {station}", [code for code in members if order.series[code].kind == kind]
    for code in tested:
        yield order.series[code].name, [code]


def _log10_p_value(chi2: float, dof: int) -> float:
    """Logarithm of the probability of a chi-square at least as far from its mean, on its side."""
    from scipy.special import gammainc

    if chi2 > dof:
        return chi2_log_p_value(chi2, dof) / math.log(10.0)
    return math.log10(max(float(gammainc(0.5 * dof, 0.5 * chi2)), 1e-300))
