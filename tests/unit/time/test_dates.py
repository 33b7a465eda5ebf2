"""UTC in bulk: to the last bit, and over leap seconds."""

from datetime import datetime
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radioloc.errors import InputError
from radioloc.time import Epochs, epochs_from_strings
from radioloc.time.dates import DateError, day_lengths_s, utc_from_seconds_of_day, utc_from_text, utc_to_text

JD_2016_12_31 = 2457753.5


def test_day_lengths():
    assert day_lengths_s(np.array([JD_2016_12_31 + 1, JD_2016_12_31, JD_2016_12_31 - 1])).tolist() == [
        86400.0,
        86401.0,
        86400.0,
    ]
    with pytest.raises(InputError, match="1971-12-31 is before 1972"):
        day_lengths_s(np.array([2441316.5]))


@given(second=st.integers(0, 86400), picosecond=st.integers(0, 10**12 - 1), leap=st.booleans())
def test_text_gives_the_nearest_float_and_comes_back(second, picosecond, leap):
    day, length = ("2016-12-31", 86401) if leap else ("2016-12-30", 86400)
    second = min(second, length - 1)
    hour, minute = min(second // 3600, 23), min(second // 60, 1439) % 60
    second_of_minute = second - 3600 * hour - 60 * minute
    text = f"{day}T{hour:02d}:{minute:02d}:{second_of_minute:02d}.{picosecond:012d}"
    epoch = utc_from_text([text])
    exact = (second + Fraction(picosecond, 10**12)) / length
    if exact < 1 - 2.0**-53:
        ulps = abs(Fraction(float(epoch.fraction[0])) - exact) / Fraction(float(np.spacing(float(exact))))
        # The part of a second is divided on its own, which rounds it twice: it counts where the whole seconds are few.
        part = Fraction(picosecond, 10**12)
        assert ulps <= (Fraction(1, 2) + 2 * part / second if second > 0 else 2)
    assert utc_from_text(utc_to_text(epoch)).fraction[0] == pytest.approx(epoch.fraction[0], abs=2.3e-16)


def test_picoseconds_survive_in_the_morning():
    text = "2024-05-13T00:00:01.123456789012"
    assert utc_to_text(utc_from_text([text])).tolist() == [text]


def test_known_texts():
    epochs = Epochs.from_jd([JD_2016_12_31, JD_2016_12_31, JD_2016_12_31], [0.0, 86400.5 / 86401, 0.5], "UTC")
    assert utc_to_text(epochs).tolist() == [
        "2016-12-31T00:00:00.000000000000",
        "2016-12-31T23:59:60.500000000000",
        "2016-12-31T12:00:00.500000000000",
    ]
    last = Epochs.from_jd(2460000.5, 1.0 - 2.0**-53, "UTC")
    assert utc_to_text(last).tolist() == ["2023-02-25T23:59:59.999999999990"]
    with pytest.raises(InputError, match="UTC"):
        utc_to_text(Epochs.from_jd(2460000.5, 0.0, "TT"))


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.datetimes(max_value=datetime(9998, 12, 31)), st.text("0123456789", max_size=30)),
        min_size=1,
        max_size=5,
    )
)
def test_dates_with_any_number_of_decimals(days):
    texts = [f"{day:%Y-%m-%dT%H:%M:%S}".zfill(19) + (f".{part}" if part else "") for day, part in days]
    if any(day.year < 1972 for day, _ in days):
        with pytest.raises(InputError, match="before 1972"):
            utc_from_text(texts)
        return
    read = utc_from_text(texts)
    for k, (day, part) in enumerate(days):
        second = 3600 * day.hour + 60 * day.minute + day.second + Fraction(int(part or 0), 10 ** len(part))
        length = Fraction(int(day_lengths_s(read.jd[k : k + 1])[0]))
        if read.fraction[k] == 0.0:
            continue  # the second of midnight, or what rounds to the next
        assert abs(Fraction(float(read.fraction[k])) * length - second) < Fraction(1, 10**11)


def test_leap_seconds():
    texts = [
        "2016-12-31T23:59:60.5",
        "2016-12-31T23:59:59.999999999",
        "1972-06-30T23:59:60",
        "2017-01-01T00:00:00",
    ]
    exact = [
        (86400 + Fraction(1, 2)) / 86401,
        (86400 - Fraction(1, 10**9)) / 86401,
        Fraction(86400, 86401),
        0,
    ]
    assert utc_from_text(texts).fraction.tolist() == [float(fraction) for fraction in exact]


@pytest.mark.parametrize(
    "text",
    [
        *(
            "2021-02-29",
            "2020-02-30T00:00:00",
            "2020-13-01",
            "2020-00-10",
            "2021-01-00",
            "2019-366",
            "2020-367",
        ),
        *("2016-12-30T23:59:60.5", "2016-12-31T12:00:60", "2016-12-31T22:59:60", "2016-12-31T23:59:61"),
        *("", "2020-1-1", "2020-12-01T15", "20201201", "2020-12-01T15:11:00+01:00", "２021-02-28", "2" * 100),
    ],
)
def test_dates_that_do_not_exist_are_refused(text):
    with pytest.raises(DateError, match=r"not a date|not a time|not a leap second") as caught:
        utc_from_text(["2021-02-28T00:00:00", text])
    assert caught.value.row == 1
    with pytest.raises(InputError):
        epochs_from_strings(text, "UTC")


def test_seconds_past_the_end_belong_to_the_next_day():
    jd = np.array([JD_2016_12_31, JD_2016_12_31, JD_2016_12_31 + 1])
    epochs = utc_from_seconds_of_day(jd, np.array([86400.0, 86401.0, 86401.0]))
    assert (epochs.jd - JD_2016_12_31).tolist() == [0.0, 1.0, 2.0]
    assert epochs.fraction.tolist() == [86400.0 / 86401.0, 0.0, 1.0 / 86400.0]
