"""Numbers that say how well observations are fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels

SCALING_PROBABILITY = 0.999
"""The formal covariance is scaled up when the reduced chi-square would exceed its value by chance in fewer than one
fit of a thousand."""


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """Residuals of the observations that share a label (a station, a type).

    Parameters
    ----------
    label : str
        What they share.
    used, rejected : int
        How many took part in the fit, how many were left out for any reason.
    mean_m, rms_m, wrms_m : float or None
        Mean, root mean square, and root mean square weighted by 1/sigma^2 of the used residuals, m (of
        the round trip for ranges); None if none was used.
    """

    label: str
    used: int
    rejected: int
    mean_m: float | None
    rms_m: float | None
    wrms_m: float | None

    def to_dict(self) -> dict[str, Any]:
        """Its numbers without the label."""
        return {key: value for key, value in asdict(self).items() if key != "label"}


@dataclass(frozen=True, slots=True)
class FitStatistics:
    """Residuals of a fit as a whole.

    Parameters
    ----------
    total : GroupStatistics
        All observations.
    by_station, by_type, by_path : tuple of GroupStatistics
        By label, in alphabetic order; the label of a path has the type before it, such as ``range A>lander>B``. A
        station's mean can hide what its paths show, such as a two-way bias against a three-way one.
    chi2 : float
        Weighted sum of squares with the a-priori rows.
    dof : int
        Degrees of freedom.
    chi2_per_dof : float or None
        Reduced chi-square; None without redundancy.
    chi2_per_dof_bound : float or None
        What it exceeds by chance in one fit of a thousand.
    robust_scale : float
        Spread of the residuals over their stated sigmas by the median, outliers included.
    excess_noise_m : dict of str to float
        Noise that was added in quadrature to every stated sigma of a type, m; the chi-square is with it.
    """

    total: GroupStatistics
    by_station: tuple[GroupStatistics, ...]
    by_type: tuple[GroupStatistics, ...]
    by_path: tuple[GroupStatistics, ...]
    chi2: float
    dof: int
    chi2_per_dof: float | None
    chi2_per_dof_bound: float | None
    robust_scale: float
    excess_noise_m: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """All numbers, in types that JSON has."""
        total = self.total.to_dict()
        groups = {"by_station": self.by_station, "by_type": self.by_type, "by_path": self.by_path}
        return {
            **total,
            "chi2": self.chi2,
            "dof": self.dof,
            "chi2_per_dof": self.chi2_per_dof,
            "chi2_per_dof_bound": self.chi2_per_dof_bound,
            "excess_noise_m": dict(self.excess_noise_m),
            "robust_scale": self.robust_scale,
            **{key: {group.label: group.to_dict() for group in items} for key, items in groups.items()},
        }


def finite_or_none(value: float) -> float | None:
    """A number for JSON, which has neither infinity nor NaN."""
    return float(value) if math.isfinite(value) else None


def chi2_quantile(probability: float, dof: int) -> float:
    """Value that chi-square of some degrees of freedom stays below with a probability."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * dof, probability))


def group_statistics(
    label: str, residual_m: NDArray[np.float64], sigma_m: NDArray[np.float64], used: NDArray[np.bool_]
) -> GroupStatistics:
    """Statistics of some observations; residuals, sigmas and the mask have shape (n,)."""
    n_used = int(used.sum())
    rejected = len(used) - n_used
    if n_used == 0:
        return GroupStatistics(label, 0, rejected, None, None, None)
    r, weight = residual_m[used], 1.0 / sigma_m[used] ** 2
    return GroupStatistics(
        label,
        n_used,
        rejected,
        float(r.mean()),
        float(np.sqrt(np.mean(r**2))),
        float(np.sqrt((weight * r**2).sum() / weight.sum())),
    )


def statistics_by(
    labels: Labels | Sequence[str] | NDArray[np.str_],
    residual_m: NDArray[np.float64],
    sigma_m: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> tuple[GroupStatistics, ...]:
    """Statistics of each group of observations that share a label, in alphabetic order."""
    groups = Labels.of(labels)
    found = []
    for label in groups.present():
        which = groups.are(label)
        found.append(group_statistics(label, residual_m[which], sigma_m[which], used[which]))
    return tuple(found)
