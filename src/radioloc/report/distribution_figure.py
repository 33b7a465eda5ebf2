"""Residuals over their sigmas: against elevation, and how they are distributed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.report.envelope import MOST_POINTS, REJECTED_COLOR
from radioloc.report.figures import COLORS, several_panels, style_axes
from radioloc.report.residual_figures import kind_word, tracking_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BIN_DEG, _LEAST_IN_BIN = 5.0, 5
_LEAST_REACH = 4.0  # sigmas, above and below
_BEYOND = 3.0
_NORMAL_BEYOND = math.erfc(_BEYOND / math.sqrt(2.0))


def plot_distribution(solution: Solution | Residuals, ax: Axes | None = None) -> Figure:
    """Draw residuals over their sigmas against elevation, and their histogram beside the normal distribution.

    The sigmas are those of the fit, additive variance components included: where they are right, the root mean square
    is near 1 at all elevations, and the histogram follows the curve. Observations left out are red, at the edge where
    they are beyond.

    Parameters
    ----------
    solution : Solution or Residuals
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        There are no residuals, none is used, or they have no elevations.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [axes.get_xlabel() for axes in radioloc.report.plot_distribution(solution).axes]
    ['elevation (deg)', 'density']
    """
    residuals = tracking_of(solution)
    used, elevation_deg = residuals.used, residuals.elevation_deg
    if elevation_deg is None:
        raise InputError("the residuals have no elevations to draw them against")
    if not used.any():
        raise InputError("no observation is used, so there is no distribution to draw")
    size = residuals.residual_m / residuals.sigma_m
    middle = float(np.median(size[used]))
    middle *= abs(middle) > _LEAST_REACH  # about zero, but where all residuals are far from it
    reach = 1.08 * max(_LEAST_REACH, float(np.abs(size[used] - middle).max()))
    name = f"{solution.name}: " if isinstance(solution, Solution) else ""
    figure = several_panels(ax, 8.4, 3.9, f"{name}residuals over their sigmas")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.2, 1.0))
    for axes in (left, right):
        style_axes(axes)
        axes.axhline(0.0, color="0.4", linewidth=0.8)
    _draw_dots(left, residuals, size)
    out = np.clip(size[~used], middle - 0.97 * reach, middle + 0.97 * reach)
    if len(out):
        style: dict[str, Any] = {
            "color": REJECTED_COLOR,
            "markersize": 4,
            "rasterized": len(out) > MOST_POINTS,
        }
        left.plot(elevation_deg[~used], out, "x", linestyle="none", label=f"{len(out)} left out", **style)
    bins = np.floor(elevation_deg[used] / _BIN_DEG)
    numbers, place, count = np.unique(bins, return_inverse=True, return_counts=True)
    rms = np.sqrt(np.bincount(place, size[used] ** 2) / count)
    many = count >= _LEAST_IN_BIN
    at_deg = (numbers[many] + 0.5) * _BIN_DEG
    left.plot(at_deg, rms[many], "-s", color="black", markersize=3, label=f"rms in {_BIN_DEG:g} deg")
    left.set_xlabel("elevation (deg)")
    left.set_ylabel("residual over sigma")
    left.set_ylim(middle - reach, middle + reach)
    edges = np.linspace(middle - reach, middle + reach, int(min(60, 8 + 2.0 * math.sqrt(used.sum()))) + 1)
    right.hist(size[used], edges, density=True, orientation="horizontal", color=COLORS[0], alpha=0.6)
    curve = np.linspace(-reach, reach, 401)
    right.plot(
        np.exp(-0.5 * curve**2) / math.sqrt(2.0 * math.pi), curve, color="black", lw=1.2, label="normal"
    )
    right.set_xlabel("density")
    beyond = 100.0 * float((np.abs(size[used]) > _BEYOND).mean())
    right.set_title(
        f"rms {np.sqrt(np.mean(size[used] ** 2)):.3g}; beyond {_BEYOND:g} sigma:\n{beyond:.3g} %, "
        f"normal {100.0 * _NORMAL_BEYOND:.2g} %",
        fontsize=7.5,
        color="0.3",
    )
    right.legend(fontsize=7, frameon=False, loc="lower right")
    legend = figure.legend(
        *left.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=6,
        fontsize=8,
        frameon=False,
        markerscale=1.5,
    )
    for handle in legend.get_lines():
        handle.set_alpha(1.0)
    return figure.figure


def _draw_dots(axes: Axes, residuals: Residuals, size: np.ndarray) -> None:
    """The used residuals by type; of very many how dense they are."""
    used, elevation_deg = residuals.used, residuals.elevation_deg
    assert elevation_deg is not None
    if used.sum() > 4 * MOST_POINTS:
        shown = axes.hexbin(
            elevation_deg[used], size[used], gridsize=(90, 45), bins="log", cmap="Blues", mincnt=1
        )
        shown.set_rasterized(True)
        shown.set_label("observations, darker: more")
        return
    for k, kind in enumerate(residuals.types.present()):
        rows = used & residuals.types.are(kind)
        style = {"color": COLORS[k % len(COLORS)], "alpha": max(0.25, min(0.8, 400.0 / max(1, rows.sum())))}
        axes.plot(
            elevation_deg[rows],
            size[rows],
            ".",
            markersize=4,
            rasterized=True,
            label=kind_word(kind),
            **style,
        )
