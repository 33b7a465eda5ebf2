"""Used observations by series, whitened by their stated noise and in order of time.

A series is what one link measures of one kind. Delays of one epoch that share errors of stations are brought to
independent combinations by the principal axes of their covariance, each of which is a series; the axes of one epoch
serve for all epochs at which the same baselines were observed, so that a combination is the same from epoch to epoch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.gauss_markov import Points, Series, SeriesNoise
from radioloc.estimation.linearization import times
from radioloc.estimation.observation_noise import (
    ALONE,
    Block,
    ObservationNoise,
    Rows,
    RowsOf,
    slices,
    slices_of_chain,
    unchained,
)
from radioloc.labels import Labels, distinct
from radioloc.measurements.link import Link
from radioloc.measurements.predictor import ROWS_AT_ONCE
from radioloc.time import Epochs
from radioloc.vectors import Floats

MAX_POINTS = 250  # of a series; longer ones are averaged over bins before a noise model is sought
_ROW_WIDTH_RATIO = 4  # numbers of a row over those of a usual one: effects of errors are beside its partials
_SIGMA_RTOL = 1e-6  # of combinations that are equal but for rounding
_MIN_REMAINING_FRACTION = 0.37  # symmetric networks have no such part, so rounding does not decide


@dataclass(frozen=True, slots=True, eq=False)
class LinkSeries:
    """What one link measures of one kind."""

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
    code: NDArray[np.intp]  # (n,), which of the series an observation belongs to
    order: NDArray[np.intp]  # (n,), rows, sorted by series and time

    @classmethod
    def of(cls, types: Labels, paths: Labels, time_s: Floats) -> SeriesOrder:
        """That of observations of some types and paths (n,), made at some times (n,), s."""
        pairs = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        series = []
        present, code = np.unique(pairs, return_inverse=True)
        for pair in present.tolist():
            kind, path = types.texts[pair // len(paths.texts)], paths.texts[pair % len(paths.texts)]
            signs = Link.from_path(path).reception_signs if ">" in path else {path: 1.0}
            series.append(LinkSeries(kind, path, signs))
        return cls(types, time_s, tuple(series), code, np.lexsort((time_s, code)))

    @property
    def links(self) -> Labels:
        """Kind and path of each observation."""
        return Labels(self.code.astype(np.int32), tuple(one.name for one in self.series))

    def of_stations(self, codes: Iterable[int]) -> dict[str, dict[int, float]]:
        """Those of some series that each station has part in, with its sign."""
        found: dict[str, dict[int, float]] = {}
        for code in codes:
            for station, sign in self.series[code].signs.items():
                found.setdefault(station, {})[code] = sign
        return found


@dataclass(frozen=True, eq=False)
class Bundle:
    """The k series of combinations of the same j baselines, b values each; of single observations one series."""

    series: tuple[Series, ...]
    rows: NDArray[np.intp]  # (b, j), observations, in order of time
    time_s: Floats  # (b,)
    whitening: Floats  # (u, k, j), from observations to independent combinations of unit variance
    which: NDArray[np.intp]  # (b,), which of these is a value's
    # (2, b), of counts of a phase, by which they are brought to independent ones before
    factor: Floats | None = None

    @cached_property
    def step_s(self) -> Floats:
        """Time since the value before, s, shape (b,)."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    def _slices(self) -> Iterator[slice]:
        if self.factor is not None:
            return slices_of_chain(self.factor)
        return slices(len(self.rows), _ROW_WIDTH_RATIO * self.rows.shape[1])

    def parts(self, rows_of: RowsOf) -> Iterator[tuple[slice, Floats]]:
        """Some thousand of the values after others, (m, j, c), from rows (m,) to numbers (m, c) that belong to them."""
        for part in self._slices():
            values = rows_of(self.rows[part].ravel())
            if self.factor is not None:
                values = unchained(self.factor[:, part], values)
            yield part, np.ascontiguousarray(values).reshape(*self.rows[part].shape, -1)

    def whitened_parts(self, rows_of: RowsOf, noise: Mapping[str, SeriesNoise]) -> Iterator[Floats]:
        """Values (k, m, c), part by part, by the root of the inverse covariance, one process for each series."""
        from radioloc.estimation._kernels import whiten

        numbers, state = self._numbers(noise), np.zeros((0, 0))
        variance = numbers[2].copy()
        for part, values in self.parts(rows_of):
            state = state if part.start else np.zeros((len(variance), values.shape[2]))
            combined = (self.whitening, self.which[part], values)
            yield whiten(self.step_s[part], *numbers, *combined, variance, state)

    def whitened(self, rows_of: RowsOf, noise: Mapping[str, SeriesNoise]) -> Floats:
        """All of them at once, (k, b, c)."""
        return np.concatenate(list(self.whitened_parts(rows_of, noise)), axis=1)

    def weighted(self, values: Floats, noise: Mapping[str, SeriesNoise]) -> Floats:
        """Whitened values (k, b, c) by that root transposed, by which both are the inverse covariance's."""
        from radioloc.estimation._kernels import weigh

        return weigh(self.step_s, *self._numbers(noise), values)

    def on_observations(self, weighted: Floats) -> Iterator[tuple[Rows, Floats]]:
        """Some thousand rows after others (m,), and what their combinations' :meth:`weighted` values are of them."""
        for part in self._slices():
            whitening = self.whitening[self.which[part]]
            values = np.swapaxes(whitening, 1, 2) @ np.swapaxes(weighted[:, part], 0, 1)
            values = values.reshape(-1, weighted.shape[2])
            if self.factor is not None:
                values = unchained(self.factor[:, part], values, adjoint=True)
            yield self.rows[part].ravel(), values

    def _numbers(self, noise: Mapping[str, SeriesNoise]) -> Floats:
        """White variance, correlation time and ratio of each series, (3, k); white of unit variance by default."""
        found = [noise.get(one.key) for one in self.series]
        return np.array(
            [
                (1.0, 1.0, 0.0) if one is None else (one.white, one.correlation_time_s, one.ratio)
                for one in found
            ]
        ).T.copy()


