"""Mapping functions of radio waves against published values."""

import numpy as np
import pytest
from mappings import continued_fraction, height_correction, niell, vmf3

from radioloc.media.mapping_functions import day_of_year, mapping_factors, vmf3_bc
from radioloc.time import Epochs

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


# MJD and nanoseconds of the day; latitude, longitude (rad), height (m), zenith distance (rad), a hydrostatic and wet;
# the mapping factors. One case more, at 0.2 degrees of elevation, is left out.
VMF3_HT = [
    (49910, 63840313720400, -1.00655839762322463, -1.269846006397008953, 829.89198810515767946, 1.479746892873592401,
     0.0035730098695386462, 0.00031829758849169666, 8.121899082072079779, 10.634685859837416544),
    (47252, 85454786300822, -0.99961005735638530645, -1.535559624731509754, 2024.084328148853274, 1.009382911196702981,
     0.00331715125402642485, 0.00027656306962914589, 1.863182725958604902, 1.877041709129812608),
    (52573, 45968822588632, -0.72809675130317486058, 0.64657972158758836301, 1200.012802389383296, 0.19754704707866258,
     0.01632044127182305515, 0.00169622903295432812, 1.019183700146594207, 1.019765815866078063),
    (60309, 74895554286777, -0.14342150316881907557, 0.99219874199870705667, 1009.329529676551374, 0.20592471138694496,
     0.01885650717138715252, 0.00140194053314290413, 1.020764741499591288, 1.021521453423524184),
    (47176, 14428517423314, -1.431123073339695573, -1.370891390550610600, 2814.832308724194263, 1.087097112141426569,
     0.01096636564494461036, 0.00085074300404099242, 2.070552000134979309, 2.143713817670696020),
    (56552, 37377501566196, -0.02487747751083047021, -1.121328613609578362, 1504.494626368838226, 0.5248185955983596,
     0.01387855180187660617, 0.00148759202241975056, 1.150282489685982013, 1.154941832791583911),
    (58950, 21841862341063, -0.71993925109076728486, 2.006684850039577306, 1679.095786525634594, 1.134205624740412421,
     0.00282556259640217352, 0.00077474758675946903, 2.335588285645833206, 2.356581845331821245),
    (45303, 22580717394152, 0.82448949290365325382, -1.808616383037678377, 83.82284862202868680, 0.33307940529340013258,
     0.00631341240425861532, 0.00151078488330494485, 1.057366695324877037, 1.057965731514443508),
    (59043, 40460378009873, 1.279793938551734733, -1.585092092504545969, 1146.666449912136841, 0.36094074669212516948,
     0.00280761457543542235, 0.00167577124632660316, 1.068453283432329703, 1.068618772173420828),
]  # fmt: skip


@pytest.mark.parametrize("case", VMF3_HT, ids=lambda case: str(case[0]))
def test_vmf3_ht_in_octave(case: tuple[float, ...]) -> None:
    """Results of vmf3_ht.m of TU Wien in Octave for random input, published with the library iers2010 (xanthospap).

    Its coefficients a are up to ten times what air can have, which the readers of its files refuse.
    """
    mjd, day_ns, latitude, longitude, height_m, zenith_distance, a_h, a_w, hydrostatic, wet = case
    day = day_of_year(Epochs.from_jd(2400000.5 + mjd, day_ns * 1e-9 / 86400.0, "UTC"))
    b_h, b_w, c_h, c_w = vmf3_bc(latitude, longitude, day)
    elevation_rad = np.pi / 2 - zenith_distance
    factors = mapping_factors(elevation_rad, height_m, (a_h, b_h, c_h), (a_w, b_w, c_w))
    np.testing.assert_allclose(factors.hydrostatic, [hydrostatic], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(factors.wet, [wet], rtol=0.0, atol=1e-12)
