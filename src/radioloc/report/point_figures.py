"""A position from images of a point or of landmarks, drawn with the ellipse of each source of its error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.report.figures import COLORS, SCALE_95, length_unit, several_panels, style_axes
from radioloc.report.point_solution import PointSolution
from radioloc.report.position_figures import error_ellipse
from radioloc.report.position_table import difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_SHOWN = 1e-2
"""Sources with a smaller part of the sigma are not drawn."""


def plot_point(solution: PointSolution, ax: Axes | None = None) -> Figure:
    """Draw the 95 % ellipses of a position by source of error, and its landmarks where it has some.

    Parameters
    ----------
    solution : PointSolution
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure
        One panel about the position; of stereo images one more, with the landmarks, circles about them at the distances
        measured, and the ellipse relative to the map.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate_images(radioloc.studies.read_image_study("examples/stereo/stereo.toml"))
    >>> len(radioloc.report.plot_point(solution).axes)
    2
    """
    stereo = solution.landmarks_en_m is not None
    figure = several_panels(ax, 10.0 if stereo else 5.2, 5.6, f"{solution.name}: position")
    panels = figure.subplots(1, 1 + stereo, squeeze=False)[0]
    if stereo:
        _draw_landmarks(panels[0], solution)
    _draw_sources(panels[-1], solution)
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(),
        handles,
        loc="outside lower center",
        ncols=6 if stereo else 3,
        fontsize=8,
        frameon=False,
    )
    return figure.figure


def _draw_sources(axes: Axes, solution: PointSolution) -> None:
    total_m2 = solution.covariance_enu_m2[:2, :2]
    parts = {source.name: source.covariance_enu_m2[:2, :2] for source in solution.sources}
    least_m2 = _SHOWN**2 * total_m2.trace()
    ellipses = {name: part for name, part in parts.items() if part.trace() > least_m2} | {"all": total_m2}
    reach_m = 1.15 * SCALE_95 * float(np.sqrt(np.diag(total_m2).max()))
    factor = _frame(axes, solution, reach_m)
    for color, (name, part) in zip(COLORS[1:], ellipses.items(), strict=False):
        ellipse = error_ellipse((0.0, 0.0), part, SCALE_95, factor)
        look = (
            {"edgecolor": color, "linewidth": 1.4}
            if name != "all"
            else {"edgecolor": "0.1", "linestyle": "--"}
        )
        ellipse.set(fill=False, label=name, **look)
        axes.add_patch(ellipse)
    axes.set_title("ellipses of 95 %, by source", fontsize=8, color="0.3")


def _draw_landmarks(axes: Axes, solution: PointSolution) -> None:
    from matplotlib.patches import Circle

    assert solution.landmarks_en_m is not None
    assert solution.distances_m is not None
    reach_m = 1.2 * float(np.abs(solution.landmarks_en_m).max())
    factor = _frame(axes, solution, reach_m)
    names = [one["name"] for one in solution.details["landmarks"]]
    for k, (name, place_m, distance_m) in enumerate(
        zip(names, solution.landmarks_en_m, solution.distances_m, strict=True)
    ):
        color = COLORS[1 + k % (len(COLORS) - 1)]
        label = "distances measured" if k == 0 else None
        axes.add_patch(
            Circle(
                tuple(factor * place_m), factor * distance_m, fill=False, edgecolor=color, lw=0.8, label=label
            )
        )
        axes.plot(*(factor * place_m), "^", color=color, markersize=6)
        axes.annotate(name, tuple(factor * place_m), xytext=(5, 5), textcoords="offset points", fontsize=8)
    own_m2 = sum(
        (source.covariance_enu_m2[:2, :2] for source in solution.sources if not source.shared),
        np.zeros((2, 2)),
    )
    ellipse = error_ellipse((0.0, 0.0), own_m2, SCALE_95, factor)
    ellipse.set(
        facecolor=(COLORS[0], 0.3), edgecolor=COLORS[0], linewidth=0.9, label="95 %, relative to the map"
    )
    axes.add_patch(ellipse)
    axes.set_title("landmarks", fontsize=8, color="0.3")


def _frame(axes: Axes, solution: PointSolution, reach_m: float) -> float:
    """A square about the position, with the known ones that are in it; the factor from metres to its unit."""
    factor, unit = length_unit(reach_m)
    style_axes(axes)
    axes.set_aspect("equal")
    axes.set_xlim(-factor * reach_m, factor * reach_m)
    axes.set_ylim(-factor * reach_m, factor * reach_m)
    axes.set_xlabel(f"east of the position ({unit})")
    axes.set_ylabel(f"north of the position ({unit})")
    axes.plot(0.0, 0.0, "o", color=COLORS[0], markersize=4, label="position")
    for marker, (name, place) in zip("+x", solution.references.items(), strict=False):
        _, _, west_m, north_m, _ = difference(place.selenographic, solution.position.selenographic)
        if max(abs(west_m), abs(north_m)) < reach_m:
            axes.plot(
                -factor * west_m,
                factor * north_m,
                marker,
                color="0.2",
                markersize=10,
                linestyle="",
                label=name,
            )
    return factor
