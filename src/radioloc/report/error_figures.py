"""Errors of estimates by source and their correlations; errors and sigmas of tracking plans by length of arc."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.consider import sum_by_source
from radioloc.lunar.local import EAST_NORTH_UP
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
from radioloc.results.covariance import CovarianceStudy, PlannedArc
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.names import parameter_name, source_name
from radioloc.results.solution import Level, Solution
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MAX_PANELS = 12
_MAX_CORRELATED = 40
_MAX_NUMBERED = 12  # parameters, with numbers in the cells of the matrix
_MAX_SOURCES = 9  # Number of bars of an error budget; the smallest sources share the last


@draws_names_literally
def plot_budget(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the sigmas of the position east, north and up by source of error, the largest first."""
    items = sum_by_source(solution.budget)
    if not items:
        raise NothingToDrawError("expected a position that is estimated and determined")
    names = [source_name(item.source) for item in items]
    variances_m2 = np.square([item.sigma_m for item in items])
    if len(names) > _MAX_SOURCES:
        small = slice(_MAX_SOURCES - 1, None)
        names[small] = [f"{len(names[small])} others"]
        variances_m2 = np.vstack([variances_m2[: _MAX_SOURCES - 1], variances_m2[small].sum(axis=0)])
    names.insert(0, "total")
    sigmas_m = np.sqrt(np.vstack([variances_m2.sum(axis=0), variances_m2]))
    axes = one_panel(ax, 6.4, 1.2 + 0.42 * len(names), f"{solution.name}: error budget")
    style_axes(axes)
    axes.grid(visible=False, axis="y")
    factor, unit = length_unit(float(sigmas_m[0].max()))
    sigmas, rows = factor * sigmas_m, np.arange(len(names))
    for k, side in enumerate(EAST_NORTH_UP):
        axes.barh(rows + 0.26 * (k - 1), sigmas[:, k], 0.24, color=COLORS[k], label=side)
    for row, sigma_m in enumerate(sigmas_m):
        note, at = f"{metres(float(np.linalg.norm(sigma_m)))} m", (float(sigmas[row].max()), row)
        axes.annotate(note, at, (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(rows, names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.15 * float(sigmas.max()))
    axes.axhline(0.5, color="0.4", linewidth=0.8)
    axes.set_xlabel(f"1 sigma ({unit}); beside the bars: 3D")
    legend_below(axes, ax, 3)
    return axes.figure.figure


@draws_names_literally
def plot_correlations(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the correlation matrix of the estimated parameters."""
    # Lower triangle: total covariance; upper triangle: without consider parameters.
    determined = _determined(solution)
    if len(determined) < 2:
        raise NothingToDrawError("expected at least two parameters that are estimated and determined")
    chosen = sorted(determined[:_MAX_CORRELATED])
    names = [parameter_name(solution.parameters.names[k]) for k in chosen]
    total, scaled = (_covariance(solution, chosen, level) for level in ("total", "scaled"))
    coefficients = np.tril(_correlation(total)) + np.triu(_correlation(scaled), 1)
    side_in = 2.2 + 0.34 * len(names)
    axes = one_panel(ax, side_in + 1.4, side_in + 0.3, f"{solution.name}: correlations")
    image = axes.imshow(coefficients, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.figure.colorbar(image, ax=axes, shrink=0.8)
    notes = []
    if solution.consider.parameters:
        notes = ["lower left: total covariance", "upper right: without considered errors"]
    if len(names) < len(determined):
        notes.append(f"{len(names)} of {len(determined)} parameters")
    axes.set_title("\n".join(notes), fontsize=8, color="0.3")
    if len(names) <= _MAX_NUMBERED:
        for (row, column), value in np.ndenumerate(coefficients):
            color = "white" if abs(value) > 0.6 else "black"
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=color)
    return axes.figure.figure


def _determined(solution: Solution) -> list[int]:
    """Return the indices of determined parameters, by their correlation with the position's."""
    variances = np.diag(solution.covariance)
    usable = np.flatnonzero(solution.parameters.free & np.isfinite(variances) & (variances > 0.0))
    of_position = solution.position_partials[:, usable].any(axis=0)
    correlation = np.abs(_correlation(_covariance(solution, usable.tolist())))
    order = np.where(of_position, 2.0, correlation[:, of_position].max(axis=1, initial=0.0))
    return list(usable[np.argsort(-order, kind="stable")].tolist())


def _correlation(covariance: Floats) -> Floats:
    sigmas = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / sigmas / sigmas[:, None])


def _covariance(solution: Solution, chosen: list[int], level: Level = "total") -> Floats:
    return solution.parameter_covariance(level)[np.ix_(chosen, chosen)]


@draws_names_literally
def plot_trials(study: MonteCarlo, ax: Axes | None = None) -> Figure:
    """Draw the horizontal errors of each arc's trials with the claimed and the observed 95 % ellipses."""
    good, relation = study["converged"] == 1.0, " the orbit from" if study.at_h else " of"
    arcs = np.flatnonzero(good.any(axis=0)).tolist()
    if not arcs:
        raise NothingToDrawError(f"{study.name}: expected converged trials")
    if len(arcs) > _MAX_PANELS:
        raise InputError(f"{study.name}: expected 1 to {_MAX_PANELS} arcs, got {len(arcs)}")
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
            ellipses.insert(0, (error_m.mean(axis=0), np.cov(error_m.T), COLORS[1], "-", "95 % observed"))
        for centre_m, spread_m2, color, dashes, label in ellipses:
            style = {"edgecolor": color, "linestyle": dashes, "linewidth": 1.3, "label": label}
            draw_ellipse(axes, centre_m, spread_m2, SCALE_95, factor, fill=False, **style)
        axes.plot(0.0, 0.0, "+", color=COLORS[6], markersize=9, markeredgewidth=1.2, label="truth")
        axes.set_xlim(-factor * reach_m, factor * reach_m)
        axes.set_ylim(-factor * reach_m, factor * reach_m)
        epoch_text = f" at {study.at_h[k]:.1f} h" if study.at_h else ""
        axes.set_title(f"{study.hours[k]:g} h{epoch_text}", fontsize=9)
    for axes in panels[-columns:]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(f"{first}{relation} the truth ({unit})")
    for axes in panels[::columns]:
        axes.set_ylabel(f"{second}{relation} the truth ({unit})")
    legend_outside(figure, panels[:1], 4)
    return figure.figure


def _reach_m(error_m: Floats, claimed_m2: Floats) -> float:
    """Return half the width of a square that contains the ellipse and nearly all trials."""
    quantile_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(quantile_m, SCALE_95 * float(np.sqrt(np.diag(claimed_m2).max())))


@draws_names_literally
def plot_covariance(study: CovarianceStudy, ax: Axes | None = None) -> Figure:
    """Draw the sigmas by length, and their sources."""
    arcs = [arc for arc in study.arcs if arc.determined]
    if not arcs:
        raise NothingToDrawError(f"{study.name}: expected a length that determines the position")
    hours = np.array([arc.hours for arc in arcs])
    figure = several_panels(ax, 7.5, 6.5, study.name)
    upper, lower = figure.subplots(2, 1, sharex=True)
    radius_m = np.array([arc.radius_95_m for arc in arcs])
    upper.plot(hours, radius_m, "o-", color="0.1", linewidth=2.0, label="95 % radius, horizontal")
    for k, axis in enumerate(study.longest.axes):
        sigma_m = [arc.sigma_m[k] for arc in arcs]
        upper.plot(hours, sigma_m, ".-", color=COLORS[k], label=f"1 sigma {axis}")
    if study.reach_m is not None:
        label = f"{metres(study.reach_m)} m"
        upper.axhline(study.reach_m, color="0.5", linestyle="--", linewidth=1.0, label=label)
    upper.set_ylabel("metres")
    _draw_sources(lower, arcs)
    for axes in (upper, lower):
        axes.set_xscale("log")
        log_scale(axes)
        style_axes(axes)
        axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    lower.set_xticks(hours, [f"{h:.3g}" for h in hours])
    lower.minorticks_off()
    return figure.figure


def _draw_sources(axes: Axes, arcs: Sequence[PlannedArc]) -> None:
    variances_m2 = [
        {kind: float(by_axis[:2].sum()) for kind, by_axis in arc.by_source().items()} for arc in arcs
    ]
    kinds = list(dict.fromkeys(kind for item in reversed(variances_m2) for kind in item))
    groups = {source_name(kind): [kind] for kind in kinds}
    if len(kinds) > len(COLORS):  # lines differ in colour
        groups = {source_name(kind): [kind] for kind in kinds[: len(COLORS) - 1]}
        groups["others"] = kinds[len(COLORS) - 1 :]
    first_m, last_m = (math.sqrt(max(variances_m2[k].values())) for k in (0, -1))
    bottom_m = max(0.03 * last_m, 1e-4)
    for color, (label, group) in zip(COLORS, groups.items(), strict=False):
        variance_m2 = [sum(item.get(kind, 0.0) for kind in group) for item in variances_m2]
        # The legend omits lines lower the edge.
        entry = label if max(variance_m2) > bottom_m**2 else f"_{label}"
        axes.plot([arc.hours for arc in arcs], np.sqrt(variance_m2), ".-", color=color, label=entry)
    axes.set_ylabel("horizontal 1 sigma by source (m)")
    axes.set_xlabel("hours from the start")
    axes.set_ylim(bottom=bottom_m, top=2.0 * max(first_m, last_m))
