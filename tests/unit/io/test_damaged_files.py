"""Whatever happens to a file, reading it gives observations or one of the library's errors, nothing else."""

import gzip
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from quick import some
from tdm_messages import DELAY, RANGES, THREE_WAY, TWO_WAY, kvn, xml

from radioloc.errors import DataQualityWarning, InputError
from radioloc.io.detect import read_observations
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
MESSAGES = {"kvn": "\n".join(kvn(*SEGMENTS)) + "\n", "xml": xml(*SEGMENTS)}
OTHERS = ["crd", "mini", "table"]
BEGINNINGS = [
    b"",
    b"\x1f\x8b",
    b"H1 CRD 2\n",
    b"512006 4 7",
    b"CCSDS_TDM_VERS = 2.0\n",
    b'<tdm version="2.0">',
]

# The damage is drawn inside the test; the file's content is the same for all examples.
# Characters that mean something in numbers, dates, paths, CSV, KVN or XML, and some that must not pass as digits.
CHARACTERS = st.one_of(st.sampled_from('0123456789 .,-+eEnaHTZ:=_<>/&;!?[]#"\n\r\t\x0b±٣²'), st.characters())
EXTREME = ["nan", "inf", "-1", "0", "1e999", "1e300", "-1e-999", "9" * 25, "na", "", "0x10", "1_0", "1e18"]
EXTREME += ["UTC", "2021-03-28T14:00:00"]


@pytest.fixture(params=[*OTHERS, *MESSAGES])
def damaged(request, tmp_path):
    """Text of a file, and how and where to read what becomes of it."""
    name = request.param
    if name in MESSAGES:
        text, read = MESSAGES[name], lambda path: read_tdm(path, AGREEMENT)
    else:
        text, read = request.getfixturevalue("texts")[name], read_observations
    return text, (read, tmp_path / "damaged")


def read_or_refuse(file, content):
    read, path = file
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            observations = read(path)
    except InputError as error:
        if path.name not in str(error):
            pytest.fail(f"the message does not name the file: {error}")
        return None
    assert len(observations) > 0
    assert np.isfinite(observations.value_m).all()
    assert (observations.sigma_m > 0.0).all()
    assert ((observations.epoch.fraction >= 0.0) & (observations.epoch.fraction < 1.0)).all()
    return observations


def test_undamaged(damaged):
    text, file = damaged
    assert len(read_or_refuse(file, text.encode())) >= 3


@given(data=st.data())
def test_characters_replaced_added_and_taken_away(damaged, data):
    text, file = damaged
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.sampled_from([0, 1, 1, 1, 2, 5, 40]))
        put = data.draw(st.text(CHARACTERS, max_size=3))
        text = text[:start] + put + text[start + length :]
    read_or_refuse(file, text.encode("utf-8", "surrogatepass"))


@given(data=st.data())
def test_lines_taken_away_repeated_and_moved(damaged, data):
    text, file = damaged
    lines = text.split("\n")
    places = st.integers(0, len(lines) - 1)
    chosen = [lines[i] for i in data.draw(st.lists(places, max_size=2 * len(lines)))]
    start, taken = data.draw(places), data.draw(st.sampled_from([0, 1, 2, 3, len(lines)]))
    read_or_refuse(file, "\n".join([*lines[:start], *chosen, *lines[start + taken :]]).encode())


@given(data=st.data())
def test_values_exchanged_for_extreme_ones(damaged, data):
    text, file = damaged
    lines = text.split("\n")
    number = data.draw(st.integers(0, len(lines) - 1))
    for separator in (",", "=", " ", ">"):
        fields = lines[number].split(separator)
        if len(fields) > 1 and data.draw(st.booleans()):
            place = data.draw(st.integers(0, len(fields) - 1))
            tail = "<" + fields[place].partition("<")[2] if "<" in fields[place] else ""
            fields[place] = data.draw(st.sampled_from(EXTREME)) + tail
            lines[number] = separator.join(fields)
    read_or_refuse(file, "\n".join(lines).encode())


@given(data=st.data())
def test_any_bytes(damaged, data):
    _, file = damaged
    start = data.draw(st.sampled_from(BEGINNINGS))
    read_or_refuse(file, start + data.draw(st.binary(max_size=200)))


@pytest.mark.parametrize("step", some([1, 13], [13]))
def test_cut_anywhere(damaged, step):
    text, file = damaged
    content = text.encode()
    whole = read_or_refuse(file, content)
    for end in range(0, len(content), step):
        part = read_or_refuse(file, content[:end])
        assert part is None or len(part) <= len(whole)
        # CRD and messages have end marks; KVN has one of each segment, and whole segments are a message.
        if text.startswith("H1"):
            assert part is None or len(part) == len(whole)
        elif text in MESSAGES.values():
            assert part is None or content[:end].rstrip().endswith((b"DATA_STOP", b"</tdm>"))
    zipped = gzip.compress(content)
    for end in range(0, len(zipped), 7 * step):
        assert read_or_refuse(file, zipped[:end]) is None
