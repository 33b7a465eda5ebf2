"""Normal points: dense observations condensed to one for each link and interval.

Residuals r from a prediction change slowly, so that a straight line r = a + b t represents those of an interval. A
normal point is the prediction at its epoch plus the value of the line there. The epoch is the middle of the interval.
Where the slope of the line would add more than a twentieth to the variance, it is the nearest tenth of the interval, or
else the mean epoch of the observations. Delays of baselines with equal sampling thus have common epochs. Outliers are
rejected by their distance from the median of the interval.

The sums of an interval are additive. Observations can therefore be read and condensed in parts, one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.estimation.editing import THRESHOLD
from radioloc.estimation.statistics import robust_scale
from radioloc.labels import changed, distinct
from radioloc.measurements.observations import Observations
from radioloc.time import Epochs, tai_to_utc, utc_to_tai
from radioloc.vectors import Floats, Indices

CURVATURE_PER_S2 = 3.3e-12
"""Largest departure of residuals from a line, over the distance of the a-priori position and the interval squared."""

_KEYS = ("file", "link", "kind", "tag", "wavelength_um", "uplink_hz")  # equal within a normal point
_MAX_LEVER = 0.05  # part of the variance that the slope of the line adds; 2.5 % of sigma
_MIN_TESTED_COUNT = 3  # of two observations, none is the median


@dataclass(frozen=True, slots=True, eq=False)
class IntervalSums:
    """Sums over the residuals of g normal points."""

    observations: Observations  # one of each
    number: Indices  # (g,), of the interval since J2000
    # (g, 5), of w, w t, w t^2, w r and w r t, with weights w and times t since the middle of the interval
    sums: Floats

    @classmethod
    def concatenate(cls, parts: Sequence[IntervalSums]) -> IntervalSums:
        """Join sums, and add those of the same normal point."""
        observations = Observations.concatenate([part.observations for part in parts])
        number, sums = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("number", "sums")
        )
        order, starts = _groups(observations, number)
        rows = order[starts]
        return cls(observations.select(rows), number[rows], np.add.reduceat(sums[order], starts))

    @property
    def shared_count(self) -> int:
        """Number of intervals of one link and type with observations of several files."""
        items = self.observations
        keys = np.stack([self.number, items.link, items.kind, items.file], axis=1)
        of_links, of_files = (len(distinct(rows)[0]) for rows in (keys[:, :3], keys))
        return of_files - of_links

    def points(self, interval_s: float) -> tuple[Observations, Floats]:
        """Return normal points whose values are still to be predicted, and their residuals, m, shape (g,)."""
        weight, *means = self.sums.T
        t, t2, r, rt = (mean / weight for mean in means)
        variance_s2 = np.maximum(t2 - t**2, 0.0)
        tenth_s = 0.1 * interval_s
        point_s = t.copy()
        for choice_s in (tenth_s * np.rint(t / tenth_s), 0.0):
            point_s = np.where((choice_s - t) ** 2 < _MAX_LEVER * variance_s2, choice_s, point_s)
        slope, lever = np.zeros_like(t), np.zeros_like(t)
        np.divide(rt - r * t, variance_s2, out=slope, where=point_s != t)
        np.divide((point_s - t) ** 2, variance_s2, out=lever, where=point_s != t)
        day, second_s = np.divmod((self.number + 0.5) * interval_s + point_s, SECONDS_PER_DAY)
        epoch = Epochs.from_jd(J2000_JD + day, second_s / SECONDS_PER_DAY, "TAI")
        points = replace(self.observations, epoch=tai_to_utc(epoch), sigma_m=np.sqrt((1.0 + lever) / weight))
        order = np.lexsort((points.link, self.number))
        return points.select(order), (r + slope * (point_s - t))[order]


_REFERENCE = Epochs(np.array([J2000_JD]), np.zeros(1), "TAI")


def interval_sums(
    observations: Observations, residual_m: Floats, interval_s: float
) -> tuple[IntervalSums, int]:
    """Return the sums of observations by their residuals (n,), m, and the number of outliers rejected."""
    since_s = utc_to_tai(observations.epoch).seconds_since(_REFERENCE)
    number = np.floor(since_s / interval_s).astype(np.int64)
    order, starts = _groups(observations, number, residual_m)
    counts = np.diff(starts, append=len(order))
    middle = order[starts + counts // 2]
    deviation_m = np.abs(residual_m[order] - np.repeat(residual_m[middle], counts))
    deviation_m[np.repeat(counts < _MIN_TESTED_COUNT, counts)] = 0.0
    series = changed(observations.link[order], observations.kind[order])
    parts = np.split(deviation_m / observations.sigma_m[order], np.flatnonzero(series)[1:])
    # The deviations of medians, and of intervals that are not tested, are zero.
    limits = [THRESHOLD * max(1.0, robust_scale(part[part > 0.0], 0)) for part in parts]
    is_used = np.concatenate([part <= limit for part, limit in zip(parts, limits, strict=True)])
    rows, group = order[is_used], np.repeat(np.arange(len(starts)), counts)[is_used]
    t = since_s[rows] - (number[rows] + 0.5) * interval_s
    weight, r = observations.sigma_m[rows] ** -2.0, residual_m[rows]
    columns = (weight, weight * t, weight * t**2, weight * r, weight * r * t)
    sums = np.stack(
        [np.bincount(group, column, len(starts)).astype(np.float64) for column in columns], axis=1
    )
    return IntervalSums(observations.select(middle), number[middle], sums), int((~is_used).sum())


def _groups(observations: Observations, number: Indices, *within: Floats) -> tuple[Indices, Indices]:
    """Return rows in order of normal points, and the start of each of these; in each, in order of `within`."""
    keys = [np.nan_to_num(getattr(observations, name)) for name in _KEYS]
    keys = [number, *(key for key in keys if (key != key[:1]).any())]
    order = np.lexsort((*within, *keys))
    return order, np.flatnonzero(changed(*(key[order] for key in keys)))
