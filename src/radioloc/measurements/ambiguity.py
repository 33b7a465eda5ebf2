"""Resolution of ambiguous ranges by predicted ranges.

The period M of a ranging code makes the light path ambiguous by multiples of c M. The multiple nearest to the predicted
range is correct if the error of the prediction is below half of the modulus. The limit is a quarter, so that the next
multiple is at least three times as far.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.vectors import Floats

MAX_DISTANCE_FRACTION = 0.25  # largest distance from the nearest multiple, as a fraction of the modulus
MAX_OUTLIER_FRACTION = 0.1  # of ranges beyond that distance: gross errors, which editing rejects


def without_ambiguity(observations: Observations, expected_m: Floats) -> Observations:
    """Return the observations with ambiguities resolved by the expected values, m (NaN for other observations)."""
    turns = np.rint((expected_m - observations.value_m) / observations.modulus_m)
    value_m = observations.value_m + np.nan_to_num(turns) * np.nan_to_num(observations.modulus_m)
    part = abs(value_m - expected_m) / observations.modulus_m
    is_ambiguous = np.isfinite(part)
    is_distant = is_ambiguous & (part > MAX_DISTANCE_FRACTION)
    if is_distant.sum() > MAX_OUTLIER_FRACTION * is_ambiguous.sum():
        row = int(np.argmax(is_distant))
        raise InputError(
            f"{observations.origin(row)}: the ambiguity of {observations.modulus_m[row]:.6g} m cannot be resolved: the "
            f"nearest range differs by {abs(value_m - expected_m)[row]:.6g} m from the prediction, "
            f"{is_distant.sum()} of {is_ambiguous.sum()} ranges by more than a quarter of the modulus; improve the "
            "a-priori position or trajectory, or exclude these ranges"
        )
    return replace(observations, value_m=value_m, modulus_m=np.full(len(observations), np.nan))
