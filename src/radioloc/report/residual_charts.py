"""Residuals over time as charts of plotly's, one for each link: what is drawn, as plain data."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.report.cards import have_paths
from radioloc.report.figures import length_unit, utc_dates
from radioloc.report.residual_panels import (
    BINS,
    MOST_POINTS,
    Dates,
    Limits,
    Panel,
    envelope_of,
    half_heights_m,
    link_panels,
    station_panels,
    tracking_of,
)

_MOST_ON_PAGE = 40_000
_MOST_WITH_BARS = 300
"""Bars of more observations than these in one chart hide each other."""
_HOVER = "%{x|%Y-%m-%d %H:%M:%S} UTC<extra></extra><br>"


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart: its title, what a line beside it says, and what plotly draws, with colours by number."""

    title: str
    statement: str
    note: str
    content: dict[str, Any]


def residual_charts(solution: Solution) -> list[Chart]:
    """A chart for each panel of :func:`~radioloc.report.plot_links`, of stations where paths are not known."""
    residuals = tracking_of(solution)
    panels = link_panels(residuals) if have_paths(residuals) else station_panels(residuals)
    dates = utc_dates(residuals.epoch_utc)
    most = min(MOST_POINTS, _MOST_ON_PAGE // len(panels))
    return [
        _chart(residuals, dates, panel, half_height_m, most)
        for panel, half_height_m in zip(panels, half_heights_m(panels), strict=True)
    ]


def _chart(residuals: Residuals, dates: Dates, panel: Panel, half_height_m: float, most: int) -> Chart:
    factor, unit = length_unit(abs(panel.middle_m) + half_height_m)
    y, middle, half_height = factor * residuals.residual_m, factor * panel.middle_m, factor * half_height_m
    sigma = factor * residuals.sigma_m
    crowded = len(panel.used) > most
    traces: list[dict[str, Any]] = []
    for k, (name, rows) in enumerate(panel.links.items()):
        used = rows[residuals.used[rows]]
        if not len(used):
            continue
        trace = {"name": escape(name or panel.title, quote=False), "marker": {"size": 4, "color": k}}
        if crowded:
            trace |= _envelope(dates[used], y[used], (dates.min(), dates.max()), unit)
        else:
            trace |= _dots(dates[used], y[used], sigma[used], unit, len(panel.used) <= _MOST_WITH_BARS)
        if len(panel.links) > 1:
            trace["hovertemplate"] = f"%{{fullData.name}}<br>{trace['hovertemplate']}"
        traces.append(trace)
    if len(panel.out):
        traces.append(_left_out(residuals, dates, y, panel.out, unit))
    notes = [f"bars: minimum to maximum in 1/{BINS} of the time, dots: mean"] if crowded else []
    if beyond := int((np.abs(y[panel.out] - middle) > half_height).sum()):
        notes.insert(0, f"{beyond} of these beyond the chart")
    ends = dates.min(), dates.max()
    pad = max(0.02 * (ends[1] - ends[0]), np.timedelta64(1, "m"))
    layout = {
        "xaxis": {"type": "date", "range": [_milliseconds(ends[0] - pad), _milliseconds(ends[1] + pad)]},
        "yaxis": {
            "range": [middle - half_height, middle + half_height],
            "title": {"text": f"residual ({unit})"},
        },
        "showlegend": len(panel.links) > 1,
    }
    return Chart(
        panel.title, panel.statement(factor, unit), "; ".join(notes), {"data": traces, "layout": layout}
    )


def _dots(
    dates: Dates, y: NDArray[np.float64], sigma: NDArray[np.float64], unit: str, bars: bool
) -> dict[str, Any]:
    trace: dict[str, Any] = {"mode": "markers", "x": _packed(_milliseconds(dates), "f8"), "y": _packed(y)}
    trace["customdata"] = _packed(sigma)
    trace["hovertemplate"] = f"{_HOVER}%{{y:.4g}} ± %{{customdata:.3g}} {unit}"
    if bars:
        trace["error_y"] = {"type": "data", "array": _packed(sigma), "thickness": 1, "width": 0}
    return trace


def _envelope(dates: Dates, y: NDArray[np.float64], limits: Limits, unit: str) -> dict[str, Any]:
    found = envelope_of(dates, y, limits)
    return {
        "mode": "markers",
        "x": _packed(_milliseconds(found.middle), "f8"),
        "y": _packed(found.mean),
        "text": [
            f"{n} observations, {low:.4g} to {high:.4g}, mean {mean:.4g} ± {deviation:.3g} {unit}"
            for _, n, low, high, mean, deviation in zip(*found, strict=True)
        ],
        "hovertemplate": f"{_HOVER}%{{text}}",
        "error_y": {
            "type": "data",
            "symmetric": False,
            "array": _packed(found.highest - found.mean),
            "arrayminus": _packed(found.mean - found.lowest),
            "thickness": 1,
            "width": 0,
        },
    }


def _left_out(
    residuals: Residuals, dates: Dates, y: NDArray[np.float64], out: NDArray[np.intp], unit: str
) -> dict[str, Any]:
    """What was left out, of too many those that are farthest off."""
    shown = np.sort(out[np.argsort(-np.abs(y[out]), kind="stable")[:MOST_POINTS]])
    return {
        "name": f"{len(out)} left out",
        "mode": "markers",
        "marker": {"size": 7, "symbol": "x-thin", "color": "left out"},
        "x": _packed(_milliseconds(dates[shown]), "f8"),
        "y": _packed(y[shown]),
        "text": [escape(text, quote=False) for text in residuals.statuses[shown]],
        "hovertemplate": f"{_HOVER}%{{y:.4g}} {unit}<br>%{{text}}",
    }


def _milliseconds(dates: Any) -> Any:
    """Of the Unix epoch, as plotly counts."""
    return dates.astype("datetime64[ms]").astype(np.int64).astype(np.float64)


def _packed(values: ArrayLike, dtype: str = "f4") -> dict[str, str]:
    """Numbers as plotly unpacks them."""
    data = np.ascontiguousarray(values, dtype=f"<{dtype}").tobytes()
    return {"dtype": dtype, "bdata": base64.b64encode(data).decode()}
