"""Mapping functions of radio waves against published values."""

import numpy as np
import pytest

from radioloc.earth.mapping_functions import continued_fraction, height_correction, niell
from radioloc.earth.vmf3 import vmf3

GREEN_BANK_LATITUDE_RAD = 0.6708665767
GREEN_BANK_MJD = 55055.0
GREEN_BANK_ELEVATION_RAD = np.pi / 2 - 1.278564131

MAPPING = 1e-14
"""Rounding of a mapping function near 4."""


def vmf1_bc(mjd: float, latitude_rad: float) -> tuple[float, float, float, float]:
    """B and c of VMF1, northern hemisphere (IERS Conventions 2010, section 9.2, with the file VMF1.F)."""
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


GRAZ_ELEVATIONS_DEG = (30.0, 10.0, 5.0)


@pytest.mark.parametrize(
    ("hydrostatic_a", "wet_a", "height_m", "hydrostatic", "wet"),
    [
        (0.00120480, 0.00058178, 0.0, (1.9929, 5.5575, 10.1579), (1.9965, 5.6568, 10.7460)),
        (0.00121094, 0.00053970, 538.30, (1.9929, 5.5586, 10.1638), (1.9968, 5.6640, 10.7955)),
    ],
)
def test_vmf3_at_graz(
    hydrostatic_a: float,
    wet_a: float,
    height_m: float,
    hydrostatic: tuple[float, ...],
    wet: tuple[float, ...],
) -> None:
    """Printed by vmf3.m and vmf3_ht.m of TU Wien for 2024-01-01, with a of the file of sites and of GPT3."""
    factors = vmf3(
        np.deg2rad(GRAZ_ELEVATIONS_DEG),
        hydrostatic_a,
        wet_a,
        np.deg2rad(47.0671),
        np.deg2rad(15.4935),
        1.0,
        height_m,
    )
    np.testing.assert_allclose(factors.hydrostatic, hydrostatic, rtol=0.0, atol=5e-5)
    np.testing.assert_allclose(factors.wet, wet, rtol=0.0, atol=5e-5)


@pytest.mark.parametrize(
    ("hydrostatic_a", "wet_a", "latitude_deg", "longitude_deg", "day", "elevation_deg", "hydrostatic", "wet"),
    [
        (0.00127683, 0.00060955, 38.4, 280.0, 223.5, 15.0, 3.798573498079678, 3.8317942899906696),
        (0.00121, 0.0004, -30.0, 149.6, 196.5, 5.0, 10.157384072638775, 10.965122378181029),
        (0.00118, 0.00055, -89.0, 10.0, 364.5, 10.0, 5.561766292285158, 5.662004821124551),
        (0.00115, 0.0004, 65.0, -147.0, 14.5, 3.0, 14.873454470935258, 17.14691742885985),
    ],
)
def test_vmf3_against_orekit(
    hydrostatic_a: float,
    wet_a: float,
    latitude_deg: float,
    longitude_deg: float,
    day: float,
    elevation_deg: float,
    hydrostatic: float,
    wet: float,
) -> None:
    """ViennaThree of Orekit 13.1, for which noon of 1 January is day 1."""
    factors = vmf3(
        np.deg2rad(elevation_deg),
        hydrostatic_a,
        wet_a,
        np.deg2rad(latitude_deg),
        np.deg2rad(longitude_deg),
        day,
        0.0,
    )
    # Rounding of a mapping function near 16 through sums of 182 harmonics.
    np.testing.assert_allclose(factors.hydrostatic, hydrostatic, rtol=0.0, atol=10.0 * MAPPING)
    np.testing.assert_allclose(factors.wet, wet, rtol=0.0, atol=10.0 * MAPPING)
