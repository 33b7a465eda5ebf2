"""What the error of a position is made of, as bars."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.budget import BudgetItem, by_source
from radioloc.estimation.solution import Solution
from radioloc.report.cards import metres
from radioloc.report.figures import COLORS, legend_below, length_unit, one_panel, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIDES = ("east", "north", "up")
_MOST = 9
"""Sources; the smallest of more are one bar."""


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
    if len(items) > _MOST:
        rest = [_variances_m2(item) for item in items[_MOST - 1 :]]
        items[_MOST - 1 :] = [BudgetItem.of(f"{len(rest)} others", "", np.sum(rest, axis=0))]
    items.insert(0, BudgetItem.of("total", "", np.sum([_variances_m2(item) for item in items], axis=0)))
    axes = one_panel(ax, 6.4, 1.2 + 0.42 * len(items), f"{solution.name}: error budget")
    style_axes(axes)
    axes.grid(visible=False, axis="y")
    factor, unit = length_unit(max(items[0].east_m, items[0].north_m, items[0].up_m))
    sigmas = factor * np.sqrt([_variances_m2(item) for item in items])
    rows = np.arange(len(items))
    for k, side in enumerate(_SIDES):
        axes.barh(rows + 0.26 * (k - 1), sigmas[:, k], 0.24, color=COLORS[k], label=side)
    for row, item in enumerate(items):
        reach = float(sigmas[row].max())
        note = f"{metres(item.total_m)} m"
        axes.annotate(note, (reach, row), (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(rows, [item.source for item in items])
    axes.set_ylim(len(items) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.15 * float(sigmas.max()))
    axes.axhline(0.5, color="0.4", linewidth=0.8)
    axes.set_xlabel(f"1 sigma ({unit}); beside the bars: all three together")
    legend_below(axes, ax, 3)
    return axes.figure.figure


def _variances_m2(item: BudgetItem) -> tuple[float, float, float]:
    return item.east_m**2, item.north_m**2, item.up_m**2
