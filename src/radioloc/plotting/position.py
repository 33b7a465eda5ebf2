"""The estimated position beside a known or an a-priori one, with its error ellipses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.estimation.build import compare_with
from radioloc.estimation.solution import Solution
from radioloc.plotting.figures import COLORS, length_unit, new_figure, style_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_position(
    solution: Solution,
    reference_pa_m: ArrayLike | None = None,
    reference_name: str | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the estimate east and north of another position, with the ellipses of one sigma and of 95 %.

    Parameters
    ----------
    solution : Solution
        What to draw; ellipses are those of the total covariance.
    reference_pa_m : array_like, shape (3,), optional
        The position at the origin, principal axes, m; the reference of the solution by default, or else the
        estimate itself.
    reference_name : str, optional
        What that is.
    title : str, optional
        Title; the solution's name by default.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with :func:`~radioloc.plotting.save_figure`.

    Raises
    ------
    InputError
        The position is held or not determined, so it has no error ellipse.
    """
    from matplotlib.patches import Ellipse as EllipsePatch

    # The one-sigma ellipse holds 1 - exp(-1/2) = 39.3 % in the plane.
    ellipses = [
        (solution.ellipse(0.95), 0.15, "95 %"),
        (solution.ellipse(1.0 - math.exp(-0.5)), 0.3, "1 sigma"),
    ]
    if not solution.position_estimated or ellipses[0][0] is None:
        raise InputError("the position is held or not determined, so there is no error ellipse to draw")
    comparison = solution.reference
    if reference_pa_m is not None:
        known = np.array(reference_pa_m, dtype=np.float64)
        comparison = compare_with(solution, known, reference_name or "reference")
    east_m, north_m = (0.0, 0.0) if comparison is None else (comparison.east_m, comparison.north_m)

    # A square that holds the larger ellipse, whose reach east and north is 2.45 sigmas, and the origin.
    sigma_east_m, sigma_north_m, _ = solution.sigma_enu_m()
    corners_m = np.array([(east_m, north_m), (east_m, north_m), (0.0, 0.0)])
    corners_m[:2] += np.outer((-1.0, 1.0), (2.45 * sigma_east_m, 2.45 * sigma_north_m))
    center_m = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))
    reach_m = 0.58 * float((corners_m.max(axis=0) - corners_m.min(axis=0)).max())
    factor, unit = length_unit(reach_m)
    figure = new_figure(5.2, 5.4)
    axes = figure.add_subplot()
    style_axes(axes)
    axes.set_aspect("equal")
    for ellipse, opacity, label in ellipses:
        if ellipse is None:
            continue
        axes.add_patch(
            EllipsePatch(
                (factor * east_m, factor * north_m),
                2.0 * factor * ellipse.semi_minor_m,
                2.0 * factor * ellipse.semi_major_m,
                angle=-ellipse.azimuth_deg,
                facecolor=(COLORS[0], opacity),
                edgecolor=COLORS[0],
                linewidth=0.9,
                label=label,
            )
        )
    axes.plot(factor * east_m, factor * north_m, "o", color=COLORS[0], markersize=5, label="estimate")
    if comparison is not None:
        axes.plot(0.0, 0.0, "+", color=COLORS[1], markersize=12, markeredgewidth=1.8, label=comparison.name)
    axes.set_xlim(factor * (center_m[0] - reach_m), factor * (center_m[0] + reach_m))
    axes.set_ylim(factor * (center_m[1] - reach_m), factor * (center_m[1] + reach_m))
    origin = "the estimate" if comparison is None else comparison.name
    axes.set_xlabel(f"east of {origin} ({unit})", fontsize=9)
    axes.set_ylabel(f"north of {origin} ({unit})", fontsize=9)
    axes.legend(loc="best", fontsize=8, frameon=True, framealpha=0.9, edgecolor="0.8")
    figure.suptitle(f"{solution.name}: position" if title is None else title, fontsize=11, fontweight="bold")
    axes.set_title(_caption(solution, comparison is not None, east_m, north_m), fontsize=8, color="0.3")
    return figure


def _caption(solution: Solution, compared: bool, east_m: float, north_m: float) -> str:
    sigma_east_m, sigma_north_m, sigma_up_m = solution.sigma_enu_m()
    factor, unit = length_unit(max(sigma_east_m, sigma_north_m, sigma_up_m))
    text = (
        f"1 sigma: east {factor * sigma_east_m:.3g}, north {factor * sigma_north_m:.3g}, "
        f"up {factor * sigma_up_m:.3g} {unit}"
    )
    if compared:
        factor, unit = length_unit(math.hypot(east_m, north_m))
        text += f"; offset {factor * math.hypot(east_m, north_m):.3g} {unit}"
    return text
