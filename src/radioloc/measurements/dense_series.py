"""Smooth series of observations, their segments, and the polynomials of segments.

Observations with the same path, kind, time tag, count interval and recorded conditions form a series. A series is cut
at gaps and every six hours of UTC, at the corners of tables (Earth orientation at 0h, VMF3 every six hours), and its
pieces are divided into segments of equal length. docs/architecture.md derives the error bound of accepted segments. The
interpolated quantities are the columns of :class:`~radioloc.measurements.predictor.Computed` without the status, shape
(width, n).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed
from radioloc.measurements.target_motion import Motions
from radioloc.time import Epochs, tai_to_utc, utc_to_tai
from radioloc.vectors import Floats, Indices, Mask

DEGREE_BY_LENGTH_S = ((600.0, 6), (3600.0, 10), (10800.0, 16))  # largest length of segments, and degree
MAX_GAP_S = 900.0  # the target may have been below the horizon in a longer gap
MIN_OBSERVATIONS_PER_POINT = 4  # for each computed point, else interpolation saves no time
CHECK_POINT_COUNT = 5  # points of a segment at which its polynomial is compared with the model

_MEASURED = ("epoch", "value_m", "sigma_m", "modulus_m")
_FREE_IN_A_SERIES = {*_MEASURED, "link", "links", "files", "file", "line", "ramps"}
_WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity")

SAFETY_FACTOR = 4.0  # between tolerances and deviations at the check points
VALUE_TOLERANCE_M = 0.9e-4  # of values: 0.3 ps of delay
PARTIAL_TOLERANCE = 1e-6  # of partials, relative to the largest in the segment; of elevations, rad
MAX_COEFFICIENTS = 4 * math.ceil(DEGREE_BY_LENGTH_S[-1][1] / 4) + 1  # in groups of four after the first
_ROUNDING = {
    "by_position_pa": 2e-12,
    "by_time_m_s": 1e-6,
    "by_transponder_delay_m_s": 1e-5,
    "by_zenith_wet": 1e-9,
    "by_station_itrf": 2e-12,
    "by_electron_content_m": 1e-9,
    "mean_by_position_pa": 2e-12,
}
"""Rounding errors of the partials, a lower limit of tolerances."""
_MAX_POSITION_TOLERANCE = 1e-9  # of a partial by position, m/m: 0.01 mm of the value over 10 km
_NEGLIGIBLE_FRACTION = 1e-3  # of the tolerance: sum of the last coefficients that are dropped
# To limits of elevation; smaller margins may be crossed between nodes or 10 km away.
_MIN_MARGIN_RAD = np.radians(0.05)
_EARTH_ROTATION_RAD_S = 7.3e-5


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments of series."""

    begin: Indices  # place of the first observation in the order of the series
    end: Indices  # place after the last observation
    degree: Indices  # of the polynomial
    middle: Epochs  # TAI
    half_s: Floats  # half of the length

    def __len__(self) -> int:
        return len(self.begin)


