"""CRD normal points: what each record gives, and that nothing which changes the numbers passes unseen."""

import math

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io.crd import parse_crd
from radioloc.measurements.registry import TIME_TAGS
from radioloc.time import epochs_from_strings, utc_to_tai

# One float of a second of day resolves 1.5e-11 s; the range changes by less than 1e3 m in a second.
EPOCH_TOLERANCE_S = 2e-11
FLIGHT_TOLERANCE_M = 1e-6  # ten times what one float of 7.7e8 m resolves


def seconds_apart(observations, texts):
    return np.abs(utc_to_tai(observations.epoch).seconds_since(utc_to_tai(epochs_from_strings(texts, "UTC"))))


def replaced(lines, old, new):
    """Lines with the first that contains a text changed, and the number of that line."""
    place = next(i for i, line in enumerate(lines) if old in line)
    return [*lines[:place], lines[place].replace(old, new), *lines[place + 1 :]], place + 1


def session(*data, h4="h4  1 2024  4 12  2 15 23 2024  4 12  2 18 19  1 0 0 0 1 0 2 0", version=2):
    return [
        f"h1 CRD {version} 2025  6 26 21",
        "h2 APOL 7045 95  1  4 ILRS",
        "h3 apollo11 100  100  na 0 1  3",
        h4,
        "c0 0 532.0 std3 lpd",
        *data,
        "h8",
        "h9",
    ]


def point(second, flight="2.4614224083999", event=2, count=147, rms="180.2"):
    return f"11 {second} {flight} std3 {event} 176.0 {count} {rms} na na na na 0 43.0"


def test_values_of_each_point(crd_lines):
    read = parse_crd("a.np2", crd_lines, None)
    assert len(read) == 3
    assert read.paths().tolist() == ["7845>apollo15>7845"] * 2 + ["7045>apollo11>7045"]
    assert read.line.tolist() == [11, 13, 22]
    dates = ["2024-05-13T16:16:31.933300993282", "2024-05-13T16:39:37.950832485437", "2024-04-12T02:16:55"]
    assert seconds_apart(read, dates).max() < EPOCH_TOLERANCE_S
    flights_s = np.array([2.581730448437, 2.582208383656, 2.4614224083999])
    assert np.abs(read.value_m - C_M_S * flights_s).max() < FLIGHT_TOLERANCE_M
    sigmas_s = [253.2e-12 / math.sqrt(40), 202.8e-12 / math.sqrt(85), 180.2e-12 / math.sqrt(147)]
    assert read.sigma_m == pytest.approx(C_M_S * np.array(sigmas_s), rel=1e-12)
    assert read.wavelength_um.tolist() == [0.5321, 0.5321, 0.532]
    assert read.tags().tolist() == ["transmit"] * 3


def test_weather_is_interpolated_between_records_and_held_outside(crd_lines):
    read = parse_crd("a.np2", crd_lines, None)
    share = (58591.933300993282 - 58288.178257980457) / (59697.657519922454 - 58288.178257980457)
    assert read.pressure_hpa == pytest.approx([871.95 - 0.10 * share, 871.85, 728.75], abs=1e-9)
    assert read.temperature_k == pytest.approx([287.25 + 0.20 * share, 287.45, 282.17], abs=1e-9)
    assert read.relative_humidity == pytest.approx([0.63 + 0.01 * share, 0.64, 0.18], abs=1e-9)


def test_weather_more_than_two_hours_away_is_missing():
    h4 = "h4  1 2024  4 12  2 15 23 2024  4 12  9 18 19  1 0 0 0 1 0 2 0"
    lines = session("20 8215 728.75 na -1 0", point(8215), point(15415, "2.47"), point(15416, "2.48"), h4=h4)
    read = parse_crd("a.np2", lines, None)
    assert read.pressure_hpa[:2].tolist() == [728.75, 728.75]
    assert np.isnan(read.pressure_hpa[2])
    assert np.isnan(read.temperature_k).all()
    assert np.isnan(read.relative_humidity).all()
    assert np.isnan(parse_crd("a.np2", session(point(8215)), None).pressure_hpa).all()


@pytest.mark.parametrize(("event", "tag"), [(0, "receive"), (1, "bounce"), (2, "transmit")])
def test_epoch_event_becomes_the_time_tag(event, tag):
    assert TIME_TAGS[parse_crd("a.np2", session(point(8215, event=event)), None).tag[0]] == tag


