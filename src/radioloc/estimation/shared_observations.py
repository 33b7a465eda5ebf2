"""A sample of the observations of a solution, by which solutions of the same data are recognised.

The content decides, not the file: the same ranges as CSV, CRD, TDM or Parquet are the same information, and two halves
of a file are not. Rows are chosen by a hash of their epoch alone, so that solutions with common observations choose
common ones, whatever else they use.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.statistics import Residuals
from radioloc.vectors import Floats

MAX_SAMPLE_COUNT = 128  # but for the same epoch; of 3 % in common, one is found in 98 % of cases
_JD_2000 = 2451544.5
_HASH_FACTOR = 2654435761  # 2^32 divided by the golden ratio (Knuth 1998, section 6.4)
_EPOCH_TOLERANCE_S = 1e-3  # formats round to milliseconds
_ROUNDING_SIGMAS, _ROUNDING_M = 0.02, 2e-4  # light times to 1 ps, ranges to a part of their sigma
_MIN_OFFSET_COUNT = 8  # observations that tell a constant difference of calibration from noise
_MIN_SERIES_COUNT = 3  # observations by which a single series decides


@dataclass(frozen=True, slots=True, eq=False)
class SampledSeries:
    """Sampled observations of one path, type and count interval."""

    path: str
    type: str
    count_s: float | None  # None of types that count nothing
    sigma_m: float  # median
    utc_s: Floats  # (m,), UTC, seconds of days of 86400 s since 2000-01-01
    observed_m: Floats  # (m,)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> SampledSeries:
        """Return the series that ``solution.json`` has as one of its ``observations``."""
        utc_s, observed_m = (np.array(content[key], dtype=np.float64) for key in ("utc_s", "observed_m"))
        if utc_s.shape != observed_m.shape or utc_s.ndim != 1:
            raise ValueError
        count_s = content["count_s"]
        return cls(
            str(content["path"]),
            str(content["type"]),
            None if count_s is None else float(count_s),
            float(content["sigma_m"]),
            utc_s,
            observed_m,
        )

    @property
    def stations(self) -> tuple[str, str, bool]:
        """The stations of the path, and whether it is a baseline; files have the target under several names."""
        first, *_, last = ["", *re.split("[<>]", self.path)][-3:]
        return first, last, "<" in self.path


def residual_sample(residuals: Residuals) -> list[dict[str, Any]]:
    """Return the sampled series of the observations that a fit used, in types that JSON has."""
    rows = np.flatnonzero(residuals.used)
    epoch = residuals.epoch_utc[rows]
    utc_s = ((epoch.jd - _JD_2000) + epoch.fraction) * SECONDS_PER_DAY
    hashed = (np.rint(1e3 * utc_s).astype(np.int64).astype(np.uint64) * np.uint64(_HASH_FACTOR)) % np.uint64(
        2**32
    )
    if len(rows) > MAX_SAMPLE_COUNT:
        largest = np.partition(hashed, MAX_SAMPLE_COUNT - 1)[MAX_SAMPLE_COUNT - 1]
        chosen = np.flatnonzero(hashed <= largest)[: 8 * MAX_SAMPLE_COUNT]
        rows, utc_s = rows[chosen], utc_s[chosen]
    sampled = residuals.select(rows)
    count_s = np.full(len(rows), np.nan) if sampled.count_s is None else sampled.count_s
    groups: dict[tuple[str, str, float | None], list[int]] = {}
    for k, (path, kind, count) in enumerate(zip(sampled.path, sampled.type, count_s.tolist(), strict=True)):
        groups.setdefault((str(path), str(kind), None if np.isnan(count) else count), []).append(k)
    return [
        {
            "path": path,
            "type": kind,
            "count_s": count,
            "sigma_m": float(f"{np.median(sampled.sigma_m[members]):.3g}"),
            "utc_s": utc_s[members].round(4).tolist(),
            "observed_m": sampled.observed_m[members].round(4).tolist(),
        }
        for (path, kind, count), members in groups.items()
    ]


def share_observations(first_sample: Iterable[SampledSeries], second_sample: Sequence[SampledSeries]) -> bool:
    """Return whether most sampled observations of one path, type and epoch have the same values in both."""
    # Values may differ by a constant in each series, as another calibration adds. Counts of another length over the
    # same time are of the same cycles.
    totals = np.zeros(2, dtype=np.int64)
    for first in first_sample:
        for second in second_sample:
            if (first.stations, first.type) != (second.stations, second.type):
                continue
            separation_s = np.abs(first.utc_s[:, None] - second.utc_s)
            counts_s = (first.count_s or 0.0), (second.count_s or 0.0)
            if abs(counts_s[0] - counts_s[1]) > 1e-6 * max(counts_s):
                if (separation_s < 0.5 * abs(counts_s[0] - counts_s[1])).any():
                    return True
                continue
            is_simultaneous = separation_s <= _EPOCH_TOLERANCE_S
            rows = is_simultaneous.any(axis=1)
            difference_m = np.where(is_simultaneous, first.observed_m[:, None] - second.observed_m, np.inf)[
                rows
            ]
            closest_m = np.take_along_axis(
                difference_m, np.abs(difference_m).argmin(axis=1, keepdims=True), axis=1
            )
            if len(closest_m) >= _MIN_OFFSET_COUNT:
                closest_m -= np.median(closest_m)
            allowed_m = _ROUNDING_SIGMAS * min(first.sigma_m, second.sigma_m) + _ROUNDING_M
            equal_count, count = int((np.abs(closest_m) <= allowed_m).sum()), len(closest_m)
            if count >= _MIN_SERIES_COUNT and 2 * equal_count > count:
                return True
            totals += equal_count, count
    return bool(2 * totals[0] > totals[1])