def together(bundles: Sequence[Bundle]) -> list[list[Bundle]]:
    """Bundles of some thousand rows together; a longer one alone."""
    groups: list[list[Bundle]] = []
    size = 0
    for one in bundles:
        size += one.rows.size
        if size >= ROWS_AT_ONCE // _ROW_WIDTH_RATIO or not groups:
            groups.append([])
            size = one.rows.size
        groups[-1].append(one)
    return groups


def with_numbers(group: Sequence[Bundle], rows_of: RowsOf) -> Iterator[tuple[Bundle, RowsOf]]:
    """Bundles that are together with what gives the numbers of their rows, which are asked for once."""
    if len(group) == 1:
        return iter([(group[0], rows_of)])
    rows = [one.rows.ravel() for one in group]
    parts = np.split(rows_of(np.concatenate(rows)), np.cumsum([len(some) for some in rows])[:-1])

    def known(part: Floats) -> RowsOf:
        return lambda _: part

    return ((one, known(part)) for one, part in zip(group, parts, strict=True))


def points_of(bundles: Sequence[Bundle], rows_of: RowsOf, root: Floats) -> Points:
    """Points of each series, averaged beyond :data:`MAX_POINTS`, with partials by the parameters times `root`."""
    from radioloc.estimation._kernels import add_to_bins

    # Sums of bins are over the root of their count, so they are of unit variance where observations are independent.
    columns, of_series, of_points = [], [], []
    for one, numbers in (pair for group in together(bundles) for pair in with_numbers(group, rows_of)):
        place, duration_s = bins(one.time_s, MAX_POINTS)
        in_bin, k = np.bincount(place), len(one.series)
        sums, squares = np.zeros((0, 0, 0)), np.zeros(k)
        for part, values in one.parts(numbers):
            sums = sums if part.start else np.zeros((k, len(in_bin), values.shape[2]))
            add_to_bins(place[part], one.whitening, one.which[part], values, sums, squares)
        time_s = np.bincount(place, one.time_s) / in_bin
        gain, step_s = np.sqrt(in_bin), np.diff(time_s, prepend=time_s[0])
        columns.append((sums / gain[:, None]).reshape(-1, sums.shape[2]))
        of_series += [(len(in_bin), len(place), square, duration_s) for square in squares.tolist()]
        of_points += [(step_s, gain, time_s)] * k
    length, count, squares, width_s = (np.array(column) for column in zip(*of_series, strict=True))
    step_s, gain, time_s = (np.concatenate(column) for column in zip(*of_points, strict=True))
    both = np.concatenate(columns)
    return Points(
        series=tuple(series for one in bundles for series in one.series),
        begin=np.append(0, np.cumsum(length)),
        count=count,
        squares=squares,
        width_s=width_s,
        step_s=step_s,
        gain=gain,
        residual=both[:, 0].copy(),
        unit=times(both[:, 1:], root),
        time_s=time_s,
    )


