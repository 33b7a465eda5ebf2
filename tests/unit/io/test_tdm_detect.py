"""Messages among other files of observations, read as one."""

import gzip

import pytest
from tdm_messages import RANGES, TWO_WAY, kvn, xml

from radioloc.constants import C_M_S
from radioloc.earth import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.formats import read_observations
from radioloc.io.tdm import TdmAgreement, read_tdm, read_tdm_file

AGREEMENT = TdmAgreement(sigma_m={"range": 2.0}, turnaround=(880, 749))
TABLE = (
    "epoch_utc,type,path,observed_m,sigma_m,time_tag\n"
    "2021-03-28T15:00:00,range,KASHI>lander>KASHI,7.688e8,1,receive\n"
)
UPLINK = ["TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 7.2e9"]


@pytest.fixture
def files(tmp_path):
    texts = {
        "table": TABLE,
        "ranges.kvn": "\r\n".join(kvn((TWO_WAY, RANGES[:1]))),
        "more.xml": xml((TWO_WAY, RANGES[1:]), prefix="ndm:"),
        "uplink.tdm": "\n".join(kvn((TWO_WAY, UPLINK))),
    }
    paths = []
    for name, text in texts.items():
        paths.append(tmp_path / name)
        paths[-1].write_bytes(gzip.compress(text.encode()) if name == "more.xml" else text.encode())
    return paths


def test_messages_take_the_place_of_the_first(files):
    read = read_observations(files, tdm=AGREEMENT)
    assert read.value_m.tolist() == [7.688e8, 768800123.4567, 768801500.0]
    assert read.sigma_m.tolist() == [1.0, 2.0, 2.0]
    assert read.uplink_hz[1:].tolist() == [7.2e9] * 2
    assert read.wavelength_um[1:] == pytest.approx(1e6 * C_M_S / (7.2e9 * 880 / 749), rel=1e-15)
    assert [read.origin(i).split(", ")[0].rpartition("/")[2] for i in range(3)] == [
        "table",
        "ranges.kvn",
        "more.xml",
    ]
    turned = read_observations(files[::-1], tdm=AGREEMENT)
    assert turned.value_m.tolist() == [768801500.0, 768800123.4567, 7.688e8]


def test_a_station_need_not_be_known(files):
    read = read_observations(files[1], tdm=AGREEMENT, catalogue=StationCatalogue([]))
    assert read.paths().tolist() == ["KASHI>lander>KASHI"]


def test_read_tdm(files, tmp_path):
    assert len(read_tdm(str(files[1]), AGREEMENT)) == 1
    assert read_tdm(files[1:], AGREEMENT).files == tuple(str(file) for file in files[1:])
    with pytest.raises(InputError, match="at least one message"):
        read_tdm([], AGREEMENT)
    with pytest.raises(FileFormatError, match=r"CCSDS_TDM_VERS"):
        read_tdm_file(files[0])
    with pytest.raises(FileFormatError, match="no such file"):
        read_tdm_file(tmp_path / "none")
