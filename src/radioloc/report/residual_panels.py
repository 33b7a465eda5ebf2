"""Residuals over time: panels of stations and links, envelopes of many values, and charts of plotly's as plain data.

More dots than a panel has columns of pixels hide each other. The envelope shows, for each short bin of time, the range
of the values, so that none is missed, and in a darker colour their mean and standard deviation, which dots would hide.
Observations that were left out are all drawn.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS
from radioloc.report.cards import have_paths, ways
from radioloc.report.figures import length_unit, utc_dates

Dates = NDArray[np.datetime64]
Limits = tuple[np.datetime64, np.datetime64]
_Rows = NDArray[np.intp]

MOST_POINTS = 5000
"""More in one panel are drawn as an envelope."""
BINS = 400
"""Bins of time in the width of a panel."""
_MAX_HEIGHT_RATIO = 4.0  # panels share a scale unless one would be squeezed by more than this
_LONGEST_NAMES = 44  # characters of links that find room above a station's panel, beside numbers
_LEAST_PART = 0.3  # of a panel about zero that residuals fill, or else it is about their middle
_MOST_ON_PAGE = 40_000
_MOST_WITH_BARS = 300
"""Bars of more observations than these in one chart hide each other."""
_HOVER = "%{x|%Y-%m-%d %H:%M:%S} UTC<extra></extra><br>"


class Panel:
    """What one panel shows: its title, which panels share its scale, which rows by the name of their link.

    A panel of a station, in which bars must find room, shares its scale with all others. Where its observations are all
    of one way, or were given without a path, its only link has no name.
    """

    def __init__(self, residuals: Residuals, title: str, like: str, links: dict[str, _Rows]) -> None:
        self.title, self.like, self.links = title, like, links
        self.rows = np.concatenate(list(links.values()))
        used = residuals.used[self.rows]
        self.used, self.out = self.rows[used], self.rows[~used]
        self.crowded = len(self.used) > MOST_POINTS
        shown = self.used if len(self.used) else self.rows
        residual_m, sigma_m = residuals.residual_m[shown], residuals.sigma_m[shown]
        bar_m = 0.0 if like else sigma_m
        lowest_m, highest_m = float((residual_m - bar_m).min()), float((residual_m + bar_m).max())
        # About zero, but where residuals would be a thin band far from it.
        about_zero_m = max(-lowest_m, highest_m, float(np.median(sigma_m)))
        thin = len(shown) > 1 and highest_m - lowest_m < 2.0 * _LEAST_PART * about_zero_m
        self.middle_m = 0.5 * (lowest_m + highest_m) if thin and lowest_m * highest_m > 0.0 else 0.0
        self.half_height_m = 1.15 * (
            max(0.5 * (highest_m - lowest_m), float(np.median(sigma_m))) if self.middle_m else about_zero_m
        )
        self.statistics = residuals.statistics(title, self.rows)

    def statement(self, factor: float, unit: str) -> str:
        """How many are used and their rms, in a unit that is a factor from metres; of links, how many are left out."""
        found = self.statistics
        text = f"{found.used} used"
        size_m = found.rms_m if self.like else found.wrms_m
        if size_m is not None:
            size = f"{factor * size_m:#.3g}" if self.like else f"{factor * size_m:.3g}"
            text += f", {'rms' if self.like else 'wrms'} {size} {unit}"
        return f"{text}, {found.rejected} left out" if self.like and found.rejected else text


def residuals_of(solution: Solution | Residuals) -> Residuals:
    """The residuals of a solution, or those given; an error where there are none."""
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("there are no residuals to draw")
    return residuals


def station_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by station, and by the way of their signal where there are several."""
    stations = residuals.stations
    return [
        Panel(residuals, name, "", _by_way(residuals, np.flatnonzero(stations.are(name))))
        for name in stations.present()
    ]


def _of_maps(residuals: Residuals) -> NDArray[np.bool_]:
    """Which residuals are of places on maps."""
    return residuals.types.are("map_east") | residuals.types.are("map_north")