class DenseSeries:
    """Observations in order of series and time; conditions that the model does not use may vary in a series."""

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
        """Return segments of all pieces with enough observations."""
        return self._segments_of(list(self._pieces()))

    def divided(self, segments: Segments) -> Segments:
        """Return four parts of each segment, or two; parts with too few observations are dropped."""
        pieces: list[tuple[int, int]] = []
        min_count = 4 * min_observation_count(DEGREE_BY_LENGTH_S[-1][1])
        for begin, end in zip(segments.begin.tolist(), segments.end.tolist(), strict=True):
            # Quarters need fewer steps for short segments; halves retain segments of sparse series.
            pieces += self._even(begin, end, 4 if end - begin >= min_count else 2)
        return self._segments_of(pieces)

    def observations_at(
        self, segments: Segments, points: Callable[[int], Floats]
    ) -> tuple[Observations, Indices]:
        """Return observations of each segment's series at the `points` of its degree, -1 to 1, and their segments."""
        places = [points(degree) for degree in segments.degree.tolist()]
        of_point = np.repeat(np.arange(len(segments)), [len(x) for x in places])
        shift_s = segments.half_s[of_point] * np.concatenate([[], *places])
        series = self._observations.select(self.order[segments.begin[of_point]])
        return replace(series, epoch=tai_to_utc(segments.middle[of_point].shifted(shift_s))), of_point

    def segments_of_rows(self, segments: Segments) -> tuple[NDArray[np.int32], Floats]:
        """Return the segment of each observation, or -1, and its place in the segment, -1 to 1; shapes (n,)."""
        n = len(self.order)
        segment, x = np.full(n, -1, dtype=np.int32), np.zeros(n)
        # Times relative to each segment keep their digits in long arcs.
        for k in range(len(segments)):
            rows = self.order[segments.begin[k] : segments.end[k]]
            days = (self._tai.jd[rows] - segments.middle.jd[k]) + (
                self._tai.fraction[rows] - segments.middle.fraction[k]
            )
            segment[rows] = k
            x[rows] = days * (SECONDS_PER_DAY / segments.half_s[k])
        return segment, x

    def _pieces(self) -> Iterator[tuple[int, int]]:
        """Yield pieces without a gap in a quarter of a day, divided evenly."""
        if not len(self.order):
            return
        max_length_s = DEGREE_BY_LENGTH_S[-1][0]
        quarter = self._quarter[self.order]
        gap = np.diff(self._elapsed_s) > MAX_GAP_S
        cuts = np.flatnonzero((np.diff(self._code) != 0) | (np.diff(quarter) != 0) | gap) + 1
        bounds = [0, *cuts.tolist(), len(self.order)]
        for begin, end in itertools.pairwise(bounds):
            # Ramps have corners.
            ramped = self._observations.ramped[self.order[begin]]
            if ramped or end - begin < min_observation_count(DEGREE_BY_LENGTH_S[0][1]):
                continue
            length_s = self._elapsed_s[end - 1] - self._elapsed_s[begin]
            yield from self._even(begin, end, max(1, int(np.ceil(length_s / max_length_s))))

    def _even(self, begin: int, end: int, count: int) -> Iterator[tuple[int, int]]:
        """Yield parts of equal duration."""
        elapsed_s = self._elapsed_s[begin:end]
        edges_s = elapsed_s[0] + (elapsed_s[-1] - elapsed_s[0]) * np.arange(1, count) / count
        inner = begin + np.searchsorted(elapsed_s, edges_s)
        return itertools.pairwise([begin, *inner.tolist(), end])

    def _segments_of(self, pieces: list[tuple[int, int]]) -> Segments:
        """Return segments of pieces with enough observations, at different instants."""
        begin, end = np.array([(b, e) for b, e in pieces if e > b], dtype=np.intp).reshape(-1, 2).T
        length_s = self._elapsed_s[end - 1] - self._elapsed_s[begin]
        lengths_s, degrees = np.array(DEGREE_BY_LENGTH_S).T
        # The longest segments may be longer by the rounding of their ends.
        index = np.minimum(np.searchsorted(lengths_s, length_s), len(lengths_s) - 1)
        degree = degrees.astype(np.intp)[index]
        keep = (end - begin >= min_observation_count(degree)) & (length_s > 0.0)
        begin, end, degree = begin[keep], end[keep], degree[keep]
        first, last = self._tai[self.order[begin]], self._tai[self.order[end - 1]]
        half_s = 0.5 * last.seconds_since(first)
        return Segments(begin, end, degree, first.shifted(half_s), half_s)


@cache
def nodes(degree: int) -> Floats:
    """Return the nodes of a polynomial of a degree: roots of the Chebyshev polynomial of the next degree."""
    return np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))


@cache
def check_points(degree: int) -> Floats:
    """Return both ends and three extremes between the nodes, the places of the largest interpolation errors."""
    extremes = np.round(np.linspace(0, degree + 1, CHECK_POINT_COUNT))
    return np.cos(np.pi * extremes / (degree + 1))


def min_observation_count(degree: Any) -> Any:
    """Return the smallest number of observations of an interpolated segment."""
    return MIN_OBSERVATIONS_PER_POINT * (degree + 1 + CHECK_POINT_COUNT)


def series_codes(
    model: PhysicalModel, observations: Observations, more_partials: bool = False
) -> NDArray[np.int64]:
    """Return the index of each observation's series, with equal values of the columns that the model uses, (n,)."""
    ignored = set(_FREE_IN_A_SERIES)
    media = {medium.name: medium for medium in model.media}
    foreign = bool(set(media) - {"troposphere", "ionosphere", "antenna_axis_offset"})
    # Partials with respect to the electron content always need the frequencies.
    frequencies = more_partials or (
        "ionosphere" in media and (model.ionosphere is not None or model.media_calibrations is not None)
    )
    if not (frequencies or foreign):
        ignored.add("uplink_hz")
    if not ("troposphere" in media or foreign):
        ignored.update(_WEATHER)
    code = observations.link.astype(np.int64)
    for field in fields(observations):
        if field.name not in ignored:
            code = _folded(code, getattr(observations, field.name))
    return code


