from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from atmosphere_files import IONEX_LATITUDES, IONEX_LONGITUDES, Field, ionex_text

from radioloc.earth.geodesy import itrf_from_geodetic
from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.media.ionex import IonexMaps, read_ionex
from radioloc.media.ionosphere import ionosphere_delay_m, modified_shell_mapping, pierce_point
from radioloc.time import epochs_from_strings, utc_to_tt

ROUNDING_TECU = 0.06
"""Half of the last digit of values in 0.1 TECU, and a little."""


def flat(latitude, longitude, hour):
    """Field that is linear in latitude and time and constant in longitude."""
    return 40.0 + 0.2 * latitude + hour + 0.0 * longitude


def sun_fixed(latitude, longitude, hour):
    """Constant bulge that follows the Sun, which rotated maps reproduce exactly."""
    local = np.deg2rad(longitude + 15.0 * hour)
    return 30.0 + 20.0 * np.cos(local) + 0.0 * latitude


@pytest.fixture
def maps(tmp_path: Path) -> Callable[..., IonexMaps]:
    def read(field: Field, **options) -> IonexMaps:
        path = tmp_path / "test0150.19i"
        path.write_text(ionex_text(field, **options))
        return read_ionex(path)

    return read


def test_content_of_a_file(maps) -> None:
    read = maps(flat)
    assert read.grid.shape == (71, 73)
    assert (read.shell_height_m, read.base_radius_m, read.max_gap_s) == (450e3, 6371e3, 7200.0)
    assert read.source == "test0150.19i"
    np.testing.assert_allclose(read.mjd_utc, 58498.0 + np.array([0, 2, 4, 6]) / 24.0)
    expected = flat(IONEX_LATITUDES[:, None], IONEX_LONGITUDES, 2.0)
    np.testing.assert_allclose(read.tec_tecu[1], expected, atol=ROUNDING_TECU)


def test_linear_in_latitude_and_time(maps) -> None:
    utc = epochs_from_strings(["2019-01-15T00:00:00", "2019-01-15T03:30:00", "2019-01-15T06:00:00"], "UTC")
    latitude, longitude = np.array([35.4, -87.5, 1.1]), np.deg2rad([-117.0, 180.0, 359.0])
    tec, by_tt = (
        maps(flat).vertical_tec(np.deg2rad(latitude), longitude, at) for at in (utc, utc_to_tt(utc))
    )
    np.testing.assert_allclose(tec, flat(latitude, 0.0, np.array([0.0, 3.5, 6.0])), atol=ROUNDING_TECU)
    np.testing.assert_allclose(tec, by_tt, rtol=1e-9)


def test_maps_rotate_with_the_sun(maps) -> None:
    """The bulge follows the Sun between maps; rotated columns need no interpolation."""
    read = maps(sun_fixed)
    dates = ["2019-01-15T00:20:00", "2019-01-15T01:00:00", "2019-01-15T04:40:00"]
    hours = np.array([1.0 / 3.0, 1.0, 14.0 / 3.0])
    # Twenty minutes are 5 degrees, one column.
    tec = read.vertical_tec(0.0, np.deg2rad([175.0, -25.0, 60.0]), epochs_from_strings(dates, "UTC"))
    np.testing.assert_allclose(tec, sun_fixed(0.0, np.array([175.0, -25.0, 60.0]), hours), atol=ROUNDING_TECU)
    # Without rotation the mean of two maps would have 3.4 % less of the bulge: 0.7 TECU at its crest.
    noon = read.vertical_tec(0.0, np.deg2rad([-15.0]), epochs_from_strings([dates[1]], "UTC"))
    assert noon[0] == pytest.approx(50.0, abs=ROUNDING_TECU)


def wavy(latitude, longitude, hour):
    waves = 10.0 * np.cos(np.deg2rad(longitude + 15.0 * hour)) + 3.0 * np.sin(
        np.deg2rad(3 * longitude - 2 * latitude)
    )
    return 40.0 + 0.2 * latitude + hour + waves


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "date", "tec_tecu"),
    [
        (40.0, 10.0, "2019-01-15T03:24:30", 54.36624222724273),
        (-35.4, 149.0, "2019-01-15T00:45:00", 25.003711590498536),
        (0.0, 20.0, "2019-01-15T05:59:00", 45.18947567627564),
    ],
)
def test_against_orekit(maps, latitude_deg: float, longitude_deg: float, date: str, tec_tecu: float) -> None:
    """GlobalIonosphereMapModel of Orekit 13.1 with ROTATED_LINEAR, on the same file.

    Orekit rotates the maps with the stars, not the Sun: 0.04 degrees less an hour, up to 0.002 TECU.
    """
    tec = maps(wavy).vertical_tec(
        np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), epochs_from_strings([date], "UTC")
    )
    assert tec[0] == pytest.approx(tec_tecu, abs=2e-3)


