"""Residuals over time in one panel: dots, or where there are too many to tell apart, their envelope.

More dots than a panel has columns of pixels hide each other. The envelope shows, for each short bin of time, the range
of the values, so that none is missed, and in a darker colour their mean and standard deviation, which dots would hide.
Observations that were left out are all drawn, but for those that would lie within a pixel of another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Dates = NDArray[np.datetime64]
Limits = tuple[np.datetime64, np.datetime64]

MOST_POINTS = 5000
"""More in one panel are drawn as an envelope."""
BINS = 400
"""Bins of time in the width of a panel."""
MOST_MARKS = 800
"""More marks in one panel are drawn as an image within a vector file, one for each pixel that has any."""
PLACES = (2000, 1000)
"""Places in the width and the height of a panel, which are finer than its pixels."""
ENVELOPE_NOTE = (
    f"bars: minimum to maximum in 1/{BINS} of the time; dark: mean \N{PLUS-MINUS SIGN} standard deviation"
)
"""What a figure with an envelope says of it."""
REJECTED_COLOR = "#B00020"
_EDGE = 0.93  # where, in half heights, observations beyond it are shown


class Envelope(NamedTuple):
    """What many values are in each bin of time that has any: its middle, how many, their range, mean and deviation."""

    middle: Dates
    counts: NDArray[np.intp]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


def envelope_of(dates: Dates, values: NDArray[np.float64], limits: Limits) -> Envelope:
    """Put many values into bins of time."""
    place = bin_of(dates, limits)
    count = np.bincount(place, minlength=BINS)
    there = count > 0
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, place, values)
    np.maximum.at(highest, place, values)
    mean = np.bincount(place, values, BINS)[there] / count[there]
    squares = np.bincount(place, (values - mean[np.cumsum(there)[place] - 1]) ** 2, BINS)[there]
    deviation = np.sqrt(squares / count[there])
    middle = limits[0] + (np.flatnonzero(there) + 0.5) / BINS * (limits[1] - limits[0])
    return Envelope(middle, count[there], lowest[there], highest[there], mean, deviation)


def draw_envelope(
    axes: Axes, dates: Dates, values: NDArray[np.float64], limits: Limits, *, color: str, label: str
) -> Any:
    """Draw the envelope of many points and return the handle for a legend."""
    middle, _, lowest, highest, mean, deviation = envelope_of(dates, values, limits)
    # Side by side: as wide as a bin, in points of 1/72 inch; an image, so that vector files stay small.
    width = 72.0 * axes.get_window_extent().width / axes.figure.dpi / BINS
    style: dict[str, Any] = {"color": color, "linewidth": max(width, 0.5), "solid_capstyle": "butt"}
    style |= {"snap": False, "rasterized": True}
    axes.plot(*_bars(middle, lowest, highest), alpha=0.35, **style)
    [dark] = axes.plot(*_bars(middle, mean - deviation, mean + deviation), alpha=0.7, label=label, **style)
    return dark


def draw_left_out(
    axes: Axes,
    dates: Dates,
    values: NDArray[np.float64],
    limits: Limits,
    middle: float,
    half_height: float,
    size: float,
) -> list[Any]:
    """Mark what was left out, beyond the panel by triangles at its edge; return the handles, labelled by how many."""
    away, edge = values - middle, _EDGE * half_height
    beyond = np.abs(away) > edge
    handles = []
    for which, marker, name in (
        (~beyond, "x", "left out"),
        (beyond & (away > 0.0), "^", "left out, above"),
        (beyond & (away < 0.0), "v", "left out, below"),
    ):
        if not which.any():
            continue
        shown = middle + np.clip(away[which], -edge, edge)
        some = apart(dates[which], shown, limits, 2.0 * half_height)
        handles += axes.plot(
            dates[which][some],
            shown[some],
            marker,
            color=REJECTED_COLOR,
            markersize=size,
            linestyle="none",
            rasterized=len(some) > MOST_MARKS,
            label=f"{which.sum()} {name}",
        )
    return handles


def _bars(
    dates: Dates, low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[Dates, NDArray[np.float64]]:
    """Upright bars as one line with gaps, which is drawn many times as quickly as a line each."""
    return np.repeat(dates, 3), np.stack([low, high, np.full(len(low), np.nan)], axis=-1).ravel()


def apart(dates: Dates, values: NDArray[np.float64], limits: Limits, height: float) -> NDArray[np.intp]:
    """Indices of points of which no two would be drawn on one pixel: all if they are few, else one of each place."""
    if len(dates) <= MOST_MARKS:
        return np.arange(len(dates))
    across, up = PLACES
    column = np.floor(_part_of(dates, limits) * across)
    row = np.floor(values / height * up)
    _, first = np.unique(column * (2 * up + 1) + row, return_index=True)
    return np.sort(first)


def bin_of(dates: Dates, limits: Limits) -> NDArray[np.intp]:
    """Number of the bin of time that each date is in, 0 to BINS - 1."""
    return np.minimum((_part_of(dates, limits) * BINS).astype(np.intp), BINS - 1)


def _part_of(dates: Dates, limits: Limits) -> NDArray[np.float64]:
    """How far from the first to the last date of a panel, 0 to 1."""
    whole = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part: NDArray[np.float64] = (dates - limits[0]) / np.timedelta64(1, "ms") / whole
    return part
