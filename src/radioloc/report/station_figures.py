"""Where stations are on the Earth, the links between them, and when they see a point on the Moon."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.report.figures import (
    COLORS,
    date_axes,
    draws_names_literally,
    legend_below,
    one_panel,
    several_panels,
    style_axes,
    utc_dates,
)
from radioloc.simulation.visibility import Masks, Target, elevations
from radioloc.time import epochs_from_strings, tai_to_tt, tai_to_utc, utc_to_tai

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Floats = NDArray[np.float64]

_EPOCHS = 721
_AROUND_DEG, _LEAST_DEG = 8.0, (50.0, 30.0)  # around the stations; across and upwards


@draws_names_literally
def plot_stations(
    tracking: Solution | Residuals | Observations | Iterable[Link],
    catalogue: StationCatalogue | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw stations on a map of the Earth, VLBI baselines and three-way links as great circles.

    Parameters
    ----------
    tracking : Solution, Residuals, Observations or iterable of Link
        Whose stations.
    catalogue : StationCatalogue, optional
        Where they are; that of the package by default.
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Geodetic longitude and latitude, deg; coastlines are those of Natural Earth (public domain).

    Raises
    ------
    InputError
        There are no stations.
    StationError
        A station is not in the catalogue.

    Examples
    --------
    >>> import radioloc
    >>> observations = radioloc.read_observations("examples/change5/short_arc.csv")
    >>> radioloc.report.plot_stations(observations).axes[0].get_xlabel()
    'east longitude (deg)'
    """
    from matplotlib.patheffects import withStroke

    links = _links_of(tracking)
    catalogue = StationCatalogue.default() if catalogue is None else catalogue
    where = {}
    for name in dict.fromkeys(name for link in links for name in link.stations):
        place = geodetic_from_itrf(catalogue.get(name).itrf_m)
        where[name] = np.degrees([float(place.longitude_rad), float(place.latitude_rad)])
    if not where:
        raise InputError("there are no stations to draw")
    pairs = {(link.differenced, tuple(sorted(set(link.stations)))) for link in links}
    lines = {
        (differenced, pair): _great_circle(*(where[name] for name in pair))
        for differenced, pair in sorted(pairs)
        if len(pair) > 1
    }
    places = np.concatenate([list(where.values()), *lines.values()])
    west_deg, east_deg = _west_and_east(np.array(list(where.values()))[:, 0])
    south_deg, north_deg = _widened(places[:, 1].min(), places[:, 1].max(), _LEAST_DEG[1])
    south_deg, north_deg = max(south_deg, -90.0), min(north_deg, 90.0)
    middle_deg = 0.5 * (west_deg + east_deg)
    stretch = 1.0 / np.cos(np.radians(np.clip(0.5 * (south_deg + north_deg), -60.0, 60.0)))
    shape = stretch * (north_deg - south_deg) / (east_deg - west_deg)
    axes = one_panel(ax, 8.0, 1.1 + 7.2 * float(np.clip(shape, 0.3, 0.9)), "stations")
    style_axes(axes)
    axes.set_aspect(stretch)
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for line in _coastlines():
        axes.plot(*_about(line, middle_deg), color="0.55", linewidth=0.7)
    styles = {True: (COLORS[1], "-", "baseline"), False: (COLORS[0], "--", "three-way")}
    for (differenced, _), line in lines.items():
        color, dashes, label = styles[differenced]
        axes.plot(*_about(line, middle_deg), color=color, linestyle=dashes, linewidth=1.2, label=label)
        styles[differenced] = color, dashes, "_"  # each kind of line is named once
    for name, at_deg in where.items():
        [at] = _about(at_deg[np.newaxis], middle_deg).T
        axes.plot(*at, "^", color="black", markersize=6, markeredgecolor="white", zorder=3)
        axes.annotate(name, tuple(at), (5, 4), textcoords="offset points", fontsize=8, path_effects=halo)
    axes.set_xlim(west_deg, east_deg)
    axes.set_ylim(south_deg, north_deg)
    axes.xaxis.set_major_formatter(
        lambda value, _: f"{(value + 180.0) % 360.0 - 180.0:g}".replace("-", "\N{MINUS SIGN}")
    )
    axes.set_xlabel("east longitude (deg)")
    axes.set_ylabel("latitude (deg)")
    if lines:
        legend_below(axes, ax, 2)
    return axes.figure.figure


