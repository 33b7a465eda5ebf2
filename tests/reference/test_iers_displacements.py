"""Displacements of stations against test cases printed with the software of the IERS Conventions (2010)."""

import numpy as np
import pytest

from radioloc.earth.blq import parse_blq
from radioloc.earth.ocean_loading import loading_enu_m, sum_of_tides
from radioloc.earth.solid_tide import solid_earth_tide
from radioloc.time import Epochs, epochs_from_strings, utc_to_tt

SOLID_TIDE_M = 1e-15
"""Rounding of the printed numbers, which have 17 digits."""

OCEAN_LOADING_M = 5.1e-7
"""The printed numbers have six decimals: half of the last."""

# Header of DEHANTTIDEINEL.F: date, station, Moon, Sun, displacement, m.
SOLID_TIDE_CASES = [
    (
        "2009-04-13",
        (4075578.385, 931852.890, 4801570.154),
        (-179996231.920342, -312468450.131567, -169288918.592160),
        (137859926952.015, 54228127881.4350, 23509422341.6960),
        (0.07700420357108125891, 0.06304056321824967613, 0.05516568152597246810),
    ),
    (
        "2012-07-13",
        (1112189.660, -4842955.026, 3985352.284),
        (300396716.912, 243238281.451, 120548075.939),
        (-54537460436.2357, 130244288385.279, 56463429031.5996),
        (-0.02036831479592076, 0.056582547762259724, -0.07597679676871742),
    ),
    (
        "2015-07-15",
        (1112200.5696, -4842957.8511, 3985345.9122),
        (369817604.4348, 1897917.5258, 120804980.8284),
        (100210282451.6279, 103055630398.3160, 56855096480.4475),
        (0.0050957086917236384, 0.08286630259835287, -0.06366349254041896),
    ),
]


@pytest.mark.parametrize(("date", "station", "moon", "sun", "expected"), SOLID_TIDE_CASES)
def test_solid_earth_tide(date: str, station: tuple, moon: tuple, sun: tuple, expected: tuple) -> None:
    """The routine takes UTC for UT1, and so does this test; the cases are at midnight."""
    utc = epochs_from_strings(date, "UTC")
    displacement_m = solid_earth_tide(*np.array([[station], [moon], [sun]]), utc_to_tt(utc), utc.fraction)
    np.testing.assert_allclose(displacement_m[0], expected, rtol=0.0, atol=SOLID_TIDE_M)


def test_solid_earth_tide_of_all_cases_at_once() -> None:
    dates, stations, moons, suns, expected = (list(column) for column in zip(*SOLID_TIDE_CASES, strict=True))
    utc = epochs_from_strings(dates, "UTC")
    displacement_m = solid_earth_tide(*np.array([stations, moons, suns]), utc_to_tt(utc), utc.fraction)
    np.testing.assert_allclose(displacement_m, expected, rtol=0.0, atol=SOLID_TIDE_M)


# Header of HARDISP.F: coefficients of the ocean tide model CSR4.0, and displacement up, south and west, m,
# every hour from 2009-06-25T01:10:45.
BLQ = """\
  ONSALA
  .00352 .00123 .00080 .00032 .00187 .00112 .00063 .00003 .00082 .00044 .00037
  .00144 .00035 .00035 .00008 .00053 .00049 .00018 .00009 .00012 .00005 .00006
  .00086 .00023 .00023 .00006 .00029 .00028 .00010 .00007 .00004 .00002 .00001
   -64.7  -52.0  -96.2  -55.2  -58.8 -151.4  -65.6 -138.1    8.4    5.2    2.1
    85.5  114.5   56.5  113.6   99.4   19.1   94.1  -10.4 -167.4 -170.0 -177.7
   109.5  147.0   92.7  148.8   50.5  -55.1   36.4 -170.4  -15.0    2.3    5.2
  REYKJAVIK
  .02359 .01481 .00448 .00419 .00273 .00033 .00088 .00005 .00081 .00034 .00034
  .00514 .00280 .00089 .00078 .00106 .00074 .00035 .00018 .00004 .00001 .00003
  .00209 .00077 .00051 .00021 .00151 .00066 .00047 .00019 .00014 .00008 .00006
    78.5  102.3   76.3  104.1  -52.0 -160.4  -52.6 -128.0 -174.8 -175.7 -178.1
    54.2   93.8   38.9   96.9    2.3  -12.5    3.1  -31.6 -144.4 -122.6 -173.5
   156.2 -167.1  141.9 -164.9  155.9  178.7  155.6 -168.5  177.7  178.7  179.7
"""