def tracking_of(solution: Solution | Residuals) -> Residuals:
    """All residuals but those of places on maps, of which two numbers say all; these where there are no others."""
    residuals = residuals_of(solution)
    of_maps = _of_maps(residuals)
    return residuals.select(~of_maps) if of_maps.any() and not of_maps.all() else residuals


def places_of(residuals: Residuals) -> list[str]:
    """What a line below a figure says of places on maps."""
    found: dict[str, list[str]] = {}
    for k in np.flatnonzero(_of_maps(residuals)).tolist():
        axis = residuals.types[[k]][0].removeprefix("map_")
        away = f"{axis} {residuals.residual_m[k]:+.3g} m"
        found.setdefault(residuals.paths[[k]][0], []).append(away)
    return [f"place {path}: {', '.join(away)}" for path, away in found.items()]


def _by_way(residuals: Residuals, rows: _Rows) -> dict[str, _Rows]:
    """Rows of a station by the way of their signal; nameless where that is one, or too many for a legend."""
    codes = residuals.paths.codes[rows]
    present = np.unique(codes).tolist()
    if len(present) == 1:
        return {"": rows}
    names = dict(zip(present, ways([Link.from_path(residuals.paths.texts[k]) for k in present]), strict=True))
    if sum(map(len, set(names.values()))) > _LONGEST_NAMES:
        return {"": rows}
    named = np.array([names[code] for code in codes.tolist()])
    return {name: rows[named == name] for name in sorted(set(names.values()), reverse=True)}


