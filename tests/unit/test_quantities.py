"""Whatever is public honours units and scales of time by the names of its arguments, or refuses them by name."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import CartesianRepresentation, EarthLocation
from astropy.time import Time

import radioloc
from radioloc.earth import EarthOrientation, StationCatalogue
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import LunarPosition, rot_icrf_to_iau_moon
from radioloc.lunar.frames import hidden_by_moon
from radioloc.media import UniformTec
from radioloc.simulation import Masks, Session, elevations, two_way, windows
from radioloc.study import EstimateChoice, ObservationChoice, PlaceOnMap
from radioloc.time import (
    epochs_from_strings,
    geocentric_tdb_minus_tt,
    to_scale,
    topocentric_tdb_minus_tt,
    tt_to_tdb,
    utc_strings,
    utc_to_tt,
)
from radioloc.time.scales import tdb_to_tt

REFUSED = {
    "function": (lambda: topocentric_tdb_minus_tt(1.0 * u.cd, [0.0, 0.0, 0.0]), "earth_velocity_m_s"),
    "method": (lambda: UniformTec(10.0).slant_tec(None, 0.0, 1.0 * u.cd, None), "elevation_rad"),
    "class method": (lambda: LunarPosition.from_selenographic(1.0 * u.cd, 0.0, 0.0), "longitude_deg"),
    "record": (lambda: Session(**SESSION | {"step_s": 1.0 * u.cd}), "step_s"),
    "values by name": (lambda: Masks(10.0, by_station_deg={"KASHI": 1.0 * u.cd}), "by_station_deg"),
    "time": (lambda: utc_strings(Time("2020-01-01", scale="tcb")), "time scale 'TCB'"),
}


@pytest.mark.parametrize(("call", "words"), REFUSED.values(), ids=REFUSED)
def test_quantity_of_another_kind_is_refused_by_name_of_argument(call, words):
    with pytest.raises(InputError, match=words):
        call()


# What is given with a unit, and the same without.

SESSION = {
    "kind": "range", "pairs": two_way("KASHI"), "start_utc": "2020-12-01T15:11:00", "stop_utc": "2020-12-01T16:11:00",
    "step_s": 60.0, "sigma_m": 2.5,
}  # fmt: skip
START = Time("2020-12-01T15:11:00", scale="utc")


@pytest.mark.parametrize(
    ("make", "plain"),
    [
        (
            lambda: Session(**SESSION | {"start_utc": START.tdb, "step_s": 1 * u.min, "sigma_m": 250 * u.cm}),
            lambda: Session(**SESSION | {"start_utc": "2020-12-01T15:11:00.000000000"}),
        ),
        (
            lambda: Masks(np.pi / 18 * u.rad, by_station_deg={"KASHI": 300 * u.arcmin}),
            lambda: Masks(10.0, by_station_deg={"KASHI": 5.0}),
        ),
        (
            lambda: EstimateChoice(
                range_bias="all", range_bias_sigma_m=20 * u.cm, clock="all",
                clock_sigma_s={"KASHI": 3 * u.us, "JIAMUSI": 5e-6}, ephemeris_sigma_m=1e-3 * u.km, pass_gap_h=1 * u.day,
            ),
            lambda: EstimateChoice(
                range_bias="all", range_bias_sigma_m=0.2, clock="all",
                clock_sigma_s={"KASHI": 3e-6, "JIAMUSI": 5e-6}, ephemeris_sigma_m=1.0, pass_gap_h=24.0,
            ),
        ),
        (
            lambda: PlaceOnMap(
                longitude_deg=1 * u.rad, latitude_deg=0.5, sigma_m=0.01 * u.km, map="m",
                map_sigma_m=[0.02, 0.03] * u.km,
                known_deg_m=(1.0 * u.rad, 0.5 * u.deg, 1 * u.km),
            ),
            lambda: PlaceOnMap(
                longitude_deg=np.degrees(1.0), latitude_deg=0.5, sigma_m=10.0, map="m", map_sigma_m=(20.0, 30.0),
                known_deg_m=(1.0 * u.rad, 0.5 * u.deg, 1 * u.km),
            ),
        ),
    ],
)  # fmt: skip
def test_records_are_the_same_with_units(make, plain):
    assert repr(rounded(make())) == repr(rounded(plain()))


def rounded(value):
    """A record as nested dictionaries, floats to 12 digits: units are converted by products."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: rounded(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(map(rounded, value))
    assert not hasattr(value, "unit") or value.unit in (u.deg, u.rad, u.km)
    return float(f"{value:.12g}") if isinstance(value, float) else value


