"""Errors that last for a while: how likely sums over stretches of time make them, and what they add to a covariance.

In each series the whitened errors are white noise and a first-order Gauss-Markov process,

    V_ij = w d_ij + c exp(-|t_i - t_j| / tau).

Sums over stretches of n observations then have the covariance n w + c sum(k), with the correlations k between
stretches; deviations from the means of the stretches have the variance w + c (1 - k), k being the mean correlation
within one. What the parameters can absorb of the sums is projected out (restricted maximum likelihood, Patterson and
Thompson 1971). Correlation times tau and ratios c / w are tried on a grid; w is the most likely one of each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.series_stretches import FEWEST, PartialSums, StretchSums
from radioloc.estimation.statistics import SCALING_PROBABILITY

_Floats = NDArray[np.float64]

TAUS = 10
"""Correlation times tried, from half the shortest stretch to half the longest span, evenly by their logarithm."""
RATIOS = np.logspace(-6.0, 3.0, 46)
"""Ratios c / w that are tried."""
_CHANCE = 0.01
"""White residuals seem to be alike in one fit of a hundred: a correlation that is missed costs a factor on the sigmas,
one that is not there costs little."""


@dataclass(frozen=True, slots=True, eq=False)
class LastingErrors:
    """How errors that last spread over the stretches of some series.

    Parameters
    ----------
    codes : tuple of int
        The series, s in number.
    taus_s : ndarray, shape (taus,)
    kernels : ndarray, shape (s, taus, b, b)
        Correlations between the stretches.
    inside_spread : ndarray, shape (s, taus, ratios)
        Variance of deviations from the means of stretches over w.
    onto_modes : ndarray, shape (s, taus, d, b)
        From sums over the root of their counts to coordinates along the principal axes of the correlations; what the
        parameters can absorb has none.
    inverse_spread : ndarray, shape (s, taus, ratios, d)
        w over the variance along those axes.
    log_spread : ndarray, shape (s, taus, ratios)
        Sum of the logarithms of those variances over w.
    kept, stretches : ndarray, shape (s,)
        Axes and stretches of each.
    """

    codes: tuple[int, ...]
    taus_s: _Floats
    kernels: _Floats
    inside_spread: _Floats
    onto_modes: _Floats
    inverse_spread: _Floats
    log_spread: _Floats
    kept: _Floats
    stretches: _Floats

    @classmethod
    def of(cls, sums: StretchSums, partials: PartialSums, absorbed: float) -> LastingErrors | None:
        """Those of the series that partials are known of and that the parameters leave enough of; None without any.

        Parameters
        ----------
        sums : StretchSums
        partials : PartialSums
        absorbed : float
            Sigmas that the estimate may be off by: what it then takes out of a series is projected out.
        """
        bases = {}
        for code, sums_of in zip(partials.codes, partials.sums, strict=True):
            basis = _not_absorbed(sums, code, sums_of, absorbed)
            if basis.shape[1] >= FEWEST:
                bases[code] = basis
        if not bases:
            return None
        taus_s = _tried_taus_s(sums, partials.codes)
        n, most = len(bases), max(len(basis) for basis in bases.values())
        widest = max(basis.shape[1] for basis in bases.values())
        kernels = np.zeros((n, len(taus_s), most, most))
        onto = np.zeros((n, len(taus_s), widest, most))
        values = np.zeros((n, len(taus_s), widest))
        for k, (code, basis) in enumerate(bases.items()):
            part, (b, d) = sums.stretches.part(code), basis.shape
            root_count = np.sqrt(sums.count[part])
            one = np.array(
                [kernel(sums.time_s[part], sums.stretches.width_s[code], tau_s) for tau_s in taus_s]
            )
            values[k, :, :d], axes = principal_axes(
                basis.T @ (root_count[:, None] * one * root_count) @ basis
            )
            kernels[k, :, :b, :b] = one
            onto[k, :, :d, :b] = np.swapaxes(axes, 1, 2) @ basis.T
        spread = 1.0 + RATIOS[:, None] * values[:, :, None, :]
        return cls(
            codes=tuple(bases),
            taus_s=taus_s,
            kernels=kernels,
            inside_spread=1.0 + RATIOS * (1.0 - kernels[:, :, 0, 0])[..., None],
            onto_modes=onto,
            inverse_spread=1.0 / spread,
            log_spread=np.log(spread).sum(axis=3),
            kept=np.array([basis.shape[1] for basis in bases.values()], dtype=np.float64),
            stretches=np.array([len(basis) for basis in bases.values()], dtype=np.float64),
        )

    def likelihood(self, sums: StretchSums) -> Likelihood:
        """That of residuals for all correlation times and ratios."""
        n, n_taus, widest, most = self.onto_modes.shape
        residual = sums.stretches.side_by_side(sums.residual, self.codes)[:, :most]
        count = sums.stretches.side_by_side(sums.count, self.codes, empty=1.0)[:, :most]
        scaled = residual / np.sqrt(count)
        along = (self.onto_modes.reshape(n, -1, most) @ scaled[..., None]).reshape(n, n_taus, widest, 1) ** 2
        squares = (self.inverse_spread @ along)[..., 0]
        codes = list(self.codes)
        inside = np.maximum(sums.squares[codes] - (scaled**2).sum(axis=1), 0.0)[:, None, None]
        dof_inside = (sums.used[codes] - self.stretches)[:, None, None]
        every = self.kept[:, None, None] + dof_inside
        white = (squares + inside / self.inside_spread) / every
        log = -0.5 * (every * np.log(white) + self.log_spread + dof_inside * np.log(self.inside_spread))
        null = -0.5 * every * np.log((along[:, :1].sum(axis=2) + inside) / every)
        return Likelihood(log - null, white)


@dataclass(frozen=True, slots=True, eq=False)
class Likelihood:
    """Restricted likelihood of some series.

    Parameters
    ----------
    log : ndarray, shape (s, taus, ratios)
        Logarithm of the likelihood over that of white noise.
    white : ndarray, shape (s, taus, ratios)
        Most likely w of each.
    """

    log: _Floats
    white: _Floats

    def significant(self, groups: Sequence[str], n_groups: int) -> dict[int, _Floats]:
        """Which series have errors that last, and the logarithm of the likelihood that says how they do.

        All series of a group have one tau and one ratio c / w, which their few hours tell better together, unless a
        series says otherwise.

        Parameters
        ----------
        groups : sequence of str
            Of each series.
        n_groups : int
            Groups that were looked at, these and others.
        """
        found = {}
        differing = -math.log((1.0 - SCALING_PROBABILITY) / len(groups))
        for group in dict.fromkeys(groups):
            mine = [k for k, other in enumerate(groups) if other == group]
            together = self.log[mine].sum(axis=0)
            # Two parameters more than white noise: chi-square of two degrees of freedom, 1 - exp(-x / 2).
            if together.max() < -math.log(_CHANCE / n_groups):
                continue
            best = np.unravel_index(int(together.argmax()), together.shape)
            for k in mine:
                own = self.log[k]
                found[k] = own if own.max() - own[best] > differing else together
        return found


@dataclass(frozen=True, slots=True, eq=False)
class AveragedErrors:
    """White and lasting errors of the series that show some, averaged over a likelihood.

    Parameters
    ----------
    codes : tuple of int
        The series, s in number.
    white : ndarray, shape (s,)
        Variance w.
    coloured : ndarray, shape (s, taus)
        Variance c by correlation time; their sum is the whole.
    kernel : ndarray, shape (s, b, b)
        Covariance of the lasting errors between stretches.
    """

    codes: tuple[int, ...]
    white: _Floats
    coloured: _Floats
    kernel: _Floats

    @classmethod
    def of(cls, lasting: LastingErrors, sums: StretchSums, groups: Sequence[str]) -> AveragedErrors | None:
        """Average over the likelihood of what residuals show; None where no group shows errors that last.

        A c far beyond the variance of the residuals, which then would all have been absorbed by the parameters, counts
        for as much less (Gelman 2006).

        Parameters
        ----------
        lasting : LastingErrors
        sums : StretchSums
        groups : sequence of str
            Of each series of the sums, also of those that are not looked at.
        """
        likelihood = lasting.likelihood(sums)
        found = likelihood.significant([groups[code] for code in lasting.codes], len(set(groups)))
        if not found:
            return None
        chosen, log = list(found), np.array(list(found.values()))
        codes = [lasting.codes[k] for k in chosen]
        white, variance = likelihood.white[chosen], sums.variance[codes]
        coloured = white * RATIOS
        weights = np.exp(log - log.max(axis=(1, 2), keepdims=True)) / (
            1.0 + coloured / variance[:, None, None]
        )
        weights /= weights.sum(axis=(1, 2), keepdims=True)
        by_tau = (weights * coloured).sum(axis=2)
        most = lasting.kernels.shape[2]
        kernel = np.array(
            [one @ lasting.kernels[k].reshape(len(one), -1) for one, k in zip(by_tau, chosen, strict=True)]
        ).reshape(-1, most, most)
        return cls(tuple(codes), (weights * white).sum(axis=(1, 2)), by_tau, kernel)

    def added(self, partials: PartialSums) -> _Floats:
        """What each series adds to a unit covariance, shape (s, q, q); the partials are of these series."""
        unit = partials.sums[:, : self.kernel.shape[1]]
        return np.asarray(
            (self.white - 1.0)[:, None, None] * partials.products
            + np.swapaxes(unit, 1, 2) @ self.kernel @ unit
        )


def _tried_taus_s(sums: StretchSums, codes: Sequence[int]) -> _Floats:
    """Correlation times that are tried for some series, s, shape (taus,)."""
    widths_s = sums.stretches.width_s[list(codes)]
    longest_s = max(float(np.ptp(sums.time_s[sums.stretches.part(code)])) for code in codes)
    return np.geomspace(0.5 * widths_s.min(), max(0.5 * longest_s, widths_s.max()), TAUS)


def _not_absorbed(sums: StretchSums, code: int, partials: _Floats, absorbed: float) -> _Floats:
    """Basis of what the parameters leave of sums over the stretches of a series, shape (b, d)."""
    count = sums.count[sums.stretches.part(code)]
    left, s, _ = np.linalg.svd(partials[: len(count)] / np.sqrt(count)[:, None])
    return np.asarray(left[:, int((s * absorbed > 1.0).sum()) :])


def principal_axes(covariances: _Floats) -> tuple[_Floats, _Floats]:
    """Variances, none below zero, and principal axes in columns of covariances (k, d, d).

    Between stretches that gaps cut short the mean correlations are not quite those of any process: a matrix of them can
    have a negative eigenvalue. Of matrices that are not symmetric to the last bit some LAPACK libraries find none.
    """
    symmetric = 0.5 * (covariances + np.swapaxes(covariances, 1, 2))
    try:
        values, axes = np.linalg.eigh(symmetric)
    except np.linalg.LinAlgError:
        from scipy.linalg import eigh

        found = [eigh(one, driver="evr") for one in symmetric]  # another algorithm, slower
        values, axes = (np.array(part) for part in zip(*found, strict=True))
    return np.maximum(values, 0.0), axes


def kernel(time_s: _Floats, width_s: float, tau_s: float) -> _Floats:
    """Mean of exp(-|dt| / tau) over the observations of two stretches, evenly spread over their length."""
    x = width_s / tau_s
    apart = np.abs(time_s[:, None] - time_s[None, :])
    between = np.exp(-apart / tau_s) * (2.0 * math.sinh(0.5 * x) / x) ** 2
    # Stretches that end at a gap are shorter than others, so neighbours may be nearer than a whole one.
    same = 2.0 * (x - 1.0 + math.exp(-x)) / x**2
    between = np.minimum(between, same)
    np.fill_diagonal(between, same)
    return between
