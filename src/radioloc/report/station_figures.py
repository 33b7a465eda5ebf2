"""Elevation of a point on the Moon above stations, and when they see it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.quantities import accepts_quantities
from radioloc.report.figures import (
    COLORS,
    date_axes,
    draws_names_literally,
    several_panels,
    style_axes,
    utc_dates,
)
from radioloc.simulation.visibility import Masks, Target, elevations
from radioloc.time import epochs_from_strings, tai_to_tt, tai_to_utc, utc_to_tai

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_EPOCH_COUNT = 721


@draws_names_literally
@accepts_quantities
def plot_visibility(
    model: PhysicalModel,
    target_pa_m: Target,
    stations: Sequence[str],
    start_utc: str,
    stop_utc: str,
    masks: Masks | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the elevation of the target above stations' horizons, and below it when each of them, and all, see it.

    Parameters
    ----------
    model, target_pa_m, stations, start_utc, stop_utc, masks
        As of :func:`~radioloc.simulation.windows`, with its errors.
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure
        Elevations are thick where target and station see each other above the masks. A rise or a set is drawn to a
        720th of the time; :func:`~radioloc.simulation.windows` has them to the second.

    Examples
    --------
    >>> import radioloc
    >>> model = radioloc.measurements.PhysicalModel.build()
    >>> lander = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    >>> lander_pa_m = lander.to_axes("PA", model.ephemeris.constants).xyz_m
    >>> figure = radioloc.report.plot_visibility(
    ...     model, lander_pa_m, ["KASHI", "NEUQUEN"], "2020-12-02T00:00:00", "2020-12-03T00:00:00"
    ... )
    >>> [text.get_text() for text in figure.axes[1].get_yticklabels()]
    ['KASHI', 'NEUQUEN', 'all']
    """
    if not stations:
        raise InputError("no station is given")
    masks = masks or Masks()
    limits = utc_to_tai(epochs_from_strings([start_utc, stop_utc], "UTC"))
    length_s = float(limits[1].seconds_since(limits[0])[0])
    if length_s <= 0.0:
        raise InputError(f"{stop_utc} is not after {start_utc}")
    tai = limits[0].shifted(np.linspace(0.0, length_s, _EPOCH_COUNT))
    found = elevations(model, target_pa_m, stations, tai_to_tt(tai))
    dates = utc_dates(tai_to_utc(tai))
    seen = found.margin_rad(masks) >= 0.0
    names = list(found.stations)
    figure = several_panels(ax, 8.4, 4.4 + 0.22 * len(names), "elevation and visibility")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 0.6 + 0.22 * len(names)))
    for axes in (above, below):
        style_axes(axes)
    elevation_deg = np.degrees(found.at_station_rad)
    step = dates[1] - dates[0]
    rows = {name: seen[:, k] for k, name in enumerate(names)} | {"all": seen.all(axis=1)}
    for k, (name, mine) in enumerate(rows.items()):
        color = COLORS[k % (len(COLORS) - 1)] if name in names else "0.3"
        if name in names:
            above.plot(dates, elevation_deg[:, k], color=color, linewidth=0.7, alpha=0.6)
            there = np.where(mine, elevation_deg[:, k], np.nan)
            above.plot(dates, there, color=color, linewidth=2.2, label=name)
        first, last = np.flatnonzero(np.diff(mine, prepend=False, append=False)).reshape(-1, 2).T
        spans = np.maximum(dates[last - 1] - dates[first], step)
        for start, span in zip(dates[first], spans, strict=True):
            below.barh(k, span, left=start, height=0.6, color=color)
        if not len(spans):
            note: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7}
            below.annotate("never", (dates[0], k), (3, 0), **note)
    for mask_deg in sorted({masks.of(name) for name in names}):
        above.axhline(mask_deg, color="0.4", linewidth=0.9, linestyle="--")
        above.annotate(
            f"mask {mask_deg:g}", (dates[0], mask_deg), (2, 2), textcoords="offset points", fontsize=7
        )
    above.axhline(0.0, color="0.4", linewidth=0.8)
    above.set_ylim(
        min(-5.0, max(-20.0, float(elevation_deg.min()))), min(90.0, float(elevation_deg.max()) + 8.0)
    )
    above.set_ylabel("elevation (deg)")
    above.legend(
        fontsize=8, frameon=False, ncols=5, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderpad=0.0
    )
    below.set_yticks(range(len(rows)), list(rows))
    below.set_ylim(len(rows) - 0.5, -0.5)
    below.set_xlim(dates[0], dates[-1])
    date_axes([above, below], dates)
    return figure.figure
