"""Points by the hundred thousand: what a dot each would show, without drawing them all.

More dots than a panel has columns of pixels hide each other. Of each short span of time the panel then shows from where
to where the points reach, so that none can be missed, and in a darker colour their mean and standard deviation, which
the dots would hide. Points with a mark of their own, as observations left out have, are all drawn, but for those that
would lie within a pixel of another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 5000
"""More in one panel are drawn by spans."""
SPANS = 400
"""Spans of time in the width of a panel."""
MOST_MARKS = 800
"""More in one panel are a picture within a file of lines, and drawn once where they would be drawn on one pixel."""
PLACES = (2000, 1000)
"""Places in the width and in the height of a panel, which are less than pixels."""
CROWD_NOTE = (
    f"bars: all of 1/{SPANS} of the time, lowest to highest; "
    "dark: mean \N{PLUS-MINUS SIGN} standard deviation"
)
"""What a figure with spans says of them."""


def draw_spans(
    axes: Axes,
    dates: NDArray[np.datetime64],
    values: NDArray[np.float64],
    limits: tuple[np.datetime64, np.datetime64],
    *,
    color: str,
    label: str,
) -> Any:
    """Draw many points by spans of time and return the handle for a legend.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    dates : ndarray of datetime64, shape (n,)
    values : ndarray, shape (n,)
    limits : tuple of datetime64
        First and last date of the panel, which all spans together fill.
    color, label : str
    """
    span = span_of(dates, limits)
    count = np.bincount(span, minlength=SPANS)
    there = count > 0
    lowest, highest = np.full(SPANS, np.inf), np.full(SPANS, -np.inf)
    np.minimum.at(lowest, span, values)
    np.maximum.at(highest, span, values)
    mean = np.bincount(span, values, SPANS)[there] / count[there]
    spread = np.sqrt(
        np.bincount(span, (values - mean[np.cumsum(there)[span] - 1]) ** 2, SPANS)[there] / count[there]
    )
    middle = limits[0] + (np.flatnonzero(there) + 0.5) / SPANS * (limits[1] - limits[0])
    # Side by side: as wide as a span, in points of 1/72 inch.
    width = 72.0 * axes.get_window_extent().width / axes.figure.dpi / SPANS
    # A picture within a file of lines, which otherwise grows with every panel.
    style: dict[str, Any] = {
        "color": color,
        "linewidth": max(width, 0.5),
        "solid_capstyle": "butt",
        "snap": False,
        "rasterized": True,
    }
    axes.plot(*_bars(middle, lowest[there], highest[there]), alpha=0.35, **style)
    [dark] = axes.plot(*_bars(middle, mean - spread, mean + spread), alpha=0.7, label=label, **style)
    return dark


def _bars(
    dates: NDArray[np.datetime64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.datetime64], NDArray[np.float64]]:
    """Upright bars as one line with gaps, which is drawn many times as quickly as a line each."""
    return np.repeat(dates, 3), np.stack([low, high, np.full(len(low), np.nan)], axis=-1).ravel()


def apart(
    dates: NDArray[np.datetime64],
    values: NDArray[np.float64],
    limits: tuple[np.datetime64, np.datetime64],
    height: float,
) -> NDArray[np.intp]:
    """Points of which no two would be drawn on the same pixel, as indices: one of each place; all if they are few.

    Parameters
    ----------
    dates : ndarray of datetime64, shape (n,)
    values : ndarray, shape (n,)
        Between two numbers that are `height` apart.
    limits : tuple of datetime64
        First and last date of the panel.
    height : float
        Height of the panel, in units of the values.
    """
    if len(dates) <= MOST_MARKS:
        return np.arange(len(dates))
    across, up = PLACES
    column = _part_of(dates, limits) * across
    row = np.floor(values / height * up)
    _, first = np.unique(np.floor(column) * (2 * up + 1) + row, return_index=True)
    return np.sort(first)


def span_of(dates: NDArray[np.datetime64], limits: tuple[np.datetime64, np.datetime64]) -> NDArray[np.intp]:
    """Number of the span of time that each date is in, 0 to SPANS - 1."""
    return np.minimum((_part_of(dates, limits) * SPANS).astype(np.intp), SPANS - 1)


def _part_of(
    dates: NDArray[np.datetime64], limits: tuple[np.datetime64, np.datetime64]
) -> NDArray[np.float64]:
    """How far from the first to the last date of a panel, 0 to 1."""
    whole = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part: NDArray[np.float64] = (dates - limits[0]) / np.timedelta64(1, "ms") / whole
    return part
