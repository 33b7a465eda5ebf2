"""Structure of the noise of a type: noisier stations and links, and shared errors of stations in delays.

A station or link that is noisier or quieter than the others of its type has a variance component of its own. The
squares of the residuals over their sigmas are compared between each station (each link) and the rest of its type. Two
tests must agree: Fisher's, of the ratio of two variances, which is exact for few normal residuals; and Welch's (1947),
of the logarithms of their means, each against the scatter of the means of tenths of the time, which holds as well where
residuals are correlated in time, shared by the baselines of an epoch, or not normal.

The delays of one epoch between three or more stations close: the sum of A to B and B to C less A to C has the noise of
the baselines only, whatever the errors of the arrival times. Where other combinations of residuals are significantly
larger, and the study states no errors of stations, the covariance of the delays is

    C = diag(baseline variances) + sum over stations s of var_s b_s b_s^T,

with the signs b_s of the arrival at s in the delays, and baseline variances in proportion to the squared sigmas. Its
components are estimated by iterated least squares with weights C^-1: restricted maximum likelihood of normal errors
(Anderson 1973; Koch 1999, section 3.6). Means over tenths of the time, with the effects of clocks, troposphere and
parameters, are subtracted first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.labels import USED, Labels, distinct
from radioloc.noise.covariance import ALONE, ObservationCovariance, SharedAtEpoch, White
from radioloc.vectors import Codes, Floats, Indices, Mask

MIN_OBSERVATIONS = 10  # observations that determine a variance: the standard deviation to a quarter
_BATCHES = 10
"""Number of parts of the time whose means are compared or subtracted: a tenth of two days is longer than the usual
correlation time of a link."""
SAME_EPOCH_S = 0.05
"""A delay is tagged with the arrival at its first station. One wavefront meets all stations within 43 ms, the light
time through the Earth; epochs 0.1 s apart or more are distinct."""
_SHARED_SIGNIFICANCE_LEVEL = 0.01
"""Missed errors of stations halve the covariance; those that are small or absent hardly change it."""
_MAX_STEPS = 20
_STEP_TOLERANCE = 1e-6  # relative change of the components at convergence
_MIN_OWN_VARIANCE_FRACTION = 1e-2  # smallest baseline variance in a step; zero would make closures exact
# Largest sigma of a station over that of a baseline; more is an error of the model.
_MAX_STATION_SIGMA_RATIO = 1e3
_ROUNDING = 1e-9
_MAX_STEP_S = 1800.0  # mean time between successive residuals: errors of the model vary over hours
MIN_DIFFERENCES = 20  # second differences of a series that determine its noise to a half
_LOWER_QUARTILE = 0.3186  # of the size of normal residuals; outliers move it less than the median
_MIN_NOISE_RATIO = 3.0
"""Noise over stated sigmas from which the limit of five sigmas rejects a tenth of good data. A quarter of outliers
feeds second differences by less."""
# Of a series with larger noise than that: half of what the limit of five sigmas rejects.
_MIN_OUTLIER_FRACTION = 0.05
_MIN_SQUARE_SUM = 1e-99  # sum of squares of residuals of zero
_MIN_VARIANCE_RATIO = 2.0  # ratio of the variance of a station to the mean, for variances of each station


def by_link(order: SeriesOrder, gap_s: float = np.inf) -> Labels:
    """Each link of each type as a group of its own, or each of its passes, which begin after a silence of `gap_s`.

    Those with fewer than :data:`MIN_OBSERVATIONS` observations are the group of their type.
    """
    code, time_s = order.code[order.order], order.time_s[order.order]
    first = np.diff(code, prepend=-1) != 0
    run = np.cumsum(first | (np.diff(time_s, prepend=-np.inf) > gap_s)) - 1
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    texts, number = [], 0
    for start, count in zip(starts.tolist(), np.bincount(run).tolist(), strict=True):
        number = 1 if first[start] else number + 1
        link = order.series[code[start]]
        name = f"{link.kind} of {link.path}" + (f" {number}" if np.isfinite(gap_s) else "")
        texts.append(name if count >= MIN_OBSERVATIONS else link.kind)
    group = np.empty(len(code), dtype=np.intp)
    group[order.order] = run
    return Labels.coded(texts, group)


def noise_ratios(differences: Differences, count: int) -> Floats:
    """Noise of each series over its sigmas by the lower quartile of second differences; 1 of short series."""
    ends = np.cumsum(np.bincount(differences.code, minlength=count))
    parts = np.split(np.abs(differences.value), ends[:-1])
    return np.array(
        [np.quantile(part, 0.25) / _LOWER_QUARTILE if len(part) >= MIN_DIFFERENCES else 1.0 for part in parts]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """Second differences of successive residuals of each series over their sigmas, of the variance of the residuals."""

    code: Indices  # (m,), index of the series, ascending
    value: Floats  # (m,)

    @classmethod
    def from_residuals(
        cls, residual_m: Floats, sigma_m: Floats, selected: Mask, order: SeriesOrder
    ) -> Differences:
        """Differences of selected observations; those with long gaps between them are omitted."""
        rows = order.order[selected[order.order]]
        code, time_s, normalized = order.code[rows], order.time_s[rows], residual_m[rows] / sigma_m[rows]
        is_joined = (code[2:] == code[:-2]) & (time_s[2:] - time_s[:-2] < 2.0 * _MAX_STEP_S)
        # Independent noise of unit variance has second differences of variance 1 + 4 + 1.
        value = (normalized[2:] - 2.0 * normalized[1:-1] + normalized[:-2]) / math.sqrt(6.0)
        return cls(code[2:][is_joined], value[is_joined])


def noisy_groups(edited: EditedFit, order: SeriesOrder) -> tuple[Labels, Floats] | None:
    """Return groups of types, stations and links much noisier than stated with their noise, m, or None.

    The noise is that of each observation (n,) and zero for the others. Outliers and errors of the model hardly feed
    second differences, and the weights that the stated sigmas give to the noisy series do not either. Without it a
    station that states a hundredth of its sigmas determines the estimate, and its own observations are rejected
    (`tests/unit/jobs/test_stated_sigmas.py`).
    """
    fit, usable = edited.fit, edited.initial_status.are(USED)
    usable_count, outlier_count = (
        np.bincount(order.code, mask, len(order.series)) for mask in (usable, usable & ~fit.used)
    )
    if edited.is_settled and not (outlier_count > _MIN_OUTLIER_FRACTION * usable_count).any():
        return None
    ratios = noise_ratios(
        Differences.from_residuals(fit.residual_m, fit.sigma_m, usable, order), len(order.series)
    )
    is_noisy = ratios > _MIN_NOISE_RATIO
    if not is_noisy.any():
        return None
    names = [series.kind for series in order.series]
    for kind in {*names}:
        codes = [code for code, series in enumerate(order.series) if series.kind == kind]
        if is_noisy[codes].all():
            continue
        for code in np.flatnonzero(is_noisy[codes]).tolist():
            names[codes[code]] = f"{kind} of {order.series[codes[code]].path}"
        for station, members in order.of_stations(codes).items():
            of_station = [code for code, sign in members.items() if sign]
            if is_noisy[of_station].all():
                for code in of_station:
                    names[code] = f"{kind} of {station}"
    noise_m = np.where(is_noisy, ratios, 0.0)[order.code] * fit.sigma_m
    return Labels.coded(names, order.code), noise_m


def split(fit: FitResult, order: SeriesOrder, groups: Labels, added_m: Mapping[str, float]) -> Labels | None:
    """Return groups with the most different station or link as a further group; None if no difference is significant.

    Without it, errors exceed their sigmas where one station of three is three times as noisy as the others
    (`tests/statistics/test_variance_components.py`).
    """
    # Each group is of whole series of one type and has an additive component, m. Without one it is divided only where
    # the noisier part is noisier than stated. The chance allows for all that are compared.
    squares, counts = _batch_sums(fit, order)
    candidates = list(_candidates(order, groups, np.flatnonzero(counts.any(axis=1))))
    if not candidates:
        return None
    limit = 0.5 * (1.0 - SCALING_PROBABILITY) / len(candidates)  # noisier or quieter
    sides = np.array([candidate[1] for candidate in candidates], dtype=np.float64)
    mean = (sides @ squares).sum(axis=2) / (sides @ counts).sum(axis=2)
    sides = np.take_along_axis(sides, np.argsort(-mean, axis=1, kind="stable")[:, :, None], axis=1)
    sums, numbers = sides @ squares, sides @ counts
    chances = chances_of_noisier(sums, numbers, numbers.sum(axis=2))
    # Of the significant ones the division that raises the likelihood most: the noisy station, not the quiet ones.
    total, count = sums.sum(axis=2), numbers.sum(axis=2)
    scatter = np.log(np.maximum(total, _MIN_SQUARE_SUM) / np.maximum(count, 1.0))
    of_both = np.log(np.maximum(total.sum(axis=1), _MIN_SQUARE_SUM) / count.sum(axis=1))
    gain = of_both * count.sum(axis=1) - (count * scatter).sum(axis=1)
    significant = np.flatnonzero(chances <= limit)
    for k in significant[np.argsort(-gain[significant], kind="stable")].tolist():
        name, (members, _) = candidates[k]
        is_member = members[order.code]
        # Absorption by parameters is computed last, because it requires all partials
        dof = np.array([_dof(fit, side[order.code] > 0.0) for side in sides[k]])
        has_no_component = not added_m[groups.texts[groups.codes[is_member.argmax()]]] > 0.0
        is_explained = has_no_component and sums[k, 0].sum() <= chi2_quantile(
            SCALING_PROBABILITY, round(dof[0])
        )
        if chances_of_noisier(sums[k], numbers[k], dof) < limit and not is_explained:
            return Labels.coded((*groups.texts, name), np.where(is_member, len(groups.texts), groups.codes))
    return None


def _candidates(order: SeriesOrder, groups: Labels, codes: Indices) -> Iterator[tuple[str, Mask]]:
    """Yield each receiving station and link, with masks of its series and of the other ones, (2, series)."""
    group_of = np.full(len(order.series), -1)
    group_of[order.code] = groups.codes
    name_of_part: dict[tuple[int, tuple[int, ...]], str] = {}
    for group in np.unique(group_of[codes]).tolist():
        group_codes = codes[group_of[codes] == group].tolist()
        stations = order.of_stations(group_codes).items()
        members = {name: [code for code, sign in signs.items() if sign] for name, signs in stations}
        members |= {order.series[code].path: [code] for code in group_codes}
        for name, chosen in members.items():
            if 0 < len(chosen) < len(group_codes):
                name_of_part.setdefault((group, tuple(chosen)), f"{order.series[chosen[0]].kind} of {name}")
    is_present = np.zeros(len(order.series), dtype=bool)
    is_present[codes] = True
    for (group, part), name in name_of_part.items():
        is_part = np.zeros_like(is_present)
        is_part[list(part)] = True
        yield name, np.stack([is_part, is_present & (group_of == group) & ~is_part])


def _batch_sums(fit: FitResult, order: SeriesOrder) -> tuple[Floats, Floats]:
    """Return sums of squares over the sigmas, and numbers of used observations, by series and tenth of it in time."""
    code = order.code[order.order]
    count = np.bincount(code)
    rank = np.arange(len(code)) - (np.cumsum(count) - count)[code]
    place = code * _BATCHES + rank * _BATCHES // count[code]
    used = fit.used[order.order]
    square = np.where(used, fit.residual_m[order.order] / fit.sigma_m[order.order], 0.0) ** 2
    length = len(count) * _BATCHES
    squares, counts = (np.bincount(place, values, length).astype(np.float64) for values in (square, used))
    return squares.reshape(-1, _BATCHES), counts.reshape(-1, _BATCHES)


def chances_of_noisier(sums: Floats, numbers: Floats, dof: Floats) -> Floats:
    """P-values of the larger noise of the first side of each pair; one if the second is noisier."""
    from scipy.special import fdtrc, stdtr

    # Sums and numbers of the batches have shape (..., 2, batches), degrees of freedom (..., 2).
    total, batches = sums.sum(axis=-1), (numbers > 0.0).sum(axis=-1)
    is_testable = (dof >= 1.0).all(axis=-1) & (batches >= 2).all(axis=-1) & (total > 0.0).all(axis=-1)
    sums, numbers, dof, total = (
        np.where(is_testable.reshape(is_testable.shape + (1,) * (array.ndim - is_testable.ndim)), array, 1.0)
        for array in (sums, numbers, dof, total)
    )
    freedom = np.maximum(batches - 1.0, 1.0)
    deviations = sums - (total / numbers.sum(axis=-1))[..., None] * numbers
    variances = (1.0 + 1.0 / freedom) * np.square(deviations / total[..., None]).sum(axis=-1)
    variances = np.maximum(variances, 1e-99)  # residuals that are nothing but rounding may be exactly alike
    variance = variances.sum(axis=-1)
    means = total / dof
    ratio = means[..., 0] / means[..., 1]
    joint_dof = variance**2 / (variances**2 / freedom).sum(axis=-1)
    scatter_chance = stdtr(joint_dof, -np.log(ratio) / np.sqrt(variance))
    chance = np.maximum(scatter_chance, fdtrc(dof[..., 0], dof[..., 1], ratio))
    return np.asarray(np.where(is_testable & (ratio > 1.0), chance, 1.0))


def _dof(fit: FitResult, members: Mask) -> float:
    """Return the number of used observations of a group less the sum of their leverages."""
    used = fit.used & members
    leverage = sum(
        float(np.square(part).sum()) for part in fit.noise.whitener(used).whitened(fit.unit_partials())
    )
    return float(used.sum()) - leverage


@dataclass(frozen=True, slots=True, eq=False)
class _Pattern:
    """Epochs at which the same k baselines were observed, b of them."""

    signs: Floats  # (k, stations)
    residual_m: Floats  # (b, k), less the means of parts of the time
    sigma_m: Floats  # (b, k), of the delays' own errors, in proportion
    part: Indices  # (b,)

    @property
    def dof(self) -> int:
        """Epochs less the means that were taken off."""
        return len(self.part) - len(np.unique(self.part))

    def sides(self) -> tuple[Floats, Floats]:
        """Squares and degrees of freedom of combinations with most and least errors of stations, (2, parts) each."""
        values, axes = np.linalg.eigh(self.signs @ self.signs.T)
        squares = np.square((self.residual_m / self.sigma_m) @ axes)
        # Each delay has two stations: with independent errors the mean is two
        side_axes = np.stack([values > 2.0 + _ROUNDING, values < 2.0 - _ROUNDING])
        sums = [np.bincount(self.part, squares @ side, _BATCHES) for side in side_axes]
        epochs = np.maximum(np.bincount(self.part, minlength=_BATCHES) - 1.0, 0.0)
        return np.array(sums), side_axes.sum(axis=1)[:, None] * epochs


def noise_with_shared(
    fit: FitResult, order: SeriesOrder, delay_sigma_m: Floats
) -> tuple[ObservationCovariance, dict[str, float]] | None:
    """Covariance with shared errors of stations in delays, and their sigmas, m; None if not significant.

    Without it, the covariance is half of what it should be where stations have errors of their own
    (`tests/statistics/test_shared_errors.py`).
    """
    # Sigmas of the delays, all their errors together, stay as large as they are in the mean; their own errors are in
    # proportion to `own_m` (n,).
    sigmas_m: dict[str, float] = {}
    codes_of: dict[str, list[int]] = {}
    for code, link in enumerate(order.series):
        if -1.0 in link.signs.values():
            codes_of.setdefault(link.kind, []).append(code)
    n, noise_m, shared = len(delay_sigma_m), fit.noise.white_m, list[SharedAtEpoch]()
    stated = [term.group != ALONE for term in fit.noise.of_type(SharedAtEpoch)]
    if any((is_shared & order.types.are(kind)).any() for kind in codes_of for is_shared in stated):
        return None
    for kind, codes in codes_of.items():
        rows = np.flatnonzero(order.types.are(kind)).astype(np.int32)
        epoch = epoch_numbers(order.time_s[rows])
        names = sorted(order.of_stations(codes))
        signs = np.array([[order.series[code].signs.get(name, 0.0) for name in names] for code in codes])
        of_code = np.searchsorted(codes, np.arange(len(order.series))).astype(np.int32)[order.code[rows]]
        patterns = list(_patterns(fit, rows, epoch, of_code, signs, delay_sigma_m))
        variance_m2 = _components(patterns, len(names))
        if variance_m2 is None:
            continue
        stations = np.argsort(signs, axis=1)[of_code][:, [0, -1]]
        # Sizes of residuals are known better than what is left of them without means
        variances = variance_m2[0] * np.square(delay_sigma_m[rows]) + variance_m2[1:][stations].sum(axis=1)
        variance_m2 *= np.square(fit.sigma_m[rows]).sum() / variances.sum()
        of_stations_m = np.sqrt(variance_m2[1:])
        if (
            of_stations_m.max()
            > _MAX_STATION_SIGMA_RATIO * np.sqrt(variance_m2[0]) * delay_sigma_m[rows].min()
        ):
            continue
        noise_m = noise_m.copy()
        noise_m[rows] = np.sqrt(variance_m2[0]) * delay_sigma_m[rows]
        group, source, effect_m = np.full(n, ALONE), np.zeros((n, 2), dtype=np.intp), np.zeros((n, 2))
        group[rows], source[rows] = epoch, stations
        effect_m[rows] = of_stations_m[stations] * [-1.0, 1.0]
        shared.append(SharedAtEpoch(group, source, effect_m))
        sigmas_m |= {f"{kind} of {name}": of_stations_m[k].item() for k, name in enumerate(names)}
    if not sigmas_m:
        return None
    structured = (term for term in fit.noise.terms if not isinstance(term, White))
    return ObservationCovariance((White(noise_m), *structured, *shared)), sigmas_m


def epoch_numbers(time_s: Floats) -> Codes:
    """Return the index of the epoch of each time (n,), s, in order of time."""
    order = np.argsort(time_s, kind="stable")
    number = np.empty(len(time_s), dtype=np.int32)
    number[order] = np.cumsum(np.diff(time_s[order], prepend=-np.inf) > SAME_EPOCH_S) - 1
    return number


def _patterns(
    fit: FitResult, rows: Codes, epoch: Codes, of_code: Codes, signs: Floats, delay_sigma_m: Floats
) -> Iterator[_Pattern]:
    """Epochs at which baselines with stations in common are used, by these baselines."""
    used = fit.used[rows]
    row_of = np.full((epoch.max() + 1, len(signs)), -1, dtype=np.int32)
    row_of[epoch[used], of_code[used]] = rows[used]
    kinds, pattern_index = distinct(row_of >= 0)
    for k, observed in enumerate(kinds):
        epochs_of_pattern = np.flatnonzero(pattern_index == k)
        part = epochs_of_pattern * _BATCHES // len(row_of)
        epochs = np.bincount(part, minlength=_BATCHES)
        alike = np.abs(signs[observed] @ signs[observed].T)
        if (
            len(epochs_of_pattern) < MIN_OBSERVATIONS
            or epochs.max() < 2
            or not (alike - np.diag(np.diag(alike))).any()
        ):
            continue
        at = row_of[epochs_of_pattern][:, observed]
        residual_m = fit.residual_m[at]
        means_m = np.zeros((_BATCHES, at.shape[1]))
        np.add.at(means_m, part, residual_m)
        means_m /= np.maximum(epochs, 1)[:, None]
        residual_m -= means_m[part]
        yield _Pattern(signs[observed], residual_m, delay_sigma_m[at], part)


def _components(patterns: Sequence[_Pattern], stations: int) -> Floats | None:
    """Baseline variance over the squared sigmas and variances of stations, m^2; None if not significant."""
    if not patterns:
        return None
    sides = [pattern.sides() for pattern in patterns]
    sums, numbers = (np.sum(arrays, axis=0) for arrays in zip(*sides, strict=True))
    if chances_of_noisier(sums, numbers, numbers.sum(axis=1)) > _SHARED_SIGNIFICANCE_LEVEL:
        return None
    matrices, squares, fillers, dof = _stacked(patterns, stations)
    pooled = np.stack([matrices[0], matrices[1:].sum(axis=0)])
    common, common_likelihood = _likeliest(pooled, squares, fillers, dof)
    individual, individual_likelihood = _likeliest(matrices, squares, fillers, dof)
    is_different = np.abs(np.log(np.maximum(individual[1:], 1e-300) / common[1])).max() > np.log(
        _MIN_VARIANCE_RATIO
    )
    is_better = common_likelihood - individual_likelihood > chi2_quantile(
        SCALING_PROBABILITY, max(stations - 1, 1)
    )
    return individual if is_different and is_better else np.append(common[0], np.full(stations, common[1]))


def _stacked(patterns: Sequence[_Pattern], stations: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Additions of each component to the covariance (c, p, k, k), products (p, k, k), the rest (p, k, k), dof."""
    # A pattern of fewer than k baselines has others besides, without residuals and of unit variance: the rest.
    size = max(len(pattern.signs) for pattern in patterns)
    fillers = np.tile(np.eye(size), (len(patterns), 1, 1))
    squares, matrices = np.zeros_like(fillers), np.zeros((1 + stations, *fillers.shape))
    for k, pattern in enumerate(patterns):
        block = (k, slice(len(pattern.signs)), slice(len(pattern.signs)))
        fillers[block] = 0.0
        squares[block] = pattern.residual_m.T @ pattern.residual_m
        matrices[0][block] = np.diag(np.square(pattern.sigma_m).mean(axis=0))
        matrices[1:][:, *block] = pattern.signs.T[:, :, None] * pattern.signs.T[:, None, :]
    return matrices, squares, fillers, np.array([pattern.dof for pattern in patterns], dtype=np.float64)


