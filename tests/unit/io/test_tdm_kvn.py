"""KVN messages: what is read, and that each way of being wrong is one clear error that names the line."""

import numpy as np
import pytest
from tdm_messages import RANGES, THREE_WAY, TWO_WAY, kvn

from radioloc.errors import FileFormatError
from radioloc.io.tdm import kvn as tdm_kvn
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.io.tdm.message import read_records
from radioloc.time import epochs_from_strings, tai_to_utc, to_scale, utc_to_tai


def read(*segments, **options):
    return parse_kvn("a.kvn", kvn(*segments, **options))


def test_header_metadata_and_records():
    lines = kvn((THREE_WAY | {"RANGE_UNITS": "KM", "PATH": "1, 2, 3"}, ["COMMENT on data", "", *RANGES]))
    lines[1:1] = ["COMMENT  two words ", "COMMENT"]
    message = parse_kvn("a.kvn", lines)
    assert message.header.comments == ("two words", "")
    assert message.header.originator == "TEST"
    (segment,) = message.segments
    assert segment.metadata["RANGE_UNITS"] == "km"
    assert segment.metadata["PATH"] == "1,2,3"
    assert segment.data_comments == ("on data",)
    assert segment.counts() == {"RANGE": 2}
    # Kilometres become metres in the decimal number, not in the float.
    assert segment.value.tolist() == [768800123.4567, 768801500.0]
    assert [lines[n - 1] for n in segment.line] == RANGES
    assert lines[segment.line_of("MODE") - 1] == "MODE = SEQUENTIAL"
    assert len(message) == 2


@pytest.mark.parametrize("keyword", ["SYSTEM TIME", "TIME SYSTEM"])
def test_time_system_as_some_files_have_it(keyword):
    lines = [line.replace("TIME_SYSTEM = UTC", f"{keyword} = TAI") for line in kvn((TWO_WAY, RANGES))]
    (segment,) = parse_kvn("a.kvn", lines).segments
    assert segment.metadata["TIME_SYSTEM"] == "TAI"


@pytest.mark.parametrize("chunk", [1, 2, 3, 100])
def test_chunks_join_seamlessly(chunk, monkeypatch):
    records = [f"RANGE = 2021-03-28T14:00:{i:02d} {768800 + i}.5" for i in range(7)]
    records[3:3] = ["", "COMMENT between"]
    monkeypatch.setattr(tdm_kvn, "_BLOCK_LINES", chunk)
    lines = kvn((TWO_WAY, records))
    (segment,) = parse_kvn("a.kvn", lines).segments
    assert segment.value.tolist() == [768800500.0 + 1000.0 * i for i in range(7)]
    assert [lines[n - 1] for n in segment.line] == [r for r in records if r.startswith("RANGE")]
    assert segment.data_comments == ("between",)


def test_own_exponents_of_values():
    units = {"MODE": "SEQUENTIAL", "RANGE_UNITS": "s"}
    values = ["1.25E+00", "125e-2", "+1.25", "0001.25"]
    records = [f"RANGE = 2021-03-28T14:00:0{i} {value}" for i, value in enumerate(values)]
    assert read((TWO_WAY | units, records)).segments[0].value.tolist() == [1.25] * 4
    assert read((TWO_WAY, records)).segments[0].value.tolist() == [1250.0] * 4
    percent = ["RHUMIDITY = 2021-03-28T14:00:00 4.5e1"]
    assert read((TWO_WAY, percent)).segments[0].value.tolist() == [0.45]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"TIME_SYSTEM": None}, "TIME_SYSTEM"),
        ({"TIME_SYSTEM": "SCLK"}, "TIME_SYSTEM"),
        ({"PATH": "1,2,4"}, "participant 4"),
        ({"RANGE_UNITS": "m"}, "RANGE_UNITS"),
        ({"INTEGRATION_INTERVAL": "0"}, "INTEGRATION_INTERVAL"),
        ({"RECEIVE_DELAY_1": "1_0"}, "RECEIVE_DELAY_1"),
        ({"CORRECTION_RANGE": "1.0"}, "CORRECTIONS_APPLIED"),
        ({"START_TIME": "2021-02-30T00:00:00"}, "START_TIME: .* not a date that exists"),
        ({"PARTICIPANT_6": "X"}, "PARTICIPANT_6"),
    ],
)
def test_wrong_metadata(change, problem):
    with pytest.raises(FileFormatError, match=problem) as caught:
        read((TWO_WAY | change, RANGES))
    lines = kvn((TWO_WAY | change, RANGES))
    named = lines[caught.value.line - 1]
    assert named.split(" =")[0] in (*change, "TIME_SYSTEM", "META_START", "PARTICIPANT_1")