def _links_of(tracking: Solution | Residuals | Observations | Iterable[Link]) -> list[Link]:
    if isinstance(tracking, Solution):
        tracking = tracking.residuals
    if isinstance(tracking, Residuals):
        return [Link.from_path(path) for path in tracking.paths.present()]
    return list(tracking.links if isinstance(tracking, Observations) else tracking)


def _west_and_east(longitude_deg: _Floats) -> tuple[float, float]:
    """Limits of the map: all longitudes but the widest stretch without a station."""
    ordered = np.sort(longitude_deg % 360.0)
    gaps = np.diff(ordered, append=ordered[0] + 360.0)
    k = int(gaps.argmax())
    first = ordered[(k + 1) % len(ordered)]
    west_deg, east_deg = _widened(first, first + 360.0 - gaps[k], _LEAST_DEG[0])
    if east_deg - west_deg > 360.0:
        return -180.0, 180.0
    turns = 360.0 * round(0.5 * (west_deg + east_deg) / 360.0)
    return west_deg - turns, east_deg - turns


def _widened(low_deg: float, high_deg: float, least_deg: float) -> tuple[float, float]:
    around_deg = max(_AROUND_DEG, 0.5 * (least_deg - (high_deg - low_deg)))
    return float(low_deg) - around_deg, float(high_deg) + around_deg


def _about(line: _Floats, middle_deg: float) -> _Floats:
    """Longitudes and latitudes, shape (2, n), within half a turn of the middle; a gap where a line leaves the map."""
    longitude, latitude = line.T
    longitude = (longitude - middle_deg + 180.0) % 360.0 - 180.0 + middle_deg
    cuts = np.flatnonzero(np.abs(np.diff(longitude)) > 180.0) + 1
    return np.array([np.insert(longitude, cuts, np.nan), np.insert(latitude, cuts, np.nan)])


def _great_circle(one_deg: _Floats, other_deg: _Floats) -> _Floats:
    """Longitude and latitude along the shorter way, shape (n, 2)."""
    one, other = erfa.s2c(*np.radians([one_deg, other_deg]).T)
    part = np.linspace(0.0, 1.0, 91)[:, np.newaxis]
    return np.degrees(np.stack(erfa.c2s((1.0 - part) * one + part * other), axis=-1))


def _coastlines() -> list[_Floats]:
    """Lines of coast, each of shape (n, 2), east longitude and latitude, deg."""
    text = (files("radioloc.report") / "data" / "coastlines.txt").read_text(encoding="utf-8")
    lines = (line.split() for line in text.splitlines() if not line.startswith("#"))
    return [0.1 * np.array([point.split(",") for point in line], dtype=np.float64) for line in lines]


@draws_names_literally
@bare_arguments
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
    limits = utc_to_tai(epochs_from_strings([start_utc, stop_utc]))
    length_s = float(limits[1].seconds_since(limits[0])[0])
    if length_s <= 0.0:
        raise InputError(f"{stop_utc} is not after {start_utc}")
    tai = limits[0].shifted(np.linspace(0.0, length_s, _EPOCHS))
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
        starts = np.flatnonzero(np.diff(mine.astype(np.int8), prepend=0) == 1)
        stops = np.flatnonzero(np.diff(mine.astype(np.int8), append=0) == -1)
        # As numbers of days, which bars are drawn in.
        spans = [(dates[a], max(dates[b] - dates[a], step)) for a, b in zip(starts, stops, strict=True)]
        for start, span in spans:
            below.barh(k, span, left=start, height=0.6, color=color)
        if not spans:
            below.annotate(
                "never", (dates[0], k), (3, 0), textcoords="offset points", va="center", fontsize=7
            )
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
