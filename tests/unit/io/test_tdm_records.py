"""Epochs of records in bulk: both forms of date, all time systems, to the last bit."""

import numpy as np
import pytest

from radioloc.errors import FileFormatError
from radioloc.io.tdm.message import read_records
from radioloc.time import epochs_from_strings, tai_to_utc, to_scale, utc_to_tai

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
