"""What the trials of a Monte Carlo study say together: how large errors are, whether the claimed sigmas are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.orbit_state import ALONG_ACROSS_RADIAL, EAST_NORTH_UP

_Floats = NDArray[np.float64]
_Three = tuple[float, ...]

SIDES = EAST_NORTH_UP
NORMAL_95, CHI2_2_95, CHI2_6_95 = 1.959963984540054, 5.991464547107979, 12.591587243743977
"""Quantile of 97.5 % of the normal distribution; of 95 % of chi-square of two and of six degrees of freedom."""


def sides_of(columns: Sequence[str]) -> tuple[str, ...]:
    """Axes of the errors that results have: of a place, or of an orbit."""
    return SIDES if "east_m" in columns else ALONG_ACROSS_RADIAL


@dataclass(frozen=True, slots=True)
class Inside:
    """How often the truth is inside a claimed interval or ellipse of 95 %.

    ``count`` of ``trials``; the fraction lies from ``low`` to ``high`` in 95 % of studies with so many trials if the
    claim is right.
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

    If the claimed covariance is right, 1 is expected, and ``low`` to ``high`` in 95 % of studies with so many trials.
    """

    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """Mean and standard deviation of a parameter's estimates, rms of their errors, median of the claimed sigma."""

    name: str
    mean: float
    std: float
    rms_error: float | None  # None where the truth of the parameter is not known
    sigma: float


@dataclass(frozen=True, slots=True)
class ArcSummary:
    """One arc's trials; statistics are of those that converged."""

    hours: float
    span_h: float
    trials: int
    converged: int
    mean_m: _Three  # position less truth by the axes, as the next two; the claimed sigma is the median
    rms_m: _Three
    sigma_m: _Three
    rms_horizontal_m: float
    radius_68_m: float  # horizontal distance from the truth that 68 % are within; of 95 % likewise
    radius_95_m: float
    # By the axes: the claimed interval of 95 %; horizontal: the claimed ellipse of 95 %; of an orbit also the state.
    inside: dict[str, Inside]
    nees: Nees  # of the position in space; of that on the sphere the next
    nees_horizontal: Nees
    used: float  # mean number of observations that took part; of those that did not the mean and the largest
    rejected: float
    rejected_most: int
    # Horizontal distance from the longest arc's position that 95 % are within; None for that itself.
    from_longest_95_m: float | None
    parameters: tuple[ParameterSummary, ...]
    at_h: float | None = None  # of an orbit when its position is compared, from the state's epoch
    nees_state: Nees | None = None  # of an orbit's position and velocity

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``, and of an orbit when."""
        return f"{self.hours:g} h" + ("" if self.at_h is None else f" at {self.at_h:.1f} h")


def summarize(
    hours: float,
    span_h: float,
    columns: Sequence[str],
    values: _Floats,
    longest: _Floats | None,
    at_h: float | None = None,
) -> ArcSummary | None:
    """Summarize the trials of one arc, None where none has converged.

    Values have shape (trials, columns); `longest` are those of the longest arc, if this is another one.
    """
    sides = sides_of(columns)
    converged = columns.index("converged")
    good = values[:, converged] == 1.0
    n = int(good.sum())
    if not n:
        return None
    found = dict(zip(columns, values[good].T, strict=True))
    error_m = np.stack([found[f"{side}_m"] for side in sides], axis=-1)
    sigma_m = np.stack([found[f"sigma_{side}_m"] for side in sides], axis=-1)
    horizontal_m = np.hypot(error_m[:, 0], error_m[:, 1])
    held = np.abs(error_m) <= NORMAL_95 * sigma_m
    counts = dict(zip(sides, held.sum(axis=0).tolist(), strict=True))
    counts["horizontal"] = int((found["nees_horizontal"] <= CHI2_2_95).sum())
    if at_h is not None:
        counts["state"] = int((found["nees_state"] <= CHI2_6_95).sum())
    low, high = binomial_bounds(n, 0.95)
    apart = None
    if longest is not None and (both := good & (longest[:, converged] == 1.0)).any():
        plane = [columns.index(f"{side}_m") for side in sides[:2]]
        apart = float(np.quantile(np.hypot(*(values - longest)[both][:, plane].T), 0.95))
    return ArcSummary(
        hours=hours,
        span_h=span_h,
        trials=len(values),
        converged=n,
        mean_m=tuple(error_m.mean(axis=0).tolist()),
        rms_m=tuple(np.sqrt((error_m**2).mean(axis=0)).tolist()),
        sigma_m=tuple(np.median(sigma_m, axis=0).tolist()),
        rms_horizontal_m=_rms(horizontal_m),
        radius_68_m=float(np.quantile(horizontal_m, 0.68)),
        radius_95_m=float(np.quantile(horizontal_m, 0.95)),
        inside={key: Inside(count, n, low, high) for key, count in counts.items()},
        nees=_nees(found["nees"], 3),
        nees_horizontal=_nees(found["nees_horizontal"], 2),
        used=float(found["used"].mean()),
        rejected=float(found["rejected"].mean()),
        rejected_most=int(found["rejected"].max()),
        from_longest_95_m=apart,
        parameters=tuple(
            ParameterSummary(
                name,
                float(found[name].mean()),
                float(found[name].std()),
                _rms(found[f"{name}.error"]) if f"{name}.error" in found else None,
                float(np.median(found[f"{name}.sigma"])),
            )
            for name in columns
            # NaN in an arc without observations that the parameter acts on.
            if f"{name}.sigma" in found and not np.isnan(found[name]).any()
        ),
        at_h=at_h,
        nees_state=None if at_h is None else _nees(found["nees_state"], 6),
    )


def binomial_bounds(n: int, probability: float) -> tuple[float, float]:
    """Fractions that the successes in n > 0 trials lie within in 95 % of cases, both ends included."""
    from scipy.special import bdtr

    below = bdtr(np.arange(n + 1), n, probability)
    low, high = (int(np.searchsorted(below, quantile)) for quantile in (0.025, 0.975))
    return low / n, min(high, n) / n


def _rms(values: _Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def _nees(values: _Floats, dimension: int) -> Nees:
    from scipy.special import chdtri

    dof = dimension * len(values)
    low, high = (float(chdtri(dof, 1.0 - quantile)) / dof for quantile in (0.025, 0.975))
    return Nees(float(values.mean()) / dimension, low, high)
