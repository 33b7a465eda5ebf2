"""Residuals over time: a panel for each station, or for each baseline and each station that receives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

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
_Dates = NDArray[np.datetime64]
MOST_LINKS = 30
_MAX_HEIGHT_RATIO = 4.0  # panels share a scale unless one would be squeezed by more than this
_LEGEND_STRIP = 1.3  # where a panel with a legend ends below, in half heights
_LONGEST_TITLES = 58  # characters that find room above a panel


class _Layout(NamedTuple):
    """Of a page: most panels, what they are of, columns, inches of a panel and around all, dates, what red means."""

    most: int
    noun: str
    columns: int
    panel_in: tuple[float, float]
    margin_in: tuple[float, float]
    ticks: tuple[int, int]
    left_out: str


_STATIONS = _Layout(12, "stations", 1, (8.0, 1.75), (0.0, 1.1), (4, 9), "")
_LINKS = _Layout(
    MOST_LINKS, "links", 3, (3.7, 1.9), (0.6, 0.9), (3, 6), "red: left out; triangles are beyond the panel"
)


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
    residuals = _residuals_of(solution)
    stations = residuals.stations
    panels = [_Panel(name, "", {"": np.flatnonzero(stations.are(name))}) for name in stations.present()]
    return _grid(solution, title, panels, _STATIONS)


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
    return _grid(solution, title, _link_panels(_residuals_of(solution)), _LINKS)


def _residuals_of(solution: Solution | Residuals) -> Residuals:
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    return residuals


def _grid(
    solution: Solution | Residuals, title: str | None, panels: Sequence[_Panel], layout: _Layout
) -> Figure:
    """A grid of panels over one axis of dates, and below it what is not said in them."""
    residuals = _residuals_of(solution)
    if title is None:
        name = f"{solution.name}: " if isinstance(solution, Solution) else ""
        title = f"{name}observed \N{MINUS SIGN} computed"
    notes = []
    if len(panels) > layout.most:
        notes = [f"{layout.most} of {len(panels)} {layout.noun}, those with the most observations"]
        largest = np.argsort([-len(panel.all_rows) for panel in panels], kind="stable")[: layout.most]
        panels = [panels[k] for k in sorted(largest.tolist())]
    n_columns = min(layout.columns, len(panels))
    n_rows = -(-len(panels) // n_columns)
    width_in, height_in = layout.panel_in
    figure = new_figure(
        width_in * n_columns + layout.margin_in[0], height_in * n_rows + layout.margin_in[1], title
    )
    places = list(figure.subplots(n_rows, n_columns, sharex=True, squeeze=False).flat)
    dates = utc_dates(residuals.epoch_utc)
    for k, (panel, half_height_m) in enumerate(zip(panels, _half_heights(residuals, panels), strict=True)):
        style_axes(places[k])
        places[k].axhline(0.0, color="0.4", linewidth=0.8)
        draw = _draw_links if panel.like else _draw_station
        draw(places[k], residuals, dates, panel, half_height_m, COLORS[k % len(COLORS)])
    for axes in places[len(panels) :]:
        axes.set_visible(False)
    for column in range(n_columns):
        lowest = places[(len(panels) - 1 - column) // n_columns * n_columns + column]
        date_axis(lowest, dates, *layout.ticks)
        lowest.tick_params(labelbottom=True)
    if any(_crowded(residuals, panel) for panel in panels):
        notes.append(ENVELOPE_NOTE)
    color = "0.4" if notes else REJECTED_COLOR
    if layout.left_out and not residuals.used.all():
        notes.append(layout.left_out)
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color=color)
    return figure


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
    words = kind.removeprefix("vlbi_").replace("one_way", "one-way")
    return words.replace("_", " ").replace("doppler", "Doppler")


def _half_heights(residuals: Residuals, panels: Sequence[_Panel]) -> list[float]:
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
        like_m = [m for other, m in zip(panels, alone_m, strict=True) if other.like == panel.like]
        squeezed = max(like_m) > _MAX_HEIGHT_RATIO * min(like_m)
        out.append(mine_m if squeezed else max(like_m))
    return out


def _draw_station(
    axes: Axes, residuals: Residuals, dates: _Dates, panel: _Panel, half_height_m: float, color: str
) -> None:
    rows = panel.all_rows
    used, out = rows[residuals.used[rows]], rows[~residuals.used[rows]]
    factor, unit = length_unit(half_height_m)
    y, limit, limits = factor * residuals.residual_m, factor * half_height_m, (dates.min(), dates.max())
    statistics = group_statistics(
        panel.title, residuals.residual_m[rows], residuals.sigma_m[rows], residuals.used[rows]
    )
    label = f"{statistics.used} used"
    if statistics.wrms_m is not None:
        label += f", wrms {factor * statistics.wrms_m:.3g} {unit}"
    style: dict[str, Any] = {"color": color, "label": label}
    if _crowded(residuals, panel):
        handles = [draw_envelope(axes, dates[used], y[used], limits, **style)]
    else:
        style |= {"fmt": "o", "markersize": 3.2, "markeredgecolor": "white", "markeredgewidth": 0.3}
        sigma = factor * residuals.sigma_m[used]
        handles = [axes.errorbar(dates[used], y[used], sigma, elinewidth=0.7, alpha=0.85, **style)]
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
    style = {"frameon": False, "borderpad": 0.0, "bbox_to_anchor": (1.0, 0.98), "handletextpad": 0.3}
    axes.legend(handles=handles, loc="lower right", ncols=len(handles), fontsize=8, **style)


def _halved(values: Any) -> Any:
    return np.asarray(values) * 0.5


def _doubled(values: Any) -> Any:
    return np.asarray(values) * 2.0


def _draw_links(
    axes: Axes, residuals: Residuals, dates: _Dates, panel: _Panel, half_height_m: float, _: str
) -> None:
    """A colour for each link; the legend has a strip of its own below, where it hides nothing."""
    factor, unit = length_unit(half_height_m)
    y, used, limit = factor * residuals.residual_m, residuals.used, factor * half_height_m
    limits, crowded = (dates.min(), dates.max()), _crowded(residuals, panel)
    handles: list[Any] = []
    for k, (name, rows) in enumerate(panel.rows.items()):
        kept = rows[used[rows]]
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)], "label": name}
        if crowded:
            handles.append(draw_envelope(axes, dates[kept], y[kept], limits, **style))
        else:
            # Thousands of dots are an image within a vector file, or no viewer opens it.
            handles += axes.plot(dates[kept], y[kept], ".", markersize=2.5, rasterized=True, **style)
    rows = panel.all_rows
    kept, out = rows[used[rows]], rows[~used[rows]]
    draw_left_out(axes, dates[out], y[out], limits, limit, 4)
    axes.set_ylim(-limit * (_LEGEND_STRIP if any(panel.rows) else 1.0), limit)
    axes.set_ylabel(f"residual ({unit})", fontsize=8)
    panel_title(axes, panel.title, "left", fontsize=7.5, fontweight="bold")
    statement = f"{len(kept)} used"
    if len(kept):
        statement += f", rms {np.sqrt(np.mean(y[kept] ** 2)):#.3g} {unit}"
    if len(out):
        statement += f", {len(out)} left out"
    size = 6.5 if len(panel.title) + len(statement) < _LONGEST_TITLES else 5.2
    panel_title(axes, statement, "right", fontsize=size)
    if any(panel.rows):
        style = {"framealpha": 0.85, "edgecolor": "none", "borderpad": 0.2, "handletextpad": 0.1}
        axes.legend(
            handles=handles, loc="lower right", fontsize=7, ncols=len(handles), markerscale=2.5, **style
        )
