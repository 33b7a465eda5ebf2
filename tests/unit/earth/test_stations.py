import dataclasses
import importlib.resources
import re

import numpy as np
import pytest

from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import Station, StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.time import Epochs

EXACT_M = 1e-8
"""Rounding of a coordinate of an Earth radius, and of its motion over decades."""

APOLLO_2000_M = np.array([-1463998.9079, -5166632.7663, 3435012.8921])


def test_default_catalogue_has_the_thirteen_stations() -> None:
    catalogue = StationCatalogue.default()
    assert len(catalogue) == 13
    assert catalogue is StationCatalogue.default()
    assert [s.name for s in catalogue if s.kind == "llr"] == [
        "APOLLO",
        "GRASSE",
        "MATERA",
        "MLRS2",
        "WETTZELL",
    ]
    assert [s.name for s in catalogue if s.quality == "rounded"] == ["MIYUN50", "JIAMUSI", "KASHI", "NEUQUEN"]
    assert [s.name for s in catalogue if not s.velocity_known] == ["JIAMUSI", "KASHI", "NEUQUEN"]
    assert all(s.source for s in catalogue)


def test_stations_without_ocean_loading() -> None:
    missing = [s.name for s in StationCatalogue.default() if s.ocean_loading is None]
    assert missing == ["APOLLO", "JIAMUSI", "KASHI", "NEUQUEN"]
    assert "no ocean loading" in repr(StationCatalogue.default()["APOLLO"])


def test_ocean_loading_is_that_of_the_same_place() -> None:
    """Longitude and latitude in the loading table agree with the station's to a kilometre."""
    data = importlib.resources.files("radioloc.earth") / "data" / "ocean_loading.blq"
    places = re.findall(r"^  (\S+)\n.*\n\$\$ lon/lat: (\S+) (\S+)", data.read_text(), re.MULTILINE)
    assert len(places) == 9
    for name, longitude_deg, latitude_deg in places:
        station = StationCatalogue.default()[name]
        place = geodetic_from_itrf(station.itrf_m)
        assert np.rad2deg(place.longitude_rad) % 360.0 == pytest.approx(float(longitude_deg), abs=0.01)
        assert np.rad2deg(place.latitude_rad) == pytest.approx(float(latitude_deg), abs=0.01)
        assert station.ocean_loading is not None
        assert station.ocean_loading.source.startswith("TPXO.7.2")


def test_default_stations_are_where_they_should_be() -> None:
    """Coarse places from atlases, so that swapped signs or axes cannot hide."""
    expected_deg = {
        "APOLLO": (-105.82, 32.78),
        "GRASSE": (6.92, 43.75),
        "MATERA": (16.70, 40.65),
        "MLRS2": (-104.02, 30.68),
        "WETTZELL": (12.88, 49.14),
        "SESHAN25": (121.20, 31.10),
        "TIANMA65": (121.14, 31.09),
        "KUNMING": (102.80, 25.03),
        "URUMQI": (87.18, 43.47),
        "MIYUN50": (116.98, 40.56),
        "JIAMUSI": (130.77, 46.49),
        "KASHI": (76.71, 38.42),
        "NEUQUEN": (-70.15, -38.19),
    }
    for station in StationCatalogue.default():
        place = geodetic_from_itrf(station.itrf_m)
        longitude_deg, latitude_deg = expected_deg[station.name]
        assert np.rad2deg(place.longitude_rad) == pytest.approx(longitude_deg, abs=0.02)
        assert np.rad2deg(place.latitude_rad) == pytest.approx(latitude_deg, abs=0.02)
        assert -10.0 < place.height_m < 3000.0


@pytest.mark.parametrize("name", ["APOLLO", "apollo", " Apollo ", "7045", 7045, "apol", "70610"])
def test_found_whatever_the_name(name: str | int) -> None:
    catalogue = StationCatalogue.default()
    assert catalogue.get(name).name == "APOLLO"
    assert catalogue[name].name == "APOLLO"
    assert name in catalogue


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


def test_position_without_velocity_stands_still() -> None:
    kashi = StationCatalogue.default()["KASHI"]
    positions = kashi.position_at(Epochs.from_jd([2440000.5, 2460000.5], 0.0, "TT"))
    np.testing.assert_array_equal(positions, np.tile(kashi.itrf_m, (2, 1)))


def test_position_wants_tt() -> None:
    with pytest.raises(InputError, match="TT"):
        StationCatalogue.default()["KASHI"].position_at(Epochs.from_jd(2451545.0, scale="UTC"))


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
        ({"kind": "radio"}, "kind 'radio'"),
        ({"quality": "good"}, "quality 'good'"),
        ({"epoch_year": float("nan")}, "epoch_year must be a finite number"),
        ({"itrf_m": [6378.137, 0.0, 0.0]}, "give metres"),
        ({"itrf_m": [6378137.0, 0.0]}, "three finite"),
        ({"velocity_m_yr": [0.0, float("inf"), 0.0]}, "three finite"),
    ],
)
def test_refuses_a_bad_station(changes: dict[str, object], message: str) -> None:
    with pytest.raises(StationError, match=message):
        make_station(**changes)


def test_with_station_adds_and_replaces_in_a_new_catalogue() -> None:
    default = StationCatalogue.default()
    larger = default.with_station(make_station())
    assert "mn" in larger
    assert "mn" not in default
    assert len(larger) == 14
    loading = default["MLRS2"].ocean_loading
    own = larger.with_station(dataclasses.replace(default["APOLLO"], ocean_loading=loading))
    assert len(own) == 14
    assert own["7045"].ocean_loading is loading
    assert own["7045"].velocity_known
    assert default["7045"].ocean_loading is None


def test_with_station_refuses_an_alias_already_taken() -> None:
    with pytest.raises(StationError, match="APOLLO and MINE are both called '7045'"):
        StationCatalogue.default().with_station(make_station(aliases=("7045",)))


def test_is_immutable() -> None:
    station = StationCatalogue.default()["APOLLO"]
    with pytest.raises(ValueError, match="read-only"):
        station.itrf_m[0] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        station.name = "X"  # type: ignore[misc]
