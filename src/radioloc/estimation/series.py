"""Used observations by series, whitened by their stated noise and in order of time.

A series is what one link measures of one kind. Delays of one epoch that share errors of stations are brought to
independent combinations by the principal axes of their covariance, each of which is a series; the axes of one epoch
serve for all epochs at which the same baselines were observed, so that a combination is the same from epoch to epoch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.gauss_markov import Points, Series, SeriesNoise
from radioloc.estimation.linearization import WhitenedPartials
from radioloc.labels import Labels, changed, distinct
from radioloc.measurements.link import Link
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.noise.covariance import ObservationCovariance
from radioloc.noise.processes import KalmanFilter, transitions
from radioloc.noise.whitening import Blocks, Diagonal, Rows, RowsOf, Structure, StructuredWhitener
from radioloc.time import Epochs
from radioloc.vectors import Codes, Floats, Indices, Mask

MAX_POINTS = 250  # of a series; longer ones are averaged over bins before a noise model is sought
_MIN_COMPILED_ROWS = 2**16  # of observations from which on noise is sought by compiled loops
_MIN_INTACT_FRACTION = 0.9  # of each series of a trial, below which all series are found anew
_ROWS_AT_ONCE = 2**20  # of indices that are made at once
_MAX_BIN_ROWS = 16  # rows of a bin whose partials are computed: partials are smooth within a bin
_SIGMA_RTOL = 1e-6  # of combinations that are equal but for rounding
_MIN_REMAINING_FRACTION = 0.37  # symmetric networks have no such part, so rounding does not decide


@dataclass(frozen=True, slots=True, eq=False)
class LinkSeries:
    """Observations of one link and type."""

    kind: str
    path: str
    signs: Mapping[str, float]  # with which the reception at each station is in the value

    @property
    def name(self) -> str:
        """Kind of measurement and path."""
        return f"{self.kind} {self.path}"


@dataclass(frozen=True, slots=True, eq=False)
class SeriesOrder:
    """Rows in order of series and time; the same for all fits of the same observations."""

    types: Labels  # kinds of the n observations
    time_s: Floats  # (n,), when each was made, s from any instant
    series: tuple[LinkSeries, ...]
    code: Codes  # (n,), which of the series an observation belongs to
    order: Codes  # (n,), rows, sorted by series and time
    is_of_trials: bool = False  # whether so many fits are made with it that compilation of their loops pays

    @classmethod
    def from_labels(cls, types: Labels, paths: Labels, time_s: Floats) -> SeriesOrder:
        """Sort observations of types and paths (n,) at times (n,), s."""
        pairs = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        series = []
        present = np.flatnonzero(np.bincount(pairs))
        number = np.zeros(present.max(initial=-1) + 1, dtype=np.int32)
        number[present] = np.arange(len(present))
        for pair in present.tolist():
            kind, path = types.texts[pair // len(paths.texts)], paths.texts[pair % len(paths.texts)]
            signs = Link.from_path(path).reception_signs if ">" in path else {path: 1.0}
            series.append(LinkSeries(kind, path, signs))
        code = number[pairs]
        return cls(types, time_s, tuple(series), code, np.lexsort((time_s, code)).astype(np.int32))

    @property
    def links(self) -> Labels:
        """Kind and path of each observation."""
        return Labels(self.code, tuple(series.name for series in self.series))

    def of_stations(self, codes: Iterable[int]) -> dict[str, dict[int, float]]:
        """Series of each receiving station, with its signs."""
        series_of_station: dict[str, dict[int, float]] = {}
        for code in codes:
            for station, sign in self.series[code].signs.items():
                series_of_station.setdefault(station, {})[code] = sign
        return series_of_station


@dataclass(frozen=True, eq=False)
class IndependentSeries(StructuredWhitener):
    """Whitener to independent combinations, N, which belong to s series in order of time."""

    series: tuple[Series, ...]
    number: Codes  # (N,), series of each combination, in the order of the whitener
    time_s: Floats  # (N,)
    compiled: bool = False  # whether compilation of the loops that seek their noise pays
    # Combinations (b, k) of blocks with rejected members, structure by structure, and orthonormal axes (b, k, h) of
    # these members in them.
    rejections: tuple[tuple[Indices, Floats], ...] = ()

    def with_rejections(self, rejected: Mask) -> IndependentSeries:
        """Return series of independent observations and blocks in which rejected members (n,) have no effect."""
        # With the map L of a block and orthonormal axes U of its columns for the rejected members, L^T (I - U U^T) L is
        # the inverse covariance of the others.
        rejections, start = [], 0
        for structure in self.structures:
            rows = structure.rows.reshape(len(structure.rows), -1)
            blocks = np.flatnonzero(rejected[rows].any(axis=1))
            if len(blocks):
                is_rejected = rejected[rows[blocks]]
                first = np.argsort(~is_rejected, axis=1, kind="stable")[:, : is_rejected.sum(axis=1).max()]
                roots = np.ones((len(blocks), 1, 1))
                if isinstance(structure, Blocks):
                    roots = structure.roots[structure.which[blocks]]
                axes = np.linalg.qr(np.take_along_axis(roots, first[:, None], axis=2))[0]
                axes *= np.take_along_axis(is_rejected, first, axis=1)[:, None]
                rejections.append((start + np.arange(rows.size).reshape(rows.shape)[blocks], axes))
            start += rows.size
        remaining = replace(self, rejections=tuple(rejections))
        remaining.__dict__["of_each"] = self.of_each  # the same
        return remaining

    def components(self, values: Floats, start: int) -> Iterator[tuple[Indices, Floats, Floats]]:
        """Yield blocks with rejected members in a part of the combinations (m, c), axes of these, and components."""
        for combinations, axes in self.rejections:
            blocks = slice(*np.searchsorted(combinations[:, 0], (start, start + len(values))))
            places = combinations[blocks] - start
            yield places, axes[blocks], np.swapaxes(axes[blocks], 1, 2) @ values[places]

    def project(self, values: Floats, start: int = 0) -> None:
        """Take rejected observations out of a part of the combinations (m, c), in place."""
        for places, axes, components in self.components(values, start):
            values[places] -= axes @ components

    @property
    def is_local(self) -> bool:
        """True if observations share errors within an epoch at most."""
        return all(isinstance(structure, Diagonal | Blocks) for structure in self.structures)

    @cached_property
    def intact(self) -> Floats:
        """Mask of the combinations of independent observations and blocks without rejected members, (N,), floats."""
        mask = np.broadcast_to(1.0, len(self.number))
        if self.rejections:
            mask = mask.copy()
        for combinations, _ in self.rejections:
            mask[combinations] = 0.0
        return mask

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations of unit variance, part by part."""
        return self._projected(super().whitened(rows_of))

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Yield rows and the transposed map of the parts of :meth:`whitened`, which are overwritten."""
        return super().transposed(self._projected(parts))

    def _projected(self, parts: Iterable[Floats]) -> Iterator[Floats]:
        start = 0
        for values in parts:
            self.project(values, start)
            start += len(values)
            yield values

    @cached_property
    def of_each(self) -> list[Rows]:
        """Combinations of each series, in order of time."""
        count = np.bincount(self.number, minlength=len(self.series))
        order = np.argsort(self.number, kind="stable").astype(np.int32)
        return np.split(order, np.cumsum(count)[:-1])

    @cached_property
    def bins(self) -> tuple[Codes, Indices, Floats]:
        """Bin of each combination, (N,); first bin of each series, and their count, (s + 1,); durations, s, (s,)."""
        place, begin, width_s = np.empty(len(self.number), dtype=np.int32), [0], []
        series_s, of_series, duration_s = np.zeros(0), np.zeros(0, dtype=np.intp), 0.0
        for indices in self.of_each:
            # Combinations have the times of their blocks.
            intact = indices[self.intact[indices] > 0.0]
            if not np.array_equal(series_s, self.time_s[intact]):
                series_s = self.time_s[intact]
                of_series, duration_s = bins(series_s, MAX_POINTS)
            place[indices] = begin[-1]  # of others too, without weight
            place[intact] = begin[-1] + of_series
            begin.append(begin[-1] + int(of_series[-1]) + 1)
            width_s.append(duration_s)
        return place, np.array(begin), np.array(width_s)

    @cached_property
    def in_bin(self) -> Floats:
        """Number of combinations in each bin, those of blocks with rejected members omitted."""
        return _sums(self.bins[0], self.bins[1][-1], self.intact)

    def binned(self, parts: Iterable[Floats]) -> tuple[Floats, Floats]:
        """Return sums (n, c) of whitened parts in bins by the roots of their counts, and squares of column 0, (s,)."""
        # Sums over the root of the count are of unit variance where observations are independent.
        place, begin, _ = self.bins
        sums, squares, start = np.zeros((begin[-1], 0)), np.zeros(len(self.series)), 0
        for values in parts:
            part = slice(start, start + len(values))
            sums = sums if start else np.zeros((len(sums), values.shape[1]))
            start = part.stop
            add_rows(sums, place[part], values, self.intact[part])
            squares += np.bincount(self.number[part], self.intact[part] * values[:, 0] ** 2, len(squares))
        return sums / np.sqrt(self.in_bin)[:, None], squares

    def sections(self, parts: Iterable[Floats]) -> Iterator[tuple[slice, list[int], Floats]]:
        """Yield successive combinations, the series to which they all belong, and their columns from all parts."""
        first, last = np.array([indices[[0, -1]] for indices in self.of_each]).T
        order = np.argsort(first)
        ends = np.maximum.accumulate(last[order]) + 1
        is_complete = np.append(first[order[1:]] >= ends[:-1], True)
        numbers, begin, parts = list[int](), 0, iter(parts)
        part = next(parts)
        for number, end, complete in zip(order.tolist(), ends.tolist(), is_complete.tolist(), strict=True):
            numbers.append(number)
            if not complete or (end - begin < ROWS_AT_ONCE and end < len(self.number)):
                continue
            columns, filled = np.empty((end - begin, part.shape[1])), 0
            while filled < len(columns):
                part = part if len(part) else next(parts)
                count = min(len(part), len(columns) - filled)
                columns[filled : filled + count], part = part[:count], part[count:]
                filled += count
            yield slice(begin, end), numbers, columns
            numbers, begin = [], end


@dataclass(frozen=True, slots=True, eq=False)
class StatedSeries:
    """Series of all usable observations by their stated noise, for fits that reject a few of them."""

    noise: ObservationCovariance
    series: IndependentSeries
    whitened: WhitenedPartials

    @classmethod
    def from_basis(
        cls, order: SeriesOrder, noise: ObservationCovariance, usable: Mask, basis: Floats, from_free: Floats
    ) -> StatedSeries | None:
        """Whiten the partials (n, q) of orthonormal coordinates; None if observations share more than an epoch."""
        series = independent_series(order, noise, usable)
        if not series.is_local:
            return None
        return cls(noise, series, WhitenedPartials.from_basis(series, basis, from_free))

    def with_rejections(self, rejected: Mask) -> tuple[IndependentSeries, WhitenedPartials] | None:
        """Return the series without the rejected observations (n,), and their partials; None for many of a series."""
        series, grams, start = self.series.with_rejections(rejected), list(self.whitened.grams), 0
        counts = np.bincount(series.number)
        if (np.bincount(series.number, series.intact) < _MIN_INTACT_FRACTION * counts).any():
            return None
        for k, part in enumerate(self.whitened.parts):
            for _, _, components in series.components(part, start):
                flat = components.reshape(-1, part.shape[1])
                grams[k] = grams[k] - flat.T @ flat
            start += len(part)
        return series, replace(self.whitened, grams=tuple(grams), project=series.project)


@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedWhitener:
    """Whitener of series that have noise of their own, in units of the stated noise."""

    series: IndependentSeries
    filter: KalmanFilter

    @classmethod
    def from_noise(cls, series: IndependentSeries, noise: Mapping[str, SeriesNoise]) -> CorrelatedWhitener:
        """Whitener by the noise of each series, one process each; by key, white of unit variance by default."""
        noise_of_series = (noise.get(item.key) for item in series.series)
        numbers = [
            (1.0, 0.0, 1.0) if item is None else (item.white, item.coloured.sum(), item.correlation_time_s)
            for item in noise_of_series
        ]
        white, *process = np.array(numbers)[series.number].T
        variance, tau_s = (item[:, None] for item in process)
        step_s = np.diff(series.time_s, prepend=series.time_s[0])
        transition = transitions(step_s, variance, tau_s, changed(series.number))
        every = np.zeros((len(white), 1), dtype=np.intp)
        return cls(
            series, KalmanFilter.from_processes(every, series.intact[:, None].copy(), white, transition)
        )

    @property
    def stated(self) -> IndependentSeries:
        """Whitener of the stated noise."""
        return self.series

    @property
    def structures(self) -> tuple[Structure, ...]:
        """Structures of the stated noise."""
        return self.series.structures

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations of unit variance, part by part."""
        start, state = 0, None
        for values in self.series.whitened(rows_of):
            state = np.zeros((1, values.shape[1])) if state is None else state
            yield self.filter.innovations(values, slice(start, start := start + len(values)), state)

    def transposed(self, parts: Iterable[Floats]) -> Iterator[tuple[Rows, Floats]]:
        """Rows and the product of such parts with the transpose of :meth:`whitened`."""
        whitened = list(parts)
        ends = np.cumsum([len(part) for part in whitened])
        return self.series.transposed(np.split(self.filter.adjoint(np.concatenate(whitened)), ends[:-1]))


