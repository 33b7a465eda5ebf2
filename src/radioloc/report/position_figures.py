"""Positions and their errors: estimates with their ellipses beside known places, by length of arc."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.estimation.combination import ReferenceComparison, rotated_covariance
from radioloc.lunar.local import EAST_NORTH_UP, rot_enu_between
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    NothingToDrawError,
    draw_ellipse,
    draw_square,
    draws_names_literally,
    legend_below,
    legend_outside,
    length_unit,
    one_panel,
    several_panels,
    style_axes,
)
from radioloc.results.cards import value_text
from radioloc.results.comparison import Comparison
from radioloc.results.monte_carlo import NORMAL_95
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy
from radioloc.results.tables import PositionRow
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = {"tracking": "o", "images": "^", "image_point": "v", "stereo": "D", "joint": "s"}
_REFERENCE_MARKERS = "+xsDo^"
_LINES = ("-", "--", ":", "-.")


def _marker_style(method: str, number: int) -> dict[str, Any]:
    """Return the style of a marker; those of references are black and open, so that they hide nothing."""
    style: dict[str, Any] = {"markersize": 8, "linestyle": ""}
    if method != "reference":
        color = COLORS[number % (len(COLORS) - 1)]
        return style | {"marker": _MARKERS.get(method, "o"), "color": color, "markeredgecolor": "white"}
    from matplotlib.patheffects import withStroke

    style |= {"color": "black", "fillstyle": "none", "markeredgewidth": 1.4}
    halo = withStroke(linewidth=3.0, foreground="white")
    return style | {"marker": _REFERENCE_MARKERS[number % len(_REFERENCE_MARKERS)], "path_effects": [halo]}


def draw_place(
    axes: Axes,
    factor: float,
    place_m: Floats,
    name: str,
    method: str,
    number: int,
    covariance_m2: Floats | None = None,
    shades: Sequence[tuple[float, float, str]] = (),
) -> None:
    """Mark a position with its error ellipses; `shades` are their scales in sigmas, opacities and labels."""
    style = _marker_style(method, number)
    if covariance_m2 is not None:
        for scale, opacity, label in shades:
            look = {"facecolor": (style["color"], opacity), "edgecolor": style["color"], "linewidth": 1.1}
            draw_ellipse(axes, place_m, covariance_m2, scale, factor, label=label, **look)
    axes.plot(*(factor * np.asarray(place_m)), label=name, zorder=3, **style)


def _square_around(axes: Axes, corners_m: Floats, origin: str) -> float:
    """Set the limits to a square about points, shape (n, 2), m; return the factor to its unit."""
    lowest_m, highest_m = corners_m.min(axis=0), corners_m.max(axis=0)
    reach_m = 0.58 * float((highest_m - lowest_m).max()) or 1.0
    return draw_square(axes, 0.5 * (lowest_m + highest_m), reach_m, origin)


@draws_names_literally
def plot_position(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the estimate east and north of a known position, with the ellipses of one sigma and of 95 %.

    The first reference of the solution is at the origin, or else the estimate; other references are marked.

    Parameters
    ----------
    solution : Solution
        Solution with its references; ellipses are those of the total covariance.

    Raises
    ------
    InputError
        The position is fixed or not determined, so it has no error ellipse.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.plot_position(solution).axes[0].get_xlabel()
    'east of JPL, DE421 solution (m)'
    """
    if not (solution.position_estimated and solution.position_determined):
        raise NothingToDrawError("expected a position that is estimated and determined")
    references = solution.all_references
    origin_m = np.array([references[0].east_m, references[0].north_m] if references else [0.0, 0.0])
    others_m = [origin_m - (place.east_m, place.north_m) for place in references]
    sigmas_m = solution.sigma_enu_m()
    reach_m = SCALE_95 * sigmas_m[:2]
    target = f" of {solution.targets[0].name}" if solution.targets else ""
    axes = one_panel(ax, 5.2, 5.6, f"{solution.name}: position{target}")
    corners_m = np.array([origin_m - reach_m, origin_m + reach_m, *others_m])
    factor = _square_around(axes, corners_m, references[0].name if references else "the estimate")
    covariance_m2 = solution.position_covariance("enu")[:2, :2]
    shades = (SCALE_95, 0.15, "95 %"), (1.0, 0.3, "1 sigma")
    draw_place(axes, factor, origin_m, "estimate", "tracking", 0, covariance_m2, shades)
    for k, (place, at_m) in enumerate(zip(references, others_m, strict=True)):
        draw_place(axes, factor, at_m, place.name, "reference", k)
    axes.legend(loc="best", fontsize=8, frameon=True, framealpha=0.9, edgecolor="0.8")
    axes.set_title("\n".join(_caption(solution, references)), fontsize=8, color="0.3")
    return axes.figure.figure


