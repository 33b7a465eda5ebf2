"""Residuals over time: panels of stations and links, and envelopes of many values.

More dots than a panel has columns of pixels hide each other. The envelope shows, for each short bin of time, the range
of the values, so that none is missed, and in a darker colour their mean and standard deviation, which dots would hide.
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
"""More in one panel are drawn as an envelope."""
BINS = 400
"""Bins of time in the width of a panel."""
_MAX_HEIGHT_RATIO = 4.0  # panels share a scale unless one would be squeezed by more than this
_MAX_NAME_CHARACTERS = 44  # characters of links that find room above a station's panel, beside numbers
_MIN_FILLED_FRACTION = 0.3  # of a panel about zero that residuals fill, or else it is about their middle


class Panel:
    """Contents of one panel: its title, which panels share its scale, and the rows of each error_context link."""

    # A panel of a station, in which bars must find room, shares its scale with all others. Where its observations are
    # all of one way, or were given without a path, its only link has no name.

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
        # About zero, but where residuals would be a thin band far from it.
        about_zero_m = max(-lowest_m, highest_m, float(np.median(sigma_m)))
        thin = len(shown) > 1 and highest_m - lowest_m < 2.0 * _MIN_FILLED_FRACTION * about_zero_m
        self.middle_m = 0.5 * (lowest_m + highest_m) if thin and lowest_m * highest_m > 0.0 else 0.0
        self.half_height_m = 1.15 * (
            max(0.5 * (highest_m - lowest_m), float(np.median(sigma_m))) if self.middle_m else about_zero_m
        )
        self.statistics = residuals.statistics(title, self.rows)

    def statement(self, factor: float, unit: str) -> str:
        """Return counts and rms in a unit that is a factor from metres; for links the rejected, too."""
        found = self.statistics
        text = f"{found.used} used"
        size_m = found.rms_m if self.like else found.wrms_m
        if size_m is not None:
            size = f"{factor * size_m:#.3g}" if self.like else f"{factor * size_m:.3g}"
            text += f", {'rms' if self.like else 'wrms'} {size} {unit}"
        return f"{text}, {found.rejected} rejected" if self.like and found.rejected else text


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


def _by_way(residuals: Residuals, rows: _Rows) -> dict[str, _Rows]:
    """Rows of a station by the way of their signal; nameless where that is one, or too many for a legend."""
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
    found: dict[tuple[bool, int, str], dict[str, _Rows]] = {}
    types, paths = residuals.types, residuals.paths
    links = [Link.from_path(path) for path in paths.texts]
    named, keys = link_ways(links), types.codes * len(links) + paths.codes
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
    """Values in each bin of time that has any: its middle, and their range, mean and deviation."""

    middle: Dates
    lowest: Floats
    highest: Floats
    mean: Floats
    deviation: Floats


def envelope_of(dates: Dates, values: Floats, limits: Limits) -> Envelope:
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
    return Envelope(middle, lowest[there], highest[there], mean, deviation)


def bin_of(dates: Dates, limits: Limits) -> NDArray[np.intp]:
    """Number of the bin of time that each date is in, 0 to BINS - 1."""
    whole = max((limits[1] - limits[0]) / np.timedelta64(1, "ms"), 1.0)
    part = (dates - limits[0]) / np.timedelta64(1, "ms") / whole
    return np.minimum((part * BINS).astype(np.intp), BINS - 1)
