"""Trials of a Monte Carlo study: their errors about the truth, and by length of arc."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    columns_for,
    legend_below,
    length_unit,
    log_scale,
    one_panel,
    several_panels,
    style_axes,
)
from radioloc.report.monte_carlo import MonteCarlo
from radioloc.report.position_figures import error_ellipse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Floats = NDArray[np.float64]
_MOST_PANELS = 12


def plot_trials(study: MonteCarlo, ax: Axes | None = None) -> Figure:
    """Draw the horizontal errors of each arc's trials with the 95 % ellipses that are claimed and that are found.

    The claimed one has the medians of the trials' sigmas and of their correlation.

    Parameters
    ----------
    study : MonteCarlo
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Raises
    ------
    InputError
        No trial has converged, or there are more than twelve arcs.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/change5/simulation.toml")
    >>> found = radioloc.monte_carlo(study, trials=20, hours=[6.0, 12.0])
    >>> [axes.get_title() for axes in radioloc.report.plot_trials(found).axes]
    ['12 h', '6 h']
    """
    good, of = study["converged"] == 1.0, " the orbit from" if study.at_h else " of"
    arcs = np.flatnonzero(good.any(axis=0)).tolist()
    if not 0 < len(arcs) <= _MOST_PANELS:
        raise InputError(f"{len(arcs)} arcs; a figure has room for 1 to {_MOST_PANELS}")
    first, second, _ = study.sides
    errors_m = [study.errors_m[good[:, k], k, :2] for k in arcs]
    claimed_m2 = []
    for k in arcs:
        correlation = float(np.median(study[f"correlation_{first}_{second}"][good[:, k], k]))
        root_m = np.median(study.sigmas_m[good[:, k], k, :2], axis=0)
        claimed_m2.append(np.outer(root_m, root_m) * [[1.0, correlation], [correlation, 1.0]])
    reach_m = max(_reach_m(e, c) for e, c in zip(errors_m, claimed_m2, strict=True))
    factor, unit = length_unit(reach_m)
    columns = columns_for(len(arcs), 4)
    rows = -(-len(arcs) // columns)
    title = f"{study.name}: {study.trials} trials"
    figure = several_panels(ax, 3.1 * columns + 0.5, 3.1 * rows + 0.9, title)
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
        when = f" at {study.at_h[k]:.1f} h" if study.at_h else ""
        axes.set_title(f"{study.hours[k]:g} h{when}", fontsize=9)
    for axes in shown[-columns:]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(f"{first}{of} the truth ({unit})")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"{second}{of} the truth ({unit})")
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure.figure


def plot_error_by_length(study: MonteCarlo, ax: Axes | None = None) -> Figure:
    """Draw how the errors fall with the length of the arc, beside the sigmas claimed; of an orbit at the arc's end.

    Parameters
    ----------
    study : MonteCarlo
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Raises
    ------
    InputError
        No trial has converged.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/change5/simulation.toml")
    >>> found = radioloc.monte_carlo(study, trials=20, hours=[6.0, 12.0])
    >>> radioloc.report.plot_error_by_length(found).axes[0].get_xlabel()
    'length of the arc (h)'
    """
    last = {arc.hours: arc for arc in study.arcs if arc is not None}
    arcs = sorted(last.values(), key=lambda arc: arc.hours)
    if not arcs:
        raise InputError(f"{study.name}: no trial has converged; there is nothing to draw")
    length = [arc.hours for arc in arcs]
    rms_m, sigma_m = np.array([arc.rms_m for arc in arcs]), np.array([arc.sigma_m for arc in arcs])
    far_m = np.array([arc.radius_95_m for arc in arcs])
    factor, unit = length_unit(float(max(rms_m.max(), sigma_m.max(), far_m.max())))
    axes = one_panel(ax, 6.2, 4.6, f"{study.name}: {study.trials} trials")
    style_axes(axes)
    for k, name in enumerate(study.sides):
        axes.plot(length, factor * rms_m[:, k], "o-", color=COLORS[k], markersize=4, label=f"{name}, rms")
        axes.plot(length, factor * sigma_m[:, k], "--", color=COLORS[k], lw=1.0, label=f"{name}, claimed")
    axes.plot(length, factor * far_m, "s-", color=COLORS[6], markersize=4, label="horizontal, 95 %")
    log_scale(axes)
    axes.set_xlabel("length of the arc (h)")
    axes.set_ylabel(f"error of the position ({unit})")
    axes.set_xticks(length, [f"{h:g}" for h in length])
    legend_below(axes, ax, 4)
    return axes.figure.figure


def _reach_m(error_m: _Floats, claimed_m2: _Floats) -> float:
    """Half the width of a square about the truth that holds all but a few of the trials, and the ellipse."""
    most_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(most_m, SCALE_95 * float(np.sqrt(np.diag(claimed_m2).max())))