def bins(time_s: Floats, most: int) -> tuple[NDArray[np.intp], float]:
    """Bin of each of some times (n,) in order, up to `most`, and their duration, s; gaps take no bin."""
    n = len(time_s)
    if n <= most:
        return np.arange(n), 0.0
    step_s = np.diff(time_s)
    clock_s = np.append(0.0, np.cumsum(np.minimum(step_s, 10.0 * np.median(step_s))))
    width_s = float(clock_s[-1]) / most
    if not width_s > 0.0:  # all at one instant
        return np.arange(n) * most // n, 0.0
    return np.append(0, np.cumsum(np.diff(np.floor(clock_s / width_s)) > 0.0)), width_s


def series_of(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[Bundle]:
    """All series of the observations in use."""
    taken = used if noise.shared is None else used & (noise.shared.group == ALONE)
    rows = order.order[taken[order.order]]
    bundles = []
    for mine in np.split(rows, np.flatnonzero(np.diff(order.code[rows])) + 1) if len(rows) else ():
        link = order.series[order.code[mine[0]]]
        whitening, factor = (1.0 / noise.own_m[mine])[:, None, None], None
        if noise.phase is not None and noise.phase.sigma_m[mine].any():
            whitening, factor = np.ones_like(whitening), noise.phase.factor(mine, noise.own_m)
        series = (Series(link.name, link.name, link.kind, link.kind),)
        each = np.arange(len(mine))
        bundles.append(Bundle(series, mine[:, None], order.time_s[mine], whitening, each, factor))
    return bundles + _combinations(order, noise, used)


def _combinations(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[Bundle]:
    """Combinations of observations that share errors, by the kinds of observations that are in a block."""
    found: dict[tuple[int, ...], list[Block]] = {}
    for block in noise.among(used).blocks:
        keys, of_block = distinct(order.code[block.rows])
        for k, key in enumerate(keys):
            sort, mine = np.argsort(key, kind="stable"), of_block == k
            there, which = np.unique(block.which[mine], return_inverse=True)
            axes, combined_m = block.axes[there][:, sort], block.combined_m[there]
            piece = Block(block.rows[mine][:, sort], which, axes, combined_m)
            found.setdefault(tuple(key[sort].tolist()), []).append(piece)
    bundles = []
    for key, pieces in found.items():
        rows, axes, combined_m = (
            np.concatenate([getattr(piece, name) for piece in pieces])
            for name in ("rows", "axes", "combined_m")
        )
        first = np.cumsum([0, *(len(piece.axes) for piece in pieces)])
        which = np.concatenate([piece.which + k for piece, k in zip(pieces, first, strict=False)])
        sort = np.argsort(order.time_s[rows[:, 0]], kind="stable")
        rows, which = rows[sort], which[sort]
        kind = order.series[key[0]].kind
        # Errors of stations and those of baselines alone are in different combinations, of which one may be correlated
        # in time and the other not, however near their sigmas are
        first_m = combined_m[which[0]]
        part = np.cumsum(np.diff(first_m, prepend=-np.inf) > _SIGMA_RTOL * first_m)
        # Epochs of other covariances are brought to the same combinations in the same way
        root = (axes / combined_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
        whitening = _chosen_axes(axes[which[0]], part).T @ root
        shared = f"{kind} that share errors"
        series = tuple(
            Series(
                f"{kind} {key} {j}",
                f"{kind}, combination {j + 1} of {len(key)} that share errors",
                f"{kind} {key} {number}",
                kind,
                shared,
            )
            for j, number in enumerate(part.tolist())
        )
        bundles.append(Bundle(series, rows, order.time_s[rows[:, 0]], whitening, which))
    return bundles


def _chosen_axes(axes: Floats, part: NDArray[np.intp]) -> Floats:
    """Principal axes (k, k) in columns, of which those of one sigma, in one part, are not left to rounding."""
    # Any rotation of them is as good, but noise is sought along each, so another one gives other sigmas. One after the
    # other takes all that is left in the part of the next observation, so an error of the first is in one of them.
    out = np.empty_like(axes)
    for k in np.unique(part).tolist():
        mine = axes[:, part == k]
        left = mine @ mine.T
        for column in np.flatnonzero(part == k).tolist():
            squares = np.diag(left)
            chosen = int(np.argmax(squares > _MIN_REMAINING_FRACTION * squares.max()))
            out[:, column] = left[:, chosen] / np.sqrt(squares[chosen])
            left = left - np.outer(out[:, column], out[:, column])
    return out


def seconds_since_midnight(epoch: Epochs) -> Floats:
    """Time since the first midnight, s, shape (n,); a leap second is nothing to how long errors last."""
    first = epoch.jd.min() if len(epoch) else 0.0
    return np.asarray(((epoch.jd - first) + epoch.fraction) * SECONDS_PER_DAY)
