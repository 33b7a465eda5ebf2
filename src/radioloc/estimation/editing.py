"""Outlier editing: observations are rejected with a reason, and re-admitted when they fit again.

Two faults of integrated Doppler are recognised. A *cycle slip*, a short loss of the phase, changes one count by whole
cycles; the counts around it are right. *Tracking the wrong signal*, as before the uplink starts or after another
station takes over, is an error of frequency: it biases all counts at the beginning, at the end or in a part of a pass.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.gauss_markov import SeriesWeight
from radioloc.estimation.least_squares import FitResult, fit_least_squares
from radioloc.estimation.linearization import Linearization, ResidualFunction, evaluate, row_order
from radioloc.estimation.robust import robust_start
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import robust_scale
from radioloc.estimation.status import FitStatus
from radioloc.labels import USED, Labels, changed
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, slices
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

THRESHOLD = 5.0  # sigmas; of normal residuals one in 1.7 million is larger
_MIN_THRESHOLD = 2.0  # sigmas; less rejects one good observation in 20 or more

_MAX_REJECTED_FRACTION = 0.3
"""Largest fraction of usable observations to reject: more outliers mean a wrong model, station or sigma. Without this
limit 40 of 100 wrong ranges are rejected without a message (`tests/unit/estimation/test_editing.py`)."""

_MAX_PASSES = 20
_MIN_STUDENTIZED_RATIO = 0.2  # sigma of a residual over that of its observation: leverages up to 0.96

# With 3 % independent outliers, a run of this length with one sign begins at one of 150,000 observations.
_MIN_RUN_COUNT = 3

# Cycle slips
_SLIP_TOLERANCE_SIGMAS = 5.0  # distance of a residual from whole cycles
_SLIP_MAX_TOLERANCE_CYCLES = 0.15  # with a larger tolerance nearly every residual is near a whole number
_SLIP_MAX_CYCLES = 1000.0  # more cycles at once are an error of frequency

# Tracking the wrong signal
_MIN_GAP_S, _MIN_GAP_STEPS = 300.0, 10.0  # a longer gap without counts begins a new lock
_MIN_PASS_COUNTS = 10  # counts from which a pass has a scatter of its own
_WRONG_SIGNAL_MIN_COUNTS = 3  # consecutive counts with one sign of the error; a slip changes one
_WRONG_SIGNAL_MIN_SIGMAS = 30.0  # smaller errors can be the troposphere near the horizon
_WRONG_SIGNAL_MIN_RATE_M_S = 0.03  # 1e-10 of the frequency; smaller lasting errors are those of the model
_ROUNDING_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """Least-squares fit with the rejection of outliers."""

    fit: FitResult  # the last fit
    initial_status: Labels  # USED, or the reason why an observation is not usable
    robust_scale: float  # median spread of usable residuals over their stated sigmas
    passes: int = 1  # number of fits
    complete: bool = True  # whether the set of used observations has settled
    message: str = ""  # problems of the editing
    # Variance components of groups, as sigmas; errors of stations that delays share.
    additive_sigma_m: Mapping[str, float] = field(default_factory=dict)
    shared_sigma_m: Mapping[str, float] = field(default_factory=dict)
    series_weights: tuple[SeriesWeight, ...] = ()  # series with noise that is correlated in time
    reasons: Mapping[int, str] = field(default_factory=dict)  # causes of outliers by row

    @property
    def status(self) -> Labels:
        """:data:`USED`, or the reason for the rejection, of each of n observations."""
        rejected = np.flatnonzero(self.initial_status.are(USED) & ~self.fit.used)
        residual_m = self.fit.residual_m[rejected]
        expected_m = self.fit.sigma_m[rejected] * max(1.0, self.robust_scale)
        sizes = zip(rejected.tolist(), residual_m.tolist(), expected_m.tolist(), strict=True)
        return with_reasons(
            self.initial_status, {row: self.reasons.get(row) or outlier_reason(*size) for row, *size in sizes}
        )

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """Mask of the observations that are rejected by size alone, without a cause, shape (n,)."""
        outliers = self.initial_status.are(USED) & ~self.fit.used
        outliers[list(self.reasons)] = False
        return outliers

    @property
    def ended(self) -> bool:
        """True if fit and editing ended; parameters may be undetermined."""
        return self.complete and self.fit.status in (FitStatus.CONVERGED, FitStatus.UNOBSERVABLE)

    @property
    def converged(self) -> bool:
        """True if fit and editing ended and every parameter is determined."""
        return self.complete and self.fit.converged


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
) -> EditedFit:
    """Fit parameters and reject outliers, observations whose residuals exceed a threshold in expected sigmas.

    A robust estimate, or `previous`, gives the first selection. Fit and selection then alternate until the selection
    stays the same. The limit of residuals scales with the median spread of all usable observations, so rejections do
    not tighten it. `status` has the reasons why observations are not usable; without a threshold none is rejected.
    """
    if threshold is not None and not threshold >= _MIN_THRESHOLD:
        raise InputError(f"threshold: expected {_MIN_THRESHOLD:g} sigmas or more, got {threshold}")
    if previous is None:
        x = parameters.prior_values if start is None else start
        at_x = evaluate(residual_function, x)
    else:
        x, at_x = previous.fit.x, previous.fit.linearization
    process = getattr(at_x, "process", None)
    n = len(at_x.residual_m)
    noise = ObservationCovariance.from_sigma(sigma_m, n)
    initial_status = _initial_labels(status, n)
    usable = initial_status.are(USED)
    usable_count = int(usable.sum())
    # Parameters with a-priori information take no observation.
    free_count = int((parameters.free & np.isinf(parameters.prior_sigmas)).sum())

    def fit(used: NDArray[np.bool_], start: Floats, at_start: Linearization) -> FitResult:
        return fit_least_squares(
            residual_function, parameters, noise, used=used, start=start, linearization=at_start
        )

    def spread(residual_m: Floats) -> float:
        return robust_scale(residual_m[usable] / noise.sigma_m[usable], free_count)

    # An outlier is detectable only if the other observations are redundant.
    max_rejected = min(int(_MAX_REJECTED_FRACTION * usable_count), usable_count - free_count - 1)
    if threshold is None or max_rejected < 1:
        result = fit(usable, x, at_x)
        return EditedFit(result, initial_status, spread(result.residual_m))

    if previous is not None:
        residual_m = previous.fit.residual_m
    elif process is not None:  # an orbit starts near the estimate
        residual_m = at_x.residual_m - process.effects_m(process.reference)
    else:
        x, at_x = robust_start(residual_function, parameters, noise.sigma_m, usable, at_x, x)
        residual_m = at_x.residual_m
    scale = spread(residual_m)
    selections: list[NDArray[np.bool_]] = []
    previous_fit = None if previous is None else previous.fit
    while True:
        limit_m = threshold * max(1.0, scale) * noise.sigma_m
        # The leverage of process noise is not in the partials.
        if previous_fit is not None and process is None:
            limit_m = _studentized_limits(previous_fit, residual_m, limit_m, usable)
        used = usable & (np.abs(residual_m) <= limit_m)
        if selections and np.array_equal(used, selections[-1]):
            return EditedFit(result, initial_status, scale, len(selections))
        used, message = _break_rejection_cycle(used, selections)
        complete = True
        rejected_count = usable_count - int(used.sum())
        if rejected_count > max_rejected:
            used, complete = usable, False
            message = (
                f"{rejected_count} of {usable_count} observations exceed {threshold:g} sigmas, more than the limit of "
                f"{max_rejected}, so none is rejected: check stations, sigmas and model"
            )
        elif len(selections) >= _MAX_PASSES:
            complete, message = False, f"the editing did not settle in {_MAX_PASSES} passes"
        previous_fit = result = fit(used, x, at_x)
        scale = spread(result.residual_m)
        selections.append(used)
        if message or result.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
            return EditedFit(result, initial_status, scale, len(selections), complete, message)
        x, at_x, residual_m = result.x, result.linearization, result.residual_m


def _studentized_limits(
    fit: FitResult, residual_m: Floats, limit_m: Floats, usable: NDArray[np.bool_]
) -> Floats:
    """Limits of studentized residuals (n,), m (Baarda 1968).

    With the leverage h, the variance of the residual of an observation of variance s^2 is (1 - h) s^2, or (1 + h) s^2
    if it is rejected. With limits of unscaled residuals, rejections of observations of high leverage would depend on
    the start of the fit (`tests/unit/jobs/test_locate.py`).
    """
    order = row_order(fit.linearization)
    large = order[(usable & (np.abs(residual_m) > _MIN_STUDENTIZED_RATIO * limit_m))[order]]
    unit_partials, limit_m = fit.unit_partials(), limit_m.copy()
    for part in slices(len(large)):
        rows = large[part]
        leverage = np.square(unit_partials(rows)).sum(axis=1) / fit.sigma_m[rows] ** 2
        ratio = np.sqrt(np.where(fit.used[rows], np.maximum(1.0 - leverage, 0.0), 1.0 + leverage))
        limit_m[rows] *= np.clip(ratio, _MIN_STUDENTIZED_RATIO, 1.0 / _MIN_STUDENTIZED_RATIO)
    return limit_m


def _break_rejection_cycle(
    used: NDArray[np.bool_], selections: list[NDArray[np.bool_]]
) -> tuple[NDArray[np.bool_], str]:
    """Return the selection; for one that repeats, the intersection of its cycle with a message.

    Without this rule, the editing of residuals with heavy tails can alternate for ever, in 5 of 200 cases of
    `tests/unit/estimation/test_editing.py`.
    """
    start = next((k for k, selection in enumerate(selections) if np.array_equal(used, selection)), None)
    if start is None:
        return used, ""
    cycle = np.array(selections[start:])
    common = np.asarray(cycle.all(axis=0))
    count = int((cycle.any(axis=0) & ~common).sum())
    return (
        common,
        f"{count} observations at the outlier limit alternate between used and rejected; all are rejected",
    )


def with_reasons(status: Labels, reasons: Mapping[int, str]) -> Labels:
    """Return labels with the reasons of some rows in place of their texts."""
    codes = status.codes.copy()
    codes[list(reasons)] = len(status.texts) + np.arange(len(reasons))
    return Labels.coded((*status.texts, *reasons.values()), codes)


def _initial_labels(status: ArrayLike | Labels | None, n: int) -> Labels:
    """Labels of n observations before the fit; an empty text is :data:`USED`."""
    if status is None:
        return Labels(np.zeros(n, dtype=np.int32), (USED,))
    labels = Labels.from_texts(status)
    if labels.codes.shape != (n,):
        raise InputError(f"status: expected shape ({n},), got {labels.codes.shape}")
    return Labels.coded([text or USED for text in labels.texts], labels.codes)


def outlier_reason(residual_m: float, expected_m: float) -> str:
    """Reason for a rejection by size, such as "outlier: 19.021 m is 612 times its expected 0.031 m"."""
    ratio = abs(residual_m) / expected_m
    times = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
    return f"outlier: {_format_length(abs(residual_m))} m is {times} times its expected {_format_length(expected_m)} m"


def _format_length(value_m: float) -> str:
    """Format a length to the millimetre, or to two digits if that is finer."""
    if value_m >= 0.01:
        return f"{value_m:.3f}"
    return np.format_float_positional(value_m, precision=2, unique=False, fractional=False)


def outlier_runs(edited: EditedFit, order: SeriesOrder) -> list[Rows]:
    """Rows, in order of time, of each run of outliers: successive ones of a series with residuals of one sign."""
    rows = order.order[edited.initial_status.are(USED)[order.order]]
    outlier = edited.outliers[rows]
    is_first = changed(order.code[rows], np.where(outlier, np.sign(edited.fit.residual_m[rows]), 0.0))
    runs = np.split(np.arange(len(rows)), np.flatnonzero(is_first)[1:])
    return [rows[run] for run in runs if len(run) >= _MIN_RUN_COUNT and outlier[run[0]]]


def run_reasons(edited: EditedFit, runs: Iterable[Rows]) -> dict[int, str]:
    """Reason, by row, for the rejection of the observations of runs of outliers."""
    reasons = dict[int, str]()
    for rows in runs:
        mean_m = float(edited.fit.residual_m[rows].mean())
        size = f"{'-' if mean_m < 0.0 else '+'}{_format_length(abs(mean_m))} m"
        reasons |= dict.fromkeys(
            rows.tolist(), f"outlier, one of {len(rows)} in succession, {size} in the mean"
        )
    return reasons


@dataclass(frozen=True, slots=True, eq=False)
class PhaseCounts:
    """Phase counts of n observations; NaN for observations of other types."""

    count_s: Floats  # (n,), count interval
    cycle_m: Floats  # (n,), wavelength of the downlink, by which a cycle changes the value


def phase_faults(edited: EditedFit, order: SeriesOrder, counts: PhaseCounts) -> dict[int, str]:
    """Reasons, by row, of counts with a cycle slip and of rejected counts of a wrong signal.

    Residuals are compared with the scatter of their pass. Compared with the stated sigmas, slips
    of one cycle would stay in the fit, and rejected counts before the lock would have no cause
    (`tests/unit/estimation/test_phase_editing.py`).
    """
    usable = edited.initial_status.are(USED) & ~np.isnan(counts.count_s)
    rows = order.order[usable[order.order]]
    code, time_s = order.code[rows], order.time_s[rows]
    reasons: dict[int, str] = {}
    for series in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(code)) + 1) if len(rows) else ():
        steps_s = np.diff(time_s[series])
        median_step_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        gap = steps_s > max(_MIN_GAP_S, _MIN_GAP_STEPS * median_step_s)
        for pass_rows in np.split(rows[series], np.flatnonzero(gap) + 1):
            reasons |= dict(_pass_faults(edited, pass_rows, counts))
    return reasons


def _pass_faults(edited: EditedFit, rows: Rows, counts: PhaseCounts) -> Iterator[tuple[int, str]]:
    """Rows and reasons of one pass in order of time."""
    residual_m, used = edited.fit.residual_m[rows], edited.fit.used[rows]
    sigma_m = edited.fit.sigma_m[rows] * max(1.0, edited.robust_scale)
    if used.sum() >= _MIN_PASS_COUNTS:
        residual_m = residual_m - np.median(residual_m[used])
        sigma_m = np.clip(robust_scale(residual_m[used], 1), _ROUNDING_M, sigma_m)
    cycle_m = counts.cycle_m[rows]
    cycles = np.rint(residual_m / cycle_m)
    cycle_count = np.abs(cycles)
    is_whole = np.abs(residual_m - cycles * cycle_m) <= _SLIP_TOLERANCE_SIGMAS * sigma_m
    is_slip = (
        is_whole
        & (cycle_count >= 1.0)
        & (cycle_count <= _SLIP_MAX_CYCLES)
        & (_SLIP_TOLERANCE_SIGMAS * sigma_m <= _SLIP_MAX_TOLERANCE_CYCLES * cycle_m)
    )
    for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(used)) + 1):
        offset_m = residual_m[run]
        at_border = run[0] == 0 or run[-1] == len(rows) - 1
        is_large = (
            np.median(np.abs(offset_m) / np.maximum(sigma_m[run], _ROUNDING_M)) > _WRONG_SIGNAL_MIN_SIGMAS
        )
        has_one_sign = len(run) >= _WRONG_SIGNAL_MIN_COUNTS and abs(np.sign(offset_m).sum()) == len(run)
        rate_m_s = float(np.median(offset_m / counts.count_s[rows[run]]))
        is_frequency = is_large and abs(rate_m_s) > _WRONG_SIGNAL_MIN_RATE_M_S
        if not used[run[0]] and is_frequency and (has_one_sign or (at_border and not is_slip[run].any())):
            cause = "not locked to the uplink" if at_border else "not locked to this uplink for a while"
            for row in run.tolist():
                yield int(rows[row]), f"{cause}: {_format_frequency(rate_m_s, float(cycle_m[row]))} off"
        else:
            for row in run[is_slip[run]].tolist():
                yield (
                    int(rows[row]),
                    f"cycle slip of {cycle_count[row]:.0f} cycle{'s' * int(cycle_count[row] > 1.0)}",
                )


def _format_frequency(rate_m_s: float, cycle_m: float) -> str:
    """Format an error of the range rate as a frequency, or as a rate without a wavelength."""
    if np.isnan(cycle_m):
        return f"{abs(rate_m_s):.3g} m/s"
    frequency_hz = abs(rate_m_s) / cycle_m
    return f"{1e-3 * frequency_hz:.3g} kHz" if frequency_hz >= 1e3 else f"{frequency_hz:.3g} Hz"
