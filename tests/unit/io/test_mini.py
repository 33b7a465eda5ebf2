"""The old MINI layout, column by column."""

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError
from radioloc.io.mini import parse_mini
from radioloc.time import utc_strings


def changed(lines, first, last, text):
    """Lines with columns first to last (from 1) of the second one replaced."""
    line = lines[1]
    return [lines[0], line[: first - 1] + text + line[last:], *lines[2:]]


def test_columns_of_a_normal_point(mini_lines):
    read = parse_mini("a.np", mini_lines, None)
    assert len(read) == 3
    assert read.paths().tolist() == ["7045>apollo15>7045", "7045>apollo11>7045", "7045>luna21>7045"]
    assert read.line.tolist() == [1, 2, 3]
    dates = [
        "2006-04-07T06:26:30.000000000",
        "2006-12-01T00:26:55.000000000",
        "2007-03-03T07:40:30.000000000",
    ]
    assert utc_strings(read.epoch).tolist() == dates
    assert read.value_m.tolist() == [C_M_S * t for t in (2.6494326499837, 2.4053617732419, 2.6246951655405)]
    assert read.sigma_m == pytest.approx([C_M_S * s for s in (53.8e-12, 47.4e-12, 72.7e-12)], rel=1e-14)
    assert read.pressure_hpa.tolist() == [721.60, 724.83, 721.54]
    assert read.temperature_k.tolist() == [273.95, 265.05, 264.75]
    assert read.relative_humidity.tolist() == [0.33, 0.26, 0.38]
    assert read.wavelength_um.tolist() == [0.532, 0.532, 0.532]
    assert set(read.tags()) == {"transmit"}


def test_weather_left_blank_is_not_recorded(mini_lines):
    read = parse_mini("a.np", changed(mini_lines, 57, 73, " " * 17), None)
    for column in (read.pressure_hpa, read.temperature_k, read.relative_humidity, read.wavelength_um):
        assert np.isnan(column).tolist() == [False, True, False]
    assert np.isnan(parse_mini("a.np", changed(mini_lines, 57, 62, "     0"), None).pressure_hpa[1])


@pytest.mark.parametrize(
    ("first", "last", "text", "words"),
    [
        (1, 2, "52", "record type '52'"),
        (13, 14, "6x", "date and time"),
        (38, 38, "5", "reflector .*, got 5"),
        (47, 52, "     0", "sigma_m"),
        (69, 73, "  1e3", "wavelength"),
    ],
)
def test_unusable_lines_are_refused_with_their_number(mini_lines, first, last, text, words):
    with pytest.raises(FileFormatError, match=words) as caught:
        parse_mini("a.np", changed(mini_lines, first, last, text), None)
    assert caught.value.line == 2


def test_a_day_with_a_leap_second_has_second_60(mini_lines):
    stamp = "200812312359600000000"
    read = parse_mini("a.np", changed(mini_lines, 3, 23, stamp), None)
    assert utc_strings(read.epoch, decimals=3)[1] == "2008-12-31T23:59:60.000"