def add_rows(sums: Floats, place: Indices | Codes, values: Floats, weight: Floats | float = 1.0) -> None:
    """Add values (m, c) times weights (m,) to those rows of sums that are their places (m,)."""
    from scipy.sparse import csr_array

    if values.shape[1] == 1:
        sums[:, 0] += np.bincount(place, weight * values[:, 0], len(sums))
        return
    matrix = csr_array(
        (weight * np.ones(len(place)), place, np.arange(len(place) + 1)), (len(place), len(sums))
    )
    sums += matrix.T @ values


def _sums(place: Codes, count: int, weight: Floats | None = None) -> Floats:
    """Return the sums in bins of weights (n,), by default one, part by part: indices of all rows are large."""
    sums = np.zeros(count)
    for start in range(0, len(place), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        sums += np.bincount(place[part], None if weight is None else weight[part], count)
    return sums


def points_of(series: IndependentSeries, rows_of: RowsOf) -> Points:
    """Points of each series, averaged beyond :data:`MAX_POINTS`: residuals in column 0, then partials."""
    place, begin, width_s = series.bins
    columns, squares = series.binned(series.whitened(rows_of))
    time_s = _sums(place, begin[-1], series.intact * series.time_s) / series.in_bin
    step_s = np.diff(time_s, prepend=time_s[0])
    step_s[begin[:-1]] = 0.0
    return Points(
        series=series.series,
        begin=begin,
        count=_sums(series.number, len(squares), series.intact),
        squares=squares,
        width_s=width_s,
        step_s=step_s,
        gain=np.sqrt(series.in_bin),
        residual=columns[:, 0].copy(),
        unit=columns[:, 1:],
        time_s=time_s,
        compiled=series.compiled,
    )


def link_contributions(
    series: IndependentSeries, order: SeriesOrder, rows_of: RowsOf
) -> tuple[Indices, Indices, Floats]:
    """Return contributions of links to points: point and link, (m,), and sums of smooth columns, (m, c)."""
    from scipy.sparse import csr_array

    begin = series.bins[1]
    count = _sums(series.bins[0], begin[-1])
    widths = np.ones(begin[-1], dtype=np.intp)
    for _, _, rows, bin_of in _binned_parts(series):
        widths[bin_of] = rows.shape[1]
    first = np.cumsum(widths) - widths
    code, sums = np.empty(widths.sum(), dtype=np.intp), np.zeros((0, 0))
    for structure, part, rows, bin_of in _binned_parts(series):
        width, position = rows.shape[1], first[bin_of]
        # Each combination of a block has a contribution of each member.
        index = position[:, :, None] + np.arange(width)
        code[index] = order.code[rows][:, None]
        if not isinstance(structure, Diagonal | Blocks):
            values = structure.whiten(part, rows_of(rows[:, 0]))
            sums = sums if sums.size else np.zeros((len(code), values.shape[1]))
            add_rows(sums, position[:, 0], values)
            continue
        chosen, weight = _sampled(position[:, 0])
        values = rows_of(rows[chosen].ravel())
        sums = sums if sums.size else np.zeros((len(code), values.shape[1]))
        member = np.broadcast_to(np.arange(values.shape[0]).reshape(-1, 1, width), index[chosen].shape)
        entries = _roots(structure, part, chosen) * weight[:, None, None]
        place, local = np.unique(index[chosen], return_inverse=True)
        shape = (len(place), len(values))
        sums[place] += csr_array((entries.ravel(), (local.ravel(), member.ravel())), shape) @ values
    point = np.repeat(np.arange(begin[-1]), widths)
    sums /= np.sqrt(count)[point, None]
    return point, code, sums


def binned_partials(series: IndependentSeries, rows_of: RowsOf) -> Floats:
    """Return sums (n, c) of whitened smooth columns in bins by the roots of their counts."""
    place, begin, _ = series.bins
    sums = np.zeros((begin[-1], 0))
    for structure, part, rows, bin_of in _binned_parts(series):
        if isinstance(structure, Diagonal | Blocks):
            chosen, weight = _sampled(bin_of[:, 0])
            sample = structure.select(part.start + chosen)
            values = sample.whiten(slice(None), rows_of(sample.rows.ravel()))
            if weight.max() > 1.0:
                values *= np.repeat(weight, rows.shape[1])[:, None]
            bin_of = bin_of[chosen]
        else:
            values = structure.whiten(part, rows_of(rows.ravel()))
        sums = sums if sums.size else np.zeros((len(sums), values.shape[1]))
        add_rows(sums, bin_of.ravel(), values)
    return sums / np.sqrt(_sums(place, begin[-1]))[:, None]


def _binned_parts(series: IndependentSeries) -> Iterator[tuple[Structure, slice, Indices, Codes]]:
    """Yield the parts of each structure: rows (m, k) and the bins of their combinations (m, k)."""
    start = 0
    for structure in series.structures:
        for part in structure.parts():
            rows = structure.rows[part].reshape(-1, structure.rows.size // len(structure.rows))
            bin_of = series.bins[0][start : (start := start + rows.size)]
            yield structure, part, rows, bin_of.reshape(rows.shape)


def _sampled(place: Codes) -> tuple[Indices, Floats]:
    """Choose rows of each run in one bin, evenly, and count the rows that each represents."""
    starts = np.flatnonzero(changed(place))
    count = np.diff(starts, append=len(place))
    if count.max(initial=0) <= _MAX_BIN_ROWS:
        return np.arange(len(place)), np.ones(len(place))
    rank, size = np.arange(len(place)) - np.repeat(starts, count), np.repeat(count, count)
    part = (_MAX_BIN_ROWS * np.stack([rank, rank - 1]) + size // 2) // size
    is_chosen = part[0] > part[1]  # in the middle of each part
    weight = count / np.add.reduceat(is_chosen.astype(np.intp), starts)
    rows = np.flatnonzero(is_chosen)
    return rows, np.repeat(weight, count)[rows]


def _roots(structure: Structure, part: slice, chosen: Indices) -> Floats:
    """Return the maps (m, k, k) of some blocks of a part to independent combinations."""
    if isinstance(structure, Blocks):
        return np.asarray(structure.roots[structure.which[part][chosen]])
    return structure.whiten(part, np.ones((len(structure.rows[part]), 1)))[chosen, :, None]


def bins(time_s: Floats, max_count: int) -> tuple[Indices, float]:
    """Bin of each of some times (n,) in order, up to `most`, and their duration, s; gaps take no bin."""
    n = len(time_s)
    if n <= max_count:
        return np.arange(n), 0.0
    step_s = np.diff(time_s)
    clock_s = np.append(0.0, np.cumsum(np.minimum(step_s, 10.0 * np.median(step_s))))
    width_s = float(clock_s[-1]) / max_count
    if not width_s > 0.0:  # all at one instant
        return np.arange(n) * max_count // n, 0.0
    return np.append(0, np.cumsum(np.diff(np.floor(clock_s / width_s)) > 0.0)), width_s


def independent_series(order: SeriesOrder, noise: ObservationCovariance, used: Mask) -> IndependentSeries:
    """All series of the used observations."""
    structures = noise.whitener(used, order.order).structures
    singles = [structure for structure in structures if not isinstance(structure, Blocks)]
    rows = np.concatenate([np.zeros(0, dtype=np.int32), *(structure.rows for structure in singles)])
    code = order.code[rows]
    codes = np.flatnonzero(np.bincount(code))
    number = np.searchsorted(codes, np.arange(len(order.series))).astype(np.int32)[code]
    links = [order.series[code] for code in codes.tolist()]
    series = [Series(link.name, link.name, link.kind, link.kind) for link in links]
    numbers, times_s = [number], [order.time_s[rows]]
    blocks = [
        part
        for structure in structures
        if isinstance(structure, Blocks)
        for part in _combinations(order, structure)
    ]
    for block_series, block in blocks:
        count, k = block.rows.shape
        numbers.append(np.tile(np.arange(len(series), len(series) + k, dtype=np.int32), count))
        times_s.append(np.repeat(order.time_s[block.rows[:, 0]], k))
        series += block_series
    structures = (*singles, *(block for _, block in blocks))
    number, time_s = np.concatenate(numbers), np.concatenate(times_s)
    compiled = order.is_of_trials or len(number) >= _MIN_COMPILED_ROWS
    return IndependentSeries(len(used), structures, tuple(series), number, time_s, compiled)


def _combinations(order: SeriesOrder, blocks: Blocks) -> Iterator[tuple[list[Series], Blocks]]:
    """Blocks by the links in them, with series of combinations that are the same from epoch to epoch."""
    keys, of_block = distinct(order.code[blocks.rows])
    for k, key in enumerate(keys):
        members, sort = np.flatnonzero(of_block == k), np.argsort(key, kind="stable")
        members = members[np.argsort(order.time_s[blocks.rows[members][:, sort[0]]], kind="stable")]
        present, covariance_index = np.unique(blocks.which[members], return_inverse=True)
        axes_m = blocks.axes_m[present]
        axes = np.swapaxes(blocks.roots[present] * axes_m[:, :, None], 1, 2)[:, sort]
        kind, links = order.series[key[0]].kind, tuple(key[sort].tolist())
        # Errors of stations and those of baselines alone are in different combinations, one of which may be correlated
        # in time and the other not, however near their sigmas are.
        first_m = axes_m[covariance_index[0]]
        part = np.cumsum(np.diff(first_m, prepend=-np.inf) > _SIGMA_RTOL * first_m)
        # Epochs of other covariances are brought to the same combinations in the same way.
        root = (axes / axes_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
        roots = _stable_principal_axes(axes[covariance_index[0]], part).T @ root
        series = [
            Series(
                f"{kind} {links} {j}",
                f"{kind}, combination {j + 1} of {len(links)} that share errors",
                f"{kind} {links} {number}",
                kind,
                f"{kind} that share errors",
            )
            for j, number in enumerate(part.tolist())
        ]
        yield series, Blocks(blocks.rows[members][:, sort], covariance_index, roots, axes_m)


def _stable_principal_axes(axes: Floats, part: Indices) -> Floats:
    """Principal axes (k, k) in columns; those of equal sigma in one part are chosen independently of rounding."""
    # Any rotation of them is as good, but noise is sought along each, so another one gives other sigmas. One after the
    # other takes all that is left in the part of the next observation, so an error of the first is in one of them.
    out = np.empty_like(axes)
    for k in range(1, int(part[-1]) + 1):
        part_axes = axes[:, part == k]
        projection = part_axes @ part_axes.T
        for column in np.flatnonzero(part == k).tolist():
            squares = projection.diagonal()
            chosen = int(np.argmax(squares > _MIN_REMAINING_FRACTION * squares.max()))
            axis = projection[:, chosen] / math.sqrt(squares[chosen])
            projection = projection - axis[:, None] * axis
            out[:, column] = axis
    return out


def seconds_since_midnight(epoch: Epochs) -> Floats:
    """Time since the first midnight, s, shape (n,), without leap seconds."""
    first = epoch.jd.min() if len(epoch) else 0.0
    return np.asarray(((epoch.jd - first) + epoch.fraction) * SECONDS_PER_DAY)
