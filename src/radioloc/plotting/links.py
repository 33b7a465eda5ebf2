"""Residuals over time, one panel for each baseline and for each station that ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Residuals, Solution
from radioloc.measurements.observations import KINDS, Link
from radioloc.plotting.crowds import CROWD_NOTE, MOST_POINTS, apart, draw_spans
from radioloc.plotting.figures import (
    COLORS,
    REJECTED_COLOR,
    date_axis,
    length_unit,
    new_figure,
    panel_title,
    style_axes,
    utc_dates,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ORDER = ("vlbi_delay", "vlbi_delay_rate", "range", "doppler")
_WORDS = {"vlbi_delay": "delay", "vlbi_delay_rate": "delay rate", "range": "range", "doppler": "Doppler"}
MOST_LINKS = 30
"""Panels that fit on a page."""
_COLUMNS = 3
_PANEL_IN = (3.7, 1.9)
# Panels of a kind share a scale unless one would be squeezed by more than this.
_MAX_HEIGHT_RATIO = 4.0
_LEGEND_STRIP = 1.3  # where a panel with a legend ends below, in half heights
_LEFT_OUT = "red: left out; triangles are beyond the panel"
_LONGEST_TITLES = 58  # characters that find room above a panel
_EDGE = 0.93  # where, in half heights, observations beyond a panel are shown


@dataclass(frozen=True, slots=True)
class _Panel:
    """What one panel shows: its kind and title, and which rows by the name of their link."""

    kind: str
    title: str
    rows: dict[str, NDArray[np.intp]]

    @property
    def all_rows(self) -> NDArray[np.intp]:
        return np.concatenate(list(self.rows.values()))


def plot_links(solution: Solution | Residuals, title: str | None = None) -> Figure:
    """Draw residuals over time, a panel for each VLBI baseline and for each station that receives ranges or Doppler.

    Two- and three-way ranges of a station have colours of their own. Observations left out are red crosses, or
    triangles at the edge where they are beyond a panel, which is scaled to the used ones. Panels of a kind share a
    scale. Of more than thirty links those with the most observations are drawn, as a line below then says.

    Parameters
    ----------
    solution : Solution or Residuals
        What to draw.
    title : str, optional
        Title; the solution's name by default.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with :func:`~radioloc.plotting.save_figure`.

    Raises
    ------
    InputError
        There are no observations.
    """
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    panels = _panels(residuals)
    notes = []
    if len(panels) > MOST_LINKS:
        notes.append(f"{MOST_LINKS} of {len(panels)} links, those with the most observations")
        largest = np.argsort([-len(panel.all_rows) for panel in panels], kind="stable")[:MOST_LINKS]
        panels = [panels[k] for k in sorted(largest.tolist())]
    if title is None:
        title = f"{solution.name}: " if isinstance(solution, Solution) else ""
        title += "observed \N{MINUS SIGN} computed"
    dates = utc_dates(residuals.epoch_utc)
    half_heights_m = _half_heights(residuals, panels)
    n_columns = min(_COLUMNS, len(panels))
    n_rows = -(-len(panels) // n_columns)
    width_in, height_in = _PANEL_IN
    figure = new_figure(0.6 + width_in * n_columns, 0.9 + height_in * n_rows)
    grid = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    places = list(grid.flat)
    for place, panel, half_height_m in zip(places, panels, half_heights_m, strict=False):
        _draw_panel(place, residuals, dates, panel, half_height_m)
    for place in places[len(panels) :]:
        place.set_visible(False)
    for column in range(n_columns):
        lowest = places[(len(panels) - 1 - column) // n_columns * n_columns + column]
        date_axis(lowest, dates, minticks=3, maxticks=6)
        lowest.tick_params(labelbottom=True)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    if any(_crowded(residuals, panel) for panel in panels):
        notes.append(CROWD_NOTE)
    color = "0.4" if notes else REJECTED_COLOR
    if not residuals.used.all():
        notes.append(_LEFT_OUT)
    if notes:
        figure.supxlabel("; ".join(notes), fontsize=7, color=color)
    return figure


def _crowded(residuals: Residuals, panel: _Panel) -> bool:
    return int(residuals.used[panel.all_rows].sum()) > MOST_POINTS


def _panels(residuals: Residuals) -> list[_Panel]:
    """Group observations by kind and by baseline or receiver."""
    found: dict[tuple[int, str], dict[str, NDArray[np.intp]]] = {}
    types, paths = residuals.types, residuals.paths
    keys = types.codes * len(paths.texts) + paths.codes
    for key in np.unique(keys):
        kind, path = types.texts[key // len(paths.texts)], paths.texts[key % len(paths.texts)]
        link = Link.from_path(path)
        if kind not in KINDS:
            raise InputError(f"type {kind!r} of an observation is not known; use {', '.join(KINDS)}")
        if link.differenced:
            name = ""
        else:
            name = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        found.setdefault((_ORDER.index(kind), link.place), {})[name] = np.flatnonzero(keys == key)
    return [
        _Panel(_ORDER[kind], f"{_WORDS[_ORDER[kind]]} {place}", dict(sorted(rows.items(), reverse=True)))
        for (kind, place), rows in sorted(found.items())
    ]


def _half_heights(residuals: Residuals, panels: list[_Panel]) -> list[float]:
    """Half the height of each panel, m: what holds its used residuals, or all of them if none was used."""
    alone_m = []
    for panel in panels:
        rows = panel.all_rows
        used = rows[residuals.used[rows]]
        shown = used if len(used) else rows
        reach_m = float(np.abs(residuals.residual_m[shown]).max())
        alone_m.append(1.15 * max(reach_m, float(np.median(residuals.sigma_m[shown]))))
    out = []
    for panel, mine_m in zip(panels, alone_m, strict=True):
        of_kind_m = [m for other, m in zip(panels, alone_m, strict=True) if other.kind == panel.kind]
        squeezed = max(of_kind_m) > _MAX_HEIGHT_RATIO * min(of_kind_m)
        out.append(mine_m if squeezed else max(of_kind_m))
    return out


def _draw_panel(
    axes: Axes,
    residuals: Residuals,
    dates: NDArray[np.datetime64],
    panel: _Panel,
    half_height_m: float,
) -> None:
    factor, unit = length_unit(half_height_m)
    y, used = factor * residuals.residual_m, residuals.used
    limit = factor * half_height_m
    style_axes(axes)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    handles: list[Any] = []
    limits, crowded = (dates.min(), dates.max()), _crowded(residuals, panel)
    for k, (name, rows) in enumerate(panel.rows.items()):
        kept = rows[used[rows]]
        color = COLORS[k % len(COLORS)]
        if crowded:
            handles.append(draw_spans(axes, dates[kept], y[kept], limits, color=color, label=name))
            continue
        # Thousands of dots are a picture within a file of lines, or no viewer opens it.
        handles += axes.plot(
            dates[kept],
            y[kept],
            ".",
            markersize=2.5,
            color=color,
            rasterized=True,
            label=name,
        )
    out = panel.all_rows[~used[panel.all_rows]]
    beyond = np.abs(residuals.residual_m[out]) > half_height_m
    above, below = beyond & (y[out] > 0.0), beyond & (y[out] < 0.0)
    for which, marker in ((~beyond, "x"), (above, "^"), (below, "v")):
        shown = np.clip(y[out[which]], -_EDGE * limit, _EDGE * limit) if marker != "x" else y[out[which]]
        some = apart(dates[out[which]], shown, limits, 2.0 * limit)
        axes.plot(
            dates[out[which]][some], shown[some], marker, color=REJECTED_COLOR, markersize=4, rasterized=True
        )
    # The legend has a strip of its own, where it hides nothing.
    axes.set_ylim(-limit * (_LEGEND_STRIP if any(panel.rows) else 1.0), limit)
    axes.set_ylabel(f"residual, {unit}", fontsize=8)
    panel_title(axes, panel.title, "left", fontsize=7.5, fontweight="bold")
    statement = _statement(residuals, panel.all_rows, factor, unit)
    size = 6.5 if len(panel.title) + len(statement) < _LONGEST_TITLES else 5.2
    panel_title(axes, statement, "right", fontsize=size)
    if any(panel.rows):
        axes.legend(
            handles=handles,
            loc="lower right",
            fontsize=7,
            framealpha=0.85,
            edgecolor="none",
            borderpad=0.2,
            ncols=len(handles),
            handletextpad=0.1,
            markerscale=2.5,
        )


def _statement(residuals: Residuals, rows: NDArray[np.intp], factor: float, unit: str) -> str:
    """How many observations were used and how far off they are, and how many were left out."""
    used = rows[residuals.used[rows]]
    text = f"{len(used)} used"
    if len(used):
        rms = factor * float(np.sqrt(np.mean(residuals.residual_m[used] ** 2)))
        text += f", rms {rms:#.3g} {unit}"
    left_out = len(rows) - len(used)
    return f"{text}, {left_out} left out" if left_out else text
