"""Positions on a map of the Moon, over shaded terrain or an image."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.lunar import Map, TangentPlane
from radioloc.lunar.terrain import TerrainModel
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.report.figures import (
    COLORS,
    NothingToDrawError,
    draws_names_literally,
    legend_below,
    length_unit,
    log_scale,
    one_panel,
)
from radioloc.report.position_figures import draw_place
from radioloc.results.accuracy_map import AccuracyMap
from radioloc.results.result import Result
from radioloc.results.tables import (
    SolutionLike,
    contents_by_target,
    horizontal_covariance_of,
    position_of,
    references_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_PIXELS = 600
_SHADES = (3.0, 0.10, ""), (1.0, 0.25, "")  # scale of the ellipses in sigmas, opacity, label
_SUN_AZIMUTH_DEG, _SUN_ELEVATION_DEG = 315.0, 40.0  # from the upper left, as usual for shaded relief
_MIN_CELLS = 60.0  # cells of the terrain or the image across the map
_MAX_NAMED_STUDIES = 3  # studies in the title
_MAX_LONGITUDE_OFFSET_DEG = 150.0  # from the middle, where meridians end at a pole on the map
_MAX_DEFAULT_REACH_M = 5e5  # bound of the distortion by the tangent plane
_MAX_REACH_M = 1e6  # the corners are still on the Moon
_MIN_LOG_RATIO = 3.0  # of the ends of a logarithmic scale, which then has several ticks
_SCALE_QUANTILE = 0.98  # of the sites of an accuracy map, those within the colour scale


@draws_names_literally
@accepts_quantities
def plot_map(
    solutions: SolutionLike | Iterable[SolutionLike],
    *,
    dem: str | Path | TerrainModel | None = None,
    base_map: str | Path | None = None,
    reach_m: FloatLike | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw positions, their error ellipses of one and three sigma, and references on a map in mean-Earth axes.

    Parameters
    ----------
    solutions : Solution, other result with a position, or mapping, or several
        Positions; a mapping is the content of ``solution.json``. The first is in the middle.
    dem : path-like or TerrainModel, optional
        Elevation model for shaded relief, in a format of :class:`~radioloc.lunar.TerrainModel`.
    base_map : path-like, optional
        Map image in place of an elevation model, in a format of :class:`~radioloc.lunar.Map`.
    reach_m : float, optional
        Distance from the middle to the edges, m, at most 1000 km; by default all positions with a margin, and 60 cells
        of the background if it covers them.
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, without the globe; by default those of a new figure.

    Raises
    ------
    InputError
        Positions are missing or have different axes, both backgrounds are given, a background does not cover the map,
        or the reach is out of bounds.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_map(solution)
    >>> figure.axes[0].get_xlabel()
    'east longitude, ME_DE421 (deg)'
    """
    several = [solutions] if isinstance(solutions, Result | Mapping) else list(solutions)
    contents = contents_by_target(several)
    if dem is not None and base_map is not None:
        raise InputError("expected dem or base_map, got both")
    if reach_m is not None and not 0.0 < reach_m <= _MAX_REACH_M:
        raise InputError(f"reach_m: expected a number above 0, at most {_MAX_REACH_M:g} m, got {reach_m!r}")
    frame = _frame(contents)
    plane = TangentPlane(*_place(contents[0]["position"]["me"]))
    references = dict.fromkeys((item["name"], _place(item)) for c in contents for item in references_of(c))
    ground = _ground(dem, base_map)
    min_reach_m = _reach_m(contents, references, plane) if reach_m is None else reach_m
    reach_m, image = _background(ground, plane, min_reach_m, reach_m)
    factor, unit = length_unit(2.0 * reach_m)
    studies = list(dict.fromkeys(re.sub(r", [0-9.]+ h$", "", content["name"]) for content in contents))
    title = " and ".join(studies) if len(studies) <= _MAX_NAMED_STUDIES else f"{len(studies)} studies"
    legend_rows = -(-(len(contents) + len(references)) // 2)
    axes = one_panel(ax, 6.4, 6.5 + 0.17 * legend_rows, title)
    edges = [factor * edge for edge in (-reach_m, reach_m, -reach_m, reach_m)]
    if image is not None:
        axes.imshow(image, extent=edges, cmap="gray", interpolation="bilinear")  # type: ignore[arg-type]
    for k, content in enumerate(contents):
        [at_m] = plane.from_longitude_latitude([_place(content["position"]["me"])])
        covariance_m2, method = horizontal_covariance_of(content), content.get("method", "tracking")
        name = content["name"] + (", 1 and 3 sigma" if covariance_m2 is not None else "")
        draw_place(axes, factor, at_m, name, method, k, covariance_m2, _SHADES)
    for k, (name, place) in enumerate(references):
        [at_m] = plane.from_longitude_latitude([place])
        draw_place(axes, factor, at_m, name, "reference", k)
    axes.set_xlim(edges[0], edges[1])
    axes.set_ylim(edges[2], edges[3])
    axes.set_aspect("equal")
    _draw_grid(axes, plane, reach_m, factor, frame)
    _draw_scale(axes, factor * reach_m, unit)
    if ax is None:
        _draw_globe(axes, plane)
    legend_below(axes, ax, 2)
    return axes.figure.figure


def _place(angles: Mapping[str, Any]) -> tuple[float, float]:
    return angles["longitude_deg"], angles["latitude_deg"]


def _frame(contents: Sequence[Mapping[str, Any]]) -> str:
    """Return the axes of all positions."""
    if not contents:
        raise InputError("solutions: expected at least one position")
    frames = {position_of(content)["me"]["frame"] for content in contents}
    if len(frames) > 1:
        raise InputError(f"solutions: expected positions in the same axes, got {', '.join(sorted(frames))}")
    return str(frames.pop())


def _reach_m(
    contents: Sequence[Mapping[str, Any]],
    references: Iterable[tuple[str, tuple[float, float]]],
    plane: TangentPlane,
) -> float:
    """Return the reach of a map of all positions with their ellipses, m."""
    sizes_m = []
    for content in contents:
        covariance = horizontal_covariance_of(content)
        size_m = 0.0 if covariance is None else _SHADES[0][0] * float(np.sqrt(np.diag(covariance)).max())
        sizes_m.append(size_m)
    places = [_place(content["position"]["me"]) for content in contents] + [place for _, place in references]
    offsets_m = np.abs(plane.from_longitude_latitude(places)).max(axis=1)
    offsets_m[: len(sizes_m)] += sizes_m
    if not offsets_m.max() < _MAX_DEFAULT_REACH_M:  # NaN for a point beyond the plane
        raise InputError("solutions: expected positions and references within 500 km of the first")
    return max(1.0, 1.25 * float(offsets_m.max()))


def _ground(dem: str | Path | TerrainModel | None, base_map: str | Path | None) -> Map | TerrainModel | None:
    if base_map is not None:
        return Map.open(base_map)
    if isinstance(dem, TerrainModel):
        return replace(dem, interpolation="bicubic")
    return None if dem is None else TerrainModel.open(dem, interpolation="bicubic")


def _background(
    ground: Map | TerrainModel | None, plane: TangentPlane, min_reach_m: float, reach_m: float | None
) -> tuple[float, NDArray[Any] | None]:
    """Return the reach, by default of some cells unless the ground ends before, and the image."""
    if ground is None:
        return min_reach_m, None
    cell_m = ground.resolution_m if isinstance(ground, Map) else ground.metadata.resolution_m
    reach_m = max(min_reach_m, 0.5 * _MIN_CELLS * cell_m) if reach_m is None else reach_m
    while True:
        try:
            return reach_m, _image(ground, plane, reach_m)
        except InputError:
            if reach_m == min_reach_m:
                raise
            reach_m = max(min_reach_m, 0.5 * reach_m)


def _image(ground: Map | TerrainModel, plane: TangentPlane, reach_m: float) -> NDArray[Any]:
    """Return the map image, or the shaded terrain, about the middle."""
    pixel_m = 2.0 * reach_m / _PIXELS
    first_m = reach_m - 0.5 * pixel_m
    if isinstance(ground, Map):
        view, _ = ground.view(plane, -first_m, first_m, pixel_m, (_PIXELS, _PIXELS))
        return view
    from matplotlib.colors import LightSource

    east, north = np.meshgrid(*[np.linspace(-first_m, first_m, _PIXELS)] * 2)
    degrees = plane.to_longitude_latitude(np.column_stack([east.ravel(), north[::-1].ravel()]))
    try:
        heights = ground.height_m(*np.radians(degrees).T).reshape(east.shape)
    except InputError as error:
        problem = f"the map reaches {reach_m:.0f} m from the first position"
        advice = "give a smaller reach_m (--reach), or a model of the place"
        raise InputError(f"{error}; {problem}; {advice}") from None
    light = LightSource(_SUN_AZIMUTH_DEG, _SUN_ELEVATION_DEG)
    return np.asarray(light.hillshade(heights, vert_exag=1.0, dx=pixel_m, dy=pixel_m))


def _draw_grid(axes: Axes, plane: TangentPlane, reach_m: float, factor: float, frame: str) -> None:
    """Draw lines of equal longitude and latitude with their degrees at the lower and left edges."""
    side = np.linspace(-reach_m, reach_m, 101)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    longitude, latitude = plane.to_longitude_latitude(places).T.reshape(2, len(side), len(side))
    offset_deg = (longitude - plane.longitude_deg + 180.0) % 360.0 - 180.0
    longitude = np.where(
        np.abs(offset_deg) < _MAX_LONGITUDE_OFFSET_DEG, plane.longitude_deg + offset_deg, np.nan
    )
    borders = (longitude, longitude[0], axes.set_xticks), (latitude, latitude[:, 0], axes.set_yticks)
    for angle_deg, border_deg, set_ticks in borders:
        if not (np.diff(border_deg) > 0.0).all():
            set_ticks([])  # a pole is on the map
            continue
        step = _round_length((border_deg[-1] - border_deg[0]) / 4.0)
        values = step * np.arange(math.ceil(border_deg[0] / step), math.floor(border_deg[-1] / step) + 1)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        set_ticks(factor * np.interp(values, border_deg, side), [f"{value:.{decimals}f}" for value in values])
        look: dict[str, Any] = {"colors": "0.6", "linewidths": 0.4, "linestyles": "-", "alpha": 0.7}
        axes.contour(factor * side, factor * side, angle_deg, values, zorder=1, **look)
    axes.set_xlabel(f"east longitude, {frame} (deg)", fontsize=9)
    axes.set_ylabel("latitude (deg)", fontsize=9)
    axes.tick_params(labelsize=8, color="0.4")


def _round_length(size: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten up to a size."""
    power = 10.0 ** math.floor(math.log10(size))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= size * (1.0 + 1e-9))


def _draw_scale(axes: Axes, reach: float, unit: str) -> None:
    """Draw a bar of a round length in the lower right corner."""
    from matplotlib.patheffects import withStroke

    length = _round_length(0.5 * reach)
    x, y = 0.92 * reach, -0.9 * reach
    halo = [withStroke(linewidth=3, foreground="white")]
    axes.plot([x - length, x], [y, y], color="black", linewidth=2.5, solid_capstyle="butt", path_effects=halo)
    axes.text(
        x - 0.5 * length, y + 0.03 * reach, f"{length:g} {unit}", ha="center", fontsize=8, path_effects=halo
    )


def plot_accuracy_map(accuracy: AccuracyMap, ax: Axes | None = None) -> Figure:
    """Draw the 95 % radius of each site, seen from the mean direction of the Earth, with the lunar graticule."""
    if not accuracy.determined:
        raise NothingToDrawError(f"{accuracy.name}: expected a site that is determined")
    from matplotlib.colors import LogNorm, Normalize

    axes = one_panel(ax, 6.6, 6.0, f"{accuracy.name}, {accuracy.span_h:.1f} h")
    half = 0.5 * accuracy.step_deg
    edges = [np.append(accuracy.longitude_deg - half, accuracy.longitude_deg[-1] + half)]
    edges.append(np.append(accuracy.latitude_deg + half, accuracy.latitude_deg[-1] - half))
    longitude, latitude = np.radians(np.meshgrid(*edges))
    # Cells of the far side are left out.
    is_near = np.abs((accuracy.longitude_deg + 180.0) % 360.0 - 180.0) < 90.0
    radius_m = np.where(np.isfinite(accuracy.radius_95_m) & is_near, accuracy.radius_95_m, np.nan)
    # A few sites at the limb, which hardly see the Earth, would take up most of the scale.
    low_m, high_m = np.nanquantile(radius_m, (0.0, _SCALE_QUANTILE)).tolist()
    is_log = high_m > _MIN_LOG_RATIO * low_m
    cells = axes.pcolormesh(
        np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
        radius_m,
        norm=(LogNorm if is_log else Normalize)(low_m, high_m),
        cmap="viridis_r",
        rasterized=True,
    )
    _draw_graticule(axes, 90, color="white", linewidth=0.5, alpha=0.7)
    for name, fraction, marker in (("best", 1.0, "^"), ("worst", 0.0, "v")):
        row, column = accuracy.ranked(fraction)
        longitude_rad, latitude_rad = np.radians([accuracy.longitude_deg[column], accuracy.latitude_deg[row]])
        at = np.cos(latitude_rad) * np.sin(longitude_rad), np.sin(latitude_rad)
        label = f"{name}, {accuracy.radius_95_m[row, column]:.3g} m"
        axes.plot(*at, marker, color=COLORS[1], markeredgecolor="white", linestyle="none", label=label)
    for latitude_deg in (-60, -30, 0, 30, 60):
        at = -1.02 * math.cos(math.radians(latitude_deg)), math.sin(math.radians(latitude_deg))
        axes.annotate(f"{latitude_deg}\N{DEGREE SIGN}", at, fontsize=7, ha="right", va="center")
    axes.set_aspect("equal")
    axes.axis("off")
    extend = "max" if np.nanmax(radius_m) > high_m else "neither"
    scale = axes.figure.colorbar(cells, ax=axes, shrink=0.8, label="95 % radius, m", extend=extend)
    if is_log:
        log_scale(scale.ax)
    legend_below(axes, ax, 2)
    return axes.figure  # type: ignore[return-value]


def _draw_graticule(axes: Axes, most_deg: int, **style: Any) -> None:
    """Draw meridians and parallels every 30 degrees, as seen from the mean direction of the Earth."""
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 121)
    for angle in np.radians(np.arange(-most_deg, most_deg + 1, 30)):
        axes.plot(np.sin(angle) * np.cos(turn), np.sin(turn), **style)
        axes.plot(np.cos(angle) * np.sin(turn), np.full_like(turn, np.sin(angle)), **style)


def _draw_globe(around: Axes, plane: TangentPlane) -> None:
    """Draw the near side of the Moon, with the mean direction of the Earth in its middle, and the site."""
    axes = around.inset_axes((0.015, 0.80, 0.185, 0.185))
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    axes.fill(np.cos(turn), np.sin(turn), facecolor=(1.0, 1.0, 1.0, 0.85), edgecolor="0.3", linewidth=0.8)
    _draw_graticule(axes, 60, color="0.75", linewidth=0.4)
    axes.plot(0.0, 0.0, "+", color="0.3", markersize=5, markeredgewidth=0.8)
    axes.annotate("Earth", (0.0, 0.0), (2, 2), textcoords="offset points", fontsize=6, color="0.3")
    to_earth, to_east, to_north = plane.axes()[2]
    is_near = to_earth > 0.0
    axes.plot(
        to_east,
        to_north,
        "o",
        color=COLORS[1],
        markersize=4,
        markerfacecolor=COLORS[1] if is_near else "white",
    )
    if not is_near:
        axes.set_title("far side", fontsize=6, y=-0.12)
    axes.set_aspect("equal")
    axes.axis("off")
