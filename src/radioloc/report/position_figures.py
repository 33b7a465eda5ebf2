"""Positions and their errors: an estimate with its error ellipses, trials about the truth, errors by length of arc."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.build import compare_with
from radioloc.estimation.solution import Solution
from radioloc.report.figures import COLORS, axes_for, length_unit, new_figure, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Floats = NDArray[np.float64]
_CHI2_2_95 = 5.991464547107979
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
    'east of JPL, DE421 solution (cm)'
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
    axes = axes_for(ax, 5.2, 5.4, f"{solution.name}: position" if title is None else title)
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
    axes.set_xlabel(f"east of {origin} ({unit})")
    axes.set_ylabel(f"north of {origin} ({unit})")
    axes.legend(loc="best", fontsize=8, frameon=True, framealpha=0.9, edgecolor="0.8")
    axes.set_title(_caption(solution, comparison is not None, east_m, north_m), fontsize=8, color="0.3")
    return axes.get_figure()  # type: ignore[return-value]


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


def plot_trial_scatter(
    names: Sequence[str], errors_m: Sequence[_Floats], claimed_m2: Sequence[_Floats], title: str
) -> Figure:
    """Draw the horizontal errors of each arc's trials with the 95 % ellipses that are claimed and that are found.

    Parameters
    ----------
    names : sequence of str
        Of the arcs, a panel each.
    errors_m : sequence of ndarray, shape (n, 2)
        East and north of the truth, m.
    claimed_m2 : sequence of ndarray, shape (2, 2)
        Covariance that a typical fit claims, m^2; its ellipse is drawn about the truth.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        There are no arcs, or more than panels fit on a page.
    """
    if not 0 < len(names) <= _MOST_PANELS:
        raise InputError(f"{len(names)} arcs; a figure has room for 1 to {_MOST_PANELS}")
    reach_m = max(_reach_m(e, c) for e, c in zip(errors_m, claimed_m2, strict=True))
    factor, unit = length_unit(reach_m)
    columns = min(len(names), 4)
    lines = -(-len(names) // columns)
    figure = new_figure(3.1 * columns + 0.5, 3.4 * lines + 0.9, title)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(names) :]:
        axes.set_visible(False)
    shown = panels.ravel()[: len(names)]
    for axes, name, error_m, covariance_m2 in zip(shown, names, errors_m, claimed_m2, strict=True):
        style_axes(axes)
        axes.set_aspect("equal")
        axes.scatter(
            factor * error_m[:, 0],
            factor * error_m[:, 1],
            s=6,
            color=COLORS[0],
            alpha=max(0.15, min(0.7, 60.0 / len(error_m))),
            linewidths=0,
            label="trials",
        )
        centre_m = error_m.mean(axis=0)
        if len(error_m) > 2:
            _ellipse(axes, factor * centre_m, factor**2 * np.cov(error_m.T), COLORS[1], "-", "95 % found")
        _ellipse(axes, np.zeros(2), factor**2 * covariance_m2, COLORS[6], "--", "95 % claimed")
        axes.plot(0.0, 0.0, "+", color=COLORS[6], markersize=9, markeredgewidth=1.2, label="truth")
        axes.set_xlim(-factor * reach_m, factor * reach_m)
        axes.set_ylim(-factor * reach_m, factor * reach_m)
        axes.set_title(name, fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel(f"east of the truth ({unit})")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"north of the truth ({unit})")
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def plot_error_by_length(
    hours: Sequence[float],
    errors_m: Sequence[_Floats],
    sigmas_m: Sequence[_Floats],
    title: str,
    ax: Axes | None = None,
) -> Figure:
    """Draw how the errors fall with the length of the arc, beside the sigmas claimed.

    Parameters
    ----------
    hours : sequence of float
        Lengths of the arcs, h.
    errors_m, sigmas_m : sequence of ndarray, shape (n, 3)
        Errors and claimed sigmas of each arc's trials, east, north, up, m.
    title : str
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.
    """
    from matplotlib.ticker import LogLocator, NullLocator

    order = np.argsort(hours)
    length = np.array(hours)[order]
    rms_m = np.array([np.sqrt((errors_m[k] ** 2).mean(axis=0)) for k in order])
    sigma_m = np.array([np.median(sigmas_m[k], axis=0) for k in order])
    far_m = np.array([np.quantile(np.hypot(errors_m[k][:, 0], errors_m[k][:, 1]), 0.95) for k in order])
    factor, unit = length_unit(float(max(rms_m.max(), sigma_m.max(), far_m.max())))
    axes = axes_for(ax, 6.2, 4.4, title)
    for k, name in enumerate(("east", "north", "up")):
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
    figure: Figure = axes.get_figure()  # type: ignore[assignment]
    if ax is None:
        figure.legend(loc="outside right center", fontsize=8, frameon=False)
    else:
        axes.legend(fontsize=8, frameon=False)
    return figure


def _reach_m(error_m: _Floats, claimed_m2: _Floats) -> float:
    """Half the width of a square about the truth that holds all but a few of the trials, and the ellipse."""
    most_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(most_m, float(np.sqrt(_CHI2_2_95 * np.diag(claimed_m2).max())))


def _ellipse(axes: Axes, centre: _Floats, covariance: _Floats, color: str, style: str, label: str) -> None:
    """Outline of the ellipse that holds 95 %."""
    variances, directions = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    x, y = centre[:, None] + directions @ (np.sqrt(_CHI2_2_95 * np.maximum(variances, 0.0))[:, None] * circle)
    axes.plot(x, y, style, color=color, linewidth=1.3, label=label)
