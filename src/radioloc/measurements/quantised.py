"""Readings rounded to multiples of a step, with a rounding error of step / sqrt(12)."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import DataQualityWarning
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS
from radioloc.vectors import Floats

_MIN_READING_COUNT = 10  # fewer differences may have a common divisor by chance
_MIN_CHANGE_COUNT = 5  # an outlier among equal readings changes the value twice
_SAMPLE_SIZE = 300  # readings of a series that determine the step
_MAX_UPLINK_COUNT = 200  # more frequencies vary from row to row
_TOLERANCE = 1e-3  # of multiples, relative to the smallest possible step


def common_step(values: Floats, min_step: float) -> float:
    """Return the largest step above `min_step` whose multiples are all differences of values, or 0 without one."""
    if len(values) < _MIN_READING_COUNT or not min_step > 0.0:
        return 0.0
    tolerance = max(_TOLERANCE * min_step, 16.0 * float(np.spacing(np.abs(values).max())))
    sample = values[np.unique(np.linspace(0, len(values) - 1, _SAMPLE_SIZE).astype(np.intp))]
    changes = np.abs(np.diff(sample))
    # Equal changes are a straight line, whose spacing is always a common divisor.
    if np.ptp(changes) <= tolerance or np.count_nonzero(changes > tolerance) < _MIN_CHANGE_COUNT:
        return 0.0
    differences = np.unique(changes[changes > tolerance]).tolist()
    step = differences[0]
    while step >= min_step:
        fitted, remainder = _fitted_step(step, differences, tolerance)
        if not remainder:
            multiples = (values - values[0]) / fitted
            return fitted if np.abs(multiples - np.rint(multiples)).max() * fitted <= 4.0 * tolerance else 0.0
        step = remainder  # Euclid's algorithm
    return 0.0


def _fitted_step(step: float, differences: list[float], tolerance: float) -> tuple[float, float]:
    """Fit a step to its multiples, from the smallest; return it and the first remainder above the tolerance, or 0."""
    for difference in differences:
        count = round(difference / step)
        remainder = abs(difference - count * step)
        if remainder > tolerance:
            return step, remainder
        if count:
            step = difference / count
    return step, 0.0


def with_rounding_in_sigmas(observations: Observations) -> Observations:
    """Raise the sigmas of rounded series to at least step / sqrt(12), with a warning.

    Without it, fits of Chang'e-5 ranges in steps of 100 m with sigmas of 1 m do not converge (test_quantised.py).
    """
    # A series has the same file, link, type, count interval and, with few frequencies, transmitted frequency.
    of_series = ("file", "link", "kind", "count_s")
    columns: list[NDArray[Any]] = [np.nan_to_num(getattr(observations, name)) for name in of_series]
    # Steps of a received frequency are steps of the value at a constant transmitted frequency.
    uplink_hz = np.nan_to_num(observations.uplink_hz)
    if len(uplink_hz) and np.ptp(uplink_hz) and len(np.unique(uplink_hz)) <= _MAX_UPLINK_COUNT:
        columns.append(uplink_hz)
    order = np.lexsort(columns)
    changes = np.any([np.diff(column[order]) != 0 for column in columns], axis=0)
    sigma_m = observations.sigma_m
    for rows in np.split(order, np.flatnonzero(changes) + 1):
        min_step_m = np.sqrt(12.0) * float(sigma_m[rows].min(initial=np.inf))
        step_m = common_step(observations.value_m[rows], min_step_m)
        if not step_m:
            continue
        rounding_m = step_m / np.sqrt(12.0)
        link, kind = observations.links[observations.link[rows[0]]], KINDS[observations.kind[rows[0]]]
        warnings.warn(
            f"{observations.origin(int(rows.min()))}: {kind} of {link.path}: {len(rows)} readings are multiples of "
            f"{step_m:.4g} m; their sigmas, from {sigma_m[rows].min():.3g} m on, become at least {rounding_m:.3g} m "
            "(step / sqrt(12))",
            DataQualityWarning,
            stacklevel=3,
        )
        raised_m = observations.sigma_m.copy() if sigma_m is observations.sigma_m else sigma_m
        raised_m[rows] = np.maximum(raised_m[rows], rounding_m)
        sigma_m = raised_m
    if sigma_m is observations.sigma_m:
        return observations
    sigma_m.flags.writeable = False
    return replace(observations, sigma_m=sigma_m)
