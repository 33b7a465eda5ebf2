import dataclasses
import importlib.resources
import re

import numpy as np
import pytest

from radioloc.earth import Station, StationCatalogue, geodetic_from_itrf
from radioloc.errors import StationError
from radioloc.time import Epochs

EXACT_M = 1e-8
"""Rounding of a coordinate of an Earth radius, and of its motion over decades."""

APOLLO_2000_M = np.array([-1463998.9079, -5166632.7663, 3435012.8921])


PLACES_DEG = """
APOLLO -105.82 32.78, GRASSE 6.92 43.75, MATERA 16.70 40.65, MLRS2 -104.02 30.68,
WETTZELL 12.88 49.14, SESHAN25 121.20 31.10, TIANMA65 121.14 31.09, KUNMING 102.80 25.03,
URUMQI 87.18 43.47, MIYUN50 116.98 40.56, EFLSBERG 6.88 50.52, MEDICINA 11.65 44.52,
METSAHOV 24.39 60.22, NOTO 14.99 36.88, ONSALA60 11.92 57.40, WETTZELL20 12.88 49.14,
YEBES40M -3.09 40.52, SVETLOE 29.78 60.53, ZELENCHK 41.57 43.79, BADARY 102.23 51.77,
HARTRAO 27.69 -25.89, HART15M 27.69 -25.89, HOBART12 147.44 -42.80, HOBART26 147.44 -42.80,
KATH12M 132.15 -14.38, YARRA12M 115.35 -29.05, PARKES 148.26 -33.00, WARK12M 174.66 -36.43,
JIAMUSI 130.77 46.49, KASHI 76.71 38.42, NEUQUEN -70.15 -38.19, NEWNORCIA 116.19 -31.05,
CEBREROS -4.37 40.45, MALARGUE -69.40 -35.78, KOUROU -52.80 5.25, MISASA 138.35 36.14,
USUDA64 138.36 36.13, UCHINOURA34 131.08 31.25
"""
"""Stations with coarse east longitudes and latitudes from atlases."""


def test_default_catalogue_has_its_stations() -> None:
    catalogue = StationCatalogue.default()
    assert len(catalogue) == 58
    assert catalogue is StationCatalogue.default()
    assert all(s.source for s in catalogue)
    lasers = [s for s in catalogue if s.kind == "llr"]
    assert [s.name for s in lasers] == ["APOLLO", "GRASSE", "MATERA", "MLRS2", "WETTZELL"]
    assert repr(lasers[0]) == "<Station APOLLO (llr, survey, no ocean loading)>"


def test_ocean_loading_is_that_of_the_same_place() -> None:
    """Longitude and latitude in the loading table agree with the station's to a kilometre."""
    data = importlib.resources.files("radioloc.earth") / "data" / "ocean_loading.blq"
    places = re.findall(r"^  (\S+)\n.*\n\$\$ lon/lat: (\S+) (\S+)", data.read_text(), re.MULTILINE)
    assert len(places) == 14
    for name, longitude_deg, latitude_deg in places:
        station = StationCatalogue.default()[name]
        place = geodetic_from_itrf(station.itrf_m)
        assert np.rad2deg(place.longitude_rad) % 360.0 == pytest.approx(float(longitude_deg), abs=0.01)
        assert np.rad2deg(place.latitude_rad) == pytest.approx(float(latitude_deg), abs=0.01)
        assert station.ocean_loading is not None
        assert station.ocean_loading.source.startswith("TPXO.7.2")


def test_default_stations_are_where_they_should_be() -> None:
    """Coarse places from atlases, so that swapped signs or axes cannot hide."""
    words = [row.split() for row in PLACES_DEG.replace("\n", " ").split(",")]
    expected_deg = {name: (float(longitude), float(latitude)) for name, longitude, latitude in words}
    # The complexes are some 30 km wide.
    complexes = {"Goldstone": (-116.87, 35.3), "Canberra": (148.98, -35.40), "Madrid": (-4.25, 40.43)}
    for station in StationCatalogue.default():
        place = geodetic_from_itrf(station.itrf_m)
        tolerance_deg = 0.02 if station.name in expected_deg else 0.15
        longitude_deg, latitude_deg = (expected_deg | complexes)[
            station.name if station.name in expected_deg else station.complex.split()[0]
        ]
        assert np.rad2deg(place.longitude_rad) == pytest.approx(longitude_deg, abs=tolerance_deg)
        assert np.rad2deg(place.latitude_rad) == pytest.approx(latitude_deg, abs=tolerance_deg)
        assert -20.0 < place.height_m < 3000.0