def link_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by type and by baseline or receiver, baselines first."""
    found: dict[tuple[bool, int, str], dict[str, _Rows]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    named, keys = ways(links), types.codes * len(links) + paths.codes
    for key in np.unique(keys):
        kind, k = types.texts[key // len(links)], key % len(links)
        if kind not in KINDS:
            raise InputError(f"type {kind!r} of an observation is not known; use {', '.join(KINDS)}")
        place = not links[k].differenced, KINDS.index(kind), links[k].place
        found.setdefault(place, {})[named[k]] = np.flatnonzero(keys == key)
    return [
        Panel(
            residuals,
            f"{kind_word(KINDS[kind])} {place}",
            KINDS[kind],
            dict(sorted(rows.items(), reverse=True)),
        )
        for (_, kind, place), rows in sorted(found.items(), key=lambda item: item[0])
    ]


def half_heights_m(panels: Sequence[Panel]) -> list[float]:
    """Half the height of each panel, the same for those that are alike unless one would be squeezed."""
    heights_m = []
    for panel in panels:
        like_m = [other.half_height_m for other in panels if other.like == panel.like]
        squeezed = max(like_m) > _MAX_HEIGHT_RATIO * min(like_m)
        heights_m.append(panel.half_height_m if squeezed else max(like_m))
    return heights_m


def kind_word(kind: str) -> str:
    """A type of measurement in words, short."""
    words = kind.removeprefix("vlbi_").replace("one_way", "one-way")
    return words.replace("_", " ").replace("doppler", "Doppler")


class Envelope(NamedTuple):
    """What many values are in each bin of time that has any: its middle, how many, their range, mean and deviation."""

    middle: Dates
    counts: NDArray[np.intp]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


def envelope_of(dates: Dates, values: NDArray[np.float64], limits: Limits) -> Envelope:
    """Put many values into bins of time."""
    place = bin_of(dates, limits)
    count = np.bincount(place, minlength=BINS)
    there = count > 0
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, place, values)
    np.maximum.at(highest, place, values)
    mean = np.bincount(place, values, BINS)[there] / count[there]
    squares = np.bincount(place, (values - mean[np.cumsum(there)[place] - 1]) ** 2, BINS)[there]
    deviation = np.sqrt(squares / count[there])
    middle = limits[0] + (np.flatnonzero(there) + 0.5) / BINS * (limits[1] - limits[0])
    return Envelope(middle, count[there], lowest[there], highest[there], mean, deviation)


def bin_of(dates: Dates, limits: Limits) -> NDArray[np.intp]:
    """Number of the bin of time that each date is in, 0 to BINS - 1."""
    whole = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part = (dates - limits[0]) / np.timedelta64(1, "ms") / whole
    return np.minimum((part * BINS).astype(np.intp), BINS - 1)


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
    ends = dates.min(), dates.max()
    crowded, out = len(panel.used) > most, panel.out
    traces: list[dict[str, Any]] = []
    for k, (name, rows) in enumerate(panel.links.items()):
        used = rows[residuals.used[rows]]
        if not len(used):
            continue
        which = "%{fullData.name}<br>" if len(panel.links) > 1 else ""
        if crowded:
            trace = _envelope(dates[used], y[used], ends, unit, which)
        else:
            hover = f"{which}{_HOVER}%{{y:.4g}} ± %{{customdata:.3g}} {unit}"
            trace = _dots(dates[used], y[used], hover, customdata=_packed(sigma[used]))
            if len(panel.used) <= _MOST_WITH_BARS:
                trace["error_y"] = _bars(sigma[used])
        label = escape(name or panel.title, quote=False)
        traces.append({"name": label, "marker": {"size": 4, "color": k}, **trace})
    notes = [f"bars: minimum to maximum in 1/{BINS} of the time, dots: mean"] if crowded else []
    if len(out):
        # Of too many those that are farthest off.
        shown = np.sort(out[np.argsort(-np.abs(y[out]), kind="stable")[:MOST_POINTS]])
        look = {"size": 7, "symbol": "x-thin", "color": "left out"}
        texts = [escape(text, quote=False) for text in residuals.statuses[shown]]
        trace = _dots(dates[shown], y[shown], f"{_HOVER}%{{y:.4g}} {unit}<br>%{{text}}", text=texts)
        traces.append({"name": f"{len(out)} left out", "marker": look, **trace})
    if beyond := int((np.abs(y[out] - middle) > half_height).sum()):
        notes.insert(0, f"{beyond} of these beyond the chart")
    pad = max(0.02 * (ends[1] - ends[0]), np.timedelta64(1, "m"))
    layout = {
        "xaxis": {"type": "date", "range": [_milliseconds(ends[0] - pad), _milliseconds(ends[1] + pad)]},
        "yaxis": {
            "range": [middle - half_height, middle + half_height],
            "title": {"text": f"residual ({unit})"},
        },
        "showlegend": len(panel.links) > 1,
    }
    content = {"data": traces, "layout": layout}
    return Chart(panel.title, panel.statement(factor, unit), "; ".join(notes), content)


def _dots(dates: Dates, y: NDArray[np.float64], hover: str, **more: Any) -> dict[str, Any]:
    place = {"x": _packed(_milliseconds(dates), "f8"), "y": _packed(y)}
    return {"mode": "markers", **place, "hovertemplate": hover, **more}


def _bars(up: NDArray[np.float64], **more: Any) -> dict[str, Any]:
    return {"type": "data", "array": _packed(up), "thickness": 1, "width": 0, **more}


def _envelope(dates: Dates, y: NDArray[np.float64], limits: Limits, unit: str, which: str) -> dict[str, Any]:
    found = envelope_of(dates, y, limits)
    texts = [
        f"{n} observations, {low:.4g} to {high:.4g}, mean {mean:.4g} ± {deviation:.3g} {unit}"
        for _, n, low, high, mean, deviation in zip(*found, strict=True)
    ]
    below = {"symmetric": False, "arrayminus": _packed(found.mean - found.lowest)}
    bars = _bars(found.highest - found.mean, **below)
    return _dots(found.middle, found.mean, f"{which}{_HOVER}%{{text}}", text=texts, error_y=bars)


def _milliseconds(dates: Any) -> Any:
    """Of the Unix epoch, as plotly counts."""
    return dates.astype("datetime64[ms]").astype(np.int64).astype(np.float64)


def _packed(values: ArrayLike, dtype: str = "f4") -> dict[str, str]:
    """Numbers as plotly unpacks them."""
    data = np.ascontiguousarray(values, dtype=f"<{dtype}").tobytes()
    return {"dtype": dtype, "bdata": base64.b64encode(data).decode()}
