"""Small files of each format; real normal points of the ILRS (APOLLO, Grasse) and of APOLLO (MINI)."""

import pytest

CRD = """\
H1 CRD  2 2024 09 03 15
H2 GRSM       7845 78  1  7 ILRS
H3 apollo15   0000103 0103 na 0 1 3
H4  1 2024 05 13 16 11 28 2024 05 13 17 01 47  0 0 0 0 1 0 2 0
H5  0 24 051100 OPA 6331
C0 0 532.100 me08 las5 det1 tim2 none nm01 met1 na
C1 0 las5 Nd-Yag 1064.20 10.00 150.00 150.0 5.00 1
20 58288.178257980457 871.95 287.25 63  0
40 58579.518409743439 0 me08 383 357 3.716 103371.0 317.0 64.2 0.154 -0.245 na 3 3 0 4 19.6
30 58591.933 170.2484 70.1426 0 2 0 0.0108740 0.0004620
11 58591.933300993282 2.581730448437 me08 2 582.0 40 253.2 -0.040 -0.300  na 0.7 0 3.1
20 59697.657519922454 871.85 287.45 64  0
11 59977.950832485437 2.582208383656 me08 2 590.0 85 202.8 0.046 -0.568  na 1.4 0 7.6
50 me08 236.4 0.272 -0.092 na 0
00 a comment with a sign that is not ASCII: ±
H8
h1 crd  2 2025  6 26 21
h2       APOL 7045 95  1  4       ILRS
h3 apollo11        100  100       na 0 1  3
h4  1 2024  4 12  2 15 23 2024  4 12  2 18 19  1 0 0 0 1 0 2 0
c0 0     532.0 std3 lpd apd4 cesm  na  na  na  na
11  8215.0000000 2.4614224083999 std3 2  176.0    147     180.2      na      na       na    na 0  43.0
20  8215.000  728.75 282.17   18 1
50 std3  180.2     na     na   na 1
h8
h9
"""

MINI = """\
512006 4 7 62630000000026494326499837370610 44   538 34B 72160   833 5320A 263A
51200612 1 02655000000024053617732419070610 39   474 11B 72483 -8126 5320A 495A
512007 3 3 74030000000026246951655405470610 39   727 19B 72154 -8438 5320A 499A
"""

TABLE = """\
# three light times
epoch_utc,type,path,light_time_s,sigma_s,time_tag,pressure_hpa,temperature_k,relative_humidity,wavelength_um
2006-04-07T06:26:30.0,range,APOLLO>apollo15>APOLLO,2.6494326499837,5.38e-11,transmit,721.6,273.95,0.33,0.532

2006-12-01T00:26:55,range,APOLLO>apollo11>APOLLO,2.4053617732419,4.74e-11,receive,,,,
2006-12-01T00:26:56Z,range,GRASSE>AP15>GRASSE,2.4053617732419,4.74e-11,bounce,,280.0,nan,0.532
"""


@pytest.fixture
def crd_lines():
    return CRD.split("\n")


@pytest.fixture
def mini_lines():
    return MINI.split("\n")


@pytest.fixture
def table_lines():
    return TABLE.split("\n")


@pytest.fixture
def texts():
    return {"crd": CRD, "mini": MINI, "table": TABLE}