@pytest.mark.parametrize(
    ("station", "names"),
    [
        ("APOLLO", ["APOLLO", "apollo", " Apollo ", "7045", 7045, "apol", "70610"]),
        ("DSS-24", ["DSS-24", "DSS24", "dss 24", "dss_24"]),
    ],
)
def test_found_whatever_the_name(station: str, names: list) -> None:
    catalogue = StationCatalogue.default()
    assert {catalogue.get(name).name for name in names} == {catalogue[names[-1]].name} == {station}
    assert all(name in catalogue for name in names)


def test_the_telescopes_of_a_site_move_together_and_none_up_by_more_than_a_centimetre_a_year() -> None:
    """A sign or a digit wrong of a velocity would show."""
    catalogue = StationCatalogue.default()
    for first, second in [("WETTZELL", "WETTZELL20"), ("HARTRAO", "HART15M"), ("HOBART12", "HOBART26")]:
        between_m_yr = catalogue[first].velocity_m_yr - catalogue[second].velocity_m_yr
        assert np.abs(between_m_yr).max() < 0.004
    for station in (s for s in catalogue if s.velocity_known and s.quality != "rounded"):
        up = station.itrf_m / np.linalg.norm(station.itrf_m)
        assert abs(up @ station.velocity_m_yr) < 0.010


def test_effelsberg_is_where_the_itrf_says() -> None:
    """ITRF2020's record of it (epoch 2015.0): 1 cm beside ours, 10 cm above it."""
    itrf_m = np.array([4033947.28676361, 486990.823348219, 4900431.08394323])
    itrf_m += 5.0 * np.array([-0.0139698991002166, 0.0169886132211163, 0.0107017114287353])
    tt = Epochs.from_jd(2451545.0 + 20 * 365.25, 0.0, "TT")
    away_m = StationCatalogue.default()["Ef"].position_at(tt)[0] - itrf_m
    up = itrf_m / np.linalg.norm(itrf_m)
    assert up @ away_m == pytest.approx(-0.10, abs=0.01)
    assert np.linalg.norm(away_m - (up @ away_m) * up) < 0.02


@pytest.mark.parametrize(
    ("text", "count"),
    [("goldstone", 8), ("Madrid", 6), ("canberra", 6), ("JAPAN", 3), ("new norcia", 1), ("xyz", 0)],
)
def test_stations_are_found_by_a_part_of_what_is_said_of_them(text: str, count: int) -> None:
    stations = StationCatalogue.default().find(text)
    assert len(stations) == count
    assert all(
        text.replace(" ", "").lower() in f"{s.complex}{s.country}".replace(" ", "").lower() for s in stations
    )


def test_unknown_station_says_what_is_close() -> None:
    catalogue = StationCatalogue.default()
    assert "APOLO" not in catalogue
    assert None not in catalogue
    with pytest.raises(StationError, match=r"'APOLO'.*similar: APOLLO.*with_station"):
        catalogue.get("APOLO")
    with pytest.raises(StationError, match=r"9999999.*known: APOLLO, GRASSE"):
        catalogue.get("9999999_xyz_????")


def test_position_moves_linearly() -> None:
    apollo = StationCatalogue.default()["APOLLO"]
    tt = Epochs.from_jd(2451545.0 + np.array([0.0, 3652.5, -365.25]), 0.0, "TT")
    expected = APOLLO_2000_M + np.outer([0.0, 10.0, -1.0], [-0.0139, -0.0003, -0.0023])
    np.testing.assert_allclose(apollo.position_at(tt), expected, rtol=0.0, atol=EXACT_M)
    grasse = StationCatalogue.default()["GRASSE"]
    at_2015 = Epochs.from_jd(2451545.0 + 15 * 365.25, 0.0, "TT")
    np.testing.assert_allclose(grasse.position_at(at_2015)[0], grasse.itrf_m, rtol=0.0, atol=EXACT_M)


