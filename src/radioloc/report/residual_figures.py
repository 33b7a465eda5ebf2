"""Residuals over time: a panel for each station, or for each baseline and each station that receives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS
from radioloc.report.date_axis import date_axes
from radioloc.report.envelope import ENVELOPE_NOTE, MOST_POINTS, REJECTED_COLOR, draw_envelope, draw_left_out
from radioloc.report.figures import (
    COLORS,
    columns_for,
    length_unit,
    panel_title,
    several_panels,
    style_axes,
    utc_dates,
)
from radioloc.report.link_names import ways

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Rows = NDArray[np.intp]
MOST_LINKS = 30
_MAX_HEIGHT_RATIO = 4.0  # panels share a scale unless one would be squeezed by more than this
_LEGEND_STRIP = 1.3  # where a panel with a legend ends below, in half heights
_LONGEST_TITLES = 58  # characters that find room above a panel
_LONGEST_NAMES = 44  # characters of links that find room above a station's panel, beside numbers
_LEAST_PART = 0.3  # of a panel about zero that residuals fill, or else it is about their middle


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


class Panel:
    """What one panel shows: its title, which panels share its scale, which rows by the name of their link.

    A panel of a station, in which bars must find room, shares its scale with all others. Where its observations are all
    of one way, or were given without a path, its only link has no name.
    """

    def __init__(self, residuals: Residuals, title: str, like: str, links: dict[str, _Rows]) -> None:
        self.title, self.like, self.links = title, like, links
        self.rows = np.concatenate(list(links.values()))
        used = residuals.used[self.rows]
        self.used, self.out = self.rows[used], self.rows[~used]
        self.crowded = len(self.used) > MOST_POINTS
        shown = self.used if len(self.used) else self.rows
        residual_m, sigma_m = residuals.residual_m[shown], residuals.sigma_m[shown]
        bar_m = 0.0 if like else sigma_m
        lowest_m, highest_m = float((residual_m - bar_m).min()), float((residual_m + bar_m).max())
        # About zero, but where residuals would be a thin band far from it.
        about_zero_m = max(-lowest_m, highest_m, float(np.median(sigma_m)))
        thin = len(shown) > 1 and highest_m - lowest_m < 2.0 * _LEAST_PART * about_zero_m
        self.middle_m = 0.5 * (lowest_m + highest_m) if thin and lowest_m * highest_m > 0.0 else 0.0
        self.half_height_m = 1.15 * (
            max(0.5 * (highest_m - lowest_m), float(np.median(sigma_m))) if self.middle_m else about_zero_m
        )
        self.statistics = residuals.statistics(title, self.rows)

    def statement(self, factor: float, unit: str) -> str:
        """How many are used and their rms, in a unit that is a factor from metres; of links, how many are left out."""
        found = self.statistics
        text = f"{found.used} used"
        size_m = found.rms_m if self.like else found.wrms_m
        if size_m is not None:
            size = f"{factor * size_m:#.3g}" if self.like else f"{factor * size_m:.3g}"
            text += f", {'rms' if self.like else 'wrms'} {size} {unit}"
        return f"{text}, {found.rejected} left out" if self.like and found.rejected else text


def plot_residuals(
    solution: Solution | Residuals, title: str | None = None, ax: Axes | None = None
) -> Figure:
    """Draw residuals over time, one panel for each station.

    Bars are the stated sigmas; of more than 5000 observations of a station the envelope is drawn, as a line below says.
    Observations left out are red crosses, or triangles at the edge where they are beyond a panel, which is scaled to
    the used ones. Ranges have a second scale for the one-way equivalent, counts of one interval one of rates. Of more
    than twelve stations those with the most observations are drawn, as a line below then says.

    Parameters
    ----------
    solution : Solution or Residuals
        What to draw.
    title : str, optional
        Title; the solution's name by default.
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

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
    return _grid(solution, title, ax, station_panels(tracking_of(solution)), _STATIONS)


def plot_links(solution: Solution | Residuals, title: str | None = None, ax: Axes | None = None) -> Figure:
    """Draw residuals over time, a panel for each VLBI baseline and for each station that receives ranges or Doppler.

    Two- and three-way ranges of a station have colours of their own. Panels of a kind share a scale. Of more than
    thirty links those with the most observations are drawn. All else is as in :func:`plot_residuals`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.residuals(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.plot_links(solution)
    >>> figure.axes[0].get_title(loc="left")
    'range APOLLO'
    """
    return _grid(solution, title, ax, link_panels(tracking_of(solution)), _LINKS)


def residuals_of(solution: Solution | Residuals) -> Residuals:
    """The residuals of a solution, or those given; an error where there are none."""
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    return residuals


