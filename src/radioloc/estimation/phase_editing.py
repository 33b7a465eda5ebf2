"""What goes wrong with a counted phase, by its residuals: cycle slips, and counts that were not locked to the uplink.

A receiver that loses the phase for a moment finds it again some whole cycles off: one count is wrong by these, however
long it is, and those before and after are right. A receiver that follows another signal than the one it is said to
follow, as in the first seconds of a pass before the uplink is up, or after another station took over, is off in
frequency, in all counts from there on or up to there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditedFit
from radioloc.estimation.labels import USED
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import robust_scale

_Floats = NDArray[np.float64]
_Rows = NDArray[np.intp]

_SIGMAS = 5.0
"""Sigmas within which a residual is one of whole cycles."""
_CLEAR = 0.15
"""Part of a cycle that so many sigmas may be at most: else any residual is near to a whole number."""
_MOST_CYCLES = 1000.0
"""More cycles at once are no slip, but another frequency."""
_SILENT_S, _SILENT_STEPS = 300.0, 10.0
"""Time without a count, s and in the median time from one to the next, after which the lock is a new one."""
_FEWEST = 10
"""Counts of a pass from which on it tells its own scatter."""
_RUN = 3
"""Counts on end that are off together: that is a frequency, not a slip."""
_FAR = 30.0
"""Sigmas by which they are off: less can be the air near the horizon. One count may be longer than the time without
lock."""
_OTHER_M_S = 0.03
"""Rate from which on the signal was another one, 1e-10 of its frequency; less, on end, is an error of the model."""
_ROUNDING_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PhaseCounts:
    """What is known of n observations as counts of a phase.

    Parameters
    ----------
    count_s : ndarray, shape (n,)
        Count interval, s; NaN where nothing is counted.
    cycle_m : ndarray, shape (n,)
        What a cycle adds to the value, m: the wavelength of the signal on its way down; NaN where that is not known.
    """

    count_s: _Floats
    cycle_m: _Floats


def phase_faults(edited: EditedFit, order: SeriesOrder, counts: PhaseCounts) -> dict[int, str]:
    """Counts with a cycle slip, used or left out, and others left out that were of another frequency: why, by row.

    Slips are told by the scatter of their own pass, so a stated sigma that is too large does not hide them.
    """
    usable = edited.given.are(USED) & ~np.isnan(counts.count_s)
    rows = order.order[usable[order.order]]
    code, time_s = order.code[rows], order.time_s[rows]
    found: dict[int, str] = {}
    for series in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(code)) + 1) if len(rows) else ():
        steps_s = np.diff(time_s[series])
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        silent = steps_s > max(_SILENT_S, _SILENT_STEPS * usual_s)
        for one in np.split(rows[series], np.flatnonzero(silent) + 1):
            found |= dict(_of_pass(edited, one, counts))
    return found


def _of_pass(edited: EditedFit, rows: _Rows, counts: PhaseCounts) -> Iterator[tuple[int, str]]:
    """Those of one pass, in order of time."""
    residual_m, used = edited.fit.residual_m[rows], edited.fit.used[rows]
    sigma_m = edited.fit.sigma_m[rows] * max(1.0, edited.robust_scale)
    if used.sum() >= _FEWEST:
        residual_m = residual_m - np.median(residual_m[used])
        sigma_m = np.clip(robust_scale(residual_m[used], 1), _ROUNDING_M, sigma_m)
    cycle_m = counts.cycle_m[rows]
    cycles = np.rint(residual_m / cycle_m)
    size = np.abs(cycles)
    whole = np.abs(residual_m - cycles * cycle_m) <= _SIGMAS * sigma_m
    slips = whole & (size >= 1.0) & (size <= _MOST_CYCLES) & (_SIGMAS * sigma_m <= _CLEAR * cycle_m)
    for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(used)) + 1):
        off_m = residual_m[run]
        at_border = run[0] == 0 or run[-1] == len(rows) - 1
        far = np.median(np.abs(off_m) / np.maximum(sigma_m[run], _ROUNDING_M)) > _FAR
        lasts = len(run) >= _RUN and abs(np.sign(off_m).sum()) == len(run)
        off_m_s = float(np.median(off_m / counts.count_s[rows[run]]))
        other = far and abs(off_m_s) > _OTHER_M_S
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
