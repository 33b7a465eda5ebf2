"""Positions and their errors: an estimate with its error ellipses, trials about the truth, errors by length of arc."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution, compare_with
from radioloc.report.figures import COLORS, SCALE_95, length_unit, new_figure, style_axes
from radioloc.report.monte_carlo import MonteCarlo
from radioloc.report.trial_statistics import SIDES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

_Floats = NDArray[np.float64]
_MOST_PANELS = 12


def plot_position(
    solution: Solution,
    reference_pa_m: ArrayLike | None = None,
    reference_name: str | None = None,
    title: str | None = None,
    ax: Axes | None = None,
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
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        The position is held or not determined, so it has no error ellipse.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.plot_position(solution).axes[0].get_xlabel()
    'east of JPL, DE421 solution (m)'
    """
    if not (solution.position_estimated and solution.position_determined):
        raise InputError("the position is held or not determined, so there is no error ellipse to draw")
    comparison = solution.reference
    if reference_pa_m is not None:
        comparison = compare_with(solution, reference_pa_m, reference_name or "reference")
    east_m, north_m = (0.0, 0.0) if comparison is None else (comparison.east_m, comparison.north_m)

    # A square that holds the larger ellipse and the origin.
    sigmas_m = solution.sigma_enu_m()
    corners_m = np.array([(east_m, north_m), (east_m, north_m), (0.0, 0.0)])
    corners_m[:2] += np.outer((-SCALE_95, SCALE_95), sigmas_m[:2])
    center_m = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))
    reach_m = 0.58 * float((corners_m.max(axis=0) - corners_m.min(axis=0)).max())
    factor, unit = length_unit(reach_m)
    of = f" of {solution.targets[0].name}" if solution.targets else ""
    title = f"{solution.name}: position{of}" if title is None else title
    axes = new_figure(5.2, 5.4, title).add_subplot() if ax is None else ax
    style_axes(axes)
    axes.set_aspect("equal")
    covariance_m2 = solution.position_covariance("enu")[:2, :2]
    for scale, opacity, label in ((SCALE_95, 0.15, "95 %"), (1.0, 0.3, "1 sigma")):
        ellipse = error_ellipse((east_m, north_m), covariance_m2, scale, factor)
        ellipse.set(facecolor=(COLORS[0], opacity), edgecolor=COLORS[0], linewidth=0.9, label=label)
        axes.add_patch(ellipse)
    axes.plot(factor * east_m, factor * north_m, "o", color=COLORS[0], markersize=5, label="estimate")
    if comparison is not None:
        axes.plot(0.0, 0.0, "+", color=COLORS[1], markersize=12, markeredgewidth=1.8, label=comparison.name)
    axes.set_xlim(factor * (center_m[0] - reach_m), factor * (center_m[0] + reach_m))
    axes.set_ylim(factor * (center_m[1] - reach_m), factor * (center_m[1] + reach_m))
    origin = "the estimate" if comparison is None else comparison.name
    axes.set_xlabel(f"east of {origin} ({unit})")
    axes.set_ylabel(f"north of {origin} ({unit})")
    axes.legend(loc="best", fontsize=8, frameon=True, framealpha=0.9, edgecolor="0.8")
    factor, unit = length_unit(float(max(sigmas_m)))
    east, north, up = (f"{factor * sigma_m:.3g}" for sigma_m in sigmas_m)
    caption = f"1 sigma: east {east}, north {north}, up {up} {unit}"
    if comparison is not None:
        factor, unit = length_unit(comparison.horizontal_m)
        caption += f"; offset {factor * comparison.horizontal_m:.3g} {unit}"
    axes.set_title(caption, fontsize=8, color="0.3")
    return axes.get_figure()  # type: ignore[return-value]


