"""Whatever happens to a message, reading it gives observations or one of the library's errors, nothing else."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from quick import some
from tdm_messages import DELAY, RANGES, THREE_WAY, TWO_WAY, kvn, xml

from radioloc.errors import DataQualityWarning, InputError
from radioloc.io.tdm import TdmAgreement, read_tdm

AGREEMENT = TdmAgreement(
    sigma_m={"range": 1.0, "vlbi_delay": 1.0, "doppler": 1.0}, turnaround=(880, 749), light_time_s=2.5644
)
COUNT = {"INTEGRATION_INTERVAL": "60.0", "INTEGRATION_REF": "START", "FREQ_OFFSET": "0.0"}
SEGMENTS = (
    (
        TWO_WAY | {"RANGE_MODULUS": "0.0", "RECEIVE_DELAY_1": "1e-6", "CORRECTIONS_APPLIED": "YES"},
        [*RANGES, "PRESSURE = 2021-03-28T14:00:00 870.5"],
    ),
    (
        THREE_WAY | COUNT,
        [
            "TRANSMIT_FREQ_1 = 2021-03-28T13:00:00 7.2e9",
            "TRANSMIT_FREQ_RATE_1 = 2021-03-28T13:00:00 0.5",
            "RECEIVE_FREQ_3 = 2021-087T14:00:00 8459278000.5",
        ],
    ),
    (DELAY, ["DOR = 2021-03-28T14:00:00 -1.5E-03"]),
    (
        {"TIME_SYSTEM": "UTC", "PARTICIPANT_1": "SESHAN25", "PARTICIPANT_2": "KUNMING"},
        ["CLOCK_BIAS = 2021-03-28T13:00:00 -4.59e-7", "CLOCK_DRIFT = 2021-03-28T13:00:00 1e-13"],
    ),
)
TEXTS = {"kvn": "\n".join(kvn(*SEGMENTS)) + "\n", "xml": xml(*SEGMENTS)}
# Characters that mean something in numbers, dates, KVN or XML, and some that must not pass as digits.
CHARACTERS = st.one_of(st.sampled_from("0123456789 .,-+eEnaTZ:=_<>/&;!?[]\n\r\t\x0b±٣²"), st.characters())
EXTREME = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e999",
    "1e300",
    "-1e-999",
    "9" * 25,
    "",
    "0x10",
    "1_0",
    "UTC",
    "2021-03-28T14:00:00",
]


@pytest.fixture(params=["kvn", "xml"])
def any_text(request):
    return TEXTS[request.param]


def read_or_refuse(path, content):
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            observations = read_tdm(path, AGREEMENT)
    except InputError as error:
        if path.name not in str(error):
            pytest.fail(f"the message does not name the file: {error}")
        return None
    assert len(observations) > 0
    assert np.isfinite(observations.value_m).all()
    assert ((observations.epoch.fraction >= 0.0) & (observations.epoch.fraction < 1.0)).all()
    return observations


def test_undamaged(any_text, tmp_path):
    assert len(read_or_refuse(tmp_path / "whole", any_text.encode())) == 4


@given(data=st.data())
def test_characters_replaced_added_and_taken_away(any_text, tmp_path, data):
    text = any_text
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.sampled_from([0, 1, 1, 1, 2, 5, 40]))
        put = data.draw(st.text(CHARACTERS, max_size=3))
        text = text[:start] + put + text[start + length :]
    read_or_refuse(tmp_path / "damaged", text.encode("utf-8", "surrogatepass"))


@given(data=st.data())
def test_lines_taken_away_repeated_and_moved(any_text, tmp_path, data):
    lines = any_text.split("\n")
    chosen = data.draw(st.lists(st.integers(0, len(lines) - 1), max_size=10))
    start = data.draw(st.integers(0, len(lines)))
    kept = lines[:start] + [lines[i] for i in chosen] + lines[start + data.draw(st.integers(0, 3)) :]
    read_or_refuse(tmp_path / "damaged", "\n".join(kept).encode())


@given(data=st.data())
def test_values_exchanged(any_text, tmp_path, data):
    lines = any_text.split("\n")
    number = data.draw(st.integers(0, len(lines) - 1))
    for separator in ("=", " ", ">"):
        fields = lines[number].split(separator)
        if len(fields) > 1 and data.draw(st.booleans()):
            place = data.draw(st.integers(0, len(fields) - 1))
            tail = "<" + fields[place].partition("<")[2] if "<" in fields[place] else ""
            fields[place] = data.draw(st.sampled_from(EXTREME)) + tail
            lines[number] = separator.join(fields)
    read_or_refuse(tmp_path / "damaged", "\n".join(lines).encode())


@given(
    content=st.binary(max_size=200),
    start=st.sampled_from([b"", b"CCSDS_TDM_VERS = 2.0\n", b'<tdm version="2.0">']),
)
def test_any_bytes(tmp_path, content, start):
    assert read_or_refuse(tmp_path / "damaged", start + content) is None


@pytest.mark.parametrize("step", some([1, 17], [17]))
def test_cut_anywhere(any_text, tmp_path, step):
    content = any_text.encode()
    for end in range(0, len(content), step):
        part = read_or_refuse(tmp_path / "cut", content[:end])
        # KVN has no end of its own: whole segments are a message.
        assert part is None or content[:end].rstrip().endswith((b"DATA_STOP", b"</tdm>"))
