"""Residuals over time: a panel for each station, or for each baseline and each station that receives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Residuals, Solution
from radioloc.estimation.statistics import group_statistics
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS
from radioloc.report.envelope import ENVELOPE_NOTE, MOST_POINTS, REJECTED_COLOR, draw_envelope, draw_left_out
from radioloc.report.figures import (
    COLORS,
    date_axis,
    length_unit,
    new_figure,
    panel_title,
    style_axes,
    utc_dates,
)
from radioloc.report.link_names import ways

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Rows = NDArray[np.intp]
MOST_STATIONS, MOST_LINKS = 12, 30
"""Panels that fit on a page."""
_COLUMNS = 3
_PANEL_IN = (3.7, 1.9)
_STATION_PANEL_IN = (8.0, 1.75)
_MAX_HEIGHT_RATIO = 4.0  # panels share a scale unless one would be squeezed by more than this
_LEGEND_STRIP = 1.3  # where a panel with a legend ends below, in half heights
_LEFT_OUT = "red: left out; triangles are beyond the panel"
_LONGEST_TITLES = 58  # characters that find room above a panel


@dataclass(frozen=True, slots=True)
class _Panel:
    """What one panel shows: its title, which panels share its scale, and which rows by the name of their link."""

    title: str
    like: str
    rows: dict[str, _Rows]

    @property
    def all_rows(self) -> _Rows:
        return np.concatenate(list(self.rows.values()))


def plot_residuals(solution: Solution | Residuals, title: str | None = None) -> Figure:
    """Draw residuals over time, one panel for each station.

    Bars are the stated sigmas; of more than 5000 observations of a station the envelope is drawn, as a line below says.
    Observations left out are red crosses, or triangles at the edge where they are beyond a panel, which is scaled to
    the used ones. Ranges have a second scale for the one-way equivalent. Of more than twelve stations those with the
    most observations are drawn, as a line below then says.

    Parameters
    ----------
    solution : Solution or Residuals
        What to draw.
    title : str, optional
        Title; the solution's name by default.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        There are no observations.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.plot_residuals(solution)
    >>> figure.axes[0].get_title(loc="left")
    'APOLLO'
    """
    residuals, title = _what(solution, title)
    stations = residuals.stations.present()
    panels = [
        _Panel(station, "", {"": np.flatnonzero(residuals.stations.are(station))}) for station in stations
    ]
    panels, notes = _largest(panels, MOST_STATIONS, "stations")
    half_heights_m = _half_heights(residuals, panels)
    width_in, height_in = _STATION_PANEL_IN
    figure = new_figure(width_in, 1.1 + height_in * len(panels), title)
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    dates = utc_dates(residuals.epoch_utc)
    for k, (axes, panel) in enumerate(zip(grid, panels, strict=True)):
        _draw_station(axes, residuals, dates, panel, COLORS[k % len(COLORS)], half_heights_m[k])
    date_axis(grid[-1], dates)
    _note_below(figure, residuals, panels, notes)
    return figure


def plot_links(solution: Solution | Residuals, title: str | None = None) -> Figure:
    """Draw residuals over time, a panel for each VLBI baseline and for each station that receives ranges or Doppler.

    Two- and three-way ranges of a station have colours of their own. Observations left out are red crosses, or
    triangles at the edge where they are beyond a panel, which is scaled to the used ones. Panels of a kind share a
    scale. Of more than thirty links those with the most observations are drawn, as a line below then says.

    Parameters
    ----------
    solution : Solution or Residuals
        What to draw.
    title : str, optional
        Title; the solution's name by default.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        There are no observations.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.residuals(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.plot_links(solution)
    >>> figure.axes[0].get_title(loc="left")
    'range APOLLO'
    """
    residuals, title = _what(solution, title)
    panels, notes = _largest(_link_panels(residuals), MOST_LINKS, "links")
    half_heights_m = _half_heights(residuals, panels)
    n_columns = min(_COLUMNS, len(panels))
    n_rows = -(-len(panels) // n_columns)
    width_in, height_in = _PANEL_IN
    figure = new_figure(0.6 + width_in * n_columns, 0.9 + height_in * n_rows, title)
    places = list(figure.subplots(n_rows, n_columns, sharex=True, squeeze=False).flat)
    dates = utc_dates(residuals.epoch_utc)
    for axes, panel, half_height_m in zip(places, panels, half_heights_m, strict=False):
        _draw_links(axes, residuals, dates, panel, half_height_m)
    for axes in places[len(panels) :]:
        axes.set_visible(False)
    for column in range(n_columns):
        lowest = places[(len(panels) - 1 - column) // n_columns * n_columns + column]
        date_axis(lowest, dates, minticks=3, maxticks=6)
        lowest.tick_params(labelbottom=True)
    _note_below(figure, residuals, panels, notes, _LEFT_OUT)
    return figure


def _what(solution: Solution | Residuals, title: str | None) -> tuple[Residuals, str]:
    """Residuals to draw and the title above them."""
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    if title is None:
        title = (f"{solution.name}: " if isinstance(solution, Solution) else "") + (
            "observed \N{MINUS SIGN} computed"
        )
    return residuals, title


def _largest(panels: Sequence[_Panel], most: int, noun: str) -> tuple[list[_Panel], list[str]]:
    """The panels with the most observations, in the order given, and what to say of the others."""
    if len(panels) <= most:
        return list(panels), []
    largest = np.argsort([-len(panel.all_rows) for panel in panels], kind="stable")[:most]
    note = f"{most} of {len(panels)} {noun}, those with the most observations"
    return [panels[k] for k in sorted(largest.tolist())], [note]


def _note_below(
    figure: Figure, residuals: Residuals, panels: list[_Panel], notes: list[str], left_out: str = ""
) -> None:
    if any(_crowded(residuals, panel) for panel in panels):
        notes = [*notes, ENVELOPE_NOTE]
    color = "0.4" if notes else REJECTED_COLOR
    if left_out and not residuals.used.all():
        notes = [*notes, left_out]
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color=color)


def _crowded(residuals: Residuals, panel: _Panel) -> bool:
    return int(residuals.used[panel.all_rows].sum()) > MOST_POINTS


def _link_panels(residuals: Residuals) -> list[_Panel]:
    """Group observations by type and by baseline or receiver, baselines first."""
    found: dict[tuple[bool, int, str], dict[str, _Rows]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    keys = types.codes * len(links) + paths.codes
    for key in np.unique(keys):
        kind, k = types.texts[key // len(links)], key % len(links)
        if kind not in KINDS:
            raise InputError(f"type {kind!r} of an observation is not known; use {', '.join(KINDS)}")
        place = not links[k].differenced, KINDS.index(kind), links[k].place
        found.setdefault(place, {})[ways(links)[k]] = np.flatnonzero(keys == key)
    return [
        _Panel(f"{_word(KINDS[kind])} {place}", KINDS[kind], dict(sorted(rows.items(), reverse=True)))
        for (_, kind, place), rows in sorted(found.items(), key=lambda item: item[0])
    ]


def _word(kind: str) -> str:
    return (
        kind.removeprefix("vlbi_")
        .replace("one_way", "one-way")
        .replace("_", " ")
        .replace("doppler", "Doppler")
    )


def _half_heights(residuals: Residuals, panels: list[_Panel]) -> list[float]:
    """Half the height of each panel, m: what holds its used residuals, or all of them if none was used."""
    alone_m = []
    for panel in panels:
        rows = panel.all_rows
        used = rows[residuals.used[rows]]
        shown = used if len(used) else rows
        size_m, sigma_m = np.abs(residuals.residual_m[shown]), residuals.sigma_m[shown]
        # Of a station the bars must find room as well.
        alone_m.append(
            1.15 * float(max(size_m.max(), np.median(sigma_m)) if panel.like else (size_m + sigma_m).max())
        )
    out = []
    for panel, mine_m in zip(panels, alone_m, strict=True):
        alike_m = [m for other, m in zip(panels, alone_m, strict=True) if other.like == panel.like]
        squeezed = max(alike_m) > _MAX_HEIGHT_RATIO * min(alike_m)
        out.append(mine_m if squeezed else max(alike_m))
    return out


def _draw_station(
    axes: Axes,
    residuals: Residuals,
    dates: NDArray[np.datetime64],
    panel: _Panel,
    color: str,
    half_height_m: float,
) -> None:
    rows = panel.all_rows
    used, out = rows[residuals.used[rows]], rows[~residuals.used[rows]]
    factor, unit = length_unit(half_height_m)
    y, limit, limits = factor * residuals.residual_m, factor * half_height_m, (dates.min(), dates.max())
    style_axes(axes)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    statistics = group_statistics(
        panel.title, residuals.residual_m[rows], residuals.sigma_m[rows], residuals.used[rows]
    )
    label = f"{statistics.used} used"
    if statistics.wrms_m is not None:
        label += f", wrms {factor * statistics.wrms_m:.3g} {unit}"
    handles: list[Any]
    if _crowded(residuals, panel):
        handles = [draw_envelope(axes, dates[used], y[used], limits, color=color, label=label)]
    else:
        handles = [
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
        ]
    handles += draw_left_out(axes, dates[out], y[out], limits, limit, 5)
    axes.set_ylim(-limit, limit)
    if residuals.types.are("range")[rows].all():
        axes.set_ylabel(f"round trip ({unit})", fontsize=8)
        one_way = axes.secondary_yaxis("right", functions=(_halved, _doubled))
        one_way.set_ylabel(f"one way ({unit})", fontsize=8, color="0.4")
        one_way.tick_params(labelsize=8, color="0.4", labelcolor="0.4")
        one_way.spines["right"].set_visible(False)
    else:
        axes.set_ylabel(f"residual ({unit})", fontsize=8)
    panel_title(axes, panel.title, "left", fontsize=9, fontweight="bold", color=color)
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


def _draw_links(
    axes: Axes, residuals: Residuals, dates: NDArray[np.datetime64], panel: _Panel, half_height_m: float
) -> None:
    factor, unit = length_unit(half_height_m)
    y, used, limit = factor * residuals.residual_m, residuals.used, factor * half_height_m
    limits, crowded = (dates.min(), dates.max()), _crowded(residuals, panel)
    style_axes(axes)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    handles: list[Any] = []
    for k, (name, rows) in enumerate(panel.rows.items()):
        kept = rows[used[rows]]
        color = COLORS[k % len(COLORS)]
        if crowded:
            handles.append(draw_envelope(axes, dates[kept], y[kept], limits, color=color, label=name))
        else:
            # Thousands of dots are an image within a vector file, or no viewer opens it.
            style: dict[str, Any] = {"markersize": 2.5, "color": color, "rasterized": True, "label": name}
            handles += axes.plot(dates[kept], y[kept], ".", **style)
    out = panel.all_rows[~used[panel.all_rows]]
    draw_left_out(axes, dates[out], y[out], limits, limit, 4)
    # The legend has a strip of its own, where it hides nothing.
    axes.set_ylim(-limit * (_LEGEND_STRIP if any(panel.rows) else 1.0), limit)
    axes.set_ylabel(f"residual ({unit})", fontsize=8)
    panel_title(axes, panel.title, "left", fontsize=7.5, fontweight="bold")
    statement = _statement(residuals, panel.all_rows, factor, unit)
    size = 6.5 if len(panel.title) + len(statement) < _LONGEST_TITLES else 5.2
    panel_title(axes, statement, "right", fontsize=size)
    if any(panel.rows):
        axes.legend(
            handles=handles,
            loc="lower right",
            fontsize=7,
            framealpha=0.85,
            edgecolor="none",
            borderpad=0.2,
            ncols=len(handles),
            handletextpad=0.1,
            markerscale=2.5,
        )


def _statement(residuals: Residuals, rows: _Rows, factor: float, unit: str) -> str:
    """How many observations were used and how far off they are, and how many were left out."""
    used = rows[residuals.used[rows]]
    text = f"{len(used)} used"
    if len(used):
        rms = factor * float(np.sqrt(np.mean(residuals.residual_m[used] ** 2)))
        text += f", rms {rms:#.3g} {unit}"
    left_out = len(rows) - len(used)
    return f"{text}, {left_out} left out" if left_out else text
