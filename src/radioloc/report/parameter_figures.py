"""How estimated parameters are correlated: all at once as a matrix, some two by two with their ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.report.figures import COLORS, new_figure, style_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_PARAMETERS, _MOST_PAIRED = 60, 8
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 181)
_LEVELS = {"1 sigma": 1.0, "95 %": math.sqrt(-2.0 * math.log(0.05))}
"""Factors on the axes of the ellipse of two parameters."""


def plot_correlations(solution: Solution) -> Figure:
    """Draw the correlation matrix of the estimated parameters, from the scaled covariance.

    Raises
    ------
    InputError
        Fewer than two parameters are estimated and determined, or more than 60.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_correlations(solution)
    >>> [text.get_text() for text in figure.axes[0].get_yticklabels()]
    ['position.east', 'position.north', 'position.height']
    """
    names, covariance = _determined(solution, None, _MOST_PARAMETERS)
    sigmas = np.sqrt(np.diag(covariance))
    coefficients = covariance / sigmas / sigmas[:, None]
    side_in = 2.6 + 0.28 * len(names)
    figure = new_figure(side_in + 1.0, side_in, f"{solution.name}: correlations")
    ax = figure.add_subplot()
    image = ax.imshow(coefficients, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    ax.set_yticks(range(len(names)), names, fontsize=8)
    figure.colorbar(image, ax=ax, shrink=0.8)
    if len(names) <= _MOST_PAIRED:
        for (row, column), value in np.ndenumerate(coefficients):
            color = "white" if abs(value) > 0.6 else "black"
            ax.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=7, color=color)
    return figure


def plot_contours(solution: Solution, names: Sequence[str] | None = None) -> Figure:
    """Draw parameters two by two, with the ellipses of one sigma and of 95 %, and the profile of each alone.

    The sum of squares is that of the scaled covariance; a profile is its least value over all other parameters.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        Two to eight parameters; the position by default.

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
        names = [item.name for item in solution.parameters if item.kind == "position" and not item.fixed]
    names, covariance = _determined(solution, names, _MOST_PAIRED)
    sigmas, count = np.sqrt(np.diag(covariance)), len(names)
    units = [solution.parameters[name].unit for name in names]
    figure = new_figure(2.3 * count + 0.6, 2.3 * count, f"{solution.name}: about the estimate")
    panels = figure.subplots(count, count, squeeze=False)
    for row in range(count):
        for column in range(count):
            ax = panels[row, column]
            if column > row:
                ax.remove()
                continue
            style_axes(ax)
            limit = 3.2 * sigmas[column]
            ax.set_xlim(-limit, limit)
            if row == column:
                offset = np.linspace(-limit, limit, 101)
                ax.plot(offset, (offset / sigmas[row]) ** 2, color=COLORS[0])
                ax.set_ylim(0.0, 9.0)
                ax.set_ylabel("increase of chi-square", fontsize=7)
            else:
                pair = np.ix_([column, row], [column, row])
                values, axes = np.linalg.eigh(covariance[pair])
                circle = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
                for (label, factor), color in zip(_LEVELS.items(), COLORS, strict=False):
                    x, y = axes @ (factor * np.sqrt(np.maximum(values, 0.0))[:, None] * circle)
                    ax.plot(x, y, color=color, label=label)
                ax.set_ylim(-3.2 * sigmas[row], 3.2 * sigmas[row])
                if column == 0:
                    ax.set_ylabel(f"{names[row]}, {units[row]}", fontsize=8)
            if row == count - 1:
                ax.set_xlabel(f"{names[column]}, {units[column]}", fontsize=8)
            ax.tick_params(labelsize=7)
    panels[count - 1, 0].legend(fontsize=7, frameon=False)
    return figure


def _determined(
    solution: Solution, names: Sequence[str] | None, most: int
) -> tuple[list[str], NDArray[np.float64]]:
    """Names of parameters that are estimated and determined, all by default, and their scaled covariance."""
    variances = np.diag(solution.covariance)
    usable = solution.parameters.free & np.isfinite(variances) & (variances > 0.0)
    chosen = np.flatnonzero(usable).tolist()
    if names is not None:
        chosen = [solution.parameters.index(name) for name in names]
        for k in chosen:
            if not usable[k]:
                raise InputError(f"{solution.parameters.names[k]} is not estimated, or not determined")
    if not 2 <= len(chosen) <= most:
        raise InputError(f"{len(chosen)} parameters cannot be drawn; give 2 to {most} that are estimated")
    return [solution.parameters.names[k] for k in chosen], solution.covariance[np.ix_(chosen, chosen)]