UP_SOUTH_WEST_M = {
    "ONSALA": [
        (0.003094, -0.001538, -0.000895),
        (0.001812, -0.000950, -0.000193),
        (0.000218, -0.000248, 0.000421),
        (-0.001104, 0.000404, 0.000741),
        (-0.001668, 0.000863, 0.000646),
        (-0.001209, 0.001042, 0.000137),
        (0.000235, 0.000926, -0.000667),
        (0.002337, 0.000580, -0.001555),
        (0.004554, 0.000125, -0.002278),
        (0.006271, -0.000291, -0.002615),
        (0.006955, -0.000537, -0.002430),
        (0.006299, -0.000526, -0.001706),
        (0.004305, -0.000244, -0.000559),
        (0.001294, 0.000245, 0.000793),
        (-0.002163, 0.000819, 0.002075),
        (-0.005375, 0.001326, 0.003024),
        (-0.007695, 0.001622, 0.003448),
        (-0.008669, 0.001610, 0.003272),
        (-0.008143, 0.001262, 0.002557),
        (-0.006290, 0.000633, 0.001477),
        (-0.003566, -0.000155, 0.000282),
        (-0.000593, -0.000941, -0.000766),
        (0.001992, -0.001561, -0.001457),
        (0.003689, -0.001889, -0.001680),
    ],
    "REYKJAVIK": [
        (-0.005940, -0.001245, -0.000278),
        (0.013516, -0.001086, 0.003212),
        (0.029599, -0.000353, 0.005483),
        (0.038468, 0.000699, 0.005997),
        (0.038098, 0.001721, 0.004690),
        (0.028780, 0.002363, 0.001974),
        (0.013016, 0.002371, -0.001369),
        (-0.005124, 0.001653, -0.004390),
        (-0.021047, 0.000310, -0.006225),
        (-0.030799, -0.001383, -0.006313),
        (-0.032056, -0.003048, -0.004549),
        (-0.024698, -0.004288, -0.001314),
        (-0.010814, -0.004794, 0.002623),
        (0.005849, -0.004416, 0.006291),
        (0.020857, -0.003208, 0.008766),
        (0.030226, -0.001413, 0.009402),
        (0.031437, 0.000594, 0.007996),
        (0.024079, 0.002389, 0.004844),
        (0.009945, 0.003606, 0.000663),
        (-0.007426, 0.004022, -0.003581),
        (-0.023652, 0.003601, -0.006911),
        (-0.034618, 0.002505, -0.008585),
        (-0.037515, 0.001044, -0.008270),
        (-0.031544, -0.000402, -0.006125),
    ],
}


@pytest.mark.parametrize("site", ["ONSALA", "REYKJAVIK"])
def test_ocean_loading(site: str) -> None:
    """The program takes UTC for UT1, and so does this test."""
    seconds = 3600.0 + 645.0 + 3600.0 * np.arange(24)
    utc = Epochs.from_jd(epochs_from_strings("2009-06-25", "UTC").jd, seconds / 86400.0, "UTC")
    loading_m = loading_enu_m(parse_blq(BLQ, "hardisp.blq")[site])
    enu_m = sum_of_tides(loading_m, utc_to_tt(utc), utc.fraction)
    up_south_west_m = enu_m[:, [2, 1, 0]] * [1.0, -1.0, -1.0]
    np.testing.assert_allclose(up_south_west_m, UP_SOUTH_WEST_M[site], rtol=0.0, atol=OCEAN_LOADING_M)
