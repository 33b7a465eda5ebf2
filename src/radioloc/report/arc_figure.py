"""The positions of an arc-length study beside known ones: in the plane, and by the length of the arc."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radioloc.report.arc_study import ArcStudy
from radioloc.report.figures import COLORS, length_unit, several_panels, style_axes
from radioloc.report.position_figures import DrawnPlace, draw_places, marker_style
from radioloc.report.trial_statistics import NORMAL_95, SIDES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES = ("-", "--", ":", "-.")


def plot_arcs(study: ArcStudy, ax: Axes | None = None) -> Figure:
    """Draw the positions of arcs with their 95 % ellipses beside references, and each coordinate by the arc's length.

    Parameters
    ----------
    study : ArcStudy
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure
        A panel east and north of the benchmark, and one for each coordinate, with intervals of 95 % and references as
        lines.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.arcs(radioloc.read_study("examples/change5/change5.toml"), hours=[6.0, 12.0])
    >>> [axes.get_ylabel() for axes in radioloc.report.plot_arcs(found).axes[1:]]
    ['east (m)', 'north (m)', 'up (m)']
    """
    rows = study.rows
    places = []
    for k, row in enumerate(rows):
        covariance_m2 = None
        if k < len(study.arcs) and row.sigma_west_m is not None:
            covariance_m2 = study.arcs[k].solution.position_covariance("enu")[:2, :2]
        places.append(DrawnPlace.of_row(row, covariance_m2))
    figure = several_panels(ax, 10.5, 5.9, f"{study.name}: positions by length of the arc")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.1, 1.0))
    plane = figure.add_subplot(grid[:, 0])
    draw_places(plane, places, study.benchmark)
    hours = np.array([arc.hours for arc in study.arcs])
    offsets_m = np.array([[-(row.west_m or 0.0), row.north_m or 0.0, row.up_m or 0.0] for row in rows])
    sigmas_m = np.array([[row.sigma_west_m, row.sigma_north_m, row.sigma_up_m] for row in rows], dtype=float)
    reach_m = float(np.nanmax(np.abs(offsets_m) + NORMAL_95 * np.nan_to_num(sigmas_m)))
    factor, unit = length_unit(reach_m or 1.0)
    beside = [figure.add_subplot(grid[k, 1]) for k in range(len(SIDES))]
    for k, (axes, side) in enumerate(zip(beside, SIDES, strict=True)):
        style_axes(axes)
        for number, (row, offset_m) in enumerate(
            zip(rows[len(hours) :], offsets_m[len(hours) :], strict=True)
        ):
            line = _LINES[number % len(_LINES)]
            axes.axhline(factor * offset_m[k], color="black", linewidth=0.9, linestyle=line, label=row.name)
        for number, length in enumerate(hours):
            style = marker_style("tracking", number)
            bar = factor * NORMAL_95 * sigmas_m[number, k]
            axes.errorbar(length, factor * offsets_m[number, k], bar, capsize=3, elinewidth=1.2, **style)
        axes.plot(hours, factor * offsets_m[: len(hours), k], color=COLORS[0], linewidth=0.7, alpha=0.5)
        axes.set_xscale("log")
        axes.set_xticks(
            hours, [f"{length:g}" for length in hours] if k == len(SIDES) - 1 else [""] * len(hours)
        )
        axes.minorticks_off()
        axes.set_ylabel(f"{side} ({unit})")
    beside[0].set_title(f"less {study.benchmark}; bars: 95 %", fontsize=8, color="0.3")
    if len(rows) > len(hours):
        beside[0].legend(fontsize=6.5, framealpha=0.85, loc="best")
    beside[-1].set_xlabel("length of the arc (h)")
    handles, labels = plane.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure.figure