@pytest.mark.parametrize(
    ("start", "end", "second", "date"),
    [
        ("2024  4 12 23 50  0", "2024  4 13  0 20  0", "86000.5", "2024-04-12T23:53:20.5"),
        ("2024  4 12 23 50  0", "2024  4 13  0 20  0", "600.5", "2024-04-13T00:10:00.5"),
        ("2024  4 12 23 50  0", "2024  4 13  0 20  0", "87000.5", "2024-04-13T00:10:00.5"),
        ("2024  4 12 23 50  0", "0 0 0 0 0 0", "600.5", "2024-04-13T00:10:00.5"),
        ("2024  4 12 23 50  0", "na na na na na na", "85790.5", "2024-04-12T23:49:50.5"),
        ("2024  4 12  0  5  0", "2024  4 12  0 20  0", "86399", "2024-04-11T23:59:59"),
        # 2016-12-31 had a leap second.
        ("2016 12 31 23 50  0", "2017  1  1  0 20  0", "86400.5", "2016-12-31T23:59:60.5"),
        ("2016 12 31 23 50  0", "2017  1  1  0 20  0", "600.5", "2017-01-01T00:10:00.5"),
        ("2016 12 31 11 50  0", "2016 12 31 12 20  0", "43200", "2016-12-31T12:00:00"),
    ],
)
def test_second_of_day_finds_its_day(start, end, second, date):
    read = parse_crd("a.np2", session(point(second), h4=f"h4 1 {start} {end} 1 0 0 0 1 0 2 0"), None)
    assert seconds_apart(read, date)[0] < EPOCH_TOLERANCE_S


def test_session_rms_stands_in_for_a_missing_one():
    lines = session(point(8215, rms="na"), "50 std3 200.0 na na na 1")
    assert parse_crd("a.np2", lines, None).sigma_m[0] == pytest.approx(
        C_M_S * 200e-12 / math.sqrt(147), rel=1e-12
    )
    for missing in ("na", "0.0", "-1.0"):
        with pytest.raises(FileFormatError, match="record 50"):
            parse_crd("a.np2", session(point(8215, rms=missing), "50 other 200.0 na na na 1"), None)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("H1 CRD  2", "H1 CRD  3", "version 1 or 2"),
        ("7845 78  1  7", "7845 78  1  1", "time scale 1 is not UTC"),
        ("na 0 1 3", "na 0 4 3", "transponder"),
        ("0000103 0103", "0000100 0103", "number 103 of apollo15, got 0000100"),
        ("H4  1 2024", "H4  0 2024", "'data type' 1 of normal points, got 0"),
        ("H4  1 2024 05 13", "H4  1 2024 02 30", "not a date that exists"),
        ("2024 05 13 17 01 47", "2024 05 14 17 01 47", "lasts 24.84 h"),
        ("0 0 0 0 1 0 2 0", "0 1 0 0 1 0 2 0", "refraction corrected"),
        ("0 0 0 0 1 0 2 0", "0 0 0 0 0 0 2 0", "system delay applied"),
        ("C0 0 532.100 me08", "C0 0 532.100 me09", "no record C0"),
        ("11 58591.933300993282", "11 5.8e4x", "second of day is '5.8e4x'"),
        ("11 58591.933300993282", "11 65000.0", "outside the pass"),
        ("me08 2 582.0 40", "me08 5 582.0 40", "epoch event 5 is not modelled"),
        ("40 253.2 -0.040 -0.300  na 0.7 0 3.1", "40 253.2 -0.040", "cut"),
        ("871.95 287.25 63", "871.95 14.10 63", "temperature_k: expected 150 to 350, got 14.1"),
        ("40 58579", "10 58579", "full-rate"),
        ("H5  0 24", "±  0 24", r"not known|ASCII"),
        ("H8", "00", "has no end"),
    ],
)
def test_unusable_records_are_refused_with_their_line(crd_lines, old, new, words):
    lines, number = replaced(crd_lines, old, new)
    with pytest.raises(FileFormatError, match=words) as caught:
        parse_crd("a.np2", lines, None)
    assert caught.value.line == {"H8": 17, "C0 0 532.100 me08": 11}.get(old, number)


def test_records_out_of_place_are_refused(crd_lines):
    cases = [
        (["11 1 2.5 a 2 1 1 1 0 0 0 0 0 0", *crd_lines], "stands outside"),
        ([*crd_lines, "H8"], "stands outside"),
        (session(), "no normal points"),
        ([line for line in crd_lines if not line.startswith("H4")], "outside a pass"),
    ]
    for lines, words in cases:
        with pytest.raises(FileFormatError, match=words):
            parse_crd("a.np2", lines, None)


def test_a_configuration_has_one_wavelength_in_a_pass():
    with pytest.raises(FileFormatError, match=r"6:.*'std3'"):
        parse_crd("a.np2", session("c0 0 1064.0 std3 lpd", point(8215)), None)
    assert len(parse_crd("a.np2", session("c0 0 532.0 std3 lpd", point(8215)), None)) == 1


