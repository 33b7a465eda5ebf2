"""Data editing: rejection of outliers by studentized residuals, with re-admission (Baarda 1968).

An observation with residual r_i, stated standard deviation s_i and leverage h_i is rejected if

    |r_i| > t max(1, k) s_i sqrt(1 - h_i),    h_i = (A P A^T)_ii / s_i^2,

with design matrix A and covariance P of the estimate. The threshold t is in standard deviations. For an observation
that the last fit did not use, the factor is sqrt(1 + h_i) in place of sqrt(1 - h_i), since the fit is independent of
it; the factor is limited to the interval from 0.2 to 5. The robust scale k is 1.4826 times the median of |r/s| over all
usable observations, including rejected ones, so that rejections do not tighten the limit.

1. A robust estimate, or a previous fit, gives the first residuals.
2. All observations within their limits are used, whether they were used before or not. The others are rejected.
3. The parameters are estimated; steps 2 and 3 are repeated until the set of used observations stays the same.

No observation is rejected if more than 30 % would be: the model, a station or the sigmas are then wrong. If more than
30 % exceed their limits at the robust estimate, the decision is repeated with the residuals of a fit to all
observations. A link with 70 % of outliers or more is taken as wrong as a whole and is left out of this count, as long
as such links hold less than half of the observations, the largest fraction of errors that an estimate withstands
(Rousseeuw and Leroy 1987). If such a link were counted, a station clock that is 1 ms off would keep all observations
in the fit, and the position would be wrong by thousands of kilometres.

References: Baarda (1968), A testing procedure for use in geodetic networks; Belsley, Kuh and Welsch (1980), chapter 2;
Rousseeuw and Leroy (1987), Robust regression and outlier detection, section 1.2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.estimation.gauss_markov import SeriesWeight
from radioloc.estimation.least_squares import FitResult, fit_least_squares
from radioloc.estimation.linearization import (
    Linearization,
    OrthonormalLinearization,
    ResidualFunction,
    evaluate,
    process_noise,
)
from radioloc.estimation.robust import robust_start
from radioloc.estimation.series import SeriesOrder, independent_series
from radioloc.estimation.statistics import robust_scale
from radioloc.estimation.status import FitStatus
from radioloc.labels import USED, Labels, changed
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import LinkedWhitener, Rows
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats, Mask

THRESHOLD = 5.0  # sigmas; one normal residual in 1.7 million is larger
_MIN_THRESHOLD = 2.0  # sigmas; a smaller one rejects more than 4.5 % of the good observations
_MAX_FIT_COUNT = 20
_MAX_REJECTED_FRACTION = 0.3  # of usable observations; more outliers mean a wrong model, station or sigma
_MIN_USED_FRACTION = 0.3  # of a link; with fewer observations within the limits the link is wrong as a whole
_MIN_STUDENTIZED_RATIO = 0.2  # least sqrt(1 - h) in a limit, reached at a leverage of 0.96
_MIN_RUN_LENGTH = (
    3  # outliers of one sign; if 3 % are outliers, one of 150,000 observations begins such a run
)


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """Result of a least-squares fit with rejection of outliers."""

    fit: FitResult  # the last fit
    initial_status: Labels  # USED, or the reason why an observation is not usable
    robust_scale: float  # k, of the usable residuals
    fit_count: int = 1  # number of fits of the editing
    is_settled: bool = True  # False if the editing ended early, or another fit would use other observations
    message: str = ""  # problems of the editing
    # Variance components as sigmas, m: of groups of observations, and of station errors common to delays of one epoch.
    additive_sigma_m: Mapping[str, float] = field(default_factory=dict)
    shared_sigma_m: Mapping[str, float] = field(default_factory=dict)
    series_weights: tuple[SeriesWeight, ...] = ()  # series with noise that is correlated in time
    reasons: Mapping[int, str] = field(default_factory=dict)  # causes of outliers by row

    @property
    def status(self) -> Labels:
        """:data:`USED`, or the reason for the rejection, of each of n observations."""
        rejected = np.flatnonzero(self.initial_status.are(USED) & ~self.fit.used)
        residual_m = self.fit.residual_m[rejected].tolist()
        expected_m = (self.fit.sigma_m[rejected] * max(1.0, self.robust_scale)).tolist()
        reasons = {
            row: self.reasons.get(row) or outlier_reason(residual_m[k], expected_m[k])
            for k, row in enumerate(rejected.tolist())
        }
        return with_reasons(self.initial_status, reasons)

    @property
    def outliers(self) -> Mask:
        """Mask of the observations that are rejected by size alone, without a cause, shape (n,)."""
        outliers = self.initial_status.are(USED) & ~self.fit.used
        outliers[list(self.reasons)] = False
        return outliers

    @property
    def can_continue(self) -> bool:
        """True if another fit can start here: the fit converged, and the outliers are few enough to be rejected."""
        too_many_outliers = not self.is_settled and self.fit.used[self.initial_status.are(USED)].all()
        return self.fit.converged and not too_many_outliers

    @property
    def is_at_minimum(self) -> bool:
        """True if the editing is settled with a minimum of the sum of squares; parameters may be undetermined."""
        return self.is_settled and self.fit.status in (FitStatus.CONVERGED, FitStatus.UNOBSERVABLE)

    @property
    def converged(self) -> bool:
        """True if the editing is settled, and its last fit converged with every parameter determined."""
        return self.is_settled and self.fit.converged


@accepts_quantities
def fit_with_editing(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationCovariance,
    *,
    status: ArrayLike | Labels | None = None,
    threshold: float | None = THRESHOLD,
    previous: EditedFit | None = None,
    start: Floats | None = None,
    order: SeriesOrder | None = None,
) -> EditedFit:
    """Estimate parameters and reject outliers until the set of used observations stays the same.

    `status` (n,) gives the reasons why observations are not usable. `threshold` is in sigmas; None rejects nothing.
    `previous` is a fit whose residuals replace those of the robust estimate. Without the `order` of the
    observations, no link is taken as wrong as a whole.
    """
    if threshold is not None and not threshold >= _MIN_THRESHOLD:
        raise InputError(f"threshold: expected {_MIN_THRESHOLD:g} sigmas or more, got {threshold}")
    if previous is None:
        x = parameters.prior_values if start is None else start
        linearization = evaluate(residual_function, x)
    else:
        x, linearization = previous.fit.x, previous.fit.linearization
    n = len(linearization.residual_m)
    noise = ObservationCovariance.from_sigma(sigma_m, n)
    initial_status = _initial_labels(status, n)
    editor = _Editor(residual_function, parameters, noise, initial_status.are(USED), order)
    if threshold is None or editor.max_rejected < 1:
        result = editor.fit(editor.usable, x, linearization)
        return EditedFit(result, initial_status, editor.scale(result.residual_m))

    processes, last_fit = process_noise(linearization), None if previous is None else previous.fit
    if last_fit is not None:
        residual_m = last_fit.residual_m
    elif processes:  # orbits start near the estimate
        residual_m = linearization.residual_m - sum(item.effects_m(item.reference) for item in processes)
    else:
        x, linearization = robust_start(
            residual_function, parameters, noise.sigma_m, editor.usable, linearization, x
        )
        residual_m = linearization.residual_m
    scale, selections, start_outlier_count = editor.scale(residual_m), list[Mask](), 0
    while True:
        limit_m = threshold * max(1.0, scale) * noise.sigma_m
        if last_fit is not None and not processes:  # leverages of process noise are not in the partials
            limit_m = _studentized_limits(last_fit, residual_m, limit_m, editor.usable)
        used = editor.usable & (np.abs(residual_m) <= limit_m)
        if selections and np.array_equal(used, selections[-1]):
            return EditedFit(result, initial_status, scale, len(selections))
        selection = _break_rejection_cycle(used, selections)
        outliers = editor.usable & ~selection.used
        outlier_count, too_many_outliers = int(outliers.sum()), editor.are_too_many(outliers)
        is_poor_start = last_fit is None and too_many_outliers
        if is_poor_start:
            start_outlier_count, selection = outlier_count, _Selection(editor.usable)
        elif too_many_outliers:
            # Outliers enlarge all residuals of a fit, so that their number at the robust estimate is stated.
            selection = editor.without_rejections(start_outlier_count or outlier_count, threshold)
        elif len(selections) >= _MAX_FIT_COUNT:
            message = f"the editing did not settle in {_MAX_FIT_COUNT} fits"
            selection = _Selection(selection.used, message, is_settled=False)
        selections.append(selection.used)
        last_fit = result = editor.fit(selection.used, x, linearization)
        x, linearization, residual_m = result.x, result.linearization, result.residual_m
        # Outliers that are used enlarge the residuals of all.
        scale = min(scale if is_poor_start else np.inf, editor.scale(residual_m))
        if selection.message or result.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
            return EditedFit(
                result, initial_status, scale, len(selections), selection.is_settled, selection.message
            )


def with_reasons(status: Labels, reasons: Mapping[int, str]) -> Labels:
    """Return labels with other texts in some rows."""
    if not reasons:
        return status
    codes = status.codes.copy()
    codes[list(reasons)] = len(status.texts) + np.arange(len(reasons))
    return Labels.coded((*status.texts, *reasons.values()), codes)


def outlier_reason(residual_m: float, expected_m: float) -> str:
    """Return a rejection by size in words, such as "outlier: 19.021 m is 612 times its expected 0.031 m"."""
    ratio = abs(residual_m) / expected_m
    times = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
    return f"outlier: {_format_length(abs(residual_m))} m is {times} times its expected {_format_length(expected_m)} m"


def outlier_runs(edited: EditedFit, order: SeriesOrder) -> list[Rows]:
    """Find runs of outliers: successive rows of a series, in order of time, with residuals of one sign."""
    rows = order.order[edited.initial_status.are(USED)[order.order]]
    outlier = edited.outliers[rows]
    is_first = changed(order.code[rows], np.where(outlier, np.sign(edited.fit.residual_m[rows]), 0.0))
    runs = np.split(np.arange(len(rows)), np.flatnonzero(is_first)[1:])
    return [rows[run] for run in runs if len(run) >= _MIN_RUN_LENGTH and outlier[run[0]]]


def run_reasons(edited: EditedFit, runs: Iterable[Rows]) -> dict[int, str]:
    """Return the reason, by row, for the rejection of each observation of runs of outliers."""
    reasons = dict[int, str]()
    for rows in runs:
        mean_m = float(edited.fit.residual_m[rows].mean())
        sign = "-" if mean_m < 0.0 else "+"
        text = (
            f"outlier: one of {len(rows)} in succession with a mean of {sign}{_format_length(abs(mean_m))} m"
        )
        reasons |= dict.fromkeys(rows.tolist(), text)
    return reasons


class _Selection(NamedTuple):
    """Observations to use in the next fit, which is the last if there is a message."""

    used: Mask
    message: str = ""
    is_settled: bool = True  # False if all outliers are used, or the editing ends at the limit of fits


@dataclass(frozen=True, slots=True, eq=False)
class _Editor:
    """Inputs of the editing, with its fit and the limit on the number of outliers."""

    residual_function: ResidualFunction
    parameters: ParameterSet
    noise: ObservationCovariance
    usable: Mask  # (n,), mask of the observations that may be used
    order: SeriesOrder | None

    @property
    def unconstrained_count(self) -> int:
        """Number of parameters that need an observation, as they have no a-priori information."""
        return int((self.parameters.free & np.isinf(self.parameters.prior_sigmas)).sum())

    @property
    def max_rejected(self) -> int:
        """Largest number of outliers among all usable observations."""
        return self.max_outliers(int(self.usable.sum()))

    def max_outliers(self, count: int) -> int:
        """Largest number of outliers among observations; they are detectable only if the others are redundant."""
        return min(int(_MAX_REJECTED_FRACTION * count), count - self.unconstrained_count - 1)

    def are_too_many(self, outliers: Mask) -> bool:
        """Return whether outliers (n,) are too many to be rejected; links that are wrong as a whole do not count."""
        if outliers.sum() <= self.max_rejected or self.order is None:
            return bool(outliers.sum() > self.max_rejected)
        outlier_count, count = (np.bincount(self.order.code, mask) for mask in (outliers, self.usable))
        is_plausible = count - outlier_count > _MIN_USED_FRACTION * count
        plausible_count = int(count[is_plausible].sum())
        is_majority = 2 * plausible_count > count.sum()
        return not (is_majority and outlier_count[is_plausible].sum() <= self.max_outliers(plausible_count))

    def fit(self, used: Mask, x: Floats, linearization: Linearization) -> FitResult:
        """Estimate the parameters from the used observations."""
        # Noise models of a trial use its whitened partials again.
        whitening: LinkedWhitener | None = None
        if self.order is not None and isinstance(linearization, OrthonormalLinearization):
            stated, prepared = linearization.problem.stated, None
            if stated is not None and stated.noise is self.noise:
                prepared = stated.with_rejections(self.usable & ~used)
            if prepared is None:
                whitening = independent_series(self.order, self.noise, used)
            else:
                whitening, whitened = prepared
                linearization = replace(linearization, whitened=whitened)
        return fit_least_squares(
            self.residual_function,
            self.parameters,
            self.noise,
            used=used,
            start=x,
            linearization=linearization,
            whitening=whitening,
        )

    def scale(self, residual_m: Floats) -> float:
        """Robust scale of the usable residuals over their stated sigmas."""
        normalized = residual_m[self.usable] / self.noise.sigma_m[self.usable]
        return robust_scale(normalized, self.unconstrained_count)

    def without_rejections(self, outlier_count: int, threshold: float) -> _Selection:
        """Select all usable observations, with a message that says why."""
        message = (
            f"{outlier_count} of {self.usable.sum()} observations exceed {threshold:g} sigmas, more than the limit of "
            f"{self.max_rejected}, so none is rejected: check stations, sigmas and model"
        )
        return _Selection(self.usable, message, is_settled=False)


def _studentized_limits(fit: FitResult, residual_m: Floats, limit_m: Floats, usable: Mask) -> Floats:
    """Multiply limits (n,) by sqrt(1 - h), or sqrt(1 + h) for rejected observations.

    Without these factors, rejections of observations of high leverage would depend on the start of the fit.
    The limits of residuals that are too small to be rejected at any leverage are left unchanged.
    """
    rows = np.flatnonzero(usable & (np.abs(residual_m) > _MIN_STUDENTIZED_RATIO * limit_m))
    leverage, limit_m = fit.leverage(rows), limit_m.copy()
    ratio = np.sqrt(np.where(fit.used[rows], np.maximum(1.0 - leverage, 0.0), 1.0 + leverage))
    limit_m[rows] *= np.clip(ratio, _MIN_STUDENTIZED_RATIO, 1.0 / _MIN_STUDENTIZED_RATIO)
    return limit_m


def _break_rejection_cycle(used: Mask, selections: list[Mask]) -> _Selection:
    """Return a new selection as it is; for an earlier one, the intersection of the cycle that it begins.

    Without this rule, the editing of residuals with heavy tails can alternate for ever.
    """
    start = next((k for k, selection in enumerate(selections) if np.array_equal(used, selection)), None)
    if start is None:
        return _Selection(used)
    cycle = np.array(selections[start:])
    common = np.asarray(cycle.all(axis=0))
    count = int((cycle.any(axis=0) & ~common).sum())
    message = (
        f"{count} observations at the outlier limit alternate between used and rejected; all are rejected"
    )
    return _Selection(common, message)


def _initial_labels(status: ArrayLike | Labels | None, n: int) -> Labels:
    """Return the labels of n observations before the fit; an empty text becomes :data:`USED`."""
    if status is None:
        return Labels(np.zeros(n, dtype=np.int32), (USED,))
    labels = Labels.from_texts(status)
    if labels.codes.shape != (n,):
        raise InputError(f"status: expected shape ({n},), got {labels.codes.shape}")
    return Labels.coded([text or USED for text in labels.texts], labels.codes)


def _format_length(value_m: float) -> str:
    """Format a length to the millimetre, or to two digits if that is finer."""
    if value_m >= 0.01:
        return f"{value_m:.3f}"
    return np.format_float_positional(value_m, precision=2, unique=False, fractional=False)