def station_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by station, and by the way of their signal where there are several."""
    stations = residuals.stations
    return [
        Panel(residuals, name, "", _by_way(residuals, np.flatnonzero(stations.are(name))))
        for name in stations.present()
    ]


def _of_maps(residuals: Residuals) -> NDArray[np.bool_]:
    """Which residuals are of places on maps."""
    return residuals.types.are("map_east") | residuals.types.are("map_north")


def tracking_of(solution: Solution | Residuals) -> Residuals:
    """All residuals but those of places on maps, of which two numbers say all; these where there are no others."""
    residuals = residuals_of(solution)
    of_maps = _of_maps(residuals)
    return residuals.select(~of_maps) if of_maps.any() and not of_maps.all() else residuals


def _places(residuals: Residuals) -> list[str]:
    """What a line below a figure says of places on maps."""
    found: dict[str, list[str]] = {}
    for k in np.flatnonzero(_of_maps(residuals)).tolist():
        axis = residuals.types[[k]][0].removeprefix("map_")
        away = f"{axis} {residuals.residual_m[k]:+.3g} m"
        found.setdefault(residuals.paths[[k]][0], []).append(away)
    return [f"place {path}: {', '.join(away)}" for path, away in found.items()]


def _by_way(residuals: Residuals, rows: _Rows) -> dict[str, _Rows]:
    """Rows of a station by the way of their signal; nameless where that is one, or too many for a legend."""
    codes = residuals.paths.codes[rows]
    present = np.unique(codes).tolist()
    if len(present) == 1:
        return {"": rows}
    names = dict(zip(present, ways([Link.from_path(residuals.paths.texts[k]) for k in present]), strict=True))
    if sum(map(len, set(names.values()))) > _LONGEST_NAMES:
        return {"": rows}
    named = np.array([names[code] for code in codes.tolist()])
    return {name: rows[named == name] for name in sorted(set(names.values()), reverse=True)}


def link_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by type and by baseline or receiver, baselines first."""
    found: dict[tuple[bool, int, str], dict[str, _Rows]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    named, keys = ways(links), types.codes * len(links) + paths.codes
    for key in np.unique(keys):
        kind, k = types.texts[key // len(links)], key % len(links)
        if kind not in KINDS:
            raise InputError(f"type {kind!r} of an observation is not known; use {', '.join(KINDS)}")
        place = not links[k].differenced, KINDS.index(kind), links[k].place
        found.setdefault(place, {})[named[k]] = np.flatnonzero(keys == key)
    return [
        Panel(
            residuals,
            f"{kind_word(KINDS[kind])} {place}",
            KINDS[kind],
            dict(sorted(rows.items(), reverse=True)),
        )
        for (_, kind, place), rows in sorted(found.items(), key=lambda item: item[0])
    ]


def half_heights_m(panels: Sequence[Panel]) -> list[float]:
    """Half the height of each panel, the same for those that are alike unless one would be squeezed."""
    heights_m = []
    for panel in panels:
        like_m = [other.half_height_m for other in panels if other.like == panel.like]
        squeezed = max(like_m) > _MAX_HEIGHT_RATIO * min(like_m)
        heights_m.append(panel.half_height_m if squeezed else max(like_m))
    return heights_m


def kind_word(kind: str) -> str:
    """A type of measurement in words, short."""
    words = kind.removeprefix("vlbi_").replace("one_way", "one-way")
    return words.replace("_", " ").replace("doppler", "Doppler")


def _grid(
    solution: Solution | Residuals,
    title: str | None,
    ax: Axes | None,
    panels: Sequence[Panel],
    layout: _Layout,
) -> Figure:
    """A grid of panels over one axis of dates, and below it what is not said in them."""
    residuals = tracking_of(solution)
    if title is None:
        name = f"{solution.name}: " if isinstance(solution, Solution) else ""
        title = f"{name}observed \N{MINUS SIGN} computed"
    notes = _places(residuals_of(solution))
    if len(panels) > layout.most:
        notes += [f"{layout.most} of {len(panels)} {layout.noun}, those with the most observations"]
        largest = np.argsort([-len(panel.rows) for panel in panels], kind="stable")[: layout.most]
        panels = [panels[k] for k in sorted(largest.tolist())]
    n_columns = columns_for(len(panels), layout.columns)
    n_rows = -(-len(panels) // n_columns)
    width_in, height_in = np.multiply(layout.panel_in, (n_columns, n_rows)) + layout.margin_in
    figure = several_panels(ax, width_in, height_in, title)
    places = list(figure.subplots(n_rows, n_columns, sharex=True, squeeze=False).flat)
    dates = utc_dates(residuals.epoch_utc)
    for k, (panel, half_height_m) in enumerate(zip(panels, half_heights_m(panels), strict=True)):
        _draw(places[k], residuals, dates, panel, half_height_m, COLORS[k % len(COLORS)])
    for axes in places[len(panels) :]:
        axes.set_visible(False)
    date_axes(places[: len(panels)], dates, layout.ticks, n_columns)
    if any(panel.crowded for panel in panels):
        notes.append(ENVELOPE_NOTE)
    color = "0.4" if notes else REJECTED_COLOR
    if layout.left_out and not residuals.used.all():
        notes.append(layout.left_out)
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color=color)
    return figure.figure


def _count_of_all(residuals: Residuals, rows: _Rows) -> float | None:
    """The count interval of some observations, s, if all are counts and have the same."""
    if residuals.count_s is None:
        return None
    counts_s = np.unique(residuals.count_s[rows])
    return float(counts_s[0]) if len(counts_s) == 1 and np.isfinite(counts_s[0]) else None


def _second_scale(axes: Axes, label: str, factor: float) -> None:
    """A scale on the right that is a factor times that on the left."""
    forth, back = partial(np.multiply, factor), partial(np.multiply, 1.0 / factor)
    other = axes.secondary_yaxis("right", functions=(forth, back))
    other.set_ylabel(label, fontsize=8, color="0.4")
    other.tick_params(labelsize=8, color="0.4", labelcolor="0.4")
    other.spines["right"].set_visible(False)


def _draw(
    axes: Axes,
    residuals: Residuals,
    dates: NDArray[np.datetime64],
    panel: Panel,
    half_height_m: float,
    color: str,
) -> None:
    """Residuals of one panel: of a station in its colour, with bars; of each link in a colour of its own."""
    style_axes(axes)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    factor, unit = length_unit(abs(panel.middle_m) + half_height_m)
    y, limits = factor * residuals.residual_m, (dates.min(), dates.max())
    middle, half_height = factor * panel.middle_m, factor * half_height_m
    several = len(panel.links) > 1
    statement = panel.statement(factor, unit)
    handles: list[Any] = []
    for k, (name, rows) in enumerate(panel.links.items()):
        kept = rows[residuals.used[rows]]
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)] if panel.like or several else color}
        style["label"] = name if panel.like or several else statement
        if panel.crowded:
            handles.append(draw_envelope(axes, dates[kept], y[kept], limits, **style))
        elif panel.like:
            # Thousands of dots are an image within a vector file, or no viewer opens it.
            handles += axes.plot(dates[kept], y[kept], ".", markersize=2.5, rasterized=True, **style)
        else:
            style |= {"fmt": "o", "markersize": 3.2, "markeredgecolor": "white", "markeredgewidth": 0.3}
            sigma = factor * residuals.sigma_m[kept]
            handles.append(axes.errorbar(dates[kept], y[kept], sigma, elinewidth=0.7, alpha=0.85, **style))
    size = 4 if panel.like else 5
    marks = draw_left_out(axes, dates[panel.out], y[panel.out], limits, middle, half_height, size)
    below = _LEGEND_STRIP if panel.like and any(panel.links) else 1.0
    axes.set_ylim(middle - half_height * below, middle + half_height)
    axes.set_ylabel(f"residual ({unit})", fontsize=8)
    if panel.like:
        panel_title(axes, panel.title, "left", fontsize=7.5, fontweight="bold")
        fontsize = 6.5 if len(panel.title) + len(statement) < _LONGEST_TITLES else 5.2
        panel_title(axes, statement, "right", fontsize=fontsize)
        style = {"framealpha": 0.85, "edgecolor": "none", "borderpad": 0.2, "handletextpad": 0.1}
        style |= {"fontsize": 7, "markerscale": 2.5}
    else:
        handles += marks
        if several:
            handles.insert(0, axes.plot([], [], linestyle="none", label=statement)[0])
        title_color = "black" if several else color
        panel_title(axes, panel.title, "left", fontsize=9, fontweight="bold", color=title_color)
        if residuals.types.are("range")[panel.rows].all():
            axes.set_ylabel(f"round trip ({unit})", fontsize=8)
            _second_scale(axes, f"one way ({unit})", 0.5)
        elif (count_s := _count_of_all(residuals, panel.rows)) is not None:
            _second_scale(axes, "rate of light path (mm/s)", 1e3 / (factor * count_s))
        style = {"frameon": False, "borderpad": 0.0, "bbox_to_anchor": (1.0, 0.98), "handletextpad": 0.3}
        style |= {"fontsize": 8, "columnspacing": 1.2, "handlelength": 1.2}
    if any(panel.links) or not panel.like:
        axes.legend(handles=handles, loc="lower right", ncols=len(handles), **style)