def _folded(code: NDArray[np.int64], column: NDArray[np.generic]) -> NDArray[np.int64]:
    """Return codes that also differ where a column differs."""
    if not len(code) or column.strides == (0,):
        return code
    # A column that is constant in each series, the usual case, needs no sorting.
    sample = np.zeros(int(code.max()) + 1, dtype=np.intp)
    sample[code] = np.arange(len(code))
    typical = column[sample][code]
    equal = column == typical
    if column.dtype.kind == "f":
        equal |= np.isnan(column) & np.isnan(typical)
    if equal.all():
        return code
    values, number = np.unique(column, return_inverse=True)
    return np.unique(code * len(values) + number, return_inverse=True)[1].astype(np.int64)


def _ordered(code: NDArray[np.int64], elapsed_s: Floats) -> Indices:
    """Return the order by series and time; equal times keep their order."""
    small = len(code) == 0 or int(code.max()) < 2**16
    # NumPy's stable sort of 16-bit integers is a radix sort.
    order = np.argsort(code.astype(np.uint16) if small else code, kind="stable")
    back = np.diff(elapsed_s[order]) < 0.0
    if (back & (np.diff(code[order]) == 0)).any():
        order = np.lexsort((elapsed_s, code))
    return order


Layout = dict[str, tuple[slice, tuple[int, ...]]]  # slice of the quantities and shape of rows of each column


def layout(computed: Computed) -> Layout:
    """Return the layout of columns as quantities; partials with respect to motion follow from those by position."""
    places, end = {}, 0
    for field in fields(Computed):
        if field.name not in ("status", "by_motion"):
            shape = getattr(computed, field.name).shape[1:]
            begin, end = end, end + math.prod(shape)
            places[field.name] = slice(begin, end), shape
    return places


def stacked(computed: Computed) -> Floats:
    """Return columns as quantities, shape (width, n)."""
    n = len(computed.value_m)
    columns = [(getattr(computed, name), shape) for name, (_, shape) in layout(computed).items()]
    return np.concatenate([column.reshape(n, math.prod(shape)).T for column, shape in columns])


def unstacked(quantities: Floats, places: Layout, status: NDArray[np.int8]) -> Computed:
    """Return quantities (width, n) as columns, without copies."""
    n = quantities.shape[1]
    columns = {name: quantities[place].T.reshape(n, *shape) for name, (place, shape) in places.items()}
    return Computed(**columns, status=status, by_motion=columns["by_position_pa"])


def first_nodes(degree: Indices) -> Indices:
    """Return the row of the first node of each segment, and the row after the last node."""
    return np.concatenate([[0], np.cumsum(degree + 1)])


