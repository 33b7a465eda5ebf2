"""The same linear problem fitted to other residuals again and again, as Monte Carlo studies do.

The answer is that of :func:`~radioloc.estimation.excess_noise.fit_with_excess_noise` for a linear model: robust
start, editing and excess noise included. What does not change from fit to fit is done once. The partials are turned to
a basis in which the problem, weighted as stated, is orthonormal; there normal equations lose no digits. Rows stand by
classes of equal sigma and type, whose normal matrices are known beforehand: with other sigmas they are multiplied,
and the share of what editing leaves out is taken away.

Products are made slab by slab, each so small that no linear algebra library spreads it over threads: a fit gives the
same bits in whatever process it is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.editing import EditingSettings
from radioloc.estimation.excess_noise import MAX_PASSES, SETTLED
from radioloc.estimation.factorization import factorize
from radioloc.estimation.least_squares import FitResult, FitSettings
from radioloc.estimation.linearization import DenseLinearization
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.robust import MAX_REWEIGHTINGS, robust_scale, sample
from radioloc.estimation.robust import SETTLED as START_SETTLED
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.parameters.parameter import ParameterSet

_Floats = NDArray[np.float64]

_SLAB_NUMBERS = 8192
"""Numbers in a slab of the basis; OpenBLAS, which numpy ships with, takes a second thread from 9216 on."""

_START_ROWS = 1000
"""Of more observations a sample makes the robust start, which only has to tell outliers from the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class RepeatedOutcome:
    """What a fit found.

    Parameters
    ----------
    step : ndarray, shape (p,)
        Estimate less the values that residuals and partials belong to; zero for fixed parameters.
    covariance : ndarray, shape (p, p)
        Formal covariance, excess noise included.
    noise_scale : float
        Factor from stated sigmas to those that the residuals show, 1 unless significantly more
        (:class:`~radioloc.estimation.statistics.FitStatistics`).
    root : ndarray, shape (q, q)
        Square root of the covariance of the free parameters: times its transpose it is that.
    used : ndarray of bool, shape (n,)
        Which observations took part.
    left_m : ndarray, shape (n,)
        Residuals of the fit, of usable observations, m.
    excess_noise_m : ndarray, shape (groups,)
        Noise added in quadrature, by group, m.
    converged : bool
        Whether editing and excess noise settled.
    weighed : FitResult or None
        The same fit as it is where correlated series are weighed as such; its covariance is not the inverse of its
        information.
    """

    step: _Floats
    covariance: _Floats
    noise_scale: float
    root: _Floats
    used: NDArray[np.bool_]
    left_m: _Floats
    excess_noise_m: _Floats
    converged: bool
    weighed: FitResult | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RepeatedFit:
    """A linear problem made ready to be fitted to residuals.

    Made by :meth:`of`. Observations stand slab by slab in `basis`, those of a class together; slabs are filled up
    with rows of zeros.

    Parameters
    ----------
    free : ndarray of bool, shape (p,)
        Which parameters are estimated, q of them.
    rows : ndarray of int, shape (m,)
        Usable observations, in the order of the slabs.
    place : ndarray of int, shape (m,)
        Where they stand in the slabs.
    basis : ndarray, shape (k, l, q)
        Partials by the basis.
    to_free : ndarray, shape (q, q)
        From coordinates in the basis to changes of the free parameters.
    start : ndarray of int, shape (s,)
        Indices into `rows` of those that make the robust start.
    start_basis : ndarray, shape (j, l, q)
        Their partials, in slabs of their own.
    slabs : ndarray of int, shape (c + 1,)
        First slab of each class.
    class_sigma_m : ndarray, shape (c,)
    class_group : ndarray of int, shape (c,)
    class_normal : ndarray, shape (c, q, q)
        Normal matrix of each class with weights of one.
    prior_normal, prior_side : ndarray, shape (q, q), (q,)
        Of the a-priori values.
    prior_square : float
        Sum of squares of the a-priori values about `x`.
    n_prior, n_groups, n : int
        Number of a-priori values, of groups, of all observations.
    editing : EditingSettings
    """

    free: NDArray[np.bool_]
    rows: NDArray[np.intp]
    place: NDArray[np.intp]
    basis: _Floats
    to_free: _Floats
    start: NDArray[np.intp]
    start_basis: _Floats
    slabs: NDArray[np.intp]
    class_sigma_m: _Floats
    class_group: NDArray[np.intp]
    class_normal: _Floats
    prior_normal: _Floats
    prior_side: _Floats
    prior_square: float
    n_prior: int
    n_groups: int
    n: int
    editing: EditingSettings

    @classmethod
    def of(
        cls,
        partials: _Floats,
        parameters: ParameterSet,
        x: _Floats,
        sigma_m: _Floats,
        group: NDArray[np.int32],
        usable: NDArray[np.bool_],
        editing: EditingSettings,
    ) -> RepeatedFit | None:
        """Make a problem ready.

        Parameters
        ----------
        partials : ndarray, shape (n, p)
            d(computed)/d(parameter) at x.
        parameters : ParameterSet
            What is solved for, with a-priori values.
        x : ndarray, shape (p,)
            Values that residuals will belong to.
        sigma_m : ndarray, shape (n,)
            Stated sigmas of independent errors, m.
        group : ndarray of int, shape (n,)
            Each group, from zero up, has its own excess noise.
        usable : ndarray of bool, shape (n,)
            Observations that may take part.
        editing : EditingSettings

        Returns
        -------
        RepeatedFit or None
            None where the data do not determine every parameter, or editing has nothing to choose from.
        """
        free, prior_sigmas = parameters.free, parameters.prior_sigmas[parameters.free]
        q, n_usable = int(free.sum()), int(usable.sum())
        offset = (parameters.prior_values - x)[free]
        if q == 0 or min(int(editing.max_rejected_fraction * n_usable), n_usable - q - 1) < 1:
            return None
        whole = DenseLinearization(np.zeros(len(sigma_m)), partials)
        factor = factorize(whole, ObservationNoise(sigma_m).among(usable), parameters, x, FitSettings())
        if factor is None or not factor.determined.all():
            return None
        to_free = factor.root_covariance()
        with_prior = np.isfinite(prior_sigmas)
        prior_rows = to_free[with_prior] / prior_sigmas[with_prior, None]
        pairs = np.stack([group[usable], sigma_m[usable]], axis=1)
        classes, member = np.unique(pairs, axis=0, return_inverse=True)
        member = member.reshape(-1)
        order = np.argsort(member, kind="stable")
        length = max(32, min(_SLAB_NUMBERS // q, 20 * _SLAB_NUMBERS // q**2))
        counts = np.bincount(member)
        slabs = np.concatenate([[0], np.cumsum(-(-counts // length))])
        within = np.arange(n_usable) - np.concatenate([[0], np.cumsum(counts)])[:-1].repeat(counts)
        place = slabs[:-1].repeat(counts) * length + within
        rows = np.flatnonzero(usable)[order]
        padded = np.zeros((int(slabs[-1]) * length, q))
        padded[place] = partials[rows][:, free] @ to_free
        basis = padded.reshape(-1, length, q)
        normal = np.swapaxes(basis, 1, 2) @ basis
        start = np.arange(n_usable)
        if n_usable > _START_ROWS:
            drawn = np.zeros(len(sigma_m), dtype=bool)
            drawn[sample(whole, sigma_m, usable, parameters, _START_ROWS)] = True
            start = np.flatnonzero(drawn[rows])
        of_start = np.zeros((-(-len(start) // length) * length, q))
        of_start[: len(start)] = padded[place[start]]
        return cls(
            free=free,
            rows=rows,
            place=place,
            basis=basis,
            to_free=to_free,
            start=start,
            start_basis=of_start.reshape(-1, length, q),
            slabs=slabs,
            class_sigma_m=classes[:, 1].copy(),
            class_group=classes[:, 0].astype(np.intp),
            class_normal=np.add.reduceat(normal, slabs[:-1], axis=0),
            prior_normal=prior_rows.T @ prior_rows,
            prior_side=prior_rows.T @ (offset[with_prior] / prior_sigmas[with_prior]),
            prior_square=float(np.sum((offset[with_prior] / prior_sigmas[with_prior]) ** 2)),
            n_prior=int(with_prior.sum()),
            n_groups=int(group.max()) + 1,
            n=len(sigma_m),
            editing=editing,
        )

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Observations that may take part, shape (n,)."""
        usable = np.zeros(self.n, dtype=bool)
        usable[self.rows] = True
        return usable

    def fit(self, residual_m: _Floats) -> RepeatedOutcome:
        """Fit the problem to residuals.

        Parameters
        ----------
        residual_m : ndarray, shape (n,)
            Observed - computed at the values given to :meth:`of`, m.
        """
        state = _State(self, residual_m)
        y = state.robust_start()
        edited = state.edit(y, self.class_sigma_m)
        tried_m = [np.zeros(self.n_groups)]
        complete = False
        for _ in range(MAX_PASSES):
            wanted_m = state.wanted_excess_m(edited, first=len(tried_m) == 1)
            if len(tried_m) > 1:
                wanted_m = np.where(tried_m[1] > 0.0, wanted_m, 0.0)
            if _same(wanted_m, tried_m[-1]):
                complete = True
                break
            repeated = [k for k, earlier_m in enumerate(tried_m) if _same(wanted_m, earlier_m)]
            if repeated:
                wanted_m = np.max(tried_m[repeated[0] :], axis=0)
            tried_m.append(wanted_m)
            edited = state.edit(
                edited.y if edited.complete else y, np.hypot(self.class_sigma_m, wanted_m[self.class_group])
            )
            if repeated:
                complete = True
                break
        return state.outcome(edited, tried_m[-1], complete)


@dataclass(frozen=True, slots=True, eq=False)
class _Edited:
    """Coordinates of an edited fit, which rows took part, and whether the choice of them settled."""

    y: _Floats
    sigma_m: _Floats
    used: NDArray[np.bool_]
    residual_m: _Floats
    normal: _Floats
    complete: bool


class _State:
    """One fit while it is made; arrays of usable observations, shape (m,), stand in the order of the problem's rows."""

    def __init__(self, problem: RepeatedFit, residual_m: _Floats) -> None:
        self._problem = problem
        k, length, self._q = problem.basis.shape
        flat = np.zeros(k * length)
        flat[problem.place] = residual_m[problem.rows]
        self._residual_m = flat.reshape(k, length)
        sides = self._residual_m[:, None, :] @ problem.basis
        self._class_side = np.add.reduceat(sides[:, 0], problem.slabs[:-1], axis=0)
        counts = np.diff(problem.slabs)
        self._slab_class = np.repeat(np.arange(len(counts)), counts)
        self._row_class = self._slab_class[problem.place // length]

    def robust_start(self) -> _Floats:
        """Coordinates that minimize Huber's loss, as :func:`radioloc.estimation.robust.robust_start`."""
        problem, basis = self._problem, self._problem.start_basis
        count, shape = len(problem.start), basis.shape[:2]
        sigma_m, residual_m = np.ones(shape), np.zeros(shape)
        sigma_m.ravel()[:count] = problem.class_sigma_m[self._row_class[problem.start]]
        residual_m.ravel()[:count] = self._residual_m.ravel()[problem.place[problem.start]]
        # A sample stands for all: the a-priori values weigh as much less as there are fewer rows.
        part = count / len(problem.rows)
        y = np.zeros(self._q)
        remaining = np.abs(residual_m) / sigma_m
        for _ in range(MAX_REWEIGHTINGS):
            weight = 1.0 / (sigma_m**2 * np.maximum(1.0, remaining))
            weighted = np.swapaxes(basis * weight[..., None], 1, 2)
            normal = (weighted @ basis).sum(axis=0) + part * problem.prior_normal
            side = (weighted @ residual_m[..., None]).sum(axis=0)[:, 0] + part * problem.prior_side
            new = np.linalg.solve(normal, side)
            moved = float(np.max(np.abs(basis @ (new - y)) / sigma_m))
            y = new
            remaining = np.abs(residual_m - basis @ y) / sigma_m
            if moved < START_SETTLED:
                break
            if moved < START_SETTLED * robust_scale(remaining.ravel()[:count], self._q):
                break
        return y

    def edit(self, y: _Floats, sigma_m: _Floats) -> _Edited:
        """Fit and selection by turns, as :func:`radioloc.estimation.editing.fit_with_editing`."""
        editing = self._problem.editing
        m = len(self._problem.rows)
        limit = min(int(editing.max_rejected_fraction * m), m - self._q - 1)
        row_sigma_m = sigma_m[self._row_class]
        left_m = self._left_m(y)
        seen: list[NDArray[np.bool_]] = []
        complete = True
        while True:
            normalized = np.abs(left_m) / row_sigma_m
            used = normalized <= editing.threshold * max(1.0, robust_scale(normalized, self._q))
            if seen and np.array_equal(used, seen[-1]):
                break
            repeated = [k for k, earlier in enumerate(seen) if np.array_equal(used, earlier)]
            if repeated:
                used = np.asarray(np.array(seen[repeated[0] :]).all(axis=0))
            if m - int(used.sum()) > limit:
                complete, used = False, np.ones(m, dtype=bool)
            elif len(seen) >= editing.max_passes:
                complete = False
            y, normal = self._solve(used, sigma_m)
            left_m = self._left_m(y)
            seen.append(used)
            if repeated or not complete:
                break
        return _Edited(y, sigma_m, seen[-1], left_m, normal, complete)

    def wanted_excess_m(self, edited: _Edited, *, first: bool) -> _Floats:
        """Excess that the residuals of each group ask for (:mod:`radioloc.estimation.excess_noise`), m."""
        problem = self._problem
        free_part = self._q / max(int(edited.used.sum()), 1)
        classes = len(problem.class_sigma_m)
        squares_m2 = np.bincount(
            self._row_class, weights=np.where(edited.used, edited.residual_m**2, 0.0), minlength=classes
        )
        counts = np.bincount(self._row_class, weights=edited.used, minlength=classes)
        wanted_m = np.zeros(problem.n_groups)
        for k in range(problem.n_groups):
            mine = problem.class_group == k
            dof = round(float(counts[mine].sum()) * (1.0 - free_part))
            if dof < 1:
                continue
            limit = chi2_quantile(SCALING_PROBABILITY, dof) if first else float(dof)
            wanted_m[k] = _excess_m(squares_m2[mine], problem.class_sigma_m[mine], dof, limit)
        return wanted_m

    def outcome(self, edited: _Edited, excess_m: _Floats, complete: bool) -> RepeatedOutcome:
        """Back to the parameters."""
        problem = self._problem
        root = problem.to_free @ np.linalg.inv(np.linalg.cholesky(edited.normal)).T
        covariance = np.zeros((len(problem.free),) * 2)
        covariance[np.ix_(problem.free, problem.free)] = root @ root.T
        step = np.zeros(len(problem.free))
        step[problem.free] = problem.to_free @ edited.y
        taking_part, left_m = np.zeros(problem.n, dtype=bool), np.zeros(problem.n)
        taking_part[problem.rows], left_m[problem.rows] = edited.used, edited.residual_m
        used = int(edited.used.sum())
        squares = float(np.sum((edited.residual_m / edited.sigma_m[self._row_class])[edited.used] ** 2))
        chi2, dof = squares + self._prior_squares(edited.y), used + problem.n_prior - self._q
        scale = 1.0
        if dof > 0 and chi2 > chi2_quantile(SCALING_PROBABILITY, dof):
            scale = float(np.sqrt(chi2 / dof))
        return RepeatedOutcome(
            step,
            0.5 * (covariance + covariance.T),
            scale,
            root,
            taking_part,
            left_m,
            excess_m,
            complete and edited.complete,
        )

    def _prior_squares(self, y: _Floats) -> float:
        problem = self._problem
        return float(y @ problem.prior_normal @ y - 2.0 * y @ problem.prior_side + problem.prior_square)

    def _left_m(self, y: _Floats) -> _Floats:
        """Residuals that are left, m."""
        left_m = self._residual_m - self._problem.basis @ y
        return np.asarray(left_m.ravel()[self._problem.place])

    def _solve(self, used: NDArray[np.bool_], sigma_m: _Floats) -> tuple[_Floats, _Floats]:
        """Coordinates of the fit to some observations, and their normal matrix."""
        problem = self._problem
        weight = sigma_m**-2.0
        normal = problem.prior_normal + (weight[:, None, None] * problem.class_normal).sum(axis=0)
        side = problem.prior_side + (weight[:, None] * self._class_side).sum(axis=0)
        out = np.flatnonzero(~used)
        if len(out):
            rows = problem.basis.reshape(-1, self._q)[problem.place[out]]
            share = weight[self._row_class[out]]
            weighted = rows * share[:, None]
            normal = normal - np.einsum("ni,nj->ij", weighted, rows)
            side = side - np.einsum("ni,n->i", weighted, self._residual_m.ravel()[problem.place[out]])
        return np.linalg.solve(normal, side), normal


def _excess_m(squares_m2: _Floats, sigma_m: _Floats, dof: int, limit: float) -> float:
    """As :func:`radioloc.estimation.excess_noise.excess_noise_m`, of sums of squares by sigma."""
    if float((squares_m2 / sigma_m**2).sum()) <= limit:
        return 0.0
    low_m, high_m = 0.0, float(np.sqrt(squares_m2.sum() / dof))
    for _ in range(60):
        middle_m = 0.5 * (low_m + high_m)
        if float((squares_m2 / (sigma_m**2 + middle_m**2)).sum()) > dof:
            low_m = middle_m
        else:
            high_m = middle_m
    return high_m


def _same(one_m: _Floats, other_m: _Floats) -> bool:
    return bool((np.abs(one_m - other_m) <= SETTLED * one_m).all())
