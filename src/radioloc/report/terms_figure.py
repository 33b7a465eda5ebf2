"""What each term of the model adds to computed observations over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.report.date_axis import date_axes
from radioloc.report.figures import (
    COLORS,
    columns_for,
    length_unit,
    panel_title,
    several_panels,
    style_axes,
    utc_dates,
)
from radioloc.report.link_names import short_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_NAMED = len(COLORS) - 1
_SMALL_M = 1e-6


def plot_terms(
    terms: Mapping[str, NDArray[np.float64]], observations: Observations, ax: Axes | None = None
) -> Figure:
    """Draw what each term adds to the computed values over time, a panel for each term.

    Parameters
    ----------
    terms : mapping of str to ndarray, shape (n,)
        The computed value less that without the term, m, as a predictor's ``terms`` gives them.
    observations : Observations
        What was computed, in the same order.
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure
        Links have colours of their own, those with the most observations where there are more than six. Terms below a
        micrometre are named in a line below.

    Raises
    ------
    InputError
        There are no terms or no observations, or a term is not of as many values as there are observations.

    Examples
    --------
    >>> import radioloc
    >>> arc, position_pa_m = radioloc.studies.arc_of(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_terms(arc.terms(position_pa_m), arc.observations)
    >>> figure.axes[0].get_title(loc="left")
    'shapiro'
    """
    count = len(observations)
    for name, added_m in terms.items():
        if len(added_m) != count:
            raise InputError(f"term {name} has {len(added_m)} values, but there are {count} observations")
    if not count or not terms:
        raise InputError("there are no terms of observations to draw")
    largest_m = {name: float(np.nanmax(np.abs(added_m))) for name, added_m in terms.items()}
    shown = [name for name in terms if largest_m[name] >= _SMALL_M] or list(terms)
    columns = columns_for(len(shown), 4)
    rows = -(-len(shown) // columns)
    figure = several_panels(ax, 3.7 * columns + 0.6, 1.7 * rows + 1.1, "what each term adds")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    dates = utc_dates(observations.epoch)
    numbers, counts = np.unique(observations.link, return_counts=True)
    named = numbers[np.argsort(-counts, kind="stable")][:_MOST_NAMED]
    labels = dict(
        zip(named.tolist(), short_names([observations.links[k] for k in named.tolist()]), strict=True)
    )
    groups = [(observations.link == k, COLORS[n], labels[int(k)]) for n, k in enumerate(named)]
    if len(numbers) > len(named):
        groups.append((~np.isin(observations.link, named), "0.6", f"{len(numbers) - len(named)} other links"))
    for axes, name in zip(panels, shown, strict=False):
        style_axes(axes)
        factor, unit = length_unit(largest_m[name])
        for mine, color, label in groups:
            axes.plot(
                dates[mine],
                factor * terms[name][mine],
                ".",
                color=color,
                markersize=2.5,
                rasterized=True,
                label=label,
            )
        axes.set_ylabel(unit)
        panel_title(axes, name, "left", fontsize=8, fontweight="bold")
        panel_title(axes, f"up to {factor * largest_m[name]:.3g} {unit}", "right", fontsize=6.5)
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    date_axes(list(panels[: len(shown)]), dates, (3, 6), columns)
    handles, names = panels[0].get_legend_handles_labels()
    nothing = [name for name in terms if name not in shown]
    note = f"below a micrometre: {', '.join(nothing)}" if nothing else None
    figure.legend(
        handles,
        names,
        title=note,
        loc="outside lower center",
        ncols=7,
        fontsize=8,
        title_fontsize=7,
        frameon=False,
        markerscale=3.0,
    )
    return figure.figure
