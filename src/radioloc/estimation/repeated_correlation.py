"""What residuals that stay alike add to the covariance of repeated fits of the same linear problem.

The answer is that of :func:`~radioloc.estimation.time_correlation.assess_time_correlation`, but for the stretches of
time, the parts that parameters absorb and the modes of lasting errors, which are taken from a fit of all observations
as stated: in another, other observations may be left out as outliers and sigmas may be others; as long as those are
few, all this is the same but for a part in thousands. Sums of partials are kept by stretch and stated sigma and
multiplied by the weights of a fit, and what it leaves out is taken away, as
:mod:`~radioloc.estimation.repeated_fit` does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.lasting_errors import AveragedErrors, LastingErrors
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series_stretches import (
    FEWEST,
    PartialSums,
    Stretches,
    StretchSums,
    WhitenedSeries,
    by_series,
)
from radioloc.estimation.time_correlation import ABSORBED, in_parameters

_Floats = NDArray[np.float64]

_FEWEST_LEFT = 1e-3
"""Observations that a stretch of nothing but outliers counts as: it says nothing."""


class RepeatedCorrelation:
    """What repeated fits of the same observations have in common: stretches of time, and how errors spread over them.

    Parameters
    ----------
    fit : FitResult
        Of observations that share no errors, all that may take part being used.
    types, paths, time_s
        As for :func:`~radioloc.estimation.time_correlation.assess_time_correlation`.
    """

    def __init__(self, fit: FitResult, types: Labels, paths: Labels, time_s: _Floats) -> None:
        series = WhitenedSeries(fit, types, paths)
        self._groups, self._free = series.groups, fit.parameters.free
        stretches = self._stretches = Stretches.of(series, time_s)
        self._reference = StretchSums.of(series, stretches, time_s)
        self._root = fit.factor.root_covariance()
        filled = np.flatnonzero(np.diff(stretches.starts) >= FEWEST).tolist()
        self._partials = PartialSums.of(series, stretches, time_s, self._root, filled)
        self._modes: dict[tuple[int, ...], LastingErrors | None] = {}

        rows = np.flatnonzero(fit.used)
        stretch = stretches.find(series.codes[rows].astype(np.intp), time_s[rows])
        order = np.lexsort((fit.noise.own_m[rows], stretch))
        self._rows, self._stretch = rows[order], stretch[order]
        sigma_m = fit.noise.own_m[self._rows]
        # Cells: observations of a stretch that have one stated sigma, and so one sigma in any fit.
        new = np.concatenate([[True], (np.diff(self._stretch) > 0) | (np.diff(sigma_m) != 0.0)])
        self._cell_of_row = np.cumsum(new) - 1
        first = np.flatnonzero(new)
        self._cell_own_m, self._cell_type = sigma_m[first], types.codes[self._rows[first]]
        self._first_cell = np.searchsorted(self._stretch[first], np.arange(stretches.total))
        self._first_of_stretch = first[self._first_cell]
        self._linearization = fit.linearization
        unit = self._unit(self._rows)
        self._cell_unit = np.add.reduceat(unit, first, axis=0)
        # Cells of one series and sigma have one product.
        code = series.codes[self._rows].astype(np.intp)
        self._code = code
        kinds, kind = np.unique(np.stack([code, sigma_m], axis=1), axis=0, return_inverse=True)
        by_kind = np.argsort(kind.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(kind.reshape(-1)))
        self._kind_code = kinds[:, 0].astype(np.intp)
        self._kind_cell = self._cell_of_row[by_kind[ends - 1]]
        parts = np.split(unit[by_kind], ends[:-1])
        self._kind_product = np.array([np.einsum("ni,nj->ij", part, part) for part in parts])

    def added_covariance(
        self, residual_m: _Floats, excess_m: _Floats, used: NDArray[np.bool_], root: _Floats
    ) -> _Floats | None:
        """To add to the covariance of the parameters, shape (p, p); None where no type shows correlation.

        Parameters
        ----------
        residual_m : ndarray, shape (n,)
            What the fit leaves.
        excess_m : ndarray, shape (types,)
            Excess noise of the fit, m.
        used : ndarray of bool, shape (n,)
        root : ndarray, shape (f, q)
            Root of the covariance of the free parameters.
        """
        out = np.flatnonzero(~used[self._rows])
        cell_weight = 1.0 / np.hypot(self._cell_own_m, excess_m[self._cell_type])
        sums = self._sums(residual_m, cell_weight, out)
        tried = sums.worth_a_look(self._groups)
        lasting = self._lasting(tuple(tried)) if tried else None
        if lasting is None:
            return None
        errors = AveragedErrors.of(lasting, sums, self._groups)
        if errors is None:
            return None
        added = errors.added(self._partial_sums(errors.codes, cell_weight, out)).sum(axis=0)
        turned = np.linalg.solve(self._root, root)
        lost = np.zeros(len(self._free), dtype=bool)
        return in_parameters(turned.T @ added @ turned, root, self._free, lost)

    def _sums(self, residual_m: _Floats, cell_weight: _Floats, out: NDArray[np.intp]) -> StretchSums:
        stretches, reference = self._stretches, self._reference
        z = residual_m[self._rows] * cell_weight[self._cell_of_row]
        z[out] = 0.0
        count = reference.count - np.bincount(self._stretch[out], minlength=stretches.total)
        squares = by_series(np.add.reduceat(z * z, self._first_of_stretch), stretches)
        return StretchSums(
            stretches=stretches,
            count=np.maximum(count, _FEWEST_LEFT),
            time_s=reference.time_s,
            residual=np.add.reduceat(z, self._first_of_stretch),
            squares=squares,
            used=by_series(count, stretches),
        )

    def _lasting(self, tried: tuple[int, ...]) -> LastingErrors | None:
        """How errors spread over the stretches of some series."""
        if tried not in self._modes:
            of_tried = self._partials.of_series(tried)
            self._modes[tried] = LastingErrors.of(self._reference, of_tried, ABSORBED)
        return self._modes[tried]

    def _partial_sums(
        self, codes: tuple[int, ...], cell_weight: _Floats, out: NDArray[np.intp]
    ) -> PartialSums:
        """Sums of partials over the sigmas of a fit, by the parameters of unit covariance of the reference."""
        sums = np.add.reduceat(self._cell_unit * cell_weight[:, None], self._first_cell, axis=0)
        by_kind = self._kind_product * cell_weight[self._kind_cell, None, None] ** 2
        products = np.zeros((len(self._groups), *by_kind.shape[1:]))
        np.add.at(products, self._kind_code, by_kind)
        lacking = self._unit(self._rows[out]) * cell_weight[self._cell_of_row[out], None]
        np.subtract.at(sums, self._stretch[out], lacking)
        np.subtract.at(products, self._code[out], lacking[:, :, None] * lacking[:, None, :])
        return PartialSums(codes, self._stretches.side_by_side(sums, codes), products[list(codes)])

    def _unit(self, rows: NDArray[np.intp]) -> _Floats:
        """Partials by the parameters of unit covariance of the reference, shape (m, q)."""
        return np.asarray(self._linearization.partials(rows)[:, self._free] @ self._root)