def test_mixed_time_systems():
    with pytest.raises(FileFormatError, match="one time system"):
        read((TWO_WAY, RANGES), (TWO_WAY | {"TIME_SYSTEM": "TAI"}, RANGES))


@pytest.mark.parametrize(
    ("record", "problem"),
    [
        ("RANGE = 2021-03-28T14:02:00 NaN", "NaN"),
        ("RANGE = 2021-03-28T14:02:00", "record keyword"),
        ("range = 2021-03-28T14:02:00 1.0", "data keyword"),
        ("RANGE = 2021-02-29T14:02:00 1.0", "not a date that exists"),
        ("RANGE = 2021-03-28T14:01:00 768805.0", "repeats the epoch"),
        ("RANGE = 2021-03-28T14:00:59.9 768805.0", "precedes"),
        ("RANGE = 2021-03-28T14:02:00 ٣.0", "printable ASCII"),
    ],
)
def test_wrong_record(record, problem):
    lines = kvn((TWO_WAY, [*RANGES, record]))
    with pytest.raises(FileFormatError, match=problem) as caught:
        parse_kvn("a.kvn", lines)
    assert lines[caught.value.line - 1] == record


def test_order_of_data_that_nothing_needs_does_not_matter():
    angles = ["ANGLE_1 = 2021-03-28T14:01:00 1.0", "ANGLE_1 = 2021-03-28T14:00:00 1.0"]
    assert len(read((TWO_WAY, [*RANGES, *angles]))) == 4


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda lines: lines[:-1], "expected DATA_STOP"),
        (lambda lines: [line for line in lines if "RANGE" not in line], "expected records"),
        (lambda lines: [line for line in lines if "ORIGINATOR" not in line], "ORIGINATOR is missing"),
        (lambda lines: ["CCSDS_TDM_VERS = 3.0", *lines[1:]], "CCSDS_TDM_VERS"),
        (lambda lines: [*lines[:2], "AUTHOR = X", *lines[2:]], "AUTHOR"),
        (lambda lines: [*lines[:4], "what is this", *lines[4:]], "expected keyword = value"),
        (lambda lines: [*lines[:1], "CREATION_DATE = soon", *lines[2:]], "CREATION_DATE: 'soon' is not a"),
    ],
)
def test_wrong_structure(change, problem):
    with pytest.raises(FileFormatError, match=problem):
        parse_kvn("a.kvn", change(kvn((TWO_WAY, RANGES))))


# A float of the day's fraction resolves 1e-11 s; a change of scale adds a few of these.
EPOCH_TOLERANCE_S = 3e-11
GPS_EPOCH_UTC = "1980-01-06T00:00:00"  # GPS time and UTC agree here (IS-GPS-200)


def utc(texts, time_system="UTC"):
    n = len(texts)
    line = np.arange(1, n + 1, dtype=np.int32)
    keywords = ["RANGE"] * n
    return read_records("a", keywords, texts, ["1"] * n, line, time_system=time_system, range_units="s")[1]


def seconds_apart(first, second):
    return np.abs(utc_to_tai(first).seconds_since(utc_to_tai(second)))


def test_other_time_systems():
    text = "2021-03-28T14:00:00.123456"
    expected = {
        "TAI": tai_to_utc(epochs_from_strings(text, "TAI")),
        "TT": to_scale(epochs_from_strings(text, "TT"), "UTC"),
        "TDB": to_scale(epochs_from_strings(text, "TDB"), "UTC"),
    }
    for system, expected_utc in expected.items():
        assert seconds_apart(utc([text], system), expected_utc).max() < EPOCH_TOLERANCE_S
    assert (
        seconds_apart(utc([GPS_EPOCH_UTC], "GPS"), epochs_from_strings(GPS_EPOCH_UTC, "UTC")).max()
        < EPOCH_TOLERANCE_S
    )
    # 18 leap seconds since then.
    later = seconds_apart(utc([text], "GPS"), epochs_from_strings(text, "UTC"))
    assert np.abs(later - 18.0).max() < EPOCH_TOLERANCE_S


def test_zulu_contradicts_another_time_system():
    with pytest.raises(FileFormatError, match=r"TIME_SYSTEM is TAI"):
        utc(["2021-03-28T14:00:00", "2021-03-28T14:00:01Z"], "TAI")
