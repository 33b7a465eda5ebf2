"""Used observations by series, whitened by their stated noise and in order of time.

A series is what one link measures of one kind. Delays of one epoch that share errors of stations are brought to
independent combinations by the principal axes of their covariance, each of which is a series; the axes of one epoch
serve for all epochs at which the same baselines were observed, so that a combination is the same from epoch to epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.gauss_markov import Points
from radioloc.estimation.labels import Labels
from radioloc.estimation.linearization import Rows
from radioloc.estimation.observation_noise import ALONE, ObservationNoise
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

    def type_of(self, code: int) -> str:
        """Kind of measurement."""
        return self.types.texts[code // len(self.paths.texts)]

    def name_of(self, code: int) -> str:
        """Kind of measurement and path."""
        return f"{self.type_of(code)} {self.paths.texts[code % len(self.paths.texts)]}"


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Series that are whitened together: one of single observations, or the k combinations of k baselines."""

    keys: tuple[str, ...]  # of the k series; no key occurs twice, and names are for the reader
    names: tuple[str, ...]
    groups: tuple[str, ...]  # series of the same group may have the same noise model
    rows: NDArray[np.intp]  # (b, k), in order of time
    time_s: _Floats  # (b,)
    whitening: _Floats  # (b, k, k), from observations to independent combinations of unit variance
    kind: str  # kind of measurement
    shared: str = ""  # what the combinations are called together; empty for a series of single observations

    def whitened(self, rows_of: Callable[[Rows], _Floats]) -> _Floats:
        """Combinations of numbers that belong to observations, from rows (m,) to (m, c); shape (b, k, c)."""
        return np.concatenate([self.whitening[part] @ values for part, values in self._parts(rows_of)])

    def points(
        self, rows_of: Callable[[Rows], _Floats], root: _Floats, most: int = MOST_POINTS
    ) -> list[Points]:
        """Each series, averaged where there are more than `most`, with partials by the parameters times `root`.

        `rows_of` gives residuals and partials side by side. Sums of bins are over the root of their count, so they are
        of unit variance where observations are independent.
        """
        from radioloc.estimation._kernels import add_to_bins, bins

        n, k = self.rows.shape
        place, width_s = bins(self.time_s, most) if n > most else (np.arange(n), 0.0)
        count = np.bincount(place)
        sums, squares = np.zeros((len(count), k, 1 + len(root))), np.zeros(k)
        for part, values in self._parts(rows_of):
            add_to_bins(place[part], self.whitening[part], values, sums, squares)
        gain = np.sqrt(count)
        sums /= gain[:, None, None]
        step_s = np.diff(np.bincount(place, self.time_s) / count, prepend=self.time_s[0])
        step_s[0] = 0.0
        return [
            Points(
                key=self.keys[j],
                name=self.names[j],
                group=self.groups[j],
                kind=self.kind,
                count=n,
                step_s=step_s,
                gain=gain,
                residual=sums[:, j, 0],
                unit=sums[:, j, 1:] @ root,
                squares=float(squares[j]),
                width_s=width_s,
            )
            for j in range(k)
        ]

    def _parts(self, rows_of: Callable[[Rows], _Floats]) -> Iterator[tuple[slice, _Floats]]:
        """Some instants after others, and the numbers of their observations (b, k, c)."""
        k = self.rows.shape[1]
        at_once = max(1, ROWS_AT_ONCE // k)
        for begin in range(0, len(self.rows), at_once):
            part = slice(begin, begin + at_once)
            rows = self.rows[part]
            yield part, rows_of(rows.ravel()).reshape(len(rows), k, -1)


def series_of(order: SeriesOrder, noise: ObservationNoise, used: NDArray[np.bool_]) -> list[Batch]:
    """All series of the observations in use."""
    taken = used if noise.shared is None else used & (noise.shared.group == ALONE)
    rows = order.order[taken[order.order]]
    batches = []
    for mine in np.split(rows, np.flatnonzero(np.diff(order.code[rows])) + 1):
        if len(mine):
            code = int(order.code[mine[0]])
            whitening = (1.0 / noise.own_m[mine])[:, None, None]
            name, kind = order.name_of(code), order.type_of(code)
            time_s = order.time_s[mine]
            batches.append(Batch((name,), (name,), (kind,), mine[:, None], time_s, whitening, kind))
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
        batches.append(
            Batch(
                tuple(f"{kind} {key} {j}" for j in range(len(key))),
                tuple(
                    f"{kind}, combination {j + 1} of {len(key)} that share errors" for j in range(len(key))
                ),
                tuple(f"{kind} {key} {number}" for number in part),
                rows[sort],
                order.time_s[rows[sort, 0]],
                axes[first].T @ root[sort],
                kind,
                f"{kind} that share errors",
            )
        )
    return batches
