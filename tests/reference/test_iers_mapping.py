"""Mapping functions of radio waves against published values."""

import numpy as np
import pytest

from radioloc.earth.mapping_functions import continued_fraction, height_correction, niell

GREEN_BANK_LATITUDE_RAD = 0.6708665767
GREEN_BANK_MJD = 55055.0
GREEN_BANK_ELEVATION_RAD = np.pi / 2 - 1.278564131

MAPPING = 1e-14
"""Rounding of a mapping function near 4."""


def vmf1_bc(mjd: float, latitude_rad: float) -> tuple[float, float, float, float]:
    """B and c of VMF1, northern hemisphere (IERS Conventions 2010, eq. 9.15 and table 9.3)."""
    day = mjd - 44239.0 + 1.0 - 28.0
    season = (np.cos(2.0 * np.pi * day / 365.25) + 1.0) * 0.005 / 2.0 + 0.001
    return 0.0029, 0.062 + season * (1.0 - np.cos(latitude_rad)), 0.00146, 0.04391


@pytest.mark.parametrize(
    ("height_m", "hydrostatic"), [(0.0, 3.4243421227380706), (824.17, 3.4250880879725725)]
)
def test_continued_fraction_and_height_with_vmf1(height_m: float, hydrostatic: float) -> None:
    """Headers of VMF1.F and VMF1_HT.F of the IERS Conventions (2010)."""
    bh, ch, bw, cw = vmf1_bc(GREEN_BANK_MJD, GREEN_BANK_LATITUDE_RAD)
    mapping, _ = continued_fraction(GREEN_BANK_ELEVATION_RAD, 0.00127683, bh, ch)
    correction, _ = height_correction(GREEN_BANK_ELEVATION_RAD, height_m)
    np.testing.assert_allclose(mapping + correction, hydrostatic, rtol=0.0, atol=MAPPING)
    wet, _ = continued_fraction(GREEN_BANK_ELEVATION_RAD, 0.00060955, bw, cw)
    np.testing.assert_allclose(wet, 3.4482997146925722, rtol=0.0, atol=MAPPING)


def test_niell_in_a_course_on_gnss() -> None:
    """Mercier and Perosanz, Mesures GNSS: Le Mans, 5 degrees, 1 January 1994; two decimals."""
    factors = niell(np.deg2rad(5.0), np.deg2rad(48.0), 68.0, 1.0)
    assert factors.hydrostatic == pytest.approx(10.16, abs=0.005)
    assert factors.wet == pytest.approx(10.75, abs=0.005)


@pytest.mark.parametrize(
    ("latitude_deg", "height_m", "day", "elevation_deg", "hydrostatic", "wet"),
    [
        (48.0, 68.0, 0.5, 5.0, 10.156365302344026, 10.7475138675379),
        (35.4, 1000.0, 275.5, 10.0, 5.552166678937168, 5.6586436038934975),
        (5.0, 0.0, 59.5, 30.0, 1.9924738897521368, 1.9965493248581532),
        (-30.0, 390.0, 196.5, 15.0, 3.8001815130292433, 3.833998734144709),
        (-80.0, 2800.0, 364.5, 20.0, 2.898824358655014, 2.9104632906814003),
    ],
)
def test_niell_against_orekit(
    latitude_deg: float, height_m: float, day: float, elevation_deg: float, hydrostatic: float, wet: float
) -> None:
    """NiellMappingFunctionModel of Orekit 13.1, which counts noon of 1 January as day 1.

    In the south it shifts the seasons by 183 days, not 182.625: up to 2.7e-6 here.
    """
    factors = niell(np.deg2rad(elevation_deg), np.deg2rad(latitude_deg), height_m, day)
    tolerance = 3e-6 if latitude_deg < 0.0 else 4.0 * MAPPING
    np.testing.assert_allclose(factors.hydrostatic, hydrostatic, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(factors.wet, wet, rtol=0.0, atol=4.0 * MAPPING)


def test_niell_near_the_global_mapping_function() -> None:
    """Header of GMF.F of the IERS Conventions (2010), another model: within 0.2 mm of delay at 16.7 degrees."""
    factors = niell(GREEN_BANK_ELEVATION_RAD, GREEN_BANK_LATITUDE_RAD, 844.715, 224.0)
    assert factors.hydrostatic == pytest.approx(3.4252455193391387, abs=1e-4)
    assert factors.wet == pytest.approx(3.4495891161824193, abs=1e-4)
