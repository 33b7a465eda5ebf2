"""Errors of many trials: where they scatter, beside the ellipses claimed and found, and how they fall with the arc."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.plotting.figures import COLORS, length_unit, new_figure, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHI2_2_95 = 5.991464547107979
_MOST_PANELS = 12


def plot_trial_scatter(
    names: Sequence[str],
    errors_m: Sequence[NDArray[np.float64]],
    claimed_m2: Sequence[NDArray[np.float64]],
    title: str,
) -> Figure:
    """Draw the horizontal errors of each arc's trials with the ellipses of 95 % that are claimed and that are found.

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
        Save it with :func:`~radioloc.plotting.save_figure`.

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
    figure = new_figure(3.1 * columns + 0.5, 3.4 * lines + 0.9)
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
        axes.set_xlabel(f"east of the truth ({unit})", fontsize=9)
    for axes in panels[:, 0]:
        axes.set_ylabel(f"north of the truth ({unit})", fontsize=9)
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    return figure


def plot_error_by_length(
    hours: Sequence[float],
    errors_m: Sequence[NDArray[np.float64]],
    sigmas_m: Sequence[NDArray[np.float64]],
    title: str,
) -> Figure:
    """Draw how the errors fall with the length of the arc, beside the sigmas claimed.

    Parameters
    ----------
    hours : sequence of float
        Lengths of the arcs, h.
    errors_m, sigmas_m : sequence of ndarray, shape (n, 3)
        Errors and claimed sigmas of each arc's trials, east, north, up, m.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Save it with :func:`~radioloc.plotting.save_figure`.
    """
    order = np.argsort(hours)
    length = np.array(hours)[order]
    rms_m = np.array([np.sqrt((errors_m[k] ** 2).mean(axis=0)) for k in order])
    sigma_m = np.array([np.median(sigmas_m[k], axis=0) for k in order])
    far_m = np.array([np.quantile(np.hypot(errors_m[k][:, 0], errors_m[k][:, 1]), 0.95) for k in order])
    largest_m = float(max(rms_m.max(), sigma_m.max(), far_m.max()))
    factor, unit = length_unit(largest_m)
    figure = new_figure(6.2, 4.4)
    axes = figure.add_subplot()
    style_axes(axes)
    for k, name in enumerate(("east", "north", "up")):
        axes.plot(length, factor * rms_m[:, k], "o-", color=COLORS[k], markersize=4, label=f"{name}, rms")
        axes.plot(
            length,
            factor * sigma_m[:, k],
            "--",
            color=COLORS[k],
            linewidth=1.0,
            label=f"{name}, 1 sigma claimed",
        )
    axes.plot(length, factor * far_m, "s-", color=COLORS[6], markersize=4, label="horizontal, 95 %")
    axes.set_yscale("log")
    axes.set_xlabel("length of the arc (h)", fontsize=9)
    axes.set_ylabel(f"error of the position ({unit})", fontsize=9)
    axes.set_xticks(length, [f"{h:g}" for h in length])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.tick_params(axis="y", which="minor", labelsize=7, color="0.6", labelcolor="0.4")
    figure.legend(loc="outside right center", fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    return figure


def _reach_m(error_m: NDArray[np.float64], claimed_m2: NDArray[np.float64]) -> float:
    """Half the width of a square about the truth that holds all but a few of the trials, and the ellipse."""
    most_m = float(np.quantile(np.abs(error_m), 0.998, axis=0).max())
    return 1.1 * max(most_m, float(np.sqrt(_CHI2_2_95 * np.diag(claimed_m2).max())))


def _ellipse(
    axes: Axes,
    centre: NDArray[np.float64],
    covariance: NDArray[np.float64],
    color: str,
    style: str,
    label: str,
) -> None:
    """Outline of the ellipse that holds 95 %."""
    variances, directions = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    x, y = centre[:, None] + directions @ (np.sqrt(_CHI2_2_95 * np.maximum(variances, 0.0))[:, None] * circle)
    axes.plot(x, y, style, color=color, linewidth=1.3, label=label)