def make_station(**changes: object) -> Station:
    fields: dict[str, object] = {
        "name": "MINE",
        "aliases": ("MN",),
        "kind": "ttc",
        "itrf_m": [6378137.0, 0.0, 0.0],
        "epoch_year": 2010.0,
        "quality": "survey",
        "source": "here",
    }
    return Station(**(fields | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": " "}, "needs a name"),
        ({"mount": "altaz"}, "mount 'altaz' is not one of azimuth_elevation, equatorial"),
        ({"axis_offset_m": 2130.0}, "no antenna has an axis offset of 2130"),
        ({"frame": "WGS72"}, "frame 'WGS72' is not one of ITRF2020, ITRF2014"),
        ({"epoch_year": float("nan")}, "epoch_year: expected a finite number"),
        ({"itrf_m": [6378.137, 0.0, 0.0]}, "these are kilometres"),
        (
            {"itrf_m": [3942516.9, 4870627.6, 1151367.6]},
            "-6242 m .* with y and z exchanged it would be at 5580 m",
        ),
        ({"velocity_m_yr": [0.0, float("inf"), 0.0]}, "three finite"),
    ],
)
def test_refuses_a_bad_station(changes: dict[str, object], message: str) -> None:
    with pytest.raises(StationError, match=message):
        make_station(**changes)


@pytest.mark.parametrize(
    ("order", "signs"), [((1, 0, 2), (1, 1, 1)), ((0, 1, 2), (1, -1, 1)), ((0, 1, 2), (1, 1, -1))]
)
def test_coordinates_in_another_order_than_the_catalogue_has_them_are_refused(
    order: tuple[int, ...], signs: tuple[int, ...]
) -> None:
    default = StationCatalogue.default()
    kashi = default["KASHI"]
    moved_m = kashi.itrf_m + 1000.0
    with pytest.raises(StationError, match=r"KASHI.*\d+.*catalogue's.*1.7 km"):
        default.with_station(dataclasses.replace(kashi, itrf_m=signs * moved_m[list(order)]))
    relocated = default.with_station(dataclasses.replace(kashi, itrf_m=default["PARKES"].itrf_m))
    assert relocated["KASHI"].itrf_m.tolist() == default["PARKES"].itrf_m.tolist()


def test_with_station_adds_and_replaces_in_a_new_catalogue() -> None:
    default = StationCatalogue.default()
    larger = default.with_station(make_station())
    assert "mn" in larger
    assert "mn" not in default
    assert len(larger) == len(default) + 1
    loading = default["MLRS2"].ocean_loading
    replaced = larger.with_station(dataclasses.replace(default["APOLLO"], ocean_loading=loading))
    assert len(replaced) == len(larger)
    assert replaced["7045"].ocean_loading is loading
    assert replaced["7045"].velocity_known
    assert default["7045"].ocean_loading is None


def test_geodetic_coordinates_are_those_of_the_ellipsoid() -> None:
    """ESA gives Kourou both ways; the catalogue has the one that follows from the other, rounded to millimetres."""
    fields = {
        "name": "K",
        "aliases": (),
        "kind": "ttc",
        "epoch_year": 2020.0,
        "quality": "survey",
        "source": "s",
    }
    place = {"longitude_deg": -52.8046646, "latitude_deg": 5.2514391, "height_m": -14.6719}
    station = Station.from_geodetic(**place, **fields, frame="ITRF97")
    np.testing.assert_allclose(
        station.itrf_m, StationCatalogue.default()["KOUROU"].itrf_m, rtol=0.0, atol=1e-3
    )
    assert station.frame == "ITRF97"
    for name, value in (("latitude_deg", 140.0), ("longitude_deg", 520.0), ("height_m", np.nan)):
        with pytest.raises(StationError, match=rf"station K: .*{name} = {value:g}.* 90 and 360 degrees"):
            Station.from_geodetic(**place | {name: value}, **fields)


def test_position_is_in_itrf2020_whatever_frame_it_is_given_in() -> None:
    tt = Epochs.from_jd(2460000.5, 0.0, "TT")
    moving, fixed = make_station(frame="ITRF93"), make_station(frame="ITRF93", velocity_m_yr=[0.0, 0.0, 0.0])
    # At the equator in Greenwich in 2010: T is (-51.8, 2.9, -59.8) mm, D x 24.684 mm, R2 and R3 are -3.38 and 0.40
    # milliarcseconds, 104.516 and 12.369 mm.
    away_m = moving.position_at(tt)[0] - moving.itrf_m
    np.testing.assert_allclose(away_m, [0.027116, -0.015269, -0.044716], rtol=0.0, atol=2e-6)
    np.testing.assert_array_equal(moving.position_at(tt[[0, 0]])[1], moving.itrf2020[0])
    # A velocity of zero in ITRF93 differs from zero in ITRF2020.
    assert np.linalg.norm(fixed.itrf2020[1]) > 3e-3


def test_with_station_refuses_an_alias_already_taken() -> None:
    with pytest.raises(StationError, match=r"APOLLO.*MINE.*'7045'"):
        StationCatalogue.default().with_station(make_station(aliases=("7045",)))
