"""Epochs of records in bulk: both forms of date, all time systems, to the last bit."""

from datetime import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radioloc.errors import FileFormatError
from radioloc.io.tdm.message import read_records
from radioloc.time import epochs_from_strings, tai_to_utc, to_scale, utc_to_tai
from radioloc.time.dates import utc_from_text

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


def test_forms_of_one_date():
    texts = [
        "2020-12-31T15:11:00.250",
        "2020-12-31T15:11:00.250Z",
        "2020-366T15:11:00.25",
        "2020-366T15:11:00.250000000000000000Z",
    ]
    epoch = utc(texts)
    wanted = epochs_from_strings("2020-12-31T15:11:00.25")
    assert (epoch.jd == wanted.jd).all()
    assert (epoch.fraction == wanted.fraction).all()
    assert utc(["2020-12-31T15:11:00Z", "2020-366T15:11:00"]).fraction.tolist() == [54660 / 86400] * 2


@given(
    st.lists(
        st.tuples(
            st.datetimes(
                min_value=datetime(1973, 1, 1),
                max_value=datetime(2099, 12, 31),
            ),
            st.text("0123456789", max_size=6),
            st.booleans(),
        ),
        min_size=1,
        max_size=20,
    )
)
def test_agrees_with_dates_read_one_by_one(dates):
    texts, plain = [], []
    for date, more, by_day in dates:
        time = f"{date:%H:%M:%S}.{date.microsecond:06d}{more}"
        plain.append(f"{date:%Y-%m-%d}T{time}")
        texts.append(f"{date:%Y-%j}T{time}" if by_day else plain[-1])
    epoch, wanted = utc(texts), utc_from_text(plain)
    assert np.array_equal(epoch.jd, wanted.jd)
    assert np.array_equal(epoch.fraction, wanted.fraction)


def test_leap_second():
    epoch = utc(["2016-12-31T23:59:60.5", "2016-366T23:59:60.5"])
    before = utc(["2016-12-31T23:59:59.5"] * 2)
    assert np.abs(seconds_apart(epoch, before) - 1.0).max() < EPOCH_TOLERANCE_S
    for text in ("2016-12-31T22:59:60", "2016-12-30T23:59:60"):
        with pytest.raises(FileFormatError, match="no leap second then"):
            utc([text])
    with pytest.raises(FileFormatError, match="no leap second then in TAI"):
        utc(["2016-12-31T23:59:60"], "TAI")


def test_other_time_systems():
    text = "2021-03-28T14:00:00.123456"
    expected = {
        "TAI": tai_to_utc(epochs_from_strings(text, "TAI")),
        "TT": to_scale(epochs_from_strings(text, "TT"), "UTC"),
        "TDB": to_scale(epochs_from_strings(text, "TDB"), "UTC"),
    }
    for system, wanted in expected.items():
        assert seconds_apart(utc([text], system), wanted).max() < EPOCH_TOLERANCE_S
    assert (
        seconds_apart(utc([GPS_EPOCH_UTC], "GPS"), epochs_from_strings(GPS_EPOCH_UTC)).max()
        < EPOCH_TOLERANCE_S
    )
    # 18 leap seconds since then.
    later = seconds_apart(utc([text], "GPS"), epochs_from_strings(text))
    assert np.abs(later - 18.0).max() < EPOCH_TOLERANCE_S


def test_zulu_contradicts_another_time_system():
    with pytest.raises(
        FileFormatError, match=r"a, line 2: '.*Z' ends in Z, which says UTC, but TIME_SYSTEM is TAI"
    ):
        utc(["2021-03-28T14:00:00", "2021-03-28T14:00:01Z"], "TAI")


@pytest.mark.parametrize(
    "text",
    [
        "2021-13-01T00:00:00",
        "2021-00-01T00:00:00",
        "2021-04-31T00:00:00",
        "2021-04-00T00:00:00",
        "2021-000T00:00:00",
        "2021-366T00:00:00",
        "2021-04-01T24:00:00",
        "2021-04-01T00:60:00",
        "2021-04-01T00:00:61",
        "2021-04-01T00:00:00.5ZZ",
        "2021-04-01T00:00:00.5+1",
        "2021/04/01T00:00:00",
        "2021-04-01T00:00:0",
        "21-04-01T00:00:00",
        "2021-4-01T00:00:00",
        "Z",
        "2021-04-01T",
        "2021-091T",
    ],
)
def test_dates_that_are_none(text):
    good = "2021-04-01T00:00:00"
    with pytest.raises(FileFormatError, match="line 2"):
        utc([good, text, good])
    with pytest.raises(FileFormatError, match="line 1"):
        utc([text])
