"""Small files of each format; real normal points of the ILRS (APOLLO, Grasse) and of APOLLO (MINI)."""

import pytest
from reader_cases import CRD, MINI

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
