"""UTC, TAI, TT, TDB and dates as text."""

import numpy as np
import pytest

from radioloc.errors import CoverageError, InputError
from radioloc.time import (
    Epochs,
    epochs_from_strings,
    tai_to_tt,
    tai_to_utc,
    to_scale,
    utc_strings,
    utc_to_tai,
    utc_to_tt,
)

# Last place of a fraction of a day, and one rounding more.
RESOLUTION_S = 2e-11

# TAI - UTC, s, from the dates given on (IERS Bulletin C).
TAI_MINUS_UTC = {
    "1972-01-01": 10,
    "1972-07-01": 11,
    "1999-01-01": 32,
    "2006-01-01": 33,
    "2012-07-01": 35,
    "2017-01-01": 37,
    "2024-05-01": 37,
}


@pytest.mark.parametrize(("date", "leap_s"), TAI_MINUS_UTC.items())
def test_tai_minus_utc(date, leap_s):
    tai = utc_to_tai(epochs_from_strings(date, "UTC"))
    assert tai.seconds_since(epochs_from_strings(date, "TAI")) == pytest.approx(leap_s, abs=RESOLUTION_S)
    assert utc_to_tt(epochs_from_strings(date, "UTC")).seconds_since(tai_to_tt(tai)) == 0.0
    tt = epochs_from_strings(date, "TT")
    assert utc_to_tt(epochs_from_strings(date, "UTC")).seconds_since(tt) == pytest.approx(
        leap_s + 32.184, abs=RESOLUTION_S
    )


def test_leap_second_is_one_second_long():
    dates = ["2016-12-31T23:59:59", "2016-12-31T23:59:60", "2016-12-31T23:59:60.75", "2017-01-01T00:00:00"]
    utc = epochs_from_strings(dates, "UTC")
    tai = utc_to_tai(utc)
    since = tai.seconds_since(utc_to_tai(epochs_from_strings([dates[0]] * 4, "UTC")))
    assert since == pytest.approx([0.0, 1.0, 1.75, 2.0], abs=RESOLUTION_S)
    assert utc_strings(utc, 2).tolist() == [f"{d}.00" if "." not in d else d for d in dates]
    back = tai_to_utc(tai)
    assert utc_strings(back, 3).tolist() == [f"{d[:19]}.{d[20:] or '0':0<3}" for d in dates]
    assert utc_strings(epochs_from_strings("2016-12-31T23:59:60.9999999999", "UTC")).tolist() == [
        "2017-01-01T00:00:00.000000000"
    ]


def test_the_same_date_in_several_forms():
    converted = epochs_from_strings(
        ["2020-12-01T15:11:00.25", "2020-336T15:11:00.25Z", "2020-12-01 15:11:00.250"], "UTC"
    )
    assert np.unique(converted.jd).tolist() == [2459184.5]
    assert np.unique(converted.fraction).tolist() == [(15 * 3600 + 11 * 60 + 0.25) / 86400.0]
    short = epochs_from_strings(["2020-12-01T15:11", "2020-336T15:11:00."], "UTC")
    assert np.unique(short.fraction).tolist() == [(15 * 3600 + 11 * 60) / 86400.0]
    assert epochs_from_strings("2020-336", "UTC").fraction.tolist() == [0.0]
    assert epochs_from_strings("2020-366", "UTC").day_strings().tolist() == ["2020-12-31"]


def test_only_utc_has_leap_seconds():
    for scale in ("TAI", "TT", "TDB"):
        with pytest.raises(InputError, match="not a leap second"):
            epochs_from_strings("2016-12-31T23:59:60", scale)


@pytest.mark.parametrize("convert", [utc_to_tai, utc_to_tt])
def test_utc_before_1972_is_refused(convert):
    epochs = epochs_from_strings(["1980-01-01", "1971-12-31T23:59:59"], "UTC")
    with pytest.raises(CoverageError, match="got 1971-12-31") as caught:
        convert(epochs)
    assert caught.value.covered[0] == "1972-01-01"
    convert(epochs_from_strings("1972-01-01", "UTC"))


def test_tai_before_1972_cannot_become_utc():
    with pytest.raises(CoverageError, match="1971"):
        tai_to_utc(epochs_from_strings("1971-12-31T12:00:00", "TAI"))
    with pytest.raises(CoverageError, match="1969-07-20"):
        to_scale(epochs_from_strings("1969-07-20T20:18:00", "TT"), "UTC")


def test_ut1_cannot_become_utc_without_earth_orientation():
    with pytest.raises(InputError, match="without Earth orientation"):
        to_scale(Epochs.from_jd(2459185.5, 0.0, "UT1"), "UTC")


def test_decimals_are_rounded_and_bounded():
    utc = epochs_from_strings("2020-12-31T23:59:59.999999999", "UTC")
    assert utc_strings(utc, 0).tolist() == ["2021-01-01T00:00:00"]
    assert utc_strings(utc).tolist() == ["2020-12-31T23:59:59.999999999"]
    for decimals in (-1, 10, 12):
        with pytest.raises(InputError, match="0 to 9"):
            utc_strings(utc, decimals)
