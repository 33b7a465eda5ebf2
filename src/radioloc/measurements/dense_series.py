"""Series of observations that are smooth in time, cut into segments.

Observations of one path and kind, with the same time tag, count interval and recorded conditions, are one series: all
that is computed for them is a smooth function of the time tag. A series is cut at gaps and every six hours of UTC,
where tables have their corners (Earth orientation at 0h, VMF3 every six), and what lies between into segments of equal
length.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.time import Epochs, tai_to_utc, utc_to_tai

DEGREES = ((600.0, 6), (3600.0, 10), (10800.0, 16))
"""Degree of the polynomial for segments up to these lengths, s; in three hours the Earth turns by 45 degrees."""
GAP_S = 900.0
"""A longer gap ends a segment: the point may have been below the horizon in it."""

WORTH = 4
"""A segment is worth interpolating that holds this many observations for each that is computed for it."""

CHECK_POINTS = 5
"""Points of a segment at which its polynomial is compared with the model."""

_NOT_OF_A_SERIES = (
    "epoch",
    "link",
    "links",
    "value_m",
    "sigma_m",
    "files",
    "file",
    "line",
    "ramps",
    "modulus_m",
)
_WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity")


@dataclass(frozen=True, slots=True)
class Segments:
    """Pieces of series."""

    begin: NDArray[np.intp]  # first place of its observations in the order of the series
    end: NDArray[np.intp]  # and the place after the last
    degree: NDArray[np.intp]  # of its polynomial
    middle: Epochs  # TAI
    half_s: NDArray[np.float64]  # half of its length: its first and last observation are this far away

    def __len__(self) -> int:
        return len(self.begin)


class DenseSeries:
    """The observations in order of series and time; conditions that the model does not use may vary within a series."""

    def __init__(self, model: PhysicalModel, observations: Observations, more_partials: bool = False) -> None:
        self._observations = observations
        self._tai = utc_to_tai(observations.epoch)
        self._quarter = 4.0 * observations.epoch.jd + np.floor(4.0 * observations.epoch.fraction)
        code = series_codes(model, observations, more_partials)
        first = self._tai.jd.min() if len(code) else 0.0
        elapsed_s = ((self._tai.jd - first) + self._tai.fraction) * SECONDS_PER_DAY
        self.order = _ordered(code, elapsed_s)
        self._code, self._elapsed_s = code[self.order], elapsed_s[self.order]

    def segments(self) -> Segments:
        """Segments of all pieces that hold enough observations; what they leave out is sparse."""
        return self._made(list(self._pieces()))

    def divided(self, segments: Segments) -> Segments:
        """Four parts of each segment, or two; those that would hold too few observations are left out."""
        pieces: list[tuple[int, int]] = []
        many = 4 * least_observations(DEGREES[-1][1])
        for begin, end in zip(segments.begin.tolist(), segments.end.tolist(), strict=True):
            # By quarters what has to be fine is found in fewer steps, by halves sparse series keep their segments.
            pieces += self._even(begin, end, 4 if end - begin >= many else 2)
        return self._made(pieces)

    def observations_at(
        self, segments: Segments, points: Callable[[int], NDArray[np.float64]]
    ) -> tuple[Observations, NDArray[np.intp]]:
        """Observations of each segment's series at the `points` of its degree, -1 to 1, and the segment of each."""
        at = [points(degree) for degree in segments.degree.tolist()]
        of_point = np.repeat(np.arange(len(segments)), [len(x) for x in at])
        shift_s = segments.half_s[of_point] * np.concatenate([[], *at])
        series = self._observations.select(self.order[segments.begin[of_point]])
        return replace(series, epoch=tai_to_utc(segments.middle[of_point].shifted(shift_s))), of_point

    def place(self, segments: Segments) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Segment of each observation, -1 where there is none, and where it lies in it, -1 to 1; shapes (n,)."""
        n = len(self.order)
        segment, x = np.full(n, -1, dtype=np.int32), np.zeros(n)
        # Segment by segment: the time within it keeps its digits however long the arc is.
        for k in range(len(segments)):
            rows = self.order[segments.begin[k] : segments.end[k]]
            days = (self._tai.jd[rows] - segments.middle.jd[k]) + (
                self._tai.fraction[rows] - segments.middle.fraction[k]
            )
            segment[rows] = k
            x[rows] = days * (SECONDS_PER_DAY / segments.half_s[k])
        return segment, x

    def _pieces(self) -> Iterator[tuple[int, int]]:
        """Pieces without a gap in one quarter of a day, divided evenly."""
        if not len(self.order):
            return
        longest_s = DEGREES[-1][0]
        quarter = self._quarter[self.order]
        gap = np.diff(self._elapsed_s) > GAP_S
        cuts = np.flatnonzero((np.diff(self._code) != 0) | (np.diff(quarter) != 0) | gap) + 1
        bounds = [0, *cuts.tolist(), len(self.order)]
        for begin, end in itertools.pairwise(bounds):
            # Ramps have corners.
            ramped = self._observations.ramped[self.order[begin]]
            if ramped or end - begin < least_observations(DEGREES[0][1]):
                continue
            length_s = self._elapsed_s[end - 1] - self._elapsed_s[begin]
            yield from self._even(begin, end, max(1, int(np.ceil(length_s / longest_s))))

    def _even(self, begin: int, end: int, count: int) -> Iterator[tuple[int, int]]:
        """Parts of equal length in time."""
        elapsed_s = self._elapsed_s[begin:end]
        edges_s = elapsed_s[0] + (elapsed_s[-1] - elapsed_s[0]) * np.arange(1, count) / count
        inner = begin + np.searchsorted(elapsed_s, edges_s)
        return itertools.pairwise([begin, *inner.tolist(), end])

    def _made(self, pieces: list[tuple[int, int]]) -> Segments:
        """Segments of pieces that hold enough observations, at more than one instant."""
        begin, end = np.array([(b, e) for b, e in pieces if e > b], dtype=np.intp).reshape(-1, 2).T
        length_s = self._elapsed_s[end - 1] - self._elapsed_s[begin]
        lengths_s, degrees = np.array(DEGREES).T
        # A longest segment may be longer by the rounding of its ends.
        which = np.minimum(np.searchsorted(lengths_s, length_s), len(lengths_s) - 1)
        degree = degrees.astype(np.intp)[which]
        keep = (end - begin >= least_observations(degree)) & (length_s > 0.0)
        begin, end, degree = begin[keep], end[keep], degree[keep]
        first, last = self._tai[self.order[begin]], self._tai[self.order[end - 1]]
        half_s = 0.5 * last.seconds_since(first)
        return Segments(begin, end, degree, first.shifted(half_s), half_s)


@cache
def nodes(degree: int) -> NDArray[np.float64]:
    """Roots of the Chebyshev polynomial of the next degree, where a polynomial of this degree is fixed."""
    return np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))


@cache
def check_points(degree: int) -> NDArray[np.float64]:
    """Both ends and three of the extremes between the nodes: where interpolation is worst."""
    extremes = np.round(np.linspace(0, degree + 1, CHECK_POINTS))
    return np.cos(np.pi * extremes / (degree + 1))


def least_observations(degree: Any) -> Any:
    """From how many observations on a segment is worth interpolating."""
    return WORTH * (degree + 1 + CHECK_POINTS)


def series_codes(
    model: PhysicalModel, observations: Observations, more_partials: bool = False
) -> NDArray[np.int64]:
    """Number of the series that each observation belongs to, shape (n,).

    All recorded columns but the measured value and its sigma must agree within a series, if the model uses them;
    values that were not recorded agree with each other.
    """
    free = set(_NOT_OF_A_SERIES)
    media = {medium.name: medium for medium in model.media}
    foreign = bool(model.added_media or set(media) - {"troposphere", "ionosphere", "antenna_axis_offset"})
    # Partials by the electron content need the frequencies whether or not a content is modelled.
    frequencies = more_partials or (
        "ionosphere" in media and (model.ionosphere is not None or model.media_calibrations is not None)
    )
    if not (frequencies or foreign):
        free.add("uplink_hz")
    if not ("troposphere" in media or foreign):
        free.update(_WEATHER)
    code = observations.link.astype(np.int64)
    for field in fields(observations):
        if field.name not in free:
            code = _folded(code, getattr(observations, field.name))
    return code


def _folded(code: NDArray[np.int64], column: NDArray[np.generic]) -> NDArray[np.int64]:
    """Codes that differ where the column does too."""
    if not len(code):
        return code
    # As a rule a column has one value in each series, which asks for no sorting.
    sample = np.zeros(int(code.max()) + 1, dtype=np.intp)
    sample[code] = np.arange(len(code))
    typical = column[sample][code]
    same = column == typical
    if column.dtype.kind == "f":
        same |= np.isnan(column) & np.isnan(typical)
    if same.all():
        return code
    values, number = np.unique(column, return_inverse=True)
    return np.unique(code * len(values) + number, return_inverse=True)[1].astype(np.int64)


def _ordered(code: NDArray[np.int64], elapsed_s: NDArray[np.float64]) -> NDArray[np.intp]:
    """Order by series, within it by time, within equal times as given."""
    small = len(code) == 0 or int(code.max()) < 2**16
    # Of 16-bit integers NumPy's stable sort is a radix sort.
    order = np.argsort(code.astype(np.uint16) if small else code, kind="stable")
    back = np.diff(elapsed_s[order]) < 0.0
    if (back & (np.diff(code[order]) == 0)).any():
        order = np.lexsort((elapsed_s, code))
    return order
