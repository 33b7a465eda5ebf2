"""Elevation of a point on the Moon upper stations, and when they see it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.quantities import DateLike, accepts_quantities
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
    start_utc: DateLike,
    stop_utc: DateLike,
    masks: Masks | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the elevation of a target at stations, and the times when each and all of them see it.

    Parameters
    ----------
    model, target_pa_m, stations, start_utc, stop_utc, masks
        Arguments of :func:`~radioloc.simulation.windows`, which documents the errors.

    Returns
    -------
    matplotlib.figure.Figure
        Elevations are thick where target and station see each other upper the masks. A rise or a set is drawn to a
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
        raise InputError("stations: expected at least one")
    masks = masks or Masks()
    limits = utc_to_tai(epochs_from_strings([start_utc, stop_utc], "UTC"))
    length_s = float(limits[1].seconds_since(limits[0])[0])
    if length_s <= 0.0:
        raise InputError(f"stop_utc: expected a date after {start_utc}, got {stop_utc}")
    tai = limits[0].shifted(np.linspace(0.0, length_s, _EPOCH_COUNT))
    elevation = elevations(model, target_pa_m, stations, tai_to_tt(tai))
    dates = utc_dates(tai_to_utc(tai))
    visible = elevation.margin_rad(masks) >= 0.0
    names = list(elevation.stations)
    figure = several_panels(ax, 8.4, 4.4 + 0.22 * len(names), "elevation and visibility")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 0.6 + 0.22 * len(names)))
    for axes in (upper, lower):
        style_axes(axes)
    elevation_deg = np.degrees(elevation.at_station_rad)
    step = dates[1] - dates[0]
    rows = {name: visible[:, k] for k, name in enumerate(names)} | {"all": visible.all(axis=1)}
    for k, (name, in_view) in enumerate(rows.items()):
        color = COLORS[k % (len(COLORS) - 1)] if name in names else "0.3"
        if name in names:
            upper.plot(dates, elevation_deg[:, k], color=color, linewidth=0.7, alpha=0.6)
            curve = np.where(in_view, elevation_deg[:, k], np.nan)
            upper.plot(dates, curve, color=color, linewidth=2.2, label=name)
        first, last = np.flatnonzero(np.diff(in_view, prepend=False, append=False)).reshape(-1, 2).T
        spans = np.maximum(dates[last - 1] - dates[first], step)
        for start, span in zip(dates[first], spans, strict=True):
            lower.barh(k, span, left=start, height=0.6, color=color)
        if not len(spans):
            note: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7}
            lower.annotate("never", (dates[0], k), (3, 0), **note)
    for mask_deg in sorted({masks.for_station(name) for name in names}):
        upper.axhline(mask_deg, color="0.4", linewidth=0.9, linestyle="--")
        upper.annotate(
            f"mask {mask_deg:g}", (dates[0], mask_deg), (2, 2), textcoords="offset points", fontsize=7
        )
    upper.axhline(0.0, color="0.4", linewidth=0.8)
    upper.set_ylim(
        min(-5.0, max(-20.0, float(elevation_deg.min()))), min(90.0, float(elevation_deg.max()) + 8.0)
    )
    upper.set_ylabel("elevation (deg)")
    upper.legend(
        fontsize=8, frameon=False, ncols=5, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderpad=0.0
    )
    lower.set_yticks(range(len(rows)), list(rows))
    lower.set_ylim(len(rows) - 0.5, -0.5)
    lower.set_xlim(dates[0], dates[-1])
    date_axes([upper, lower], dates)
    return figure.figure
