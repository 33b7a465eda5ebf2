"""Points by the hundred thousand: what a dot each would show, without drawing them all.

More dots than a panel has columns of pixels hide each other. Of each short span of time the panel then shows from where
to where the points reach, so that none can be missed, and in a darker colour their mean and standard deviation, which
the dots would hide.
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
    style: dict[str, Any] = {"color": color, "linewidth": max(width, 0.5), "rasterized": True}
    axes.vlines(middle, lowest[there], highest[there], alpha=0.35, **style)
    return axes.vlines(middle, mean - spread, mean + spread, alpha=0.7, label=label, **style)


def outermost(
    dates: NDArray[np.datetime64], values: NDArray[np.float64], limits: tuple[np.datetime64, np.datetime64]
) -> NDArray[np.intp]:
    """The lowest and the highest point of each span of time, as indices; all points if they are few."""
    if len(dates) <= 2 * SPANS:
        return np.arange(len(dates))
    span = span_of(dates, limits)
    order = np.lexsort((values, span))
    begins = np.flatnonzero(np.diff(span[order], prepend=-1))
    ends = np.append(begins[1:], len(order)) - 1
    return np.unique(order[np.concatenate([begins, ends])])


def span_of(dates: NDArray[np.datetime64], limits: tuple[np.datetime64, np.datetime64]) -> NDArray[np.intp]:
    """Number of the span of time that each date is in, 0 to SPANS - 1."""
    whole = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part = (dates - limits[0]) / np.timedelta64(1, "ms") / whole
    return np.minimum((part * SPANS).astype(np.intp), SPANS - 1)
