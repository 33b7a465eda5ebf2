"""Faults of counted Doppler phase: cycle slips and tracking of a wrong signal.

A *cycle slip*, a short loss of the phase, changes one count by k whole cycles. With residual r, less the median of its
pass, wavelength l of the downlink and standard deviation s, a count has a slip if

    |r - k l| <= 5 s,    1 <= |k| <= 1000,    5 s <= 0.15 l.

*Tracking a wrong signal*, before the uplink starts or after another station takes over, is an error of frequency: it
biases all counts of a run at the begin, at the end or within a pass. A run of rejected counts has this fault if the
median of |r|/s exceeds 30 and that of the range rate |r/T|, with count interval T, exceeds 0.03 m/s.

The standard deviation s is the robust scatter of the pass, at most the stated one. Compared with stated sigmas, slips
of one cycle would stay in the fit (`tests/unit/estimation/test_phase_editing.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import robust_scale
from radioloc.labels import USED, changed
from radioloc.noise.whitening import Rows
from radioloc.vectors import Floats

_MIN_GAP_S, _MIN_GAP_STEPS = 300.0, 10.0  # a longer gap without counts begins a new lock
_MIN_PASS_COUNTS = 10  # counts that determine the scatter of a pass
_ROUNDING_M = 1e-6

_SLIP_TOLERANCE_SIGMAS = 5.0  # distance of a residual from whole cycles
_SLIP_MAX_TOLERANCE_CYCLES = 0.15  # with a larger tolerance nearly every residual is near a whole number
_SLIP_MAX_CYCLES = 1000.0  # more cycles at once are an error of frequency

_WRONG_SIGNAL_MIN_COUNTS = 3  # consecutive counts with one sign of the error; a slip changes one
_WRONG_SIGNAL_MIN_SIGMAS = 30.0  # smaller errors can be the troposphere near the horizon
_WRONG_SIGNAL_MIN_RATE_M_S = 0.03  # 1e-10 of the frequency; smaller lasting errors are those of the model


@dataclass(frozen=True, slots=True, eq=False)
class PhaseCounts:
    """Phase counts of n observations; NaN for observations of other types."""

    count_s: Floats  # (n,), count interval
    wavelength_um: Floats  # (n,), of the downlink: a cycle changes the value by so much


def phase_faults(edited: EditedFit, order: SeriesOrder, counts: PhaseCounts) -> dict[int, str]:
    """Find counts with a cycle slip and rejected counts of a wrong signal; return the reasons by row."""
    usable = edited.initial_status.are(USED) & ~np.isnan(counts.count_s)
    rows = order.order[usable[order.order]]
    reasons: dict[int, str] = {}
    for series_rows in _split_at_changes(rows, order.code[rows]):
        steps_s = np.diff(order.time_s[series_rows])
        median_step_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        is_gap = steps_s > max(_MIN_GAP_S, _MIN_GAP_STEPS * median_step_s)
        for pass_rows in np.split(series_rows, np.flatnonzero(is_gap) + 1):
            reasons |= dict(_pass_faults(edited, pass_rows, counts))
    return reasons


def _pass_faults(edited: EditedFit, rows: Rows, counts: PhaseCounts) -> Iterator[tuple[int, str]]:
    """Yield rows of one pass, in order of time, that have a fault, with the reason."""
    residual_m, used = edited.fit.residual_m[rows], edited.fit.used[rows]
    sigma_m = edited.fit.sigma_m[rows] * max(1.0, edited.robust_scale)
    if used.sum() >= _MIN_PASS_COUNTS:
        residual_m = residual_m - np.median(residual_m[used])
        sigma_m = np.clip(robust_scale(residual_m[used], 1), _ROUNDING_M, sigma_m)

    cycle_m, tolerance_m = 1e-6 * counts.wavelength_um[rows], _SLIP_TOLERANCE_SIGMAS * sigma_m
    cycles = np.rint(residual_m / cycle_m)
    cycle_count = np.abs(cycles)
    is_slip = (
        (np.abs(residual_m - cycles * cycle_m) <= tolerance_m)
        & (cycle_count >= 1.0)
        & (cycle_count <= _SLIP_MAX_CYCLES)
        & (tolerance_m <= _SLIP_MAX_TOLERANCE_CYCLES * cycle_m)
    )
    for run in _split_at_changes(np.arange(len(rows)), used):
        error_m = residual_m[run]
        rate_m_s = float(np.median(error_m / counts.count_s[rows[run]]))
        error_sigmas = np.median(np.abs(error_m) / np.maximum(sigma_m[run], _ROUNDING_M))
        is_frequency_error = (
            not used[run[0]]
            and error_sigmas > _WRONG_SIGNAL_MIN_SIGMAS
            and abs(rate_m_s) > _WRONG_SIGNAL_MIN_RATE_M_S
        )
        has_one_sign = len(run) >= _WRONG_SIGNAL_MIN_COUNTS and abs(np.sign(error_m).sum()) == len(run)
        at_border = run[0] == 0 or run[-1] == len(rows) - 1
        if is_frequency_error and (has_one_sign or (at_border and not is_slip[run].any())):
            cause = "not locked to the uplink" if at_border else "not locked to this uplink for a while"
            for row in run.tolist():
                yield int(rows[row]), f"{cause}: {_format_frequency(rate_m_s, float(cycle_m[row]))} off"
        else:
            for row in run[is_slip[run]].tolist():
                plural = "s" if cycle_count[row] > 1.0 else ""
                yield int(rows[row]), f"cycle slip of {cycle_count[row]:.0f} cycle{plural}"


def _split_at_changes(rows: Rows, values: np.ndarray) -> list[Rows]:
    return np.split(rows, np.flatnonzero(changed(values))[1:]) if len(rows) else []


def _format_frequency(rate_m_s: float, cycle_m: float) -> str:
    """Format an error of the range rate as a frequency, or as a rate without a wavelength."""
    if np.isnan(cycle_m):
        return f"{abs(rate_m_s):.3g} m/s"
    frequency_hz = abs(rate_m_s) / cycle_m
    return f"{1e-3 * frequency_hz:.3g} kHz" if frequency_hz >= 1e3 else f"{frequency_hz:.3g} Hz"
