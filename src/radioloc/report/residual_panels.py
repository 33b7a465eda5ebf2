"""Residuals over time: panels of stations and links, and envelopes of many values.

More dots than a panel has columns of pixels hide each other. The envelope shows, for each short bin of time, the range
of the values, and in a darker colour their mean and standard deviation.
All rejected observations are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS
from radioloc.results.names import link_ways
from radioloc.results.solution import Solution
from radioloc.vectors import Floats

Dates = NDArray[np.datetime64]
Limits = tuple[np.datetime64, np.datetime64]
_Rows = NDArray[np.intp]

MAX_POINTS = 5000
"""Number of observations in a panel above which the envelope is drawn."""
BINS = 400
"""Number of bins of time in the width of a panel."""
_MAX_HEIGHT_RATIO = 4.0  # ratio of the heights of panels that share a scale
_MAX_NAME_CHARACTERS = 44  # room above the panel of a station
_MIN_FILLED_FRACTION = 0.3  # of a panel about zero; thinner bands are centred


class Panel:
    """Contents of a panel: its title, the type whose panels share its scale, and the rows of each named link."""

    # Panels of stations, which have error bars, share one scale (`like` is empty). An only link has no name.

    def __init__(self, residuals: Residuals, title: str, like: str, links: dict[str, _Rows]) -> None:
        self.title, self.like, self.links = title, like, links
        self.rows = np.concatenate(list(links.values()))
        used = residuals.used[self.rows]
        self.used, self.out = self.rows[used], self.rows[~used]
        self.crowded = len(self.used) > MAX_POINTS
        shown = self.used if len(self.used) else self.rows
        residual_m, sigma_m = residuals.residual_m[shown], residuals.sigma_m[shown]
        bar_m = 0.0 if like else sigma_m
        lowest_m, highest_m = float((residual_m - bar_m).min()), float((residual_m + bar_m).max())
        # A thin band far from zero is drawn about its middle.
        about_zero_m = max(-lowest_m, highest_m, float(np.median(sigma_m)))
        thin = len(shown) > 1 and highest_m - lowest_m < 2.0 * _MIN_FILLED_FRACTION * about_zero_m
        self.middle_m = 0.5 * (lowest_m + highest_m) if thin and lowest_m * highest_m > 0.0 else 0.0
        self.half_height_m = 1.15 * (
            max(0.5 * (highest_m - lowest_m), float(np.median(sigma_m))) if self.middle_m else about_zero_m
        )
        self.statistics = residuals.statistics(title, self.rows)

    def statement(self, factor: float, unit: str) -> str:
        """Return counts and rms in words; `factor` converts metres to the unit."""
        statistics = self.statistics
        text = f"{statistics.used} used"
        size_m = statistics.rms_m if self.like else statistics.wrms_m
        if size_m is not None:
            size = f"{factor * size_m:#.3g}" if self.like else f"{factor * size_m:.3g}"
            text += f", {'rms' if self.like else 'wrms'} {size} {unit}"
        return f"{text}, {statistics.rejected} rejected" if self.like and statistics.rejected else text


def solution_residuals(solution: Solution | Residuals) -> Residuals:
    """Return the residuals of a solution; an :class:`InputError` if it has no observations."""
    residuals = solution.residuals if isinstance(solution, Solution) else solution
    if not len(residuals):
        raise InputError("residuals: expected at least one observation")
    return residuals


def station_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by station and by the way of the signal."""
    stations = residuals.stations
    return [
        Panel(residuals, name, "", _rows_by_way(residuals, np.flatnonzero(stations.are(name))))
        for name in stations.present()
    ]


def _rows_by_way(residuals: Residuals, rows: _Rows) -> dict[str, _Rows]:
    """Return the rows of a station by the way of the signal, without names if the legend has no room for them."""
    codes = residuals.paths.codes[rows]
    present = np.unique(codes).tolist()
    if len(present) == 1:
        return {"": rows}
    names = dict(
        zip(present, link_ways([Link.from_path(residuals.paths.texts[k]) for k in present]), strict=True)
    )
    if sum(map(len, set(names.values()))) > _MAX_NAME_CHARACTERS:
        return {"": rows}
    named = np.array([names[code] for code in codes.tolist()])
    return {name: rows[named == name] for name in sorted(set(names.values()), reverse=True)}


def link_panels(residuals: Residuals) -> list[Panel]:
    """Group observations by type and by baseline or receiver, baselines first."""
    groups: dict[tuple[bool, int, str], dict[str, _Rows]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    named, keys = link_ways(links), types.codes * len(links) + paths.codes
    for key in np.unique(keys):
        kind, k = types.texts[key // len(links)], key % len(links)
        if kind not in KINDS:
            raise InputError(f"type of an observation: expected one of {', '.join(KINDS)}, got {kind!r}")
        place = not links[k].differenced, KINDS.index(kind), links[k].place
        groups.setdefault(place, {})[named[k]] = np.flatnonzero(keys == key)
    return [
        Panel(
            residuals,
            f"{kind_word(KINDS[kind])} {place}",
            KINDS[kind],
            dict(sorted(rows.items(), reverse=True)),
        )
        for (_, kind, place), rows in sorted(groups.items(), key=lambda item: item[0])
    ]


def half_heights_m(panels: Sequence[Panel]) -> list[float]:
    """Return half the height of each panel; panels of one type share it unless their sizes differ too much."""
    heights_m = []
    for panel in panels:
        like_m = [item.half_height_m for item in panels if item.like == panel.like]
        squeezed = max(like_m) > _MAX_HEIGHT_RATIO * min(like_m)
        heights_m.append(panel.half_height_m if squeezed else max(like_m))
    return heights_m


def kind_word(kind: str) -> str:
    """Return the short name of a type of measurement."""
    words = kind.removeprefix("vlbi_").replace("one_way", "one-way")
    return words.replace("_", " ").replace("doppler", "Doppler")


class Envelope(NamedTuple):
    """Middle of each bin of time with values, and the range, mean and standard deviation of the values."""

    middle: Dates
    lowest: Floats
    highest: Floats
    mean: Floats
    deviation: Floats


def value_envelope(dates: Dates, values: Floats, limits: Limits) -> Envelope:
    """Return the envelope of values over time."""
    place = time_bins(dates, limits)
    count = np.bincount(place, minlength=BINS)
    filled = count > 0
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, place, values)
    np.maximum.at(highest, place, values)
    mean = np.bincount(place, values, BINS)[filled] / count[filled]
    squares = np.bincount(place, (values - mean[np.cumsum(filled)[place] - 1]) ** 2, BINS)[filled]
    deviation = np.sqrt(squares / count[filled])
    middle = limits[0] + (np.flatnonzero(filled) + 0.5) / BINS * (limits[1] - limits[0])
    return Envelope(middle, lowest[filled], highest[filled], mean, deviation)


def time_bins(dates: Dates, limits: Limits) -> NDArray[np.intp]:
    """Return the bin of time of each date, 0 to BINS - 1."""
    length_ms = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part = (dates - limits[0]) / np.timedelta64(1, "ms") / length_ms
    return np.minimum((part * BINS).astype(np.intp), BINS - 1)
