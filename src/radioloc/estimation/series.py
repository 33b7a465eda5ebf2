"""Used observations by series, whitened by their stated noise and in order of time.

A series is what one link measures of one kind. Delays of one epoch that share errors of stations are brought to
independent combinations by the principal axes of their covariance, each of which is a series; the axes of one epoch
serve for all epochs at which the same baselines were observed, so that a combination is the same from epoch to epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.gauss_markov import Points, Series
from radioloc.estimation.labels import Labels
from radioloc.estimation.linearization import Rows
from radioloc.estimation.observation_noise import ALONE, ObservationNoise, cuts_of, unchained
from radioloc.measurements.link import Link
from radioloc.measurements.predictor import ROWS_AT_ONCE

_Floats = NDArray[np.float64]

MOST_POINTS = 250
"""Longer series are averaged over bins of equal duration to about so many points before a noise model is sought."""
_ONE_SIGMA = 1e-6
"""Part by which sigmas of combinations may differ that are one but for rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class SeriesOrder:
    """Rows in order of series and time; the same for all fits of the same observations."""

    types: Labels  # kind and light path of the n observations; those of one kind and path are a series
    paths: Labels
    time_s: _Floats  # (n,), when each was made, s from any instant
    code: NDArray[np.intp]  # (n,), series of each observation
    order: NDArray[np.intp]  # (n,), rows, sorted by series and time
    links: Labels  # type and path of each observation
    # Of each series, with the sign of each one's reception in the value
    stations: Mapping[int, Mapping[str, float]]

    @classmethod
    def of(cls, types: Labels, paths: Labels, time_s: _Floats) -> SeriesOrder:
        """That of observations of some types and paths (n,), made at some times (n,), s."""
        code = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        codes, number = np.unique(code, return_inverse=True)
        names, stations = [], {}
        for one in codes.tolist():
            kind, path = types.texts[one // len(paths.texts)], paths.texts[one % len(paths.texts)]
            names.append(f"{kind} {path}")
            stations[one] = Link.from_path(path).reception_signs if ">" in path else {path: 1.0}
        links = Labels(number.astype(np.int32), tuple(names))
        return cls(types, paths, time_s, code, np.lexsort((time_s, code)), links, stations)

    def type_of(self, code: int) -> str:
        """Kind of measurement."""
        return self.types.texts[code // len(self.paths.texts)]

    def name_of(self, code: int) -> str:
        """Kind of measurement and path."""
        return f"{self.type_of(code)} {self.path_of(code)}"

    def path_of(self, code: int) -> str:
        """Path."""
        return self.paths.texts[code % len(self.paths.texts)]


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Series of used observations, n together, and the blocks of observations that their values are combined from.

    A combination of k baselines is a value of each of k series; single observations are blocks of one.
    """

    series: tuple[Series, ...]
    begin: NDArray[np.intp]  # (s + 1,), first value of each series, and n
    time_s: _Floats  # (n,), of the values, in order in each series
    blocks: NDArray[np.intp]  # (b + 1,), first row of each block, and n
    rows: NDArray[np.intp]  # (n,), observations, block by block
    whitening: (
        _Floats  # (n, k), from the observations of a block to independent combinations of unit variance
    )
    place: NDArray[np.intp]  # (n,), which of the values such a combination is
    # (2, n), of rows that are counts of a phase, by which they are brought to independent ones before; none where None
    factor: _Floats | None = None

    @classmethod
    def of(cls, stretches: Sequence[_Stretch]) -> Batch:
        """Series of stretches, one after another."""
        sizes = np.array([one.rows.shape for one in stretches])
        ends = np.cumsum(sizes.prod(axis=1))
        whitening = np.zeros((ends[-1], sizes[:, 1].max()))
        place, time_s = np.empty(ends[-1], dtype=np.intp), np.empty(ends[-1])
        factor = np.repeat([[1.0], [0.0]], ends[-1], axis=1)
        for one, end, (b, k) in zip(stretches, ends.tolist(), sizes.tolist(), strict=True):
            part = slice(end - b * k, end)
            whitening[part, :k] = one.whitening.reshape(-1, k)
            place[part].reshape(b, k)[:] = part.start + np.arange(b)[:, None] + b * np.arange(k)
            time_s[part].reshape(k, b)[:] = one.time_s
            if one.factor is not None:
                factor[:, part] = one.factor
        return cls(
            tuple(series for one in stretches for series in one.series),
            np.append(0, np.cumsum(np.repeat(sizes[:, 0], sizes[:, 1]))),
            time_s,
            np.append(0, np.cumsum(np.repeat(sizes[:, 1], sizes[:, 0]))),
            np.concatenate([one.rows.ravel() for one in stretches]),
            whitening,
            place,
            factor if any(one.factor is not None for one in stretches) else None,
        )

    def added(
        self, rows_of: Callable[[Rows], _Floats], place: NDArray[np.intp], count: int
    ) -> tuple[_Floats, _Floats]:
        """Sums (count, c) of values that go to some places (n,), and of the squares of their first columns, (count,).

        They follow from the numbers that belong to observations, from rows (m,) to (m, c), taken some after others.
        """
        from radioloc.estimation._kernels import add_combinations

        sums, squares, at = np.zeros((0, 0)), np.zeros(count), 0
        cuts = self.blocks if self.factor is None else np.intersect1d(self.blocks, cuts_of(self.factor))
        while at < len(self.rows):
            end = cuts[max(cuts.searchsorted([at + ROWS_AT_ONCE, at], side="right") - [1, 0])]
            blocks = self.blocks[slice(*self.blocks.searchsorted([at, end + 1]))]
            part = slice(at, end)
            values = rows_of(self.rows[part])
            if self.factor is not None:
                values = unchained(self.factor[:, part], values)
            values = np.ascontiguousarray(values)
            sums = sums if at else np.zeros((count, values.shape[1]))
            add_combinations(
                blocks - blocks[0], self.whitening[part], place[self.place[part]], values, sums, squares
            )
            at = end
        return sums, squares

    def whitened(self, rows_of: Callable[[Rows], _Floats]) -> _Floats:
        """Values (n, c) that follow from numbers that belong to observations, from rows (m,) to (m, c)."""
        return self.added(rows_of, np.arange(len(self.rows)), len(self.rows))[0]


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """The k series of combinations of the same k baselines; of single observations one."""

    series: tuple[Series, ...]
    rows: NDArray[np.intp]  # (b, k), in order of time
    time_s: _Floats  # (b,)
    whitening: _Floats  # (b, k, k)
    factor: _Floats | None = None  # (2, b), of counts of a phase


def points_of(
    batches: Sequence[Batch], rows_of: Callable[[Rows], _Floats], root: _Floats, most: int = MOST_POINTS
) -> Points:
    """Each series, averaged where there are more than `most`, with partials by the parameters times `root`.

    `rows_of` gives residuals and partials side by side. Sums of bins are over the root of their count, so they are of
    unit variance where observations are independent.
    """
    from radioloc.estimation._kernels import bins

    columns, parts = [], []
    for batch in batches:
        place, first, width_s = bins(batch.time_s, batch.begin, most)
        in_bin = np.bincount(place)
        sums, squares = batch.added(rows_of, place, len(in_bin))
        gain = np.sqrt(in_bin)
        sums /= gain[:, None]
        time_s = np.bincount(place, batch.time_s) / in_bin
        step_s = np.diff(time_s, prepend=time_s[0])
        step_s[first[:-1]] = 0.0
        columns.append(sums)
        of_series = (np.diff(first), np.diff(batch.begin), np.add.reduceat(squares, first[:-1]), width_s)
        parts.append((*of_series, step_s, gain, time_s))
    length, count, squares, width_s, step_s, gain, time_s = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    both = np.concatenate(columns)
    return Points(
        series=tuple(one for batch in batches for one in batch.series),
        begin=np.concatenate([[0], np.cumsum(length)]),
        count=count,
        squares=squares,
        width_s=width_s,
        step_s=step_s,
        gain=gain,
        residual=both[:, 0].copy(),
        unit=both[:, 1:] @ root,
        time_s=time_s,
    )


def series_of(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[Batch]:
    """All series of the observations in use; a batch is of some thousand rows, but for a longer series."""
    taken = used if noise.shared is None else used & (noise.shared.group == ALONE)
    rows = order.order[taken[order.order]]
    stretches = []
    for mine in np.split(rows, np.flatnonzero(np.diff(order.code[rows])) + 1) if len(rows) else ():
        name, kind = order.name_of(order.code[mine[0]]), order.type_of(order.code[mine[0]])
        whitening, factor = (1.0 / noise.own_m[mine])[:, None, None], None
        if noise.phase is not None and noise.phase.sigma_m[mine].any():
            whitening, factor = np.ones_like(whitening), noise.phase.factor(mine, noise.own_m)
        series = (Series(name, name, kind, kind),)
        stretches.append(_Stretch(series, mine[:, None], order.time_s[mine], whitening, factor))
    stretches += _combinations(order, noise, used)
    together: list[list[_Stretch]] = []
    size = 0
    for one in stretches:
        size += one.rows.size
        if size > ROWS_AT_ONCE or not together:
            together.append([])
            size = one.rows.size
        together[-1].append(one)
    return [Batch.of(some) for some in together]


def _combinations(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[_Stretch]:
    """Combinations of observations that share errors, by the kinds of observations that are in a block."""
    found: dict[tuple[int, ...], list[tuple[NDArray[np.intp], _Floats, _Floats, _Floats]]] = {}
    for block in noise.among(used).blocks:
        sort = np.argsort(order.code[block.rows], axis=1, kind="stable")
        rows = np.take_along_axis(block.rows, sort, axis=1)
        codes = order.code[rows]
        axes = np.take_along_axis(block.axes, sort[:, :, None], axis=1)
        root = (axes / block.combined_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
        keys, which = codes[:1], np.zeros(len(codes), dtype=np.intp)
        if (codes != keys).any():
            keys, which = np.unique(codes, axis=0, return_inverse=True)
        for k, key in enumerate(keys):
            mine = which.ravel() == k
            parts = (rows[mine], root[mine], axes[mine], block.combined_m[mine])
            found.setdefault(tuple(key.tolist()), []).append(parts)
    stretches = []
    for key, pieces in found.items():
        rows, root, axes, combined_m = (np.concatenate(part) for part in zip(*pieces, strict=True))
        sort = np.argsort(order.time_s[rows[:, 0]], kind="stable")
        first, kind = sort[0], order.type_of(key[0])
        # Errors of stations and those of baselines alone are in different combinations, of which one may be correlated
        # in time and the other not, however near their sigmas are
        part = np.cumsum(np.diff(combined_m[first], prepend=-np.inf) > _ONE_SIGMA * combined_m[first])
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
        stretches.append(
            _Stretch(series, rows[sort], order.time_s[rows[sort, 0]], axes[first].T @ root[sort])
        )
    return stretches
