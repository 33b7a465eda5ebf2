"""Outlier editing: what does not fit is left out, with the reason kept, and let in when it fits again.

Of a counted phase what goes wrong is told by its name. A receiver that loses the phase for a moment finds it again some
whole cycles off: one count is wrong by these, however long it is, and those before and after are right. A receiver that
follows another signal than the one it is said to follow, as in the first seconds of a pass before the uplink is up, or
after another station took over, is off in frequency, in all counts from there on or up to there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.gauss_markov import SeriesWeight
from radioloc.estimation.least_squares import FitResult, FitStatus, fit_least_squares
from radioloc.estimation.linearization import Linearization, ResidualFunction, evaluate, row_order
from radioloc.estimation.robust import robust_start
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import robust_scale
from radioloc.labels import USED, Labels
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.whitening import Rows, slices
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

THRESHOLD = 5.0  # expected sigmas beyond which a residual is an outlier: of normal ones one in 1.7 million

_MIN_THRESHOLD = 2.0

_MOST_REJECTED = 0.3
"""Largest part of the usable observations that is rejected: more outliers mean a wrong model, station or sigma. Without
it 40 of 100 wrong ranges are cut away in silence (`tests/unit/estimation/test_editing.py`)."""

_MAX_PASSES = 20
_MIN_STUDENTIZED_RATIO = 0.2  # of the sigma of a residual to that of its observation: leverages up to 0.96

_SLIP_TOLERANCE_SIGMAS = 5.0  # within which a residual is one of whole cycles
_SLIP_MAX_TOLERANCE_CYCLES = 0.15  # that the tolerance may be: else any residual is near to a whole number
_SLIP_MAX_CYCLES = 1000.0  # more cycles at once are another frequency
_SILENCE_S, _SILENCE_STEPS = 300.0, 10.0  # without a count, after which the lock is a new one
_MIN_PASS_COUNTS = 10  # of a pass that shows its own scatter
_WRONG_SIGNAL_MIN_COUNTS = 3  # on end that are off together: a frequency, not a slip
_WRONG_SIGNAL_MIN_SIGMAS = 30.0  # less can be the air near the horizon
_WRONG_SIGNAL_MIN_RATE_M_S = 0.03  # 1e-10 of the frequency; less, on end, is an error of the model
_ROUNDING_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """Fit with its editing."""

    fit: FitResult  # the final one
    given: Labels  # status before the fit: USED or the reason why an observation cannot be
    robust_scale: (
        float  # spread of usable residuals over their stated sigmas by the median, 1 where those are right
    )
    passes: int = 1  # number of fits made
    complete: bool = True  # whether the editing settled on a set of observations
    message: str = ""  # what went wrong or is worth knowing
    # Standard deviations: added in quadrature to every stated one of a group; of stations' errors that delays share,
    # found from the residuals.
    additive_sigma_m: Mapping[str, float] = field(default_factory=dict)
    shared_sigma_m: Mapping[str, float] = field(default_factory=dict)
    series_weights: tuple[SeriesWeight, ...] = ()  # weighed as fewer observations, being correlated in time
    reasons: Mapping[int, str] = field(default_factory=dict)  # by row, for outliers, beyond their size

    @property
    def status(self) -> Labels:
        """:data:`USED` or the reason why an observation was left out, of length n."""
        out = np.flatnonzero(self.given.are(USED) & ~self.fit.used)
        residual_m = self.fit.residual_m[out]
        expected_m = self.fit.sigma_m[out] * max(1.0, self.robust_scale)
        sizes = zip(out.tolist(), residual_m.tolist(), expected_m.tolist(), strict=True)
        return with_reasons(
            self.given, {row: self.reasons.get(row) or outlier_reason(*size) for row, *size in sizes}
        )

    @property
    def ended(self) -> bool:
        """Whether fit and editing came to their end; not everything need be determined."""
        return self.complete and self.fit.status in (FitStatus.CONVERGED, FitStatus.UNOBSERVABLE)

    @property
    def converged(self) -> bool:
        """Whether the fit converged, everything is determined, and the editing settled."""
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
    """Fit, leaving out gross errors.

    A robust estimate (:func:`~radioloc.estimation.robust.robust_start`) gives the first guess of what is an
    outlier; then fit and selection alternate until the selection no longer changes. The spread is taken by
    the median over all usable observations, kept or not, so leaving some out does not tighten the limit for
    the rest. An observation that shares errors with others is judged, as any other, by its own standard deviation,
    all its errors together. A gross error that is small beside the shared ones stays in, and shows in the sum of
    squares.

    Parameters
    ----------
    residual_function : callable
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    parameters : ParameterSet
        What is solved for.
    sigma_m : array_like, shape (n,) or (), or ObservationCovariance
        Stated standard deviations of the observations, m; or their noise where they share errors.
    status : array_like of str, shape (n,), or Labels, optional
        Observations to leave out from the beginning have the reason here, such as ``"below the horizon"``;
        the others :data:`USED` or an empty text.
    threshold : float or None
        An observation is left out when its residual exceeds this many expected sigmas. Expected is the stated sigma,
        or more where the residuals as a whole spread more than stated. None are left out where ``None``.
    previous : EditedFit, optional
        A fit of the same observations with other sigmas, from which to start in place of a robust start.

    start : ndarray, shape (p,), optional
        Where to begin, if not at the a-priori values.

    Returns
    -------
    EditedFit

    Raises
    ------
    InputError
        The threshold is below 2; others as for :func:`~radioloc.estimation.least_squares.fit_least_squares`.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.estimation import Parameter, ParameterSet, fit_with_editing
    >>> parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m/h", "bias")])
    >>> hours = np.arange(20.0)
    >>> design = np.column_stack([np.ones(20), hours])
    >>> observed = 3.0 + 0.5 * hours + 0.01 * np.cos(2.0 * hours) + 9.0 * (hours == 7.0)
    >>> edited = fit_with_editing(lambda x: (observed - design @ x, design), parameters, sigma_m=0.01)
    >>> edited.fit.x.round(2).tolist(), np.flatnonzero(~edited.fit.used).tolist()
    ([3.0, 0.5], [7])
    """
    if threshold is not None and not threshold >= _MIN_THRESHOLD:
        raise InputError(f"an outlier threshold of {threshold} sigmas cuts good data; give 2 or more")
    if previous is None:
        x = parameters.prior_values if start is None else start
        at_x = evaluate(residual_function, x)
    else:
        x, at_x = previous.fit.x, previous.fit.linearization
    process = getattr(at_x, "process", None)
    n = len(at_x.residual_m)
    noise = ObservationCovariance.of(sigma_m, n)
    given = _given(status, n)
    usable = given.are(USED)
    n_usable = int(usable.sum())
    # Those with an a-priori value do without an observation.
    n_free = int((parameters.free & np.isinf(parameters.prior_sigmas)).sum())

    def fit(used: NDArray[np.bool_], start: Floats, at_start: Linearization) -> FitResult:
        return fit_least_squares(
            residual_function, parameters, noise, used=used, start=start, linearization=at_start
        )

    def spread(residual_m: Floats) -> float:
        return robust_scale(residual_m[usable] / noise.sigma_m[usable], n_free)

    # An outlier can be told from the rest only if at least one observation is left over without it.
    most = min(int(_MOST_REJECTED * n_usable), n_usable - n_free - 1)
    if threshold is None or most < 1:
        result = fit(usable, x, at_x)
        return EditedFit(result, given, spread(result.residual_m))

    if previous is not None:
        residual_m = previous.fit.residual_m
    elif process is not None:  # an orbit begins near the estimate
        residual_m = at_x.residual_m - process.effects_m(process.reference)
    else:
        x, at_x = robust_start(residual_function, parameters, noise.sigma_m, usable, at_x, x)
        residual_m = at_x.residual_m
    scale = spread(residual_m)
    seen: list[NDArray[np.bool_]] = []
    latest = None if previous is None else previous.fit
    while True:
        limit_m = threshold * max(1.0, scale) * noise.sigma_m
        if latest is not None and process is None:  # whose share in the leverage is not in the partials
            limit_m = _studentized(latest, residual_m, limit_m, usable)
        used = usable & (np.abs(residual_m) <= limit_m)
        if seen and np.array_equal(used, seen[-1]):
            return EditedFit(result, given, scale, len(seen))
        used, message = _break_rejection_cycle(used, seen)
        complete = True
        n_rejected = n_usable - int(used.sum())
        if n_rejected > most:
            used, complete = usable, False
            message = (
                f"{n_rejected} of {n_usable} observations exceed {threshold:g} sigmas, more than the "
                f"{most} that may be left out, so none was: check stations, sigmas and model"
            )
        elif len(seen) >= _MAX_PASSES:
            complete, message = False, f"the editing did not settle in {_MAX_PASSES} passes"
        latest = result = fit(used, x, at_x)
        scale = spread(result.residual_m)
        seen.append(used)
        if message or result.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
            return EditedFit(result, given, scale, len(seen), complete, message)
        x, at_x, residual_m = result.x, result.linearization, result.residual_m


def _studentized(fit: FitResult, residual_m: Floats, limit_m: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Limits for residuals of a fit (n,), m, with the leverage of each observation in the estimate (Baarda 1968).

    With the leverage h, the variance of a residual is 1 - h of that of the observation, or 1 + h where it is not used.
    Without it an outlier of high leverage stays in or out with the start (`tests/unit/jobs/test_locate.py`).
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
    used: NDArray[np.bool_], seen: list[NDArray[np.bool_]]
) -> tuple[NDArray[np.bool_], str]:
    """A selection and no text; or, where selections repeat, the intersection of all of the cycle, and why.

    Without it 5 of 200 fits of residuals with heavy tails do not end (`tests/unit/estimation/test_editing.py`).
    """
    first = next((k for k, earlier in enumerate(seen) if np.array_equal(used, earlier)), None)
    if first is None:
        return used, ""
    cycle = np.array(seen[first:])
    kept = np.asarray(cycle.all(axis=0))
    count = int((cycle.any(axis=0) & ~kept).sum())
    return kept, f"{count} observations at the outlier limit were left out, in and out by turns"


def with_reasons(status: Labels, reasons: Mapping[int, str]) -> Labels:
    """The same with other texts for some rows."""
    codes = status.codes.copy()
    codes[list(reasons)] = len(status.texts) + np.arange(len(reasons))
    return Labels.coded((*status.texts, *reasons.values()), codes)


def _given(status: ArrayLike | Labels | None, n: int) -> Labels:
    """What was said of n observations before the fit; an empty text is :data:`USED`."""
    if status is None:
        return Labels(np.zeros(n, dtype=np.int32), (USED,))
    given = Labels.of(status)
    if given.codes.shape != (n,):
        raise InputError(f"status has shape {given.codes.shape}; {n} observations need ({n},)")
    return Labels.coded([text or USED for text in given.texts], given.codes)


def outlier_reason(residual_m: float, expected_m: float) -> str:
    """Say why one is left out, such as "outlier: 19.021 m is 612 times its expected 0.031 m"."""
    ratio = abs(residual_m) / expected_m
    times = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
    return f"outlier: {_metres(abs(residual_m))} m is {times} times its expected {_metres(expected_m)} m"


def _metres(value_m: float) -> str:
    """Text to the millimetre, or to two digits where that is finer."""
    if value_m >= 0.01:
        return f"{value_m:.3f}"
    return np.format_float_positional(value_m, precision=2, unique=False, fractional=False)


@dataclass(frozen=True, slots=True, eq=False)
class PhaseCounts:
    """Count intervals, s, and wavelengths of the downlink, m, of n observations that count a phase; NaN where none."""

    count_s: Floats
    cycle_m: Floats  # a cycle adds as much to the value


def phase_faults(edited: EditedFit, order: SeriesOrder, counts: PhaseCounts) -> dict[int, str]:
    """Rows of counts with a cycle slip, or rejected ones of another frequency, and why.

    Slips are recognised by the scatter of their own pass. Without it a slip of one cycle that a sigma hides stays
    in the fit, and counts before the lock have no reason (`tests/unit/estimation/test_phase_editing.py`).
    """
    usable = edited.given.are(USED) & ~np.isnan(counts.count_s)
    rows = order.order[usable[order.order]]
    code, time_s = order.code[rows], order.time_s[rows]
    found: dict[int, str] = {}
    for series in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(code)) + 1) if len(rows) else ():
        steps_s = np.diff(time_s[series])
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        silent = steps_s > max(_SILENCE_S, _SILENCE_STEPS * usual_s)
        for one in np.split(rows[series], np.flatnonzero(silent) + 1):
            found |= dict(_of_pass(edited, one, counts))
    return found


def _of_pass(edited: EditedFit, rows: Rows, counts: PhaseCounts) -> Iterator[tuple[int, str]]:
    """Those of one pass, in order of time."""
    residual_m, used = edited.fit.residual_m[rows], edited.fit.used[rows]
    sigma_m = edited.fit.sigma_m[rows] * max(1.0, edited.robust_scale)
    if used.sum() >= _MIN_PASS_COUNTS:
        residual_m = residual_m - np.median(residual_m[used])
        sigma_m = np.clip(robust_scale(residual_m[used], 1), _ROUNDING_M, sigma_m)
    cycle_m = counts.cycle_m[rows]
    cycles = np.rint(residual_m / cycle_m)
    size = np.abs(cycles)
    whole = np.abs(residual_m - cycles * cycle_m) <= _SLIP_TOLERANCE_SIGMAS * sigma_m
    slips = (
        whole
        & (size >= 1.0)
        & (size <= _SLIP_MAX_CYCLES)
        & (_SLIP_TOLERANCE_SIGMAS * sigma_m <= _SLIP_MAX_TOLERANCE_CYCLES * cycle_m)
    )
    for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(used)) + 1):
        off_m = residual_m[run]
        at_border = run[0] == 0 or run[-1] == len(rows) - 1
        far = np.median(np.abs(off_m) / np.maximum(sigma_m[run], _ROUNDING_M)) > _WRONG_SIGNAL_MIN_SIGMAS
        lasts = len(run) >= _WRONG_SIGNAL_MIN_COUNTS and abs(np.sign(off_m).sum()) == len(run)
        off_m_s = float(np.median(off_m / counts.count_s[rows[run]]))
        other = far and abs(off_m_s) > _WRONG_SIGNAL_MIN_RATE_M_S
        if not used[run[0]] and other and (lasts or (at_border and not slips[run].any())):
            what = "not locked to the uplink" if at_border else "not locked to this uplink for a while"
            for k in run.tolist():
                yield int(rows[k]), f"{what}: {_frequency(off_m_s, float(cycle_m[k]))} off"
        else:
            for k in run[slips[run]].tolist():
                yield int(rows[k]), f"cycle slip of {size[k]:.0f} cycle{'s' * int(size[k] > 1.0)}"


def _frequency(off_m_s: float, cycle_m: float) -> str:
    """An error of a rate as a frequency, or as it is where the wavelength is not known."""
    if np.isnan(cycle_m):
        return f"{abs(off_m_s):.3g} m/s"
    off_hz = abs(off_m_s) / cycle_m
    return f"{1e-3 * off_hz:.3g} kHz" if off_hz >= 1e3 else f"{off_hz:.3g} Hz"
