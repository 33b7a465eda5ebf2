"""What the trials of a Monte Carlo study say together: how large errors are, whether the claimed sigmas are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Three = tuple[float, float, float]

NORMAL_95, CHI2_2_95 = 1.959963984540054, 5.991464547107979
"""Quantile of 97.5 % of the normal distribution; of 95 % of chi-square of two degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Inside:
    """How often the truth is inside a claimed interval or ellipse of 95 %.

    Parameters
    ----------
    count, trials : int
        Trials in which it is, of how many.
    low, high : float
        Where the fraction lies in 95 % of studies with so many trials if the claim is right.
    """

    count: int
    trials: int
    low: float
    high: float

    @property
    def fraction(self) -> float:
        """Part of the trials."""
        return self.count / self.trials


@dataclass(frozen=True, slots=True)
class Nees:
    """Normalized estimation error squared, error' covariance^-1 error over its dimension, mean over the trials.

    Parameters
    ----------
    mean : float
        1 if the claimed covariance is right.
    low, high : float
        Where it lies in 95 % of studies with so many trials if it is.
    """

    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """A parameter beside the position.

    Parameters
    ----------
    name : str
    mean, std : float
        Mean and standard deviation of the estimates.
    rms_error : float or None
        Root mean square of the estimate less what was put in, of range biases.
    sigma : float
        Median of the claimed sigma.
    """

    name: str
    mean: float
    std: float
    rms_error: float | None
    sigma: float


@dataclass(frozen=True, slots=True)
class ArcSummary:
    """One arc's trials.

    Parameters
    ----------
    hours, span_h : float
        Length asked for; from the start to the last observation, h.
    trials, converged : int
        How many were made; statistics are of those that converged.
    mean_m, rms_m, sigma_m : tuple of float
        Position less truth, east, north, up, m: its mean, its root mean square, and the median of the claimed sigma.
    rms_horizontal_m : float
        Root mean square of the horizontal distance from the truth, m.
    radius_68_m, radius_95_m : float
        Horizontal distance from the truth that 68 % and 95 % of the trials are within, m.
    inside : dict of str to Inside
        ``east``, ``north``, ``up``: the claimed interval of 95 %; ``horizontal``: the claimed ellipse of 95 %.
    nees, nees_horizontal : Nees
        Of the position in space and on the sphere.
    used, rejected : float
        Mean number of observations that took part and that did not.
    rejected_most : int
        Largest number of those that did not.
    from_longest_95_m : float or None
        Horizontal distance from the longest arc's position that 95 % are within, m; None for that itself.
    parameters : tuple of ParameterSummary
    """

    hours: float
    span_h: float
    trials: int
    converged: int
    mean_m: _Three
    rms_m: _Three
    sigma_m: _Three
    rms_horizontal_m: float
    radius_68_m: float
    radius_95_m: float
    inside: dict[str, Inside]
    nees: Nees
    nees_horizontal: Nees
    used: float
    rejected: float
    rejected_most: int
    from_longest_95_m: float | None
    parameters: tuple[ParameterSummary, ...]

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``."""
        return f"{self.hours:g} h"


def summarize(
    hours: float, span_h: float, columns: Sequence[str], values: _Floats, longest: _Floats | None
) -> ArcSummary | None:
    """Summarize the trials of one arc.

    Parameters
    ----------
    hours, span_h : float
    columns : sequence of str
    values : ndarray, shape (trials, columns)
    longest : ndarray, shape (trials, columns), or None
        Those of the longest arc, if this is another one.

    Returns
    -------
    ArcSummary or None
        None where no trial has converged.
    """
    place = {name: k for k, name in enumerate(columns)}
    good = values[:, place["converged"]] == 1.0
    if longest is not None:
        both = good & (longest[:, place["converged"]] == 1.0)
    kept = values[good]
    n = len(kept)
    if not n:
        return None
    error_m = kept[:, [place[f"{axis}_m"] for axis in ("east", "north", "up")]]
    sigma_m = kept[:, [place[f"sigma_{axis}_m"] for axis in ("east", "north", "up")]]
    horizontal_m = np.hypot(error_m[:, 0], error_m[:, 1])
    low, high = binomial_bounds(n, 0.95)
    held = {
        axis: int((np.abs(error_m[:, k]) <= NORMAL_95 * sigma_m[:, k]).sum())
        for k, axis in enumerate(("east", "north", "up"))
    }
    nees_horizontal = kept[:, place["nees_horizontal"]]
    held["horizontal"] = int((nees_horizontal <= CHI2_2_95).sum())
    apart = None
    if longest is not None and both.any():
        east, north = place["east_m"], place["north_m"]
        moved_m = (values - longest)[both]
        apart = float(np.quantile(np.hypot(moved_m[:, east], moved_m[:, north]), 0.95))
    names = [name for name in columns if f"{name}.sigma" in place]
    parameters = []
    for name in names:
        estimates, sigmas = kept[:, place[name]], kept[:, place[f"{name}.sigma"]]
        if np.isnan(estimates).any():
            continue  # an arc without observations that it acts on
        error = place.get(f"{name}.error")
        rms = None if error is None else float(np.sqrt((kept[:, error] ** 2).mean()))
        parameters.append(
            ParameterSummary(
                name, float(estimates.mean()), float(estimates.std()), rms, float(np.median(sigmas))
            )
        )
    return ArcSummary(
        hours=hours,
        span_h=span_h,
        trials=len(values),
        converged=n,
        mean_m=_three(error_m.mean(axis=0)),
        rms_m=_three(np.sqrt((error_m**2).mean(axis=0))),
        sigma_m=_three(np.median(sigma_m, axis=0)),
        rms_horizontal_m=float(np.sqrt((horizontal_m**2).mean())),
        radius_68_m=float(np.quantile(horizontal_m, 0.68)),
        radius_95_m=float(np.quantile(horizontal_m, 0.95)),
        inside={key: Inside(count, n, low, high) for key, count in held.items()},
        nees=_nees(kept[:, place["nees"]], 3),
        nees_horizontal=_nees(nees_horizontal, 2),
        used=float(kept[:, place["used"]].mean()),
        rejected=float(kept[:, place["rejected"]].mean()),
        rejected_most=int(kept[:, place["rejected"]].max()),
        from_longest_95_m=apart,
        parameters=tuple(parameters),
    )


def binomial_bounds(n: int, probability: float) -> tuple[float, float]:
    """Fractions that the number of successes in n trials lies within in 95 % of cases, both ends included.

    Parameters
    ----------
    n : int
        Above zero.
    probability : float
        Of a success, between 0 and 1.
    """
    from scipy.special import bdtr

    below = bdtr(np.arange(n + 1), n, probability)
    low, high = (int(np.searchsorted(below, quantile)) for quantile in (0.025, 0.975))
    return low / n, min(high, n) / n


def _nees(values: _Floats, dimension: int) -> Nees:
    from scipy.special import chdtri

    dof = dimension * len(values)
    low, high = (float(chdtri(dof, 1.0 - quantile)) / dof for quantile in (0.025, 0.975))
    return Nees(float(values.mean()) / dimension, low, high)


def _three(values: _Floats) -> _Three:
    east, north, up = values.tolist()
    return east, north, up
