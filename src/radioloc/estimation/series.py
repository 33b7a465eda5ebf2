"""Used observations by series, whitened by their stated noise and in order of time.

A series is what one link measures of one kind. Delays of one epoch that share errors of stations are brought to
independent combinations by the principal axes of their covariance, each of which is a series; the axes of one epoch
serve for all epochs at which the same baselines were observed, so that a combination is the same from epoch to epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.gauss_markov import Points, Series
from radioloc.estimation.labels import Labels
from radioloc.estimation.linearization import Rows
from radioloc.estimation.observation_noise import ALONE, ObservationNoise
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

    @classmethod
    def of(cls, types: Labels, paths: Labels, time_s: _Floats) -> SeriesOrder:
        """That of observations of some types and paths (n,), made at some times (n,), s."""
        code = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        return cls(types, paths, time_s, code, np.lexsort((time_s, code)))

    @property
    def links(self) -> Labels:
        """Type and path of each observation."""
        codes, number = np.unique(self.code, return_inverse=True)
        return Labels(number.astype(np.int32), tuple(self.name_of(code) for code in codes.tolist()))

    def type_of(self, code: int) -> str:
        """Kind of measurement."""
        return self.types.texts[code // len(self.paths.texts)]

    def name_of(self, code: int) -> str:
        """Kind of measurement and path."""
        return f"{self.type_of(code)} {self.path_of(code)}"

    def path_of(self, code: int) -> str:
        """Path."""
        return self.paths.texts[code % len(self.paths.texts)]

    def stations_of(self, code: int) -> dict[str, float]:
        """Stations, with the sign of each one's reception in the value; of a path that is only a name, that."""
        path = self.path_of(code)
        return Link.from_path(path).reception_signs if ">" in path else {path: 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Series that are whitened alike: all of single observations, or the k combinations of the same k baselines."""

    series: tuple[Series, ...]  # k for each stretch
    begin: NDArray[np.intp]  # (stretches + 1,), first of the b instants of each, and b
    rows: NDArray[np.intp]  # (b, k), each stretch in order of time
    time_s: _Floats  # (b,)
    whitening: _Floats  # (b, k, k), from observations to independent combinations of unit variance
    shared: str = ""  # what the combinations are called together; empty for single observations

    def split(self, most: int) -> Iterator[Batch]:
        """Parts of about as many rows or fewer, each of whole stretches."""
        k = self.rows.shape[1]
        ends = self.begin[1:].tolist()
        at = 0
        while at < len(ends):
            begin = int(self.begin[at])
            to = at + 1
            while to < len(ends) and (ends[to] - begin) * k <= most:
                to += 1
            part = slice(begin, ends[to - 1])
            yield Batch(
                self.series[at * k : to * k],
                self.begin[at : to + 1] - begin,
                self.rows[part],
                self.time_s[part],
                self.whitening[part],
                self.shared,
            )
            at = to

    def parts(self, rows_of: Callable[[Rows], _Floats]) -> Iterator[tuple[slice, _Floats]]:
        """Some instants after others, and numbers (b, k, c) that belong to their observations, by rows (m,)."""
        k = self.rows.shape[1]
        at_once = max(1, ROWS_AT_ONCE // k)
        for begin in range(0, len(self.rows), at_once):
            part = slice(begin, begin + at_once)
            rows = self.rows[part]
            yield part, rows_of(rows.ravel()).reshape(len(rows), k, -1)

    def whitened(self, rows_of: Callable[[Rows], _Floats]) -> _Floats:
        """Combinations of numbers that belong to observations, from rows (m,) to (m, c); shape (b, k, c)."""
        parts = [
            self.whitening[part] * values if self.rows.shape[1] == 1 else self.whitening[part] @ values
            for part, values in self.parts(rows_of)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def points_of(
    batches: Sequence[Batch], rows_of: Callable[[Rows], _Floats], root: _Floats, most: int = MOST_POINTS
) -> Points:
    """Each series, averaged where there are more than `most`, with partials by the parameters times `root`.

    `rows_of` gives residuals and partials side by side. Sums of bins are over the root of their count, so they are of
    unit variance where observations are independent.
    """
    from radioloc.estimation._kernels import add_to_bins, bins

    columns, parts = [], []
    for batch in batches:
        k = batch.rows.shape[1]
        place, first, width_s = bins(batch.time_s, batch.begin, most)
        in_bin = np.bincount(place)
        sums, squares = np.zeros((k, len(in_bin), 1 + len(root))), np.zeros((k, len(in_bin)))
        for part, values in batch.parts(rows_of):
            add_to_bins(place[part], batch.whitening[part], values, sums, squares)
        gain = np.sqrt(in_bin)
        sums /= gain[:, None]
        time_s = np.bincount(place, batch.time_s) / in_bin
        step_s = np.diff(time_s, prepend=time_s[0])
        step_s[first[:-1]] = 0.0
        columns.append(sums.reshape(-1, sums.shape[2]))
        of_series = (
            np.diff(first),
            np.diff(batch.begin),
            np.add.reduceat(squares, first[:-1], axis=1),
            width_s,
        )
        of_points = (step_s, gain, time_s)
        parts.append([np.broadcast_to(one, (k, one.shape[-1])).ravel() for one in (*of_series, *of_points)])
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
    """All series of the observations in use."""
    taken = used if noise.shared is None else used & (noise.shared.group == ALONE)
    rows = order.order[taken[order.order]]
    batches = []
    if len(rows):
        code = order.code[rows]
        begin = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
        names = [(order.name_of(one), order.type_of(one)) for one in code[begin].tolist()]
        batches = [
            Batch(
                tuple(Series(name, name, kind, kind) for name, kind in names),
                np.append(begin, len(rows)),
                rows[:, None],
                order.time_s[rows],
                (1.0 / noise.own_m[rows])[:, None, None],
            )
        ]
    return batches + _combinations(order, noise, used)


def _combinations(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[Batch]:
    """Series of combinations of observations that share errors, by the kinds of observations that are in a block."""
    found: dict[tuple[int, ...], list[tuple[NDArray[np.intp], _Floats, _Floats, _Floats]]] = {}
    for block in noise.among(used).blocks:
        sort = np.argsort(order.code[block.rows], axis=1, kind="stable")
        rows = np.take_along_axis(block.rows, sort, axis=1)
        axes = np.take_along_axis(block.axes, sort[:, :, None], axis=1)
        root = (axes / block.combined_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
        keys, which = np.unique(order.code[rows], axis=0, return_inverse=True)
        for k, key in enumerate(keys):
            mine = which.ravel() == k
            parts = (rows[mine], root[mine], axes[mine], block.combined_m[mine])
            found.setdefault(tuple(key.tolist()), []).append(parts)
    batches = []
    for key, pieces in found.items():
        rows, root, axes, combined_m = (np.concatenate(part) for part in zip(*pieces, strict=True))
        sort = np.argsort(order.time_s[rows[:, 0]], kind="stable")
        first, kind = sort[0], order.type_of(key[0])
        # Errors of stations and those of baselines alone are in different combinations, of which one may be correlated
        # in time and the other not, however near their sigmas are
        part = np.cumsum(np.diff(combined_m[first], prepend=-np.inf) > _ONE_SIGMA * combined_m[first])
        names = [f"{kind}, combination {j + 1} of {len(key)} that share errors" for j in range(len(key))]
        batches.append(
            Batch(
                tuple(
                    Series(f"{kind} {key} {j}", names[j], f"{kind} {key} {number}", kind)
                    for j, number in enumerate(part.tolist())
                ),
                np.array([0, len(rows)]),
                rows[sort],
                order.time_s[rows[sort, 0]],
                axes[first].T @ root[sort],
                f"{kind} that share errors",
            )
        )
    return batches
