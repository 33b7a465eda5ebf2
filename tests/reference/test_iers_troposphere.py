"""Optical troposphere against the test cases printed with the software of the IERS Conventions (2010)."""

import numpy as np

from radioloc.media.neutral_atmosphere import mapping_function, zenith_delay_m

LATITUDE_RAD = np.deg2rad(30.67166667)
"""McDonald Observatory."""

MAPPING = 1e-14
"""Rounding of a mapping function near 4."""

ZENITH_M = 1e-10
"""The printed wet delay differs from the published equations by 9e-11 m, the hydrostatic one by 2e-12 m."""


def test_mapping_function() -> None:
    """Header of FCUL_A.F."""
    mapping, _ = mapping_function(np.deg2rad(15.0), 300.15, LATITUDE_RAD, 2075.0)
    np.testing.assert_allclose(mapping, 3.800243667312344087, rtol=0.0, atol=MAPPING)


def test_zenith_delay() -> None:
    """Header of FCUL_ZD_HPA.F, which says 2010.344 m, but whose printed delays are those at 2003.344 m.

    They differ by 4 micrometres.
    """
    hydrostatic_m, wet_m = zenith_delay_m(798.4188, 14.322, 0.532, LATITUDE_RAD, 2003.344)
    np.testing.assert_allclose(hydrostatic_m, 1.932992176591644462, rtol=0.0, atol=ZENITH_M)
    np.testing.assert_allclose(wet_m, 0.002233748255158703871, rtol=0.0, atol=ZENITH_M)
    hydrostatic_m, _ = zenith_delay_m(798.4188, 14.322, 0.532, LATITUDE_RAD, 2010.344)
    np.testing.assert_allclose(hydrostatic_m, 1.932992176591644462, rtol=0.0, atol=4e-6)
