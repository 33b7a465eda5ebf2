"""Ambiguous ranges, known up to multiples of a modulus: which multiple, is told by the range that is expected.

A ranging code that repeats after M leaves the light path ambiguous by multiples of c M. The multiple that comes
nearest to the predicted range is right if the prediction is good to half of the modulus. Up to a quarter is
allowed, so that the next multiple is three times as far off or more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.vectors import Floats

MAX_DISTANCE_FRACTION = 0.25  # largest distance from the nearest multiple, as a fraction of the modulus
MAX_OUTLIER_FRACTION = 0.1  # of the ranges, beyond that distance: gross errors, which editing rejects


def without_ambiguity(observations: Observations, expected_m: Floats) -> Observations:
    """Return the observations with ambiguous ranges in full, next to the expected values, m (NaN where unknown)."""
    turns = np.rint((expected_m - observations.value_m) / observations.modulus_m)
    value_m = observations.value_m + np.nan_to_num(turns) * np.nan_to_num(observations.modulus_m)
    part = abs(value_m - expected_m) / observations.modulus_m
    known = np.isfinite(part)
    far = known & (part > MAX_DISTANCE_FRACTION)
    if far.sum() > MAX_OUTLIER_FRACTION * known.sum():
        row = int(np.argmax(far))
        raise InputError(
            f"{observations.origin(row)}: the range is ambiguous by multiples of {observations.modulus_m[row]:.6g} m, "
            f"and the nearest is {abs(value_m - expected_m)[row]:.6g} m from what the target's a-priori position or "
            f"trajectory makes of it ({far.sum()} of {known.sum()} such ranges are more than a quarter of that off); "
            "give a better one, or leave these ranges out"
        )
    return replace(observations, value_m=value_m, modulus_m=np.full(len(observations), np.nan))
