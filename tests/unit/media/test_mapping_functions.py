"""Derivatives of the mapping functions; their values are tested in reference/test_iers_mapping.py."""

import numpy as np
import pytest
from mappings import niell, vmf3

from radioloc.media.mapping_functions import day_of_year
from radioloc.time import epochs_from_strings

GOLDSTONE_RAD = np.deg2rad([35.4, -116.9])
MAPPINGS = {
    "niell": lambda elevation: niell(elevation, GOLDSTONE_RAD[0], 1000.0, 276.0),
    "vmf3": lambda elevation: vmf3(elevation, 1.22e-3, 5.5e-4, *GOLDSTONE_RAD, 276.0, 1000.0),
}


@pytest.mark.parametrize("elevation_deg", [3.001, 6.0, 20.0, 85.0])
@pytest.mark.parametrize("mapping", MAPPINGS.values(), ids=MAPPINGS)
def test_rates_are_the_derivatives(mapping, elevation_deg: float) -> None:
    elevation, step = np.deg2rad(elevation_deg), 1e-6
    value, ahead, behind = (mapping(elevation + k * step) for k in (0, 1, -1))
    for name in ("hydrostatic", "wet"):
        difference = (getattr(ahead, name) - getattr(behind, name)) / (2.0 * step)
        # Rounding of a number near 15 over 2e-6, and at 3 degrees the third derivative of 1e6 times 1e-12 / 6.
        np.testing.assert_allclose(getattr(value, f"{name}_rate_rad"), difference, rtol=1e-9, atol=5e-9)


def test_day_of_year() -> None:
    epochs = epochs_from_strings(
        ["2021-01-01T00:00:00", "2020-03-01T12:00:00", "2020-12-31T18:00:00", "2021-12-31"], "TT"
    )
    np.testing.assert_array_equal(day_of_year(epochs), [1.0, 61.5, 366.75, 365.0])
