"""What an estimate's errors are made of, and how its parameters are correlated: as bars, as a matrix, two by two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radioloc.estimation.consider import by_source
from radioloc.estimation.orbit_state import EAST_NORTH_UP
from radioloc.report.figures import (
    COLORS,
    NothingToDrawError,
    draws_names_literally,
    legend_below,
    length_unit,
    one_panel,
    style_axes,
)
from radioloc.results.cards import metres
from radioloc.results.solution import Level, Solution
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_CORRELATED = 40
_NUMBERS_UP_TO = 12  # parameters, with numbers in the cells of the matrix
_WITHOUT = "without considered errors"
_MOST_SOURCES = 9
"""Of an error budget; the smallest of more are one bar."""


@draws_names_literally
def plot_budget(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the sigmas of the position east, north and up by source of error, the largest first."""
    items = by_source(solution.budget)
    if not items:
        raise NothingToDrawError("the position is held or not determined, so its error has no budget to draw")
    names = [item.source for item in items]
    variances_m2 = np.square([item.sigma_m for item in items])
    if len(names) > _MOST_SOURCES:
        rest = slice(_MOST_SOURCES - 1, None)
        names[rest] = [f"{len(names[rest])} others"]
        variances_m2 = np.vstack([variances_m2[: _MOST_SOURCES - 1], variances_m2[rest].sum(axis=0)])
    names.insert(0, "total")
    sigmas_m = np.sqrt(np.vstack([variances_m2.sum(axis=0), variances_m2]))
    axes = one_panel(ax, 6.4, 1.2 + 0.42 * len(names), f"{solution.name}: error budget")
    style_axes(axes)
    axes.grid(visible=False, axis="y")
    factor, unit = length_unit(float(sigmas_m[0].max()))
    sigmas, rows = factor * sigmas_m, np.arange(len(names))
    for k, side in enumerate(EAST_NORTH_UP):
        axes.barh(rows + 0.26 * (k - 1), sigmas[:, k], 0.24, color=COLORS[k], label=side)
    for row, of_sides_m in enumerate(sigmas_m):
        note, at = f"{metres(float(np.linalg.norm(of_sides_m)))} m", (float(sigmas[row].max()), row)
        axes.annotate(note, at, (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(rows, names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.15 * float(sigmas.max()))
    axes.axhline(0.5, color="0.4", linewidth=0.8)
    axes.set_xlabel(f"1 sigma ({unit}); beside the bars: all three together")
    legend_below(axes, ax, 3)
    return axes.figure.figure


@draws_names_literally
def plot_correlations(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the correlation matrix of the estimated parameters."""
    # Below the diagonal are the correlations of the total covariance; above it, where parameters are considered, those
    # that the data alone leave.
    everything = _determined(solution)
    if len(everything) < 2:
        raise NothingToDrawError(
            "fewer than two parameters are estimated and determined, so there is no correlation"
        )
    chosen = sorted(everything[:_MOST_CORRELATED])
    names = [solution.parameters.names[k] for k in chosen]
    total, without = (_covariance(solution, chosen, level) for level in ("total", "scaled"))
    coefficients = np.tril(_correlation(total)) + np.triu(_correlation(without), 1)
    side_in = 2.2 + 0.34 * len(names)
    axes = one_panel(ax, side_in + 1.4, side_in + 0.3, f"{solution.name}: correlations")
    image = axes.imshow(coefficients, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.figure.colorbar(image, ax=axes, shrink=0.8)
    notes = []
    if solution.consider is not None:
        notes = ["lower left: total covariance", f"upper right: {_WITHOUT}"]
    if len(names) < len(everything):
        notes.append(f"{len(names)} of {len(everything)} parameters")
    axes.set_title("\n".join(notes), fontsize=8, color="0.3")
    if len(names) <= _NUMBERS_UP_TO:
        for (row, column), value in np.ndenumerate(coefficients):
            color = "white" if abs(value) > 0.6 else "black"
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=color)
    return axes.figure.figure


def _determined(solution: Solution) -> list[int]:
    """Places of the parameters that are estimated and determined."""
    # Those first that it is correlated with most; its own, before them, have 2.
    variances = np.diag(solution.covariance)
    usable = np.flatnonzero(solution.parameters.free & np.isfinite(variances) & (variances > 0.0))
    own = solution.position_partials[:, usable].any(axis=0)
    correlation = np.abs(_correlation(_covariance(solution, usable.tolist())))
    shared = np.where(own, 2.0, correlation[:, own].max(axis=1, initial=0.0))
    return list(usable[np.argsort(-shared, kind="stable")].tolist())


def _correlation(covariance: Floats) -> Floats:
    sigmas = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / sigmas / sigmas[:, None])


def _covariance(solution: Solution, chosen: list[int], level: Level = "total") -> Floats:
    return solution.parameter_covariance(level)[np.ix_(chosen, chosen)]