def plot_trial_scatter(study: MonteCarlo) -> Figure:
    """Draw the horizontal errors of each arc's trials with the 95 % ellipses that are claimed and that are found.

    The claimed one has the medians of the trials' sigmas and of their correlation.
    """
    good = study["converged"] == 1.0
    arcs = np.flatnonzero(good.any(axis=0)).tolist()
    if not 0 < len(arcs) <= _MOST_PANELS:
        raise InputError(f"{len(arcs)} arcs; a figure has room for 1 to {_MOST_PANELS}")
    errors_m = [study.errors_m[good[:, k], k, :2] for k in arcs]
    claimed_m2 = []
    for k in arcs:
        correlation = float(np.median(study["correlation_east_north"][good[:, k], k]))
        root_m = np.median(study.sigmas_m[good[:, k], k, :2], axis=0)
        claimed_m2.append(np.outer(root_m, root_m) * [[1.0, correlation], [correlation, 1.0]])
    reach_m = max(_reach_m(e, c) for e, c in zip(errors_m, claimed_m2, strict=True))
    factor, unit = length_unit(reach_m)
    columns = min(len(arcs), 4)
    rows = -(-len(arcs) // columns)
    figure = new_figure(3.1 * columns + 0.5, 3.4 * rows + 0.9, f"{study.name}: {study.trials} trials")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(arcs) :]:
        axes.set_visible(False)
    shown = panels.ravel()[: len(arcs)]
    for axes, k, error_m, covariance_m2 in zip(shown, arcs, errors_m, claimed_m2, strict=True):
        style_axes(axes)
        axes.set_aspect("equal")
        opacity = max(0.15, min(0.7, 60.0 / len(error_m)))
        style = {"s": 6, "color": COLORS[0], "alpha": opacity, "linewidths": 0}
        axes.scatter(*(factor * error_m.T), label="trials", **style)
        lines = [(np.zeros(2), covariance_m2, COLORS[6], "--", "95 % claimed")]
        if len(error_m) > 2:
            lines.append((error_m.mean(axis=0), np.cov(error_m.T), COLORS[1], "-", "95 % found"))
        for centre_m, spread_m2, color, dashes, label in reversed(lines):
            ellipse = error_ellipse(centre_m, spread_m2, SCALE_95, factor)
            ellipse.set(fill=False, edgecolor=color, linestyle=dashes, linewidth=1.3, label=label)
            axes.add_patch(ellipse)
        axes.plot(0.0, 0.0, "+", color=COLORS[6], markersize=9, markeredgewidth=1.2, label="truth")
        axes.set_xlim(-factor * reach_m, factor * reach_m)
        axes.set_ylim(-factor * reach_m, factor * reach_m)
        axes.set_title(f"{study.hours[k]:g} h", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel(f"east of the truth ({unit})")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"north of the truth ({unit})")
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def plot_error_by_length(study: MonteCarlo) -> Figure:
    """Draw how the errors fall with the length of the arc in h, beside the sigmas claimed."""
    from matplotlib.ticker import LogLocator, NullLocator

    arcs = sorted((arc for arc in study.arcs if arc is not None), key=lambda arc: arc.hours)
    length = [arc.hours for arc in arcs]
    rms_m, sigma_m = np.array([arc.rms_m for arc in arcs]), np.array([arc.sigma_m for arc in arcs])
    far_m = np.array([arc.radius_95_m for arc in arcs])
    factor, unit = length_unit(float(max(rms_m.max(), sigma_m.max(), far_m.max())))
    figure = new_figure(6.2, 4.4, f"{study.name}: {study.trials} trials")
    axes = figure.add_subplot()
    style_axes(axes)
    for k, name in enumerate(SIDES):
        axes.plot(length, factor * rms_m[:, k], "o-", color=COLORS[k], markersize=4, label=f"{name}, rms")
        axes.plot(length, factor * sigma_m[:, k], "--", color=COLORS[k], lw=1.0, label=f"{name}, claimed")
    axes.plot(length, factor * far_m, "s-", color=COLORS[6], markersize=4, label="horizontal, 95 %")
    axes.set_yscale("log")
    axes.set_xlabel("length of the arc (h)")
    axes.set_ylabel(f"error of the position ({unit})")
    axes.set_xticks(length, [f"{h:g}" for h in length])
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    figure.legend(loc="outside right center", fontsize=8, frameon=False)
    return figure


def _reach_m(error_m: _Floats, claimed_m2: _Floats) -> float:
    """Half the width of a square about the truth that holds all but a few of the trials, and the ellipse."""
    most_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(most_m, SCALE_95 * float(np.sqrt(np.diag(claimed_m2).max())))


def error_ellipse(
    centre_m: Sequence[float] | _Floats, covariance_m2: _Floats, scale: float, factor: float
) -> Ellipse:
    """An error ellipse with axes of so many sigmas, in the unit that a factor leads to from metres."""
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(covariance_m2)
    width, height = 2.0 * factor * scale * np.sqrt(np.maximum(variances, 0.0))
    azimuth_deg = math.degrees(math.atan2(directions[0, 1], directions[1, 1])) % 180.0
    return Ellipse((factor * centre_m[0], factor * centre_m[1]), width, height, angle=-azimuth_deg)
