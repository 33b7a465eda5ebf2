"""Dates below panels over time; where weeks or years without data lie between data, they are cut out."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Floats = NDArray[np.float64]
_LONG = 0.2  # of the whole span, and
_LONG_DAYS = 10.0  # a gap that may be cut out
_MOST_DATA = (
    0.25  # of the whole span: if data fill more than this beside the long gaps, they are no thin bands
)
_LEAST_WIDTH = 0.3  # of all that have data: the narrowest part
_GAP_WIDTH = 0.05
_PAD_DAYS = 0.02
_YEAR_DAYS = 365.25


def date_axes(
    panels: Sequence[Axes], dates: NDArray[np.datetime64], ticks: tuple[int, int] = (4, 9), columns: int = 1
) -> None:
    """Label the horizontal axes with UTC dates, as many as fit, below the lowest panel of each column of a grid.

    The panels share their horizontal axis. Where all data lie in a small part of the span, the gaps between are cut
    out; a grey band with its length stands for each.
    """
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

    axis, parts = panels[0].xaxis, _parts(np.asarray(date2num(dates)))
    if len(parts) > 1:
        _cut_out_gaps(panels, parts, ticks[1])
    else:
        locator = AutoDateLocator(minticks=ticks[0], maxticks=ticks[1])
        axis.set_major_locator(locator)
        axis.set_major_formatter(ConciseDateFormatter(locator))
    if dates.min() == dates.max():
        hour = np.timedelta64(1, "h")
        panels[0].set_xlim(dates.min() - hour, dates.max() + hour)
    for column in range(columns):
        lowest = panels[(len(panels) - 1 - column) // columns * columns + column]
        lowest.tick_params(labelbottom=True)
        lowest.xaxis.get_offset_text().set_fontsize(8)
        lowest.set_xlabel("UTC")


def _parts(days: _Floats) -> _Floats:
    """First and last date of what lies between the gaps that are cut out, shape (n, 2)."""
    days = np.unique(days)
    steps, span = np.diff(days), days[-1] - days[0]
    cut = np.flatnonzero(steps > max(_LONG * span, _LONG_DAYS))
    if span - steps[cut].sum() > _MOST_DATA * span:
        cut = cut[:0]
    return np.stack([days[[0, *(cut + 1)]], days[[*cut, -1]]], axis=1)


def _cut_out_gaps(panels: Sequence[Axes], parts: _Floats, most_ticks: int) -> None:
    """Draw each part in its scale and gaps as narrow bands."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, num2date

    pad = 0.08 * np.diff(parts, axis=1) + _PAD_DAYS
    edges = parts + pad * [-1.0, 1.0]
    length = np.diff(edges, axis=1)
    width = np.maximum(length, _LEAST_WIDTH * length.sum())
    steps = np.column_stack([width, np.full_like(width, _GAP_WIDTH * width.sum())]).ravel()[:-1]
    # Beyond the ends, where limits may be for a moment, the scale is that of the first and the last part.
    days = np.concatenate([edges[0, :1] - length[0], edges.ravel(), edges[-1, 1:] + length[-1]])
    drawn = np.concatenate([-width[0], [0.0], np.cumsum(steps), steps.sum() + width[-1]])
    panels[0].set_xscale(
        "function", functions=(lambda x: np.interp(x, days, drawn), lambda u: np.interp(u, drawn, days))
    )
    panels[0].set_xlim(edges[0, 0], edges[-1, 1])
    places: list[float] = []
    labels: list[str] = []
    for (first, last), share in zip(edges, (width / width.sum()).ravel(), strict=True):
        most = max(3, round(share * most_ticks))
        locator = AutoDateLocator(
            minticks=(most - 1) // 2, maxticks=most
        )  # more of the least, and it may find none
        # Whatever the version of matplotlib, the ticks of a locator may lie outside.
        ticks = locator.tick_values(num2date(first), num2date(last))
        inside = [day for day in ticks if first <= day <= last]
        inside = inside or [0.5 * (first + last)]
        texts = ConciseDateFormatter(locator).format_ticks(inside)
        places += inside
        labels += [f"{texts[0]}\n{_not_said(texts[0], num2date(inside[0]))}", *texts[1:]]
    panels[0].set_xticks(places, labels)
    for before, after in zip(edges[:-1, 1], edges[1:, 0], strict=True):
        gap_days = after - before
        years = gap_days > 2.0 * _YEAR_DAYS
        for axes in panels:
            axes.axvspan(before, after, color="0.94", linewidth=0.0, zorder=0.5)
            axes.text(
                before + 0.5 * gap_days,
                0.5,
                f"{gap_days / _YEAR_DAYS:.1f} years" if years else f"{gap_days:.0f} days",
                transform=axes.get_xaxis_transform(),
                rotation=90.0,
                fontsize=7,
                color="0.4",
                ha="center",
                va="center",
            )


def _not_said(label: str, date: datetime) -> str:
    """What the label of a tick, a year, a month, a day or a time, does not say of its date."""
    if ":" in label:
        return f"{date:%Y-%m-%d}"
    if label.isalpha():
        return f"{date:%Y}"
    return "" if len(label) == len("2024") else f"{date:%b %Y}"
