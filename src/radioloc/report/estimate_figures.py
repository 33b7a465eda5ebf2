"""What an estimate's errors are made of, and how its parameters are correlated: as bars, as a matrix, two by two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.consider import by_source
from radioloc.estimation.orbit_state import EAST_NORTH_UP
from radioloc.estimation.solution import Level, Solution
from radioloc.report.cards import metres
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    draws_names_literally,
    legend_below,
    length_unit,
    one_panel,
    several_panels,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Floats = NDArray[np.float64]

_MOST_CORRELATED, _MOST_PAIRED = 40, 8
_MOST_BESIDE_POSITION, _WORTH_SHOWING = 3, 0.5  # correlation with the position
_NUMBERS_UP_TO = 12  # parameters, with numbers in the cells of the matrix
_WITHOUT = "without considered errors"
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 181)
_DASHED: dict[str, Any] = {"linestyle": "--", "linewidth": 0.8}
_LEVELS = {"1 sigma": 1.0, "95 %": SCALE_95}
"""Factors on the axes of the ellipse of two parameters."""


_MOST_SOURCES = 9
"""Of an error budget; the smallest of more are one bar."""


@draws_names_literally
def plot_budget(solution: Solution, ax: Axes | None = None) -> Figure:
    """Draw the sigmas of a position to the east, to the north and up by source, the largest first, below the total.

    Parameters
    ----------
    solution : Solution
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Numbers at the bars are the lengths of all three together, m.

    Raises
    ------
    InputError
        The position is held or not determined.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_budget(solution)
    >>> [text.get_text() for text in figure.axes[0].get_yticklabels()][:2]
    ['total', 'moon_position']
    """
    items = by_source(solution.budget)
    if not items:
        raise InputError("the position is held or not determined, so its error has no budget to draw")
    names = [item.source for item in items]
    variances_m2 = np.square([(item.east_m, item.north_m, item.up_m) for item in items])
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
    """Draw the correlation matrix of the estimated parameters.

    Below the diagonal are the correlations of the total covariance; above it, where parameters are considered, those
    that the data alone leave. Of more than 40 parameters those of the position are drawn, and others that it is
    correlated with most.

    Parameters
    ----------
    solution : Solution
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Raises
    ------
    InputError
        Fewer than two parameters are estimated and determined.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_correlations(solution)
    >>> [text.get_text() for text in figure.axes[0].get_yticklabels()]
    ['position.east', 'position.north', 'position.height']
    """
    everything = _determined(solution)
    chosen = sorted([*everything][:_MOST_CORRELATED])
    names = _drawable_names(solution, chosen, _MOST_CORRELATED)
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


@draws_names_literally
def plot_contours(solution: Solution, names: Sequence[str] | None = None, ax: Axes | None = None) -> Figure:
    """Draw parameters two by two, with the ellipses of one sigma and of 95 %, and the profile of each alone.

    Ellipses and profiles are those of the total covariance; where parameters are considered, thin dashed lines are
    those that the data alone leave. A profile is the least increase of chi-square over all other parameters.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        Two to eight parameters; by default the position, and up to three others that it is correlated with most.
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Raises
    ------
    InputError
        A parameter is not estimated or not determined, or there are fewer than two or more than eight.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> len(radioloc.report.plot_contours(solution).axes)
    6
    """
    if names is None:
        names = [solution.parameters.names[k] for k in _about_the_position(solution)]
    chosen = [solution.parameters.index(name) for name in names]
    names = _drawable_names(solution, chosen, _MOST_PAIRED)
    covariances = [_covariance(solution, chosen)]
    if solution.consider is not None:
        covariances.append(_covariance(solution, chosen, "scaled"))
    count, limits = len(names), 3.2 * np.sqrt(np.diag(covariances[0]))
    units = [solution.parameters[name].unit for name in names]
    figure = several_panels(ax, 2.3 * count + 0.6, 2.3 * count, f"{solution.name}: about the estimate")
    panels = figure.subplots(count, count, squeeze=False)
    for row in range(count):
        for column in range(count):
            axes = panels[row, column]
            if column > row:
                axes.remove()
                continue
            style_axes(axes)
            axes.set_xlim(-limits[column], limits[column])
            if row == column:
                axes.set_ylim(0.0, 9.0)
                axes.set_ylabel("increase of chi-square", fontsize=7)
            else:
                axes.set_ylim(-limits[row], limits[row])
            if column == 0 < row:
                axes.set_ylabel(f"{names[row]}, {units[row]}", fontsize=8)
            for covariance, style in zip(covariances, ({}, _DASHED), strict=False):
                if row == column:
                    offset = np.linspace(-limits[row], limits[row], 201)
                    axes.plot(offset, offset**2 / covariance[row, row], **{"color": COLORS[0]} | style)
                else:
                    _draw_levels(axes, covariance[np.ix_([column, row], [column, row])], style)
            if row == count - 1:
                axes.set_xlabel(f"{names[column]}, {units[column]}", fontsize=8)
            axes.tick_params(labelsize=7)
    handles, labels = panels[count - 1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", fontsize=8, frameon=False)
    return figure.figure


def can_be_drawn(solution: Solution) -> tuple[bool, bool]:
    """Whether there are parameters for a figure of correlations, and for one of contours about the position."""
    contours = solution.position_determined and len(_about_the_position(solution)) > 1
    return len(_determined(solution)) > 1, contours


def _determined(solution: Solution) -> dict[int, float]:
    """Places of the parameters that are estimated and determined, and their correlation with the position.

    Those first that it is correlated with most; its own, before them, have 2.
    """
    variances = np.diag(solution.covariance)
    usable = np.flatnonzero(solution.parameters.free & np.isfinite(variances) & (variances > 0.0))
    own = solution.position_partials[:, usable].any(axis=0)
    correlation = np.abs(_correlation(_covariance(solution, usable.tolist())))
    shared = np.where(own, 2.0, correlation[:, own].max(axis=1, initial=0.0))
    order = np.argsort(-shared, kind="stable")
    return dict(zip(usable[order].tolist(), shared[order].tolist(), strict=True))


def _about_the_position(solution: Solution) -> list[int]:
    """The position's parameters and the few others that it is correlated with most; none where it is held."""
    found = _determined(solution)
    own = [k for k, shared in found.items() if shared == 2.0]
    others = [k for k, shared in found.items() if _WORTH_SHOWING <= shared < 2.0]
    return own + others[:_MOST_BESIDE_POSITION] if own else []


def _draw_levels(ax: Axes, covariance: _Floats, style: dict[str, Any]) -> None:
    variances, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(variances, 0.0))
    for (label, factor), color in zip(_LEVELS.items(), COLORS, strict=False):
        x, y = factor * root @ np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
        note = f"{label} {_WITHOUT}" if style else label
        ax.plot(x, y, **{"color": color, "label": note} | style)


def _correlation(covariance: _Floats) -> _Floats:
    sigmas = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / sigmas / sigmas[:, None])


def _covariance(solution: Solution, chosen: list[int], level: Level = "total") -> _Floats:
    return solution.parameter_covariance(level)[np.ix_(chosen, chosen)]


def _drawable_names(solution: Solution, chosen: Sequence[int], most: int) -> list[str]:
    """Names of parameters, which must be estimated and determined, and neither too few nor too many."""
    names, usable = [solution.parameters.names[k] for k in chosen], _determined(solution)
    for k, name in zip(chosen, names, strict=True):
        if k not in usable:
            raise InputError(f"{name} is not estimated, or not determined")
    if not 2 <= len(names) <= most:
        raise InputError(f"{len(names)} parameters cannot be drawn; give 2 to {most} that are estimated")
    return names
