"""Messages of observers who only receive, as they write them, and differences of one-way measurements."""

import numpy as np
import pytest
from tdm_messages import DELAY, kvn

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io import FrequencyAgreement, read_observations
from radioloc.io.tdm import TdmAgreement, tdm_observations
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.time import utc_strings

COUNT = {"INTEGRATION_INTERVAL": "10.0", "INTEGRATION_REF": "MIDDLE"}
BEACON = FrequencyAgreement(transmit_hz=2216.5e6, sigma_hz=0.5)
# The form of messages of Artemis I: no frequency sent, no start, words of an older issue, a day as a date.
AMATEUR = """\
CCSDS_TDM_VERS = 2.0
COMMENT centre carrier integrated in 10s by 0.1Hz bin
CREATION_DATE = 2022-11-20Z
ORIGINATOR = AN AMATEUR

META_START
COMMENT
SYSTEM TIME = UTC
PARTICIPANT_1 = COSPAR 8049
PARTICIPANT_2 = 2022-156A
MODE = SEQUENTIAL
PATH = 2,1
INTEGRATION_INTERVAL = 10
INTEGRATION_REF = MIDDLE
FREQ_OFFSET = 0
TRANSMIT_DELAY_1 = 0
RECEIVE_DELAY_1 = 0
DATA_QUALITY = RAW
META_STOP

DATA_START
RECEIVE_FREQ_1 =   2022-11-20T14:23:46.435   2216499795.745
RECEIVE_FREQ_1 =   2022-11-20T14:23:56.890   2216499794.845
RECEIVE_FREQ_1 =   2022-11-20T14:23:56.890   2216499794.8
RECEIVE_FREQ_1 =   2022-11-20T14:24:07.430   2216499794.045
DATA_STOP
"""
# Another observer's: a colon before the parts of a second, the path from the first participant.
TELESCOPE = """\
CCSDS_TDM_VERS = 2.0
CREATION_DATE = 2022-324T09:00:19
ORIGINATOR = A TELESCOPE
META_START
TIME_SYSTEM = UTC
START_TIME = 2022-323T12:30:01:000019
STOP_TIME = 2022-323T13:02:07:000019
PARTICIPANT_1 = Orion
PARTICIPANT_2 = DWINGELOO RADIO TELESCOPE
MODE = SEQUENTIAL
PATH = 1,2
INTEGRATION_INTERVAL = 1.0
INTEGRATION_REF = MIDDLE
FREQ_OFFSET = 2216000000
META_STOP
DATA_START
RECEIVE_FREQ_2  = 2022-323T12:30:01:500019 494443.000
DATA_STOP
"""


def read(*segments, **agreement):
    agreement = TdmAgreement(
        **{"sigma_m": dict.fromkeys(("differenced_range", "differenced_doppler"), 0.1)} | agreement
    )
    return tdm_observations(parse_kvn("a.kvn", kvn(*segments)), agreement).observations


def test_messages_of_several_observers(tmp_path):
    (tmp_path / "a.tdm").write_text(AMATEUR)
    (tmp_path / "b.tdm").write_text(TELESCOPE)
    files = sorted(tmp_path.glob("*.tdm"))
    with pytest.warns(DataQualityWarning, match=r"24:.*repeated.*23"):
        got = read_observations(files, frequencies=[BEACON])
    assert got.paths().tolist() == ["2022-156a>COSPAR 8049"] * 3 + ["orion>DWINGELOO RADIO TELESCOPE"]
    assert set(got.types()) == {"one_way_doppler"}
    assert got.count_s.tolist() == [10.0, 10.0, 10.0, 1.0]
    assert utc_strings(got.epoch, 6).tolist()[1:] == [
        "2022-11-20T14:23:56.890000",
        "2022-11-20T14:24:07.430000",
        "2022-11-19T12:30:01.500019",
    ]
    apart_hz = 2216.5e6 - np.array([2216499795.745, 2216499794.845, 2216499794.045, 2216494443.0])
    assert got.value_m == pytest.approx(C_M_S * got.count_s * apart_hz / 2216.5e6, abs=1e-6)
    assert got.sigma_m == pytest.approx(C_M_S * got.count_s * 0.5 / 2216.5e6, rel=1e-15)
    with pytest.raises(FileFormatError, match=r"TRANSMIT_FREQ_1.*Orion;.*transmit_hz"):
        read_observations(files[1:])


def test_three_way_doppler_with_an_agreed_transmitter(tmp_path):
    """The message says that the spacecraft sends; that it answers a station is known from elsewhere."""
    (tmp_path / "a.tdm").write_text(
        AMATEUR.replace("2022-11-20T14:23:56.890   2216499794.8\n", "2022-11-20T14:24:00 2216499794.8\n")
    )
    sent_hz = 2216.5e6 * 221 / 240
    uplink = FrequencyAgreement(sent_hz, 0.5, transmitter="ks", turnaround=(240, 221))
    got = read_observations(tmp_path / "a.tdm", frequencies=[uplink], catalogue=StationCatalogue.default())
    assert set(got.paths()) == {"KASHI>2022-156a>COSPAR 8049"}
    assert set(got.types()) == {"doppler"}
    assert set(got.uplink_hz) == {sent_hz}
    assert got.value_m[0] == pytest.approx(C_M_S * 10.0 * 204.255 / 2216.5e6, abs=1e-5)


# Differences of two paths


def test_differenced_range():
    delays = {"RECEIVE_DELAY_2": "1e-6", "RECEIVE_DELAY_3": "3e-6", "RANGE_MODE": "ONE_WAY"}
    got = read((DELAY | delays, ["RANGE = 2021-03-28T14:00:00 -1234.5"]), range_convention="half")
    assert got.paths().tolist() == ["SESHAN25<lander>KUNMING"]
    assert got.types().tolist() == ["differenced_range"]
    assert got.value_m[0] == pytest.approx(-1234500.0 - C_M_S * 2e-6, abs=1e-9)
    # The tag is that of the first station's reception.
    assert utc_strings(got.epoch, 6).tolist() == ["2021-03-28T13:59:59.999999"]


def test_differenced_doppler():
    record = ["DOPPLER_INTEGRATED = 2021-03-28T14:00:00 0.25"]
    got = read((DELAY | COUNT, record), doppler_convention="half")
    assert got.types().tolist() == ["differenced_doppler"]
    assert got.value_m.tolist() == [2500.0]
    frequency = ["RECEIVE_FREQ = 2021-03-28T14:00:00 -7000.0"]
    got = read((DELAY | COUNT, frequency), frequencies=(FrequencyAgreement(8.4e9, 0.5),))
    assert got.value_m[0] == pytest.approx(10.0 * C_M_S * 7000.0 / 8.4e9, rel=1e-15)
    # Of two frequencies received.
    assert got.sigma_m[0] == pytest.approx(10.0 * C_M_S * 0.5 * np.sqrt(2.0) / 8.4e9, rel=1e-15)


def test_wavelength_of_a_delay_by_the_received_frequency():
    """With a known uplink, the target sends it times the ratio."""
    uplink = FrequencyAgreement(7.2e9, 0.5, transmitter="KASHI", turnaround=(880, 749))
    got = read(
        (DELAY, ["VLBI_DELAY = 2021-03-28T14:00:00 1e-3"]), sigma_m={"vlbi_delay": 0.1}, frequencies=(uplink,)
    )
    assert got.wavelength_um[0] == pytest.approx(1e6 * C_M_S * 749 / 880 / 7.2e9, rel=1e-15)
