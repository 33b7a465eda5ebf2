"""Residuals over time, one panel for each station."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Residuals, Solution
from radioloc.estimation.statistics import group_statistics
from radioloc.plotting.crowds import CROWD_NOTE, MOST_MARKS, MOST_POINTS, apart, draw_spans
from radioloc.plotting.figures import (
    COLORS,
    REJECTED_COLOR,
    date_axis,
    length_unit,
    new_figure,
    panel_title,
    style_axes,
    utc_dates,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TITLE = "observed \N{MINUS SIGN} computed"
_MAX_PANELS = 12
_PANEL_HEIGHT_IN = 1.75
# Panels share a scale unless one would be squeezed by more than this.
_MAX_HEIGHT_RATIO = 4.0


def plot_residuals(solution: Solution | Residuals, title: str | None = None) -> Figure:
    """Draw residuals over time, one panel for each station.

    Bars are the stated sigmas. Of more than 5000 observations of a station bars show by spans of time from where to
    where they reach, as a line below says. Observations left out are red crosses, or triangles at the edge where they
    are beyond a panel, which is scaled to the used ones. Ranges have a second scale for the one-way equivalent. Of more
    than twelve stations those with the most observations are drawn, as a line below then says.

    Parameters
    ----------
    solution : Solution or Residuals
        What to draw.
    title : str, optional
        Title; the solution's name by default.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with :func:`~radioloc.plotting.save_figure`.

    Raises
    ------
    InputError
        There are no observations.
    """
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    stations = residuals.stations.present()
    notes = []
    if len(stations) > _MAX_PANELS:
        notes.append(f"{_MAX_PANELS} of {len(stations)} stations, those with the most observations")
        counts = [int(residuals.stations.are(station).sum()) for station in stations]
        largest = np.argsort(-np.array(counts), kind="stable")[:_MAX_PANELS]
        stations = tuple(stations[k] for k in sorted(largest.tolist()))
    if title is None:
        title = (f"{solution.name}: " if isinstance(solution, Solution) else "") + _TITLE

    dates = utc_dates(residuals.epoch_utc)
    half_heights_m = [_half_height(residuals, residuals.stations.are(station)) for station in stations]
    if max(half_heights_m) <= _MAX_HEIGHT_RATIO * min(half_heights_m):
        half_heights_m = [max(half_heights_m)] * len(stations)
    figure = new_figure(8.0, 1.1 + _PANEL_HEIGHT_IN * len(stations))
    panels = figure.subplots(len(stations), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axes, station) in enumerate(zip(panels, stations, strict=True)):
        _draw_station(axes, residuals, dates, station, COLORS[k % len(COLORS)], half_heights_m[k])
    date_axis(panels[-1], dates)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    if any(residuals.used[residuals.stations.are(station)].sum() > MOST_POINTS for station in stations):
        notes.append(CROWD_NOTE)
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color="0.4")
    return figure


def _draw_station(
    axes: Axes,
    residuals: Residuals,
    dates: NDArray[np.datetime64],
    station: str,
    color: str,
    half_height_m: float,
) -> None:
    mine = residuals.stations.are(station)
    used = mine & residuals.used
    out = mine & ~residuals.used
    factor, unit = length_unit(half_height_m)
    y = factor * residuals.residual_m
    limit = factor * half_height_m
    style_axes(axes)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    statistics = group_statistics(station, residuals.residual_m[mine], residuals.sigma_m[mine], used[mine])
    label = f"{statistics.used} used"
    if statistics.wrms_m is not None:
        label += f", wrms {factor * statistics.wrms_m:.3g} {unit}"
    limits = dates.min(), dates.max()
    handles: list[Any] = []
    if statistics.used > MOST_POINTS:
        handles.append(draw_spans(axes, dates[used], y[used], limits, color=color, label=label))
    else:
        handles.append(
            axes.errorbar(
                dates[used],
                y[used],
                yerr=factor * residuals.sigma_m[used],
                fmt="o",
                markersize=3.2,
                color=color,
                markeredgecolor="white",
                markeredgewidth=0.3,
                elinewidth=0.7,
                alpha=0.85,
                label=label,
            )
        )
    beyond = np.abs(residuals.residual_m) > half_height_m
    above, below = beyond & (residuals.residual_m > 0.0), beyond & (residuals.residual_m < 0.0)
    for which, marker, name in (
        (out & ~beyond, "x", "left out"),
        (out & above, "^", "left out, above"),
        (out & below, "v", "left out, below"),
    ):
        if which.any():
            shown = np.clip(y[which], -0.93 * limit, 0.93 * limit) if marker != "x" else y[which]
            style: dict[str, Any] = {
                "marker": marker,
                "color": REJECTED_COLOR,
                "markersize": 5,
                "linestyle": "none",
            }
            some = apart(dates[which], shown, limits, 2.0 * limit)
            style["rasterized"] = len(some) > MOST_MARKS
            handles += axes.plot(dates[which][some], shown[some], label=f"{which.sum()} {name}", **style)
    axes.set_ylim(-limit, limit)
    axes.set_ylabel(f"light path ({unit})", fontsize=8)
    if residuals.types.are("range")[mine].all():
        one_way = axes.secondary_yaxis("right", functions=(_halved, _doubled))
        one_way.set_ylabel(f"one way ({unit})", fontsize=8, color="0.4")
        one_way.tick_params(labelsize=8, color="0.4", labelcolor="0.4")
        one_way.spines["right"].set_visible(False)
    panel_title(axes, station, "left", fontsize=9, fontweight="bold", color=color)
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        ncols=len(handles),
        fontsize=8,
        frameon=False,
        handletextpad=0.3,
        borderpad=0.0,
    )


def _halved(values: Any) -> Any:
    return np.asarray(values) * 0.5


def _doubled(values: Any) -> Any:
    return np.asarray(values) * 2.0


def _half_height(residuals: Residuals, mine: NDArray[np.bool_]) -> float:
    """Half the height of a panel, m: what holds the used residuals, or all of them if none was used."""
    used = mine & residuals.used
    shown = used if used.any() else mine
    reach_m = np.abs(residuals.residual_m[shown]) + residuals.sigma_m[shown]
    return 1.15 * float(reach_m.max())