def _caption(solution: Solution, references: Sequence[ReferenceComparison]) -> list[str]:
    """Return the position, its sigmas, and the distance from the first known position as lines."""
    longitude_deg, latitude_deg, height_m = solution.selenographic
    sigmas_deg = np.degrees(np.sqrt(np.diag(solution.position_covariance("geographic"))[:2]))
    sigmas_m = solution.sigma_enu_m()
    place = (
        f"{value_text(longitude_deg, sigmas_deg[0])}\N{DEGREE SIGN} E, {value_text(latitude_deg, sigmas_deg[1])}"
        f"\N{DEGREE SIGN} N, {value_text(height_m, sigmas_m[2])} m ({solution.me_frame})"
    )
    factor, unit = length_unit(float(max(sigmas_m)))
    east, north, up = (f"{factor * sigma_m:.3g}" for sigma_m in sigmas_m)
    sigmas = f"1 sigma: east {east}, north {north}, up {up} {unit}"
    if references:
        factor, unit = length_unit(references[0].horizontal_m)
        sigmas += f"; offset {factor * references[0].horizontal_m:.3g} {unit}"
    return [place, sigmas]


@draws_names_literally
def plot_comparison(comparison: Comparison, ax: Axes | None = None) -> Figure:
    """Draw all positions east and north of the benchmark, estimates with their 95 % ellipses."""
    rows = comparison.rows
    axes = one_panel(
        ax, 5.6, 5.9 + 0.17 * -(-len(rows) // 2), f"Positions relative to {comparison.benchmark}"
    )
    _draw_rows(axes, rows, [comparison.covariances_en_m2.get(row.name) for row in rows], comparison.benchmark)
    legend_below(axes, ax, 2)
    return axes.figure.figure


def _draw_rows(
    axes: Axes, rows: Sequence[PositionRow], covariances_m2: Sequence[Floats | None], benchmark: str
) -> None:
    """Draw positions about the benchmark with the 95 % ellipses of those with a covariance."""
    at_m = np.array([_offset_m(row)[:2] for row in rows])
    sizes_m = np.array([np.zeros(2) if c is None else SCALE_95 * np.sqrt(np.diag(c)) for c in covariances_m2])
    factor = _square_around(axes, np.concatenate([at_m + sizes_m, at_m - sizes_m]), benchmark)
    counts: Counter[bool] = Counter()
    for row, place_m, covariance_m2 in zip(rows, at_m, covariances_m2, strict=True):
        is_reference = row.method == "reference"
        shade = (SCALE_95, 0.08, "")
        draw_place(axes, factor, place_m, row.name, row.method, counts[is_reference], covariance_m2, [shade])
        counts[is_reference] += 1
    axes.set_title("ellipses of 95 %", fontsize=8, color="0.3")


def _offset_m(row: PositionRow) -> tuple[float, float, float]:
    """Return the offset east, north and up of the benchmark; zero for the benchmark itself."""
    return row.east_m or 0.0, row.north_m or 0.0, row.up_m or 0.0


@draws_names_literally
def plot_arcs(study: ArcStudy, ax: Axes | None = None) -> Figure:
    """Draw the positions of arcs with their 95 % ellipses beside references, and coordinates by the arc's length."""
    study = study.by_target[0]
    rows, hours = study.rows, np.array([arc.hours for arc in study.arcs])
    figure = several_panels(ax, 10.5, 5.9, f"{study.name}: positions by length of the arc")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.1, 1.0))
    plane = figure.add_subplot(grid[:, 0])
    origin_m = study.references[0].position.xyz_m if study.references else study.longest.position_me_m
    covariances_m2: list[Floats | None] = [None] * len(rows)
    for k, arc in enumerate(study.arcs):
        if rows[k].sigma_east_m is not None:  # near a pole, east and north differ from those at the origin
            rotation = rot_enu_between(arc.solution.position_me_m, origin_m)
            covariances_m2[k] = rotated_covariance(rotation, arc.solution.position_covariance())[:2, :2]
    _draw_rows(plane, rows, covariances_m2, study.benchmark)
    offsets_m = np.array([_offset_m(row) for row in rows])
    sigmas_m = np.array([row.sigmas_m for row in rows], dtype=float)
    reach_m = float(np.nanmax(np.abs(offsets_m) + NORMAL_95 * np.nan_to_num(sigmas_m)))
    factor, unit = length_unit(reach_m or 1.0)
    panels = [figure.add_subplot(grid[k, 1]) for k in range(len(EAST_NORTH_UP))]
    for k, (axes, side) in enumerate(zip(panels, EAST_NORTH_UP, strict=True)):
        style_axes(axes)
        for number, row in enumerate(rows[len(hours) :]):
            line = _LINES[number % len(_LINES)]
            offset = factor * _offset_m(row)[k]
            axes.axhline(offset, color="black", linewidth=0.9, linestyle=line, label=row.name)
        for number, length in enumerate(hours):
            style = _marker_style("tracking", number)
            bar = factor * NORMAL_95 * sigmas_m[number, k]
            axes.errorbar(length, factor * offsets_m[number, k], bar, capsize=3, elinewidth=1.2, **style)
        axes.plot(hours, factor * offsets_m[: len(hours), k], color=COLORS[0], linewidth=0.7, alpha=0.5)
        axes.set_xscale("log")
        axes.set_xticks(hours, [f"{length:g}" if axes is panels[-1] else "" for length in hours])
        axes.minorticks_off()
        axes.set_ylabel(f"{side} ({unit})")
    panels[0].set_title(f"less {study.benchmark}; bars: 95 %", fontsize=8, color="0.3")
    if len(rows) > len(hours):
        panels[0].legend(fontsize=6.5, framealpha=0.85, loc="best")
    panels[-1].set_xlabel("length of the arc (h)")
    legend_outside(figure, [plane], 4)
    return figure.figure
