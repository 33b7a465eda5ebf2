"""Residuals over time, by station or by link, and over their sigmas; effects of the terms of the model.

More dots than a panel has columns of pixels hide each other. The envelope shows, for each short bin of time, the range
of the values, and in a darker colour their mean and standard deviation. All rejected observations are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS
from radioloc.report.figures import (
    COLORS,
    NARROW_TICKS,
    WIDE_TICKS,
    date_axes,
    draws_names_literally,
    legend_outside,
    length_unit,
    panel_grid,
    panel_title,
    utc_dates,
)
from radioloc.results.names import link_names, link_ways
from radioloc.results.solution import Solution
from radioloc.vectors import Floats, Indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Dates = NDArray[np.datetime64]
Limits = tuple[np.datetime64, np.datetime64]

MAX_POINTS = 5000
"""Number of observations in a panel above which the envelope is drawn."""
BINS = 400
"""Number of bins of time in the width of a panel."""
_MAX_HEIGHT_RATIO = 4.0  # ratio of the heights of panels that share a scale
_MAX_NAME_CHARACTERS = 44  # room above the panel of a station
_MIN_FILLED_FRACTION = 0.3  # of a panel about zero; thinner bands are centred


class Panel:
    """Contents of a panel: its title, the type whose panels share its scale, and the rows of each named link."""

    # Panels of stations, which have error bars, share one scale (`like` is empty). An only link has no name.

    def __init__(self, residuals: Residuals, title: str, like: str, links: dict[str, Indices]) -> None:
        self.title, self.like, self.links = title, like, links
        self.rows = np.concatenate(list(links.values()))
        used = residuals.used[self.rows]
        self.used, self.out = self.rows[used], self.rows[~used]
        self.crowded = len(self.used) > MAX_POINTS
        shown = self.used if len(self.used) else self.rows
        residual_m, sigma_m = residuals.residual_m[shown], residuals.sigma_m[shown]
        bar_m = 0.0 if like else sigma_m
        lowest_m, highest_m = float((residual_m - bar_m).min()), float((residual_m + bar_m).max())
        # A thin band far from zero is drawn about its middle.
        about_zero_m = max(-lowest_m, highest_m, float(np.median(sigma_m)))
        thin = len(shown) > 1 and highest_m - lowest_m < 2.0 * _MIN_FILLED_FRACTION * about_zero_m
        self.middle_m = 0.5 * (lowest_m + highest_m) if thin and lowest_m * highest_m > 0.0 else 0.0
        self.half_height_m = 1.15 * (
            max(0.5 * (highest_m - lowest_m), float(np.median(sigma_m))) if self.middle_m else about_zero_m
        )
        self.statistics = residuals.statistics(title, self.rows)

    def statement(self, factor: float, unit: str) -> str:
        """Return counts and rms in words; `factor` converts metres to the unit."""
        statistics = self.statistics
        text = f"{statistics.used} used"
        size_m = statistics.rms_m if self.like else statistics.wrms_m
        if size_m is not None:
            size = f"{factor * size_m:#.3g}" if self.like else f"{factor * size_m:.3g}"
            text += f", {'rms' if self.like else 'wrms'} {size} {unit}"
        return f"{text}, {statistics.rejected} rejected" if self.like and statistics.rejected else text


def solution_residuals(solution: Solution | Residuals) -> Residuals:
    """Return the residuals of a solution; an :class:`InputError` if it has no observations."""
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("residuals: expected at least one observation")
    return residuals


def station_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by station and by the way of the signal."""
    stations = residuals.stations
    return [
        Panel(residuals, name, "", _rows_by_way(residuals, np.flatnonzero(stations.are(name))))
        for name in stations.present()
    ]