def test_slant(maps) -> None:
    read = maps(flat)
    epochs = epochs_from_strings(["2019-01-15T02:00:00"] * 2, "UTC")
    station = itrf_from_geodetic(np.deg2rad(-116.9), np.deg2rad(35.4), 1000.0)
    azimuth, elevation = np.deg2rad([120.0, 250.0]), np.deg2rad([15.0, 60.0])
    vertical = read.vertical_tec(*pierce_point(station, azimuth, elevation), epochs)
    slant = read.slant_tec(station, azimuth, elevation, epochs)
    np.testing.assert_allclose(slant, modified_shell_mapping(elevation)[0] * vertical, rtol=1e-13)
    # The field has fewer electrons to the south of the station.
    assert (vertical < flat(35.4, 0.0, 2.0)).all()


def test_negative_contents_cause_no_delay(maps) -> None:
    epochs = epochs_from_strings(["2019-01-15T02:00:00"], "UTC")
    read = maps(lambda latitude, longitude, hour: -0.5 + 0.0 * latitude * longitude * hour)
    station = itrf_from_geodetic(np.deg2rad(117.0), np.deg2rad(40.0), 50.0)[None]
    tec = read.slant_tec(station, np.deg2rad([200.0]), np.deg2rad([30.0]), epochs)
    assert tec.tolist() == [0.0]
    assert ionosphere_delay_m(tec, np.array([8.4e9])).tolist() == [0.0]


def test_missing_values(tmp_path: Path) -> None:
    def with_hole(latitude, longitude, hour):
        return np.where(
            (latitude == 35.0) & (longitude == -115.0) & (hour == 2.0), 999.9, flat(latitude, longitude, hour)
        )

    path = tmp_path / "test0150.19i"
    path.write_text(ionex_text(with_hole))
    read = read_ionex(path)
    assert np.isnan(read.tec_tecu).sum() == 1
    hole = np.deg2rad([36.0]), np.deg2rad([-117.0])
    with pytest.raises(InputError, match=r"latitude 36\.0, longitude -117\.0"):
        read.vertical_tec(*hole, epochs_from_strings(["2019-01-15T02:00:00"], "UTC"))
    # At the neighbouring point and at the next epoch the missing value has no weight.
    neighbour = np.deg2rad([35.0]), np.deg2rad([-110.0])
    for place, hour, expected in ((hole, 4, 51.2), (neighbour, 2, 49.0)):
        tec = read.vertical_tec(*place, epochs_from_strings([f"2019-01-15T0{hour}:00:00"], "UTC"))
        assert tec == pytest.approx(expected, abs=0.1)


def test_epochs_and_places_outside_of_the_maps(maps, tmp_path: Path) -> None:
    read = maps(flat)
    for date in ("2019-01-14T23:59:59", "2019-01-15T06:00:01"):
        with pytest.raises(CoverageError, match=r"2019-01-15 00\.0.*UTC"):
            read.vertical_tec(0.0, 0.0, epochs_from_strings([date], "UTC"))
    with pytest.raises(InputError, match=r"-87\.5 to 87\.5"):
        read.vertical_tec(1.55, 0.0, epochs_from_strings(["2019-01-15"], "UTC"))
    later = tmp_path / "test0170.19i"
    later.write_text(ionex_text(flat, day=17))
    early = tmp_path / "test0150.19i"
    gap = read_ionex([early, later])
    assert gap.vertical_tec(0.0, 0.0, epochs_from_strings(["2019-01-17T01:00:00"], "UTC"))[
        0
    ] == pytest.approx(89.0, abs=0.1)
    with pytest.raises(CoverageError, match=r"06\.0.*UTC.*2019-01-17"):
        gap.vertical_tec(0.0, 0.0, epochs_from_strings(["2019-01-16"], "UTC"))


TEXT = ionex_text(flat, hours=(0, 2))
LINES = TEXT.splitlines()
FIRST_MAP = next(k for k, line in enumerate(LINES, start=1) if "START OF TEC MAP" in line)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("IONEX VERSION / TYPE", "RINEX VERSION / TYPE", 1, "first line"),
        ("  87.5 -87.5  -2.5   ", "  87.5 -87.5  -2.4   ", 13, "not a multiple"),
        (" 450.0 450.0   0.0", " 450.0 800.0  50.0", None, "two dimensions"),
        ("  575\n", "  575  575\n", FIRST_MAP + 3, "expected 16 values"),
        (" 450.0 450.0   0.0", "450000450000   0.0", None, "shell of the ionosphere"),
        ("  2019     1    15     0", "  2019    13    15     0", FIRST_MAP + 1, "not a date that exists"),
        ("  2019     1    15     0", "  2019     1    14     0", None, "EPOCH OF FIRST MAP"),
    ],
)
def test_damaged_file(tmp_path: Path, old: str, new: str, line: int | None, words: str) -> None:
    head, body = "\n".join(LINES[: FIRST_MAP - 1]), "\n".join(LINES[FIRST_MAP - 1 :])
    text = (
        f"{head.replace(old, new, 1)}\n{body}"
        if old in head and line != FIRST_MAP + 1
        else f"{head}\n{body.replace(old, new, 1)}"
    )
    path = tmp_path / "bad.19i"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_ionex(path)
    if line is not None:
        assert caught.value.line == line
