"""What tracking plans promise, by length of arc: errors of Monte Carlo trials, sigmas of covariance studies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.orbit_state import RTN
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    NothingToDrawError,
    draw_ellipse,
    draws_names_literally,
    legend_below,
    legend_outside,
    length_unit,
    log_scale,
    one_panel,
    panel_grid,
    several_panels,
    style_axes,
)
from radioloc.results.cards import metres
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.time import utc_strings
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 12
_DRAWN, _MOST_LINES = 600, 4
"""Epochs of an orbit in a figure, and lengths of its tracking, the longest."""


@draws_names_literally
def plot_trials(study: MonteCarlo, ax: Axes | None = None) -> Figure:
    """Draw the horizontal errors of each arc's trials with the 95 % ellipses that are claimed and that are found."""
    good, of = study["converged"] == 1.0, " the orbit from" if study.at_h else " of"
    arcs = np.flatnonzero(good.any(axis=0)).tolist()
    if not arcs:
        raise NothingToDrawError(f"{study.name}: no trial has converged; there is nothing to draw")
    if len(arcs) > _MOST_PANELS:
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
    title = f"{study.name}: {study.trials} trials"
    sizes_in = (3.1, 3.1), (0.5, 0.9)
    figure, panels, columns = panel_grid(ax, len(arcs), 4, sizes_in, title, sharex=True, sharey=True)
    for axes, k, error_m, covariance_m2 in zip(panels, arcs, errors_m, claimed_m2, strict=True):
        axes.set_aspect("equal")
        opacity = max(0.15, min(0.7, 60.0 / len(error_m)))
        dots: dict[str, Any] = {"s": 6, "color": COLORS[0], "alpha": opacity, "linewidths": 0}
        axes.scatter(*(factor * error_m.T), label="trials", **dots)
        ellipses = [(np.zeros(2), covariance_m2, COLORS[6], "--", "95 % claimed")]
        if len(error_m) > 2:
            ellipses.insert(0, (error_m.mean(axis=0), np.cov(error_m.T), COLORS[1], "-", "95 % found"))
        for centre_m, spread_m2, color, dashes, label in ellipses:
            style = {"edgecolor": color, "linestyle": dashes, "linewidth": 1.3, "label": label}
            draw_ellipse(axes, centre_m, spread_m2, SCALE_95, factor, fill=False, **style)
        axes.plot(0.0, 0.0, "+", color=COLORS[6], markersize=9, markeredgewidth=1.2, label="truth")
        axes.set_xlim(-factor * reach_m, factor * reach_m)
        axes.set_ylim(-factor * reach_m, factor * reach_m)
        when = f" at {study.at_h[k]:.1f} h" if study.at_h else ""
        axes.set_title(f"{study.hours[k]:g} h{when}", fontsize=9)
    for axes in panels[-columns:]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(f"{first}{of} the truth ({unit})")
    for axes in panels[::columns]:
        axes.set_ylabel(f"{second}{of} the truth ({unit})")
    legend_outside(figure, panels[:1], 4)
    return figure.figure


@draws_names_literally
def plot_error_by_length(study: MonteCarlo, ax: Axes | None = None) -> Figure:
    """Draw errors and claimed sigmas by the length of the arc; of an orbit at the arc's end."""
    last = {arc.hours: arc for arc in study.arcs if arc is not None}
    arcs = sorted(last.values(), key=lambda arc: arc.hours)
    if not arcs:
        raise NothingToDrawError(f"{study.name}: no trial has converged; there is nothing to draw")
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


def _reach_m(error_m: Floats, claimed_m2: Floats) -> float:
    """Half the width of a square about the truth that holds all but a few of the trials, and the ellipse."""
    most_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(most_m, SCALE_95 * float(np.sqrt(np.diag(claimed_m2).max())))