GRASSE_2015 = """\
h1 CRD  1 2015  4 29 22
h2 GRSM       7845 78  1  4
h3 apollo15        103  103          0 2
h4  1 2015  4 29 21 57 46 2015  4 29 22  9  8  0 0 0 0 1 0 2 0
c0 0    1064.2   me09 las6 det2 tim2
40 78719.19           0 me09       33       33   3.716   107173      0.0       84   0.000   0.000    0.0 3 3 0
20 79114.              873.84 279.34   84 0
11 79512.253056967700     2.660923125349 me09 2  682.7    36     232.2    .400   -.600       0.0   4.9 0
50 me09  293.8  -1.000  -1.000   -1.0 1
H8
H9
"""


def test_version_1_as_grasse_wrote_it():
    """A normal point of the ILRS of 2015: the reflector has no NORAD number, and its columns are blank."""
    read = parse_crd("a.npt", GRASSE_2015.split("\n"), None)
    assert read.paths().tolist() == ["GRSM>apollo15>GRSM"] or read.paths().tolist() == ["7845>apollo15>7845"]
    assert read.value_m[0] / C_M_S == pytest.approx(2.660923125349, abs=1e-15)
    assert (read.pressure_hpa[0], read.temperature_k[0]) == (873.84, 279.34)


def h4_of(begin, end):
    return f"h4 1 {begin} {end} 1 0 0 0 1 0 2 0"


@pytest.mark.parametrize(
    ("begin", "end", "seconds", "last"),
    [
        ("2024 4 12  2 15 23", "2024 4 12  2 18 23", (8123, 26123), "2024-04-12T07:15:23"),  # end too early
        ("2024 4 12  2 15 23", "2024 4 12  2 18 23", (15000,), "2024-04-12T04:10:00"),
        ("2024 4 12 23 50  0", "2024 4 13  0  5  0", (86000, 600, 9000), "2024-04-13T02:30:00"),
        ("2024 4 12  7  0  0", "2024 4 12  7 30  0", (8123, 26123), "2024-04-12T07:15:23"),  # begin too late
        (
            "2024 4 12  2 15 23",
            "2024 4 12  2 10 00",
            (8123, 26123),
            "2024-04-12T07:15:23",
        ),  # end before begin
    ],
)
def test_contradictory_header_times_warn_if_date_and_order_are_unique(begin, end, seconds, last):
    with pytest.warns(DataQualityWarning, match="line 4: "):
        read = parse_crd("a.np2", session(*map(point, seconds), h4=h4_of(begin, end)), None)
    assert seconds_apart(read, [last] * len(read))[-1] < EPOCH_TOLERANCE_S


@pytest.mark.parametrize(
    ("end", "seconds"),
    [
        ("2024 4 12  2 18 23", (26123, 8123)),  # not in order of time
        ("2024 4 12  2 18 23", (8123, 47000)),  # half a day outside
        ("2024 4 12  2 18 23", (8123, 83000)),  # on another date than the header's
    ],
)
def test_points_of_ambiguous_date_are_refused(end, seconds):
    with pytest.raises(FileFormatError, match="outside the pass dated by H4"):
        parse_crd("a.np2", session(*map(point, seconds), h4=h4_of("2024 4 12  2 15 23", end)), None)


@pytest.mark.parametrize(("alert", "word"), [(1, "suspect"), (2, "poor")])
def test_doubtful_data_are_kept_with_a_warning(alert, word):
    h4 = f"h4  1 2024  4 12  2 15 23 2024  4 12  2 18 19  1 0 0 0 1 0 2 {alert}"
    with pytest.warns(DataQualityWarning, match=f"line 4: .*{word}"):
        assert len(parse_crd("a.np2", session(point(8215), h4=h4), None)) == 1


def test_stations_get_catalogue_names(crd_lines):
    from radioloc.earth.stations import StationCatalogue

    lines, _ = replaced(crd_lines, "GRSM       7845", "GRSM       7846")
    with pytest.warns(DataQualityWarning, match=r"2:.*lacks.*7846"):
        paths = parse_crd("a.np2", lines, StationCatalogue.default()).paths().tolist()
    assert paths[0] == "GRASSE>apollo15>GRASSE"  # by its code, the pad being unknown
    assert paths[2] == "APOLLO>apollo11>APOLLO"
    lines, _ = replaced(crd_lines, "GRSM       7845", "GRSM       7045")
    with pytest.raises(FileFormatError, match=r"2:.*'GRSM'.*GRASSE,.*7045.*APOLLO"):
        parse_crd("a.np2", lines, StationCatalogue.default())
    lines, _ = replaced(crd_lines, "GRSM       7845", "NONE       9999")
    assert parse_crd("a.np2", lines, StationCatalogue.default()).paths()[0] == "9999>apollo15>9999"