def _likeliest(matrices: Floats, squares: Floats, fillers: Floats, dof: Floats) -> tuple[Floats, float]:
    """Components (c,) and -2 log of their likelihood, from the result of :func:`_stacked`."""
    from scipy.optimize import nnls

    scale = np.sqrt(dof)[:, None, None]
    delay_m2 = np.diagonal(matrices[0], axis1=1, axis2=2)
    # Far above plausible noise; the covariance still has an inverse
    min_fraction = 1e-3 / (_MAX_STATION_SIGMA_RATIO**2 * delay_m2[delay_m2 > 0.0].min())
    components = np.append(1.0, np.zeros(len(matrices) - 1))
    for _ in range(_MAX_STEPS):
        root = np.linalg.inv(np.linalg.cholesky(fillers + np.tensordot(components, matrices, 1)))
        transposed = np.swapaxes(root, 1, 2)
        weighted_matrices = scale * (root @ matrices @ transposed)
        weighted_squares = root @ squares @ transposed / scale
        previous = components
        components, _ = nnls(weighted_matrices.reshape(len(matrices), -1).T, weighted_squares.ravel())
        components[0] = max(
            components[0], _MIN_OWN_VARIANCE_FRACTION * previous[0], min_fraction * components[1:].max()
        )
        if np.abs(components - previous).max() <= _STEP_TOLERANCE * components.max():
            break
    covariance = fillers + np.tensordot(components, matrices, 1)
    likelihood = dof @ np.linalg.slogdet(covariance)[1]
    likelihood += np.trace(np.linalg.solve(covariance, squares), axis1=1, axis2=2).sum()
    return components, float(likelihood)
