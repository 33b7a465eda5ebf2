"""Readings that are whole multiples of a step: the rounding error is step / sqrt(12), whatever sigma is stated."""

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

_MIN_READINGS = 10  # a common divisor of fewer differences may be one by chance
_MIN_CHANGES = 5  # an outlier among equal readings changes the value twice
_SAMPLE = 300  # readings of a series from which the step is found
_MAX_UPLINKS = 200  # more of them are recorded row by row
_TOLERANCE = 1e-3  # of the smallest step in question, by which multiples may be off


def common_step(values: Floats, least: float) -> float:
    """Return the largest step above `least` of which all differences of values are multiples; 0 where there is none."""
    if len(values) < _MIN_READINGS or not least > 0.0:
        return 0.0
    tolerance = max(_TOLERANCE * least, 16.0 * float(np.spacing(np.abs(values).max())))
    sample = values[np.unique(np.linspace(0, len(values) - 1, _SAMPLE).astype(np.intp))]
    changes = np.abs(np.diff(sample))
    # Equal changes throughout are a straight line, of which any spacing is a common divisor.
    if np.ptp(changes) <= tolerance or np.count_nonzero(changes > tolerance) < _MIN_CHANGES:
        return 0.0
    differences = np.unique(changes[changes > tolerance]).tolist()
    step = differences[0]
    while step >= least:
        fitted, rest = _fitted_step(step, differences, tolerance)
        if not rest:
            multiples = (values - values[0]) / fitted
            return fitted if np.abs(multiples - np.rint(multiples)).max() * fitted <= 4.0 * tolerance else 0.0
        step = rest  # as in Euclid's algorithm
    return 0.0


def _fitted_step(step: float, differences: list[float], tolerance: float) -> tuple[float, float]:
    """Fit a step to multiples of it, the smallest first; and the remainder of the first that is none, or 0."""
    for difference in differences:
        count = round(difference / step)
        rest = abs(difference - count * step)
        if rest > tolerance:
            return step, rest
        if count:
            step = difference / count
    return step, 0.0


def with_rounding_in_sigmas(observations: Observations) -> Observations:
    """Raise the sigmas of series of readings to step / sqrt(12) where they are below, with a warning.

    Otherwise Chang'e-5's ranges in steps of 100 m, stated with 1 m, do not converge (test_quantised.py).
    """
    # A series is of one file, link, type, count interval and, where these are few, transmitted frequency.
    of_series = ("file", "link", "kind", "count_s")
    columns: list[NDArray[Any]] = [np.nan_to_num(getattr(observations, name)) for name in of_series]
    # Steps of a received frequency are those of the value under one transmitted frequency.
    uplink_hz = np.nan_to_num(observations.uplink_hz)
    if len(uplink_hz) and np.ptp(uplink_hz) and len(np.unique(uplink_hz)) <= _MAX_UPLINKS:
        columns.append(uplink_hz)
    order = np.lexsort(columns)
    changes = np.any([np.diff(column[order]) != 0 for column in columns], axis=0)
    sigma_m = observations.sigma_m
    for rows in np.split(order, np.flatnonzero(changes) + 1):
        least_m = np.sqrt(12.0) * float(sigma_m[rows].min(initial=np.inf))
        step_m = common_step(observations.value_m[rows], least_m)
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