def test_a_choice_of_observations_takes_dates_and_times():
    plain = ObservationChoice(start=epochs_from_strings("2020-12-01T15:11:00", "UTC")).start
    for date in ("2020-12-01T15:11:00", START, START.tdb):
        start = ObservationChoice(start=date).start
        assert start.scale == "UTC"
        assert abs((start.jd - plain.jd + start.fraction - plain.fraction)[0]) * 86400.0 < 1e-8
    with pytest.raises(InputError, match="'soon'"):
        ObservationChoice(start="soon")
    with pytest.raises(InputError, match="stop: expected one epoch"):
        ObservationChoice(stop=Time(["2020-12-01", "2020-12-02"]))


TIMES = Time(["2020-12-01T15:11:00", "2020-12-02T01:00:00"], scale="utc")


@pytest.mark.parametrize("scale", ["utc", "tai", "tt", "tdb"])
def test_an_epoch_in_any_scale_is_the_same_instant(scale, model):
    time, utc = getattr(TIMES, scale), epochs_from_strings(TIMES.isot.tolist(), "UTC")
    tt = utc_to_tt(utc)
    tdb = tt_to_tdb(tt)
    rounding_s = 1e-8  # 3e-6 m of a station, 1e-5 m of the Moon
    assert np.abs(utc_to_tt(time).seconds_since(tt)).max() < rounding_s
    assert np.abs(tt_to_tdb(time).seconds_since(tdb)).max() < rounding_s
    assert np.abs(tdb_to_tt(time).seconds_since(tt)).max() < rounding_s
    assert np.abs(to_scale(time, "TDB").seconds_since(tdb)).max() < rounding_s
    assert geocentric_tdb_minus_tt(time) == pytest.approx(geocentric_tdb_minus_tt(tdb), abs=1e-12)
    assert utc_strings(time, 6).tolist() == ["2020-12-01T15:11:00.000000", "2020-12-02T01:00:00.000000"]
    station = StationCatalogue.default().get("WETTZELL")
    for function, argument, tolerance in (
        (lambda at: Ephemeris.open().geocentric("moon", at)[0], tdb, 1e-4),
        (lambda at: Ephemeris.open().earth(at).position_m, tdb, 1e-3),
        (lambda at: LunarOrientation.open().angles(at)[0], tdb, 1e-13),
        (rot_icrf_to_iau_moon, tdb, 1e-13),
        (lambda at: EarthOrientation.default().evaluate(at).rot_itrf_to_gcrs, tt, 2e-12),
        (station.position_at, tt, 1e-6),
        (lambda at: elevations(model, LANDER_PA_M, ["KASHI"], at).at_station_rad, tt, 2e-12),
        (lambda at: UniformTec(10.0).slant_tec(station.itrf_m, 0.1, 0.7, at), utc, 1e-12),
    ):
        np.testing.assert_allclose(function(time), function(argument), rtol=0.0, atol=tolerance)


LANDER_PA_M = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4).to_frame("PA_DE421").xyz_m


def test_places_in_kilometres_and_of_astropy(model):
    in_km = LANDER_PA_M / 1e3 * u.km
    of_astropy = CartesianRepresentation(*in_km)
    plain = windows(model, LANDER_PA_M, ["KASHI"], "2020-12-01T15:11:00", "2020-12-02T15:11:00")
    assert plain
    for place in (in_km, of_astropy):
        assert windows(model, place, ["KASHI"], START.tt, START.tdb + 1 * u.day) == plain
    assert radioloc.LunarPosition("PA_DE421", of_astropy).xyz_m == pytest.approx(LANDER_PA_M, abs=1e-8)
    assert hidden_by_moon(of_astropy, -of_astropy)
    with pytest.raises(InputError, match="target_pa_m: expected coordinates"):
        windows(model, radioloc.LunarPosition("PA_DE421", LANDER_PA_M), ["KASHI"], "2020-12-01", "2020-12-02")
    station = EarthLocation.from_geocentric(4075539.9, 931735.2, 4801629.4, unit="m")
    earth_km_s = [10.0, 25.0, 12.0] * u.km / u.s
    bare = topocentric_tdb_minus_tt([1e4, 2.5e4, 1.2e4], [4075539.9, 931735.2, 4801629.4])
    assert topocentric_tdb_minus_tt(earth_km_s, station) == pytest.approx(bare, rel=1e-14)