def _rows_by_way(residuals: Residuals, rows: Indices) -> dict[str, Indices]:
    """Return the rows of a station by the way of the signal, without names if the legend has no room for them."""
    codes = residuals.paths.codes[rows]
    present = np.unique(codes).tolist()
    if len(present) == 1:
        return {"": rows}
    names = dict(
        zip(present, link_ways([Link.from_path(residuals.paths.texts[k]) for k in present]), strict=True)
    )
    if sum(map(len, set(names.values()))) > _MAX_NAME_CHARACTERS:
        return {"": rows}
    named = np.array([names[code] for code in codes.tolist()])
    return {name: rows[named == name] for name in sorted(set(names.values()), reverse=True)}


def link_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by type and by baseline or receiver, baselines first."""
    groups: dict[tuple[bool, int, str], dict[str, Indices]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    named, keys = link_ways(links), types.codes * len(links) + paths.codes
    for key in np.unique(keys):
        kind, k = types.texts[key // len(links)], key % len(links)
        if kind not in KINDS:
            raise InputError(f"type of an observation: expected one of {', '.join(KINDS)}, got {kind!r}")
        place = not links[k].differenced, KINDS.index(kind), links[k].place
        groups.setdefault(place, {})[named[k]] = np.flatnonzero(keys == key)
    return [
        Panel(
            residuals,
            f"{kind_word(KINDS[kind])} {place}",
            KINDS[kind],
            dict(sorted(rows.items(), reverse=True)),
        )
        for (_, kind, place), rows in sorted(groups.items(), key=lambda item: item[0])
    ]


def half_heights_m(panels: Sequence[Panel]) -> list[float]:
    """Return half the height of each panel; panels of one type share it unless their sizes differ too much."""
    heights_m = []
    for panel in panels:
        like_m = [item.half_height_m for item in panels if item.like == panel.like]
        squeezed = max(like_m) > _MAX_HEIGHT_RATIO * min(like_m)
        heights_m.append(panel.half_height_m if squeezed else max(like_m))
    return heights_m


def kind_word(kind: str) -> str:
    """Return the short name of a type of measurement."""
    words = kind.removeprefix("vlbi_").replace("one_way", "one-way")
    return words.replace("_", " ").replace("doppler", "Doppler")


class Envelope(NamedTuple):
    """Middle of each bin of time with values, and the range, mean and standard deviation of the values."""

    middle: Dates
    lowest: Floats
    highest: Floats
    mean: Floats
    deviation: Floats


def value_envelope(dates: Dates, values: Floats, limits: Limits) -> Envelope:
    """Return the envelope of values over time."""
    place = time_bins(dates, limits)
    count = np.bincount(place, minlength=BINS)
    filled = count > 0
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, place, values)
    np.maximum.at(highest, place, values)
    mean = np.bincount(place, values, BINS)[filled] / count[filled]
    squares = np.bincount(place, (values - mean[np.cumsum(filled)[place] - 1]) ** 2, BINS)[filled]
    deviation = np.sqrt(squares / count[filled])
    middle = limits[0] + (np.flatnonzero(filled) + 0.5) / BINS * (limits[1] - limits[0])
    return Envelope(middle, lowest[filled], highest[filled], mean, deviation)


def time_bins(dates: Dates, limits: Limits) -> Indices:
    """Return the bin of time of each date, 0 to BINS - 1."""
    length_ms = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part = (dates - limits[0]) / np.timedelta64(1, "ms") / length_ms
    return np.minimum((part * BINS).astype(np.intp), BINS - 1)


MAX_LINKS = 30
ENVELOPE_NOTE = (
    f"bars: minimum to maximum in 1/{BINS} of the time; dark: mean \N{PLUS-MINUS SIGN} standard deviation"
)
"""Note below a figure with an envelope."""
_REJECTED_COLOR = "#B00020"
_MAX_VECTOR_MARKS = 800  # Number of marks in a panel above which a vector file contains them as an image
_EDGE = 0.93  # of the half height: position of the marks of observations beyond the panel
_LEGEND_STRIP = 1.3  # half heights from the middle to the lower edge of a panel with a legend
_MAX_TITLE_CHARACTERS = 58  # room above a panel
_MAX_NAMED_LINKS = len(COLORS) - 1  # links with colours of their own
_MIN_TERM_M = 5e-6  # rounding of light paths


@draws_names_literally
def plot_residuals(
    solution: Solution | Residuals, title: str | None = None, ax: Axes | None = None
) -> Figure:
    """Draw residuals over time, one panel for each station.

    Bars are the stated sigmas; more than 5000 observations of a station are drawn as an envelope. Panels are scaled to
    the used observations. Rejected observations are red crosses, or triangles at the edge of the panel. Ranges have a
    second scale for the one-way equivalent, counts of one interval for rates. The twelve stations with the most
    observations are drawn.

    Parameters
    ----------
    solution : Solution or Residuals
        Source of the residuals.
    title : str, optional
        Title; the solution's name by default.

    Raises
    ------
    InputError
        The solution has no observations.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.plot_residuals(solution)
    >>> figure.axes[0].get_title(loc="left")
    'APOLLO'
    """
    sizes_in = (8.0, 1.75), (0.0, 1.1)
    return _grid(
        solution, title, ax, station_panels(solution_residuals(solution)), 12, "stations", 1, sizes_in
    )


@draws_names_literally
def plot_links(solution: Solution | Residuals, title: str | None = None, ax: Axes | None = None) -> Figure:
    """Draw residuals over time, a panel for each VLBI baseline and for each station that receives ranges or Doppler.

    Two- and three-way ranges of a station differ in colour. Panels of a type share a scale. The thirty links with the
    most observations are drawn. Marks are those of :func:`plot_residuals`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.compute_residuals(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.plot_links(solution)
    >>> figure.axes[0].get_title(loc="left")
    'range APOLLO'
    """
    sizes_in = (3.7, 1.9), (0.6, 0.9)
    return _grid(
        solution, title, ax, link_panels(solution_residuals(solution)), MAX_LINKS, "links", 3, sizes_in
    )


def _grid(
    solution: Solution | Residuals,
    title: str | None,
    ax: Axes | None,
    panels: Sequence[Panel],
    max_panels: int,
    noun: str,
    max_columns: int,
    sizes_in: tuple[Any, Any],
) -> Figure:
    """Draw panels over one axis of dates, with notes below."""
    residuals = solution_residuals(solution)
    if title is None:
        name = f"{solution.name}: " if isinstance(solution, Solution) else ""
        title = f"{name}observed \N{MINUS SIGN} computed"
    notes: list[str] = []
    if len(panels) > max_panels:
        notes.append(f"{max_panels} of {len(panels)} {noun}, those with the most observations")
        largest = np.argsort([-len(panel.rows) for panel in panels], kind="stable")[:max_panels]
        panels = [panels[k] for k in sorted(largest.tolist())]
    figure, places, columns = panel_grid(ax, len(panels), max_columns, sizes_in, title, sharex=True)
    dates = utc_dates(residuals.epoch_utc)
    for k, (panel, half_height_m) in enumerate(zip(panels, half_heights_m(panels), strict=True)):
        _draw(places[k], residuals, dates, panel, half_height_m, COLORS[k % len(COLORS)])
    of_links = bool(panels[0].like)
    date_axes(places, dates, NARROW_TICKS if of_links else WIDE_TICKS, columns)
    if any(panel.crowded for panel in panels):
        notes.append(ENVELOPE_NOTE)
    color = "0.4" if notes else _REJECTED_COLOR
    if of_links and not residuals.used.all():
        notes.append("red: rejected; triangles are beyond the panel")
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color=color)
    return figure.figure


def _count_of_all(residuals: Residuals, rows: Indices) -> float | None:
    """Return the count interval of observations, s, or None if it is not the same for all."""
    if residuals.count_s is None:
        return None
    counts_s = np.unique(residuals.count_s[rows])
    return float(counts_s[0]) if len(counts_s) == 1 and np.isfinite(counts_s[0]) else None


def _second_scale(axes: Axes, label: str, factor: float) -> None:
    """Add a scale on the right that is a factor times that on the left."""
    to_right, to_left = partial(np.multiply, factor), partial(np.multiply, 1.0 / factor)
    right = axes.secondary_yaxis("right", functions=(to_right, to_left))
    right.set_ylabel(label, fontsize=8, color="0.4")
    right.tick_params(labelsize=8, color="0.4", labelcolor="0.4")
    right.spines["right"].set_visible(False)


def _draw(
    axes: Axes, residuals: Residuals, dates: Dates, panel: Panel, half_height_m: float, color: str
) -> None:
    """Draw the residuals of a panel: of a station with error bars, or of each link in its colour."""
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    factor, unit = length_unit(abs(panel.middle_m) + half_height_m)
    y, limits = factor * residuals.residual_m, (dates.min(), dates.max())
    middle, half_height = factor * panel.middle_m, factor * half_height_m
    several = len(panel.links) > 1
    statement = panel.statement(factor, unit)
    handles: list[Any] = []
    for k, (name, rows) in enumerate(panel.links.items()):
        used = rows[residuals.used[rows]]
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)] if panel.like or several else color}
        style["label"] = name if panel.like or several else statement
        if panel.crowded:
            handles.append(draw_envelope(axes, dates[used], y[used], limits, **style))
        elif panel.like:
            # Vector files with thousands of dots are too large for viewers: the dots are an image.
            handles += axes.plot(dates[used], y[used], ".", markersize=2.5, rasterized=True, **style)
        else:
            style |= {"fmt": "o", "markersize": 3.2, "markeredgecolor": "white", "markeredgewidth": 0.3}
            sigma = factor * residuals.sigma_m[used]
            handles.append(axes.errorbar(dates[used], y[used], sigma, elinewidth=0.7, alpha=0.85, **style))
    size = 4 if panel.like else 5
    marks = _draw_rejected(axes, dates[panel.out], y[panel.out], middle, half_height, size)
    lower_edge = _LEGEND_STRIP if panel.like and any(panel.links) else 1.0
    axes.set_ylim(middle - half_height * lower_edge, middle + half_height)
    axes.set_ylabel(f"residual ({unit})", fontsize=8)
    if panel.like:
        panel_title(axes, panel.title, "left", fontsize=7.5, fontweight="bold")
        fontsize = 6.5 if len(panel.title) + len(statement) < _MAX_TITLE_CHARACTERS else 5.2
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


def draw_envelope(axes: Axes, dates: Dates, values: Floats, limits: Limits, *, color: str, label: str) -> Any:
    """Draw the envelope of many points and return the handle for a legend."""
    middle, lowest, highest, mean, deviation = value_envelope(dates, values, limits)
    # Bars are as wide as a bin, in points of 1/72 inch, and an image, so that vector files stay small.
    width = 72.0 * axes.get_window_extent().width / axes.figure.dpi / BINS
    style: dict[str, Any] = {"color": color, "linewidth": max(width, 0.5), "solid_capstyle": "butt"}
    style |= {"snap": False, "rasterized": True}
    axes.plot(*_bars(middle, lowest, highest), alpha=0.35, **style)
    [dark] = axes.plot(*_bars(middle, mean - deviation, mean + deviation), alpha=0.7, label=label, **style)
    return dark


def _draw_rejected(
    axes: Axes, dates: Dates, values: Floats, middle: float, half_height: float, size: float
) -> list[Any]:
    """Mark rejected observations, beyond the panel by triangles at its edge; return the handles of the legend."""
    offsets, edge = values - middle, _EDGE * half_height
    beyond = np.abs(offsets) > edge
    style: dict[str, Any] = {"color": _REJECTED_COLOR, "markersize": size, "linestyle": "none"}
    handles = []
    for rows, marker, name in (
        (~beyond, "x", "rejected"),
        (beyond & (offsets > 0.0), "^", "rejected, above"),
        (beyond & (offsets < 0.0), "v", "rejected, below"),
    ):
        if count := int(rows.sum()):
            shown = middle + np.clip(offsets[rows], -edge, edge)
            style |= {"rasterized": count > _MAX_VECTOR_MARKS, "label": f"{count} {name}"}
            handles += axes.plot(dates[rows], shown, marker, **style)
    return handles


def _bars(dates: Dates, low: Floats, high: Floats) -> tuple[Dates, Floats]:
    """Return vertical bars as one line with gaps, which is drawn much faster than single lines."""
    return np.repeat(dates, 3), np.stack([low, high, np.full(len(low), np.nan)], axis=-1).ravel()


@draws_names_literally
def plot_terms(terms: Mapping[str, Floats], observations: Observations, ax: Axes | None = None) -> Figure:
    """Draw the contribution of each term to the computed values over time, a panel for each term.

    Parameters
    ----------
    terms : mapping of str to ndarray, shape (n,)
        Computed value less the computed value without the term, m, from ``terms()`` of a predictor.
    observations : Observations
        Observations of the terms, in the same order.

    Returns
    -------
    matplotlib.figure.Figure
        Links differ in colour, of more than six those with the most observations. A line below names the terms under
        five micrometres.

    Raises
    ------
    InputError
        Terms or observations are empty, or their lengths differ.

    Examples
    --------
    >>> import radioloc
    >>> arc = radioloc.jobs.prepare_arc(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_terms(arc.terms(), arc.observations)
    >>> figure.axes[0].get_title(loc="left")
    'shapiro'
    """
    count = len(observations)
    for name, added_m in terms.items():
        if len(added_m) != count:
            raise InputError(
                f"term {name}: expected {count} values, one for each observation, got {len(added_m)}"
            )
    if not count or not terms:
        raise InputError("terms: expected at least one term and one observation")
    largest_m = {name: float(np.nanmax(np.abs(added_m))) for name, added_m in terms.items()}
    shown = [name for name in terms if largest_m[name] >= _MIN_TERM_M] or list(terms)
    sizes_in = (3.7, 1.7), (0.6, 1.1)
    figure, panels, columns = panel_grid(
        ax, len(shown), 4, sizes_in, "contributions of the terms", sharex=True
    )
    dates = utc_dates(observations.epoch)
    numbers, counts = np.unique(observations.link, return_counts=True)
    named = numbers[np.argsort(-counts, kind="stable")][:_MAX_NAMED_LINKS]
    labels = link_names([observations.links[k] for k in named.tolist()])
    groups = [(observations.link == k, *look) for k, *look in zip(named, COLORS, labels, strict=False)]
    if len(numbers) > len(named):
        groups.append((~np.isin(observations.link, named), "0.6", f"{len(numbers) - len(named)} other links"))
    style: dict[str, Any] = {"marker": ".", "linestyle": "", "markersize": 2.5, "rasterized": True}
    for axes, name in zip(panels, shown, strict=True):
        factor, unit = length_unit(largest_m[name])
        for rows, color, label in groups:
            axes.plot(dates[rows], factor * terms[name][rows], color=color, label=label, **style)
        axes.set_ylabel(unit)
        panel_title(axes, name, "left", fontsize=8, fontweight="bold")
        panel_title(axes, f"up to {factor * largest_m[name]:.3g} {unit}", "right", fontsize=6.5)
    date_axes(panels, dates, NARROW_TICKS, columns)
    absent = [name for name in terms if name not in shown]
    note = f"below {1e6 * _MIN_TERM_M:g} micrometres: {', '.join(absent)}" if absent else None
    legend_outside(figure, panels[:1], 7, title=note, title_fontsize=7, markerscale=3.0)
    return figure.figure
