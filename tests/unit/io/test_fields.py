"""Fields in bulk: what Python reads one by one, to the last bit, or left to Python."""

from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radioloc.errors import InputError
from radioloc.io.dates import utc_from_fields, utc_from_text
from radioloc.io.field_numbers import floats
from radioloc.io.fields import Fields, NotPlainError, TextCodes

# Deeper than rounding: the same 64 bits.
BITS = np.int64


def column(*texts):
    return Fields("".join(f"{text}\n" for text in texts).encode(), 1)


def assert_as_python(texts):
    read = floats(column(*texts), 0)
    np.testing.assert_array_equal(read.view(BITS), np.array([float(text) for text in texts]).view(BITS))


@given(st.lists(st.floats(allow_nan=False), min_size=1), st.integers(0, 20))
def test_numbers_of_any_size_and_length(values, decimals):
    assert_as_python([repr(value) for value in values])
    assert_as_python([f"{value:.{decimals}e}" for value in values])
    assert_as_python([f"{value:.{decimals}f}" for value in values])


@given(st.text("0123456789.eE+-", min_size=1, max_size=25))
def test_any_characters_of_numbers(text):
    try:
        float(text)
    except ValueError:
        with pytest.raises(ValueError, match="could not convert"):
            floats(column("1.5", text), 0)
    else:
        assert_as_python(["1.5", text])


def test_half_way_between_two_floats():
    getcontext().prec = 60
    texts = []
    for value in np.random.default_rng(3).uniform(2.0**49, 2.0**53, 300).tolist():
        middle = (Decimal(value) + Decimal(float(np.nextafter(value, np.inf)))) / 2
        texts += [format(middle, "f"), format(middle, "f") + "1", str(middle.next_minus())[:20]]
    assert_as_python(texts)


@pytest.mark.parametrize("text", ["", "-", "e5", "1e", "1e+", "1.2.3", "1e5.5", "1_0", "٣", "1 2", "--5"])
def test_what_is_no_number(text):
    with pytest.raises(ValueError, match="could not convert"):
        floats(column("1.5", text), 0)


def test_empty_fields_and_spaces():
    fields = Fields(b" 1.5 ,, 2\n, -3e2,4\n", 3)
    np.testing.assert_array_equal(floats(fields, 0, optional=True), [1.5, np.nan])
    np.testing.assert_array_equal(floats(fields, 1, optional=True), [np.nan, -300.0])
    np.testing.assert_array_equal(floats(fields, 2), [2.0, 4.0])


@pytest.mark.parametrize("text", [b"a,b\nc\n", b"a\nb,c,d\n", b'a,"b"\n', b"a,b,c\nd\n"])
def test_lines_that_are_not_plain(text):
    with pytest.raises(NotPlainError):
        Fields(text, 2)


def test_texts_are_numbered_as_they_come_from_block_to_block():
    codes = TextCodes()
    long = "station with a long name>target>Ł"
    assert codes.codes(Fields(f"b,1\na,2\nb,3\n{long},4\n".encode(), 2), 0).tolist() == [0, 1, 0, 2]
    assert codes.codes(Fields(f"{long},1\nc,2\na,3\n".encode(), 2), 0).tolist() == [2, 3, 1]
    assert codes.texts == ["b", "a", long, "c"]


@given(st.lists(st.tuples(st.datetimes(), st.text("0123456789", max_size=18)), min_size=1, max_size=5))
def test_dates(days):
    texts = [f"{day:%Y-%m-%dT%H:%M:%S}".zfill(19) + (f".{part}" if part else "") for day, part in days]
    try:
        read = utc_from_fields(column(*texts), 0)
    except ValueError:
        assert any(day.year < 1972 or len(part) > 15 for day, part in days)
        return
    expected = utc_from_text(texts)
    np.testing.assert_array_equal(read.jd, expected.jd)
    np.testing.assert_array_equal(read.fraction.view(BITS), expected.fraction.view(BITS))


@pytest.mark.parametrize(
    "text",
    [
        "2021-02-29T00:00:00",
        "2021-13-01T00:00:00",
        "2021-00-01T00:00:00",
        "2021-01-00T00:00:00",
        "2021-02-28T24:00:00",
        "2021-02-28T00:60:00",
        "2021-02-28T00:00:60",
        "2021-02-28T00:00:0x",
        "2021-02-28T00:00:00x1",
        "2021-02-28T00:00:00.1x",
        "2021/02/28T00:00:00",
        "1971-12-31T00:00:00",
        "2020-060T12:00:00",
        "now",
        "",
    ],
)
def test_dates_that_are_left_to_the_slow_way(text):
    with pytest.raises(NotPlainError):
        utc_from_fields(column("2021-02-28T00:00:00Z", text), 0)


def test_leap_seconds():
    texts = [
        "2016-12-31T23:59:60.5",
        "2016-12-31T23:59:59.999999999",
        "1972-06-30T23:59:60",
        "2017-01-01T00:00:00",
    ]
    read = utc_from_fields(column(*texts), 0)
    exact = [
        (86400 + Fraction(1, 2)) / 86401,
        (86400 - Fraction(1, 10**9)) / 86401,
        Fraction(86400, 86401),
        0,
    ]
    assert read.fraction.tolist() == [float(fraction) for fraction in exact]
    np.testing.assert_array_equal(utc_from_text(texts).fraction, read.fraction)
    with pytest.raises(NotPlainError):
        utc_from_fields(column("2016-12-30T23:59:60.5"), 0)
    with pytest.raises(NotPlainError):
        utc_from_fields(column("2016-12-31T12:00:60"), 0)
    with pytest.raises(InputError, match="leap second"):
        utc_from_text(["2016-12-30T23:59:60.5"])
