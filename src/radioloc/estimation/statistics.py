"""Residuals of a fit and their statistics."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import ConvergenceError, InputError
from radioloc.labels import USED, Labels, changed
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.quantities import TableForm, as_table
from radioloc.text_files import finite_or_none
from radioloc.time import Epochs, utc_strings
from radioloc.units import set_fields
from radioloc.vectors import Floats, Indices, Mask

SCALING_PROBABILITY = 0.999
"""The formal covariance is scaled up when the reduced chi-square would exceed its value by chance in fewer than one
fit of a thousand."""

_MAX_ROOT_STEPS = 100  # each at least halves the interval
_FIGURES = re.compile(r"[:(].*| of -?\d+ cycles?")
_MAX_EXAMPLES = 3  # of the rejected observations of one link, reason and pass
_MAD_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution to its standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Observations with their residuals after a fit; arrays of shape (n,)."""

    epoch_utc: Epochs  #: UTC of the event that the time tag names
    #: Station that a bias or a group belongs to, kind of measurement, participants of the signal path.
    stations: Labels
    types: Labels  #: likewise
    paths: Labels  #: likewise
    #: Observed value, observed - computed, stated standard deviation; m (of the round trip for ranges).
    observed_m: Floats
    residual_m: Floats  #: likewise
    sigma_m: Floats  #: likewise
    statuses: Labels  #: ``"used"`` or the reason for the rejection
    #: Lower of the stations' elevations of the Moon, deg; NaN where no station observes.
    elevation_deg: Floats | None = None
    count_s: Floats | None = None  #: count intervals of Doppler, s; NaN for other types

    def __post_init__(self) -> None:
        n = len(self.residual_m)
        for name in self.__slots__:
            column = getattr(self, name)
            if column is not None and len(column) != n:
                raise InputError(f"{name} has {len(column)} values, but there are {n} observations")
        for name in ("observed_m", "residual_m", "sigma_m"):
            set_fields(self, **{name: read_only(getattr(self, name))})

    def __len__(self) -> int:
        return len(self.residual_m)

    def __repr__(self) -> str:
        return f"<Residuals {len(self)}, {int(self.used.sum())} used>"

    def select(self, rows: Any) -> Residuals:
        """Select rows: a slice, a mask or indices."""
        columns: dict[str, Any] = {name: getattr(self, name) for name in self.__slots__}
        for name, column in columns.items():
            if column is not None:
                columns[name] = column.select(rows) if isinstance(column, Labels) else column[rows]
        return Residuals(**columns)

    @property
    def residual_mm_s(self) -> Floats:
        """Residual of Doppler as a round-trip rate, mm/s, shape (n,); NaN for other types."""
        return 1e3 * self.residual_m / (np.nan if self.count_s is None else self.count_s)

    @property
    def station(self) -> NDArray[np.str_]:
        """:attr:`stations` as texts, shape (n,)."""
        return np.asarray(self.stations[:])

    @property
    def type(self) -> NDArray[np.str_]:
        """:attr:`types` as texts, shape (n,)."""
        return np.asarray(self.types[:])

    @property
    def path(self) -> NDArray[np.str_]:
        """:attr:`paths` as texts, shape (n,)."""
        return np.asarray(self.paths[:])

    @property
    def status(self) -> NDArray[np.str_]:
        """:attr:`statuses` as texts, shape (n,)."""
        return np.asarray(self.statuses[:])

    @property
    def used(self) -> Mask:
        """Mask of the used observations, shape (n,)."""
        return self.statuses.are(USED)

    @property
    def reasons(self) -> Labels:
        """:attr:`statuses` without the figures of single observations, such as elevations."""
        return without_figures(self.statuses)

    @property
    def computed_m(self) -> Floats:
        """Computed values, m, shape (n,)."""
        return self.observed_m - self.residual_m

    def statistics(self, label: str, rows: Any = slice(None)) -> GroupStatistics:
        """Statistics of some observations: a slice, a mask or indices."""
        residual_m, sigma_m, used = self.residual_m[rows], self.sigma_m[rows], self.used[rows]
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

    def statistics_by(self, labels: Labels) -> tuple[GroupStatistics, ...]:
        """Statistics of each group of observations that share a label, in alphabetic order."""
        return tuple(self.statistics(label, labels.are(label)) for label in labels.present())

    def rejected(self) -> list[dict[str, Any]]:
        """Return the rejected observations by link, reason and pass, with the largest of each, for JSON."""
        reasons, out = self.reasons, np.flatnonzero(~self.used)
        epoch_h = 24.0 * (self.epoch_utc[out].jd + self.epoch_utc[out].fraction)
        order = np.lexsort((epoch_h, reasons.codes[out], self.paths.codes[out]))
        out, epoch_h = out[order], epoch_h[order]
        new = changed(np.column_stack([self.paths.codes[out], reasons.codes[out]]))
        new[1:] |= np.diff(epoch_h) > PASS_GAP_H
        return [self._group(rows, reasons) for rows in np.split(out, np.flatnonzero(new)[1:]) if len(rows)]

    def _group(self, rows: Indices, reasons: Labels) -> dict[str, Any]:
        """Return rejected observations of one link, reason and pass for JSON."""
        size = np.abs(self.residual_m[rows] / self.sigma_m[rows])
        largest = rows[np.argsort(-size, kind="stable")[:_MAX_EXAMPLES]]
        columns = {
            "epoch_utc": utc_strings(self.epoch_utc[largest], decimals=3).tolist(),
            "residual_m": [finite_or_none(value) for value in self.residual_m[largest]],
            "reason": self.statuses[largest].tolist(),
        }
        first, last = utc_strings(self.epoch_utc[rows[[0, -1]]], decimals=3).tolist()
        return {
            "path": str(self.paths[rows[0]]),
            "station": str(self.stations[rows[0]]),
            "reason": str(reasons[rows[0]]),
            "count": len(rows),
            "first_utc": first,
            "last_utc": last,
            "largest": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        }

    def to_table(self, form: TableForm = "astropy") -> Any:
        """All columns as a ``QTable`` of astropy, with units and ``Time``, or a ``DataFrame`` of pandas."""
        names = ("type", "station", "path", "observed_m", "computed_m", "residual_m", "sigma_m", "status")
        columns: dict[str, Any] = {"epoch_utc": self.epoch_utc} | {
            name: getattr(self, name) for name in names
        }
        if self.elevation_deg is not None:
            columns["elevation_deg"] = self.elevation_deg
        return as_table(columns, form)


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """Residuals of the observations that share a label (a station, a type)."""

    label: str  #: station, type or path
    used: int  #: number of used and of rejected observations
    rejected: int  #: likewise
    #: Mean, root mean square, and root mean square weighted by 1/sigma^2 of the used residuals, m (of the round
    #: trip for ranges); None if none was used.
    mean_m: float | None
    rms_m: float | None  #: likewise
    wrms_m: float | None  #: likewise

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers, without the label, for JSON."""
        return {key: value for key, value in asdict(self).items() if key != "label"}


@dataclass(frozen=True, slots=True)
class FitStatistics:
    """Residuals of a fit as a whole."""

    total: GroupStatistics  #: all observations
    #: By label, in alphabetic order; the label of a path has the type before it, such as ``range A>lander>B``. A
    #: station's mean can hide what its paths show, such as a two-way bias against a three-way one.
    by_station: tuple[GroupStatistics, ...]
    by_type: tuple[GroupStatistics, ...]  #: likewise
    by_path: tuple[GroupStatistics, ...]  #: likewise
    chi2: float  #: weighted sum of squares with the a-priori rows
    dof: int  #: degrees of freedom
    robust_scale: float  #: spread of the residuals over their stated sigmas by the median, outliers included
    #: Noise that was added in quadrature to every stated sigma of a type, m; the chi-square is with it.
    excess_noise_m: Mapping[str, float]
    #: Station errors that delays of one epoch share, estimated from the residuals and contained in the sigmas,
    #: m; empty without.
    shared_noise_m: Mapping[str, float]

    @property
    def chi2_per_dof(self) -> float | None:
        """Reduced chi-square; None without redundancy."""
        return self.chi2 / self.dof if self.dof > 0 else None

    @property
    def chi2_per_dof_bound(self) -> float | None:
        """99.9 % quantile of the reduced chi-square."""
        return chi2_quantile(SCALING_PROBABILITY, self.dof) / self.dof if self.dof > 0 else None

    def to_dict(self) -> dict[str, Any]:
        """All numbers, in types that JSON has."""
        groups = {"by_station": self.by_station, "by_type": self.by_type, "by_path": self.by_path}
        return {
            **self.total.to_dict(),
            "chi2": self.chi2,
            "dof": self.dof,
            "chi2_per_dof": self.chi2_per_dof,
            "chi2_per_dof_bound": self.chi2_per_dof_bound,
            "excess_noise_m": dict(self.excess_noise_m),
            "shared_noise_m": dict(self.shared_noise_m),
            "robust_scale": self.robust_scale,
            **{key: {group.label: group.to_dict() for group in items} for key, items in groups.items()},
        }


def without_figures(statuses: Labels) -> Labels:
    """Return reasons of rejections without the figures of single observations, such as elevations."""
    return Labels.coded([_FIGURES.sub("", text).rstrip() for text in statuses.texts], statuses.codes)


def read_only(values: ArrayLike) -> Floats:
    """Return a read-only array of floats; a copy unless the array is one already."""
    array = np.asarray(values, dtype=np.float64)
    if array.flags.writeable or not array.flags.owndata:
        array = array.copy()
        array.flags.writeable = False
    return array


def robust_scale(normalized: Floats, n_parameters: int) -> float:
    """Spread of normalized residuals about zero by the median absolute deviation; 0 of none."""
    n = len(normalized)
    if not n:
        return 0.0
    first = min(max(0, n_parameters - 1), n - 1)
    middle = first + (n - first) // 2
    pair = sorted({middle - (n - first + 1) % 2, middle})
    ordered = np.partition(np.abs(normalized), pair)
    return _MAD_TO_SIGMA * float(ordered[pair].mean())


def chi2_quantile(probability: float, dof: float) -> float:
    """Quantile of chi-square with some degrees of freedom."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * dof, probability))


def root_between(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Root of a function that has opposite signs at two arguments (Ridders 1979).

    Import of scipy.optimize would take 0.14 s, a tenth of a fit of laser ranges.
    """
    f_low, f_high, root = function(low), function(high), math.nan
    for _ in range(_MAX_ROOT_STEPS):
        middle = 0.5 * (low + high)
        f_middle = function(middle)
        previous, size = root, math.sqrt(f_middle**2 - f_low * f_high)
        if size == 0.0:
            return middle
        root = middle + (middle - low) * math.copysign(f_middle, f_middle * (f_low - f_high)) / size
        f_root = function(root)
        if abs(root - previous) <= tolerance or f_root == 0.0:
            return root
        if f_middle * f_root < 0.0:
            (low, f_low), (high, f_high) = sorted([(middle, f_middle), (root, f_root)])
        elif f_low * f_root < 0.0:
            high, f_high = root, f_root
        else:
            low, f_low = root, f_root
    raise ConvergenceError(f"no root of a function between {low:g} and {high:g} in {_MAX_ROOT_STEPS} steps")