@draws_names_literally
def plot_covariance(study: CovarianceStudy, ax: Axes | None = None) -> Figure:
    """Draw the sigmas by length, and of what they are made."""
    arcs = [arc for arc in study.arcs if arc.determined]
    if not arcs:
        raise NothingToDrawError(f"{study.name}: no length determines the position; there is nothing to draw")
    hours = np.array([arc.hours for arc in arcs])
    figure = several_panels(ax, 7.5, 6.5, study.name)
    above, below = figure.subplots(2, 1, sharex=True)
    radius_m = np.array([arc.radius_95_m for arc in arcs])
    above.plot(hours, radius_m, "o-", color="0.1", linewidth=2.0, label="95 % radius, horizontal")
    for k, axis in enumerate(study.longest.axes):
        sigma_m = [arc.sigma_m[k] for arc in arcs]
        above.plot(hours, sigma_m, ".-", color=COLORS[k], label=f"1 sigma {axis}")
    if study.reach_m is not None:
        label = f"{metres(study.reach_m)} m"
        above.axhline(study.reach_m, color="0.5", linestyle="--", linewidth=1.0, label=label)
    above.set_ylabel("metres")
    by_source = [arc.by_source() for arc in arcs]
    kinds = list(dict.fromkeys(kind for found in reversed(by_source) for kind in found))
    groups = {kind: [kind] for kind in kinds}
    if len(kinds) > len(COLORS):  # the smallest in one line, so that no two have one colour
        groups = {kind: [kind] for kind in kinds[: len(COLORS) - 1]} | {"others": kinds[len(COLORS) - 1 :]}
    first_m, last_m = (max(math.sqrt(v[:2].sum()) for v in by_source[k].values()) for k in (0, -1))
    bottom_m = max(0.03 * last_m, 1e-4)
    for color, (label, group) in zip(COLORS, groups.items(), strict=False):
        variance = [sum(found.get(kind, np.zeros(3))[:2].sum() for kind in group) for found in by_source]
        # Of no line below the edge the legend speaks.
        seen = label if max(variance) > bottom_m**2 else f"_{label}"
        below.plot(hours, np.sqrt(variance), ".-", color=color, label=seen)
    below.set_ylabel("horizontal 1 sigma from each, m")
    below.set_xlabel("hours from the start")
    below.set_ylim(bottom=bottom_m, top=2.0 * max(first_m, last_m))
    for axes in (above, below):
        axes.set_xscale("log")
        log_scale(axes)
        style_axes(axes)
        axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    below.set_xticks(hours, [f"{h:.3g}" for h in hours])
    below.minorticks_off()
    return figure.figure


@draws_names_literally
def plot_covariance_on_arc(study: CovarianceStudy, ax: Axes | None = None) -> Figure:
    """Draw the sigmas of an orbit over the plan, radial, along and across, by the longest of the tracking."""
    # Lines are solid where the orbit is tracked, and thin before and after it, where it is predicted.
    states = [(arc, arc.state) for arc in study.arcs if arc.state is not None]
    if not states:
        raise NothingToDrawError(f"{study.name}: no length determines an orbit; there is nothing to draw")
    figure = several_panels(ax, 8.0, 7.5, study.name)
    panels = figure.subplots(3, 1, sharex=True)
    last = states[-1][1].orbit
    tdb = last.times(_DRAWN)
    hours = np.linspace(*last.span_s, _DRAWN) / 3600.0
    for k, (arc, state) in enumerate(states[-_MOST_LINES:]):
        sigma_m = state.sigma_rtn_m(tdb)
        for axes, of_axis_m in zip(panels, sigma_m.T, strict=True):
            axes.plot(hours, of_axis_m, color=COLORS[k], linewidth=0.7, alpha=0.7)
            first_h, last_h = arc.tracked_h
            tracked = np.where((hours >= first_h) & (hours <= last_h), of_axis_m, np.nan)
            axes.plot(hours, tracked, color=COLORS[k], linewidth=1.8, label=f"{arc.hours:g} h")
    for axes, name in zip(panels, RTN, strict=True):
        axes.set_ylabel(f"1 sigma {name}, m")
        axes.set_xlim(hours[0], hours[-1])
        log_scale(axes)
        style_axes(axes)
    panels[-1].set_xlabel(f"hours from {utc_strings(last.epoch, 0)[0]} TDB")
    legend_outside(figure, panels[:1], 8, title="tracked for")
    return figure.figure
