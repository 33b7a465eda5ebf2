"""Residuals of a fit by series, whitened, and their sums over some fifty stretches of time in each series.

A series is what one link measures of one kind. Everything that is asked about errors that last is asked of these sums,
so its cost is linear in the observations.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult

_Floats = NDArray[np.float64]

_BINS = 56
"""Stretches of time that a series is divided into; gaps do not count. Larger matrices are shared out
between threads by linear algebra libraries, which takes longer than the work."""
_CELLS = 16384
"""Cells of the time line that stretches are made of."""
FEWEST = 20
"""Stretches beyond the number of parameters that a verdict takes."""
_ONE_SIGMA = 1e-6
"""Part by which sigmas of combinations may differ that are one but for rounding."""
_SCREEN = 1.0
"""Types are looked at closely when a sum over stretches spreads by more than this many standard errors."""


def shared_series(kind: str) -> str:
    """What the names of all series begin with that combinations of a kind's observations make."""
    return f"{kind}, combination "


class WhitenedSeries:
    """Independent combinations of the used observations, each with the series it belongs to.

    An observation that shares no error belongs to its own series. Those of a block are brought by the symmetric root of
    their covariance and the principal axes of the first block of the same series to combinations that are comparable
    from block to block; each combination is a series of its own.
    """

    def __init__(self, fit: FitResult, types: Labels, paths: Labels) -> None:
        self.fit = fit
        both = types.codes.astype(np.intp) * len(paths.texts) + paths.codes
        kinds, first, codes = np.unique(both, return_index=True, return_inverse=True)
        self.codes = codes.astype(np.int32)
        of_series = [divmod(int(kind), len(paths.texts)) for kind in kinds]
        self.groups = [types.texts[k] for k, _ in of_series]
        self.names = [f"{types.texts[k]} {paths.texts[j]}" for k, j in of_series]
        factor = fit.sigma_factor
        self.sigma_factor = [1.0] * len(kinds) if factor is None else factor[first].tolist()
        self._combinations = fit.noise.among(fit.used)
        self._classes: dict[tuple[int, ...], tuple[int, _Floats]] = {}

    def parts(
        self,
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], _Floats | None, _Floats]]:
        """Rows (m,), series (m,), rotations (b, k, k) or None, and sigmas (m,) or weights of the rotations."""
        for rows, block in self._combinations.rows():
            if block is None:
                yield rows, self.codes[rows].astype(np.intp), None, 1.0 / self.fit.noise.own_m[rows]
                continue
            order = np.argsort(self.codes[rows], axis=1, kind="stable")
            rows = np.take_along_axis(rows, order, axis=1)
            axes = np.take_along_axis(block.axes, order[:, :, None], axis=1)
            kinds, which = np.unique(self.codes[rows], axis=0, return_inverse=True)
            which = which.ravel()
            first = np.empty(len(kinds), dtype=np.intp)
            common = np.empty((len(kinds), *axes.shape[1:]))
            for k in np.argsort([int(np.argmax(which == k)) for k in range(len(kinds))], kind="stable"):
                key = tuple(kinds[k].tolist())
                if key not in self._classes:
                    at = int(np.argmax(which == k))
                    self._classes[key] = (len(self.names), axes[at])
                    self._name(key, block.combined_m[at])
                first[k], common[k] = self._classes[key]
            rotation = np.swapaxes(common[which], 1, 2) @ axes
            # Along the block's own axes over their sigmas, back to the observations, and along the common axes.
            whitening = (rotation / block.combined_m[:, None, :]) @ np.swapaxes(axes, 1, 2)
            codes = first[which][:, None] + np.arange(rows.shape[1])
            yield rows.ravel(), codes.ravel(), whitening, np.ones(0)

    def _name(self, key: tuple[int, ...], combined_m: _Floats) -> None:
        """Names and groups of the combinations of a kind of block: those of one sigma go together.

        Errors of stations and those of baselines alone are in different combinations. One may last and the other not,
        however near their sigmas are, so only combinations that the covariance does not tell apart are taken to be
        alike; it has them in the order of their sigmas.
        """
        kind = self.groups[key[0]]
        part = np.concatenate([[0], np.cumsum(np.diff(combined_m) > _ONE_SIGMA * combined_m[1:])])
        for j in range(len(combined_m)):
            self.names.append(f"{shared_series(kind)}{j + 1} of {len(key)} that share errors")
            self.sigma_factor.append(self.sigma_factor[key[0]])
            self.groups.append(f"{kind} {key} {part[j]}")

    @staticmethod
    def apply(values: _Floats, whitening: _Floats | None, weight: _Floats) -> _Floats:
        """Values (m, c) whitened."""
        if whitening is None:
            return values * weight[:, None]
        blocks = values.reshape(len(whitening), whitening.shape[1], -1)
        return np.asarray((whitening @ blocks).reshape(values.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """All series divided into stretches of time, one series after the other.

    Parameters
    ----------
    starts : ndarray, shape (series + 1,)
        Where the stretches of each series begin; the last is the number of stretches.
    grid : ndarray of int, shape (series, most)
        Stretches of each series side by side; the number of stretches stands for none.
    width_s : ndarray, shape (series,)
        Longest duration of a stretch.
    first_s, step_s : float
        The cells of the time line that stretches are made of.
    of_cell : ndarray of int, shape (series, cells)
        Stretch that each cell belongs to.
    blocks : Blocks
    """

    starts: NDArray[np.intp]
    grid: NDArray[np.intp]
    width_s: _Floats
    first_s: float
    step_s: float
    of_cell: NDArray[np.int32]
    blocks: Blocks

    @classmethod
    def of(cls, series: WhitenedSeries, time_s: _Floats) -> Stretches:
        """Divide the used observations, made at some times (n,)."""
        used = series.fit.used
        first_s, last_s = float(time_s[used].min()), float(time_s[used].max())
        step_s = (last_s - first_s) * (1.0 + 1e-9) / _CELLS or 1.0
        counts: dict[int, NDArray[np.intp]] = {}
        for rows, codes, _, _ in series.parts():
            cells = ((time_s[rows] - first_s) / step_s).astype(np.intp)
            for code in np.flatnonzero(np.bincount(codes)).tolist():
                more = np.bincount(cells[codes == code], minlength=_CELLS)
                counts[code] = counts[code] + more if code in counts else more
        # Names of combinations are known only after the observations have been gone through.
        n = len(series.names)
        starts, width_s = np.zeros(n + 1, dtype=np.intp), np.zeros(n)
        of_cell = np.zeros((n, _CELLS), dtype=np.int32)
        total = 0
        for code in range(n):
            filled = np.flatnonzero(counts.get(code, np.zeros(0, dtype=np.intp)))
            if len(filled):
                place, width = divided(filled)
                of_cell[code, filled] = total + place
                width_s[code] = width * step_s
                total += int(place[-1]) + 1
            starts[code + 1] = total
        lengths = np.diff(starts)
        grid = np.full((n, int(lengths.max())), total)
        grid[np.arange(grid.shape[1]) < lengths[:, None]] = np.arange(total)
        return cls(starts, grid, width_s, first_s, step_s, of_cell, Blocks.of(starts))

    @property
    def total(self) -> int:
        """Number of stretches."""
        return int(self.starts[-1])

    def find(self, codes: NDArray[np.intp], time_s: _Floats) -> NDArray[np.int32]:
        """Stretch of each observation of some series, made at some times, shape (m,)."""
        found: NDArray[np.int32] = self.of_cell[
            codes, ((time_s - self.first_s) / self.step_s).astype(np.intp)
        ]
        return found

    def part(self, code: int) -> slice:
        """Stretches of a series."""
        return slice(int(self.starts[code]), int(self.starts[code + 1]))

    def side_by_side(self, values: _Floats, codes: Sequence[int], empty: float = 0.0) -> _Floats:
        """Values (stretches, ...) of some series, shape (codes, most, ...)."""
        end = np.full((1, *values.shape[1:]), empty)
        return np.asarray(np.concatenate([values, end])[self.grid[list(codes)]])


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of one, two, four, ... stretches of each series, as long as there are five of them; sizes in turn.

    Parameters
    ----------
    first, last : ndarray of int, shape (blocks,)
        Their first stretches and those after their last ones.
    starts, series, numbers : ndarray of int, shape (k,)
        For each series and size the first block, the series, and the number of blocks.
    """

    first: NDArray[np.intp]
    last: NDArray[np.intp]
    starts: NDArray[np.intp]
    series: NDArray[np.intp]
    numbers: NDArray[np.intp]

    @classmethod
    def of(cls, starts: NDArray[np.intp]) -> Blocks:
        """Those of series that begin at some stretches, shape (series + 1,)."""
        first, last, series, numbers = [], [], [], []
        for code, (begin, end) in enumerate(itertools.pairwise(starts.tolist())):
            size = 1
            while (end - begin) // size >= 5:
                count = (end - begin) // size
                first.append(begin + size * np.arange(count))
                last.append(first[-1] + size)
                series.append(code)
                numbers.append(count)
                size *= 2
        none = [np.zeros(0, dtype=np.intp)]
        return cls(
            np.concatenate(first or none),
            np.concatenate(last or none),
            np.concatenate([[0], np.cumsum(numbers[:-1], dtype=np.intp)]),
            np.array(series, dtype=np.intp),
            np.array(numbers, dtype=np.intp),
        )


@dataclass(frozen=True, slots=True, eq=False)
class StretchSums:
    """Sums of whitened residuals over stretches.

    Parameters
    ----------
    stretches : Stretches
    count, time_s, residual : ndarray, shape (stretches,)
        Combinations in each, their mean time, the sum of their whitened residuals.
    squares, used : ndarray, shape (series,)
        Sum of squares of the whitened residuals of each series, and how many.
    """

    stretches: Stretches
    count: _Floats
    time_s: _Floats
    residual: _Floats
    squares: _Floats
    used: _Floats

    @classmethod
    def of(cls, series: WhitenedSeries, stretches: Stretches, time_s: _Floats) -> StretchSums:
        """Sum the residuals of a fit."""
        total, n = stretches.total, len(series.names)
        count, mean_s, residual, squares = np.zeros(total), np.zeros(total), np.zeros(total), np.zeros(n)
        for rows, codes, whitening, weight in series.parts():
            into = stretches.find(codes, time_s[rows])
            z = series.apply(series.fit.residual_m[rows, None], whitening, weight)[:, 0]
            count += np.bincount(into, minlength=total)
            mean_s += np.bincount(into, time_s[rows], minlength=total)
            residual += np.bincount(into, z, minlength=total)
            squares += np.bincount(codes, z * z, minlength=n)
        return cls(stretches, count, mean_s / count, residual, squares, by_series(count, stretches))

    @property
    def variance(self) -> _Floats:
        """Mean square of each series' whitened residuals, shape (series,)."""
        return np.asarray(self.squares / np.maximum(self.used, 1.0))

    def worth_a_look(self, groups: Sequence[str]) -> list[int]:
        """Series of the groups in one of which sums over stretches spread more than white ones would."""
        enough = (np.diff(self.stretches.starts) >= FEWEST) & (self.variance > 0.0)
        suspects = {groups[k] for k in np.flatnonzero(enough & self._spread()).tolist()}
        return [k for k in np.flatnonzero(enough).tolist() if groups[k] in suspects]

    def _spread(self) -> NDArray[np.bool_]:
        """Whether sums over stretches, or over some stretches together, spread more than white ones would."""
        blocks = self.stretches.blocks
        residual, count = (
            np.concatenate([[0.0], np.cumsum(values)]) for values in (self.residual, self.count)
        )
        squares = (residual[blocks.last] - residual[blocks.first]) ** 2 / (
            count[blocks.last] - count[blocks.first]
        )
        variance = np.maximum(self.variance, np.finfo(float).tiny)
        found = np.zeros(len(variance), dtype=bool)
        if len(blocks.series):
            mean = np.add.reduceat(squares, blocks.starts) / (blocks.numbers * variance[blocks.series])
            found[blocks.series[mean > 1.0 + _SCREEN * np.sqrt(2.0 / blocks.numbers)]] = True
        return found


@dataclass(frozen=True, slots=True, eq=False)
class PartialSums:
    """Sums of the whitened partials of some series by parameters of unit formal covariance.

    Parameters
    ----------
    codes : tuple of int
        The series.
    sums : ndarray, shape (codes, most, q)
        Over their stretches, side by side.
    products : ndarray, shape (codes, q, q)
        Of products of the partials, over the whole series.
    """

    codes: tuple[int, ...]
    sums: _Floats
    products: _Floats

    @classmethod
    def of(
        cls,
        series: WhitenedSeries,
        stretches: Stretches,
        time_s: _Floats,
        root: _Floats,
        codes: Sequence[int],
    ) -> PartialSums:
        """Sum the partials of a fit; `root` (free, q) has the parameters of unit covariance in its columns."""
        fit, place = series.fit, np.full(len(series.names), -1)
        place[list(codes)] = np.arange(len(codes))
        free = np.flatnonzero(fit.parameters.free)
        q, total = root.shape[1], stretches.total
        sums, products = np.zeros((total, q)), np.zeros((len(codes), q, q))
        for rows, of_rows, whitening, weight in series.parts():
            if (place[of_rows] < 0).all():
                continue
            unit = series.apply(fit.linearization.partials(rows)[:, free], whitening, weight) @ root
            into = stretches.find(of_rows, time_s[rows])
            for k in range(q):
                sums[:, k] += np.bincount(into, unit[:, k], minlength=total)
            for code in np.flatnonzero(np.bincount(of_rows)).tolist():
                if place[code] >= 0:
                    mine = unit[of_rows == code]
                    products[place[code]] += np.einsum("ni,nj->ij", mine, mine)
        return cls(tuple(codes), stretches.side_by_side(sums, codes), products)

    def of_series(self, codes: Sequence[int]) -> PartialSums:
        """Those of some of the series."""
        place = [self.codes.index(code) for code in codes]
        return PartialSums(tuple(codes), self.sums[place], self.products[place])


def by_series(values: _Floats, stretches: Stretches) -> _Floats:
    """Sum of what stretches have (stretches,) over each series, shape (series,)."""
    return np.asarray(stretches.side_by_side(values, range(len(stretches.grid))).sum(axis=1))


def divided(filled: NDArray[np.intp]) -> tuple[NDArray[np.intp], float]:
    """Divide filled cells to about :data:`_BINS` stretches: place of each cell, and a stretch's length in cells.

    A stretch is so long, and ends at any gap of its length, so gaps take no stretches.
    """
    apart = np.diff(filled).astype(np.float64)
    width = max(float(apart.sum()) / _BINS, 1.0)
    for _ in range(40):
        narrower = max(float(np.minimum(apart, width).sum()) / _BINS, 1.0)
        if narrower > 0.999 * width:
            break
        width = narrower
    clock = np.concatenate([[0.0], np.cumsum(np.minimum(apart, width))])
    _, place = np.unique(np.floor(clock / width * (1.0 + 1e-12)), return_inverse=True)
    return place, width