def polynomials(degree: Indices, at_nodes: Floats, places: Layout) -> tuple[Floats, Floats]:
    """Return coefficients of descending powers and of ascending Chebyshev polynomials, shapes (m, width, n)."""
    size = len(at_nodes)
    middle, series = np.empty((len(degree), size)), np.zeros((len(degree), size, MAX_COEFFICIENTS))
    for n, of_degree, rows in _segments_by_degree(degree):
        values = np.moveaxis(at_nodes[:, rows].reshape(size, -1, n + 1), 0, 1)
        # Differences from the value in the middle keep their digits in the sums.
        middle[of_degree] = centre = values[..., n // 2]
        series[of_degree, :, : n + 1] = (values - centre[..., None]) @ _to_chebyshev(n)
    negligible = _NEGLIGIBLE_FRACTION * _tolerances(np.abs(middle).T, places).T
    negligible[:, places["value_m"][0]] = 0.0
    tail_sum = np.abs(series) @ np.tri(MAX_COEFFICIENTS)  # of each coefficient and those after it
    np.copyto(series, 0.0, where=tail_sum < negligible[..., None])
    powers = series @ _to_powers()
    powers[..., -1] += middle
    return powers, series


def compare(
    degree: Indices, nodes: ExactPredictor, checks: ExactPredictor, motions: Motions
) -> tuple[Mask, Floats]:
    """Return whether segments agree with the model at their check points, (m,), and the deviations, (m, width).

    Nodes and check points are in the order of the segments; rows after the nodes are ignored.
    """
    m, n_nodes = len(degree), int((degree + 1).sum())
    at_nodes, at_checks = nodes.compute(motions).rows(slice(n_nodes)), checks.compute(motions)
    values, places = stacked(at_nodes), layout(at_nodes)
    size = len(values)
    model = np.moveaxis(stacked(at_checks).reshape(size, m, CHECK_POINT_COUNT), 0, 1)
    coefficients, series = polynomials(degree, values, places)
    accepted, deviation = np.ones(m, dtype=bool), np.zeros((m, size))
    # Elevations need a margin to limits, which includes the motion in half of a count interval.
    limits_rad = {0.0}.union(*(medium.limits_rad for medium in nodes.model.media))
    count_s = np.nan_to_num(checks.observations.count_s[::CHECK_POINT_COUNT])
    margin_rad = _MIN_MARGIN_RAD + _EARTH_ROTATION_RAD_S * count_s
    for n, of_degree, rows in _segments_by_degree(degree):
        selected = coefficients[of_degree]
        largest_deviation = np.abs(model[of_degree] - _evaluate(selected, check_points(n))).max(axis=-1)
        deviation[of_degree] = largest_deviation
        largest = np.abs(values[:, rows].reshape(size, -1, n + 1)).max(axis=-1)
        tail = np.abs(series[of_degree, :, n - 1 : n + 1]).sum(axis=-1)
        agrees = _tolerances(largest, places) >= np.maximum(largest_deviation, tail).T
        content = places["by_electron_content_m"][0]
        agrees[content] |= np.isnan(largest[content])  # signals without recorded frequency
        accepted[of_degree] &= agrees.all(axis=0)
        # Elevations between the nodes are on the same side of all limits, so that the status is that of the nodes.
        grid = np.linspace(-1.0, 1.0, 4 * n + 1)
        elevation_rad = _evaluate(selected[:, places["elevation_rad"][0]], grid)
        for limit_rad in limits_rad:
            distance_rad = elevation_rad - limit_rad
            side = np.sign(distance_rad[:, :, :1])
            accepted[of_degree] &= (distance_rad * side > margin_rad[of_degree, None, None]).all(axis=(1, 2))
    # All points of a segment have the same status, and the same source of Earth orientation.
    first = first_nodes(degree)[:-1]
    predicted = nodes.predicted_eop[:n_nodes], checks.predicted_eop
    of_node, of_check = np.repeat(np.arange(m), degree + 1), np.repeat(np.arange(m), CHECK_POINT_COUNT)
    at_first = np.column_stack([at_nodes.status, predicted[0]])[first]
    for computed, points, of_point in (
        (at_nodes, predicted[0], of_node),
        (at_checks, predicted[1], of_check),
    ):
        differs = np.column_stack([computed.status, points]) != at_first[of_point]
        accepted[of_point[differs.any(axis=1)]] = False
    return accepted, deviation


def _segments_by_degree(degree: Indices) -> Iterator[tuple[int, Indices, Indices]]:
    """Yield each degree, its segments and their nodes."""
    of_node = np.repeat(degree, degree + 1)
    for n in np.unique(degree):
        yield int(n), np.flatnonzero(degree == n), np.flatnonzero(of_node == n)


@cache
def _to_chebyshev(degree: int) -> Floats:
    """Return the matrix from values at the nodes to Chebyshev coefficients."""
    matrix = chebyshev.chebvander(nodes(degree), degree) * (2.0 / (degree + 1))
    matrix[:, 0] *= 0.5
    return np.asarray(matrix)


@cache
def _to_powers() -> Floats:
    """Return the matrix from Chebyshev coefficients to those of powers, descending."""
    matrix = np.zeros((MAX_COEFFICIENTS, MAX_COEFFICIENTS))
    for k, unit in enumerate(np.eye(MAX_COEFFICIENTS)):
        matrix[k, MAX_COEFFICIENTS - 1 - k :] = chebyshev.cheb2poly(unit)[::-1]
    return matrix


def _evaluate(coefficients: Floats, x: Floats) -> Floats:
    """Return polynomials at the same places of all segments, shape (m, n_quantities, len(x))."""
    return np.asarray(polynomial.polyval(x, np.moveaxis(coefficients[..., ::-1], -1, 0)))


def _tolerances(size: Floats, places: Layout) -> Floats:
    """Return tolerances at check points from the largest sizes of the quantities at the nodes; shapes (width, m)."""
    tolerances = np.full_like(size, PARTIAL_TOLERANCE / SAFETY_FACTOR)
    tolerances[places["value_m"][0]] = VALUE_TOLERANCE_M / SAFETY_FACTOR
    for name, rounding in _ROUNDING.items():
        place, _ = places[name]
        if name == "by_position_pa":
            relative = PARTIAL_TOLERANCE / SAFETY_FACTOR * np.linalg.norm(size[place], axis=0)
            tolerances[place] = np.clip(relative, rounding, _MAX_POSITION_TOLERANCE)
        else:
            relative = PARTIAL_TOLERANCE / SAFETY_FACTOR * size[place].max(axis=0, initial=0.0)
            tolerances[place] = np.maximum(relative, rounding)
    return tolerances
