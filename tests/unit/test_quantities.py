"""Whatever is public honours units and scales of time by the names of its arguments, or refuses them by name."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import Angle, CartesianRepresentation, EarthLocation
from astropy.table import Table
from astropy.time import Time

import radioloc
from radioloc.earth import EarthOrientation, Station, StationCatalogue, geodetic_from_itrf
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError, StationError
from radioloc.lunar import LunarPosition, rot_icrf_to_iau_moon
from radioloc.lunar.frames import hidden_by_moon
from radioloc.measurements import FixedPoint, Link, Observations
from radioloc.media import UniformTec
from radioloc.simulation import Masks, Session, elevations, two_way, windows
from radioloc.study import EstimateChoice, ObservationChoice, PlaceOnMap
from radioloc.time import (
    Epochs,
    epochs_from_strings,
    geocentric_tdb_minus_tt,
    to_scale,
    topocentric_tdb_minus_tt,
    tt_to_tdb,
    utc_strings,
    utc_to_tt,
)
from radioloc.time.scales import tdb_to_tt
from radioloc.units import as_metres, in_unit

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
        (lambda at: elevations(model, LANDER, ["KASHI"], at).at_station_rad, tt, 2e-12),
        (lambda at: UniformTec(10.0).slant_tec(station.itrf_m, 0.1, 0.7, at), utc, 1e-12),
    ):
        np.testing.assert_allclose(function(time), function(argument), rtol=0.0, atol=tolerance)


LANDER = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
LANDER_PA_M = LANDER.to_frame("PA_DE421").xyz_m


def test_places_in_kilometres_and_of_astropy(model):
    in_km = LANDER_PA_M / 1e3 * u.km
    of_astropy = CartesianRepresentation(*in_km)
    plain = windows(model, LANDER, ["KASHI"], "2020-12-01T15:11:00", "2020-12-02T15:11:00")
    assert plain
    for place in (in_km, of_astropy):
        assert windows(model, FixedPoint(place), ["KASHI"], START.tt, START.tdb + 1 * u.day) == plain
    assert radioloc.LunarPosition("PA_DE421", of_astropy).xyz_m == pytest.approx(LANDER_PA_M, abs=1e-8)
    assert hidden_by_moon(of_astropy, -of_astropy)
    with pytest.raises(InputError, match="write FixedPoint"):
        windows(model, in_km, ["KASHI"], "2020-12-01", "2020-12-02")
    station = EarthLocation.from_geocentric(4075539.9, 931735.2, 4801629.4, unit="m")
    earth_km_s = [10.0, 25.0, 12.0] * u.km / u.s
    bare = topocentric_tdb_minus_tt([1e4, 2.5e4, 1.2e4], [4075539.9, 931735.2, 4801629.4])
    assert topocentric_tdb_minus_tt(earth_km_s, station) == pytest.approx(bare, rel=1e-14)


ITRF_M = np.array([4075539.9, 931735.2, 4801629.4])


def station(**changes):
    fields = {
        "name": "OWN", "aliases": (), "kind": "vlbi", "itrf_m": ITRF_M, "epoch_year": 2010.0, "quality": "survey",
        "source": "made up",
    } | changes  # fmt: skip
    return Station(**fields)


def test_quantities_are_converted_and_bare_numbers_left_as_they_are():
    assert as_metres(1.5 * u.km, "x") == 1500.0
    assert in_unit(Angle("1d30m"), "deg", "x") == 1.5
    assert in_unit(180.0 * u.deg, "rad", "x") == np.pi
    assert in_unit(2.0 * u.hour, "s", "x") == 7200.0
    assert np.array_equal(as_metres([1.0 * u.km, 3.0 * u.m], "x"), [1000.0, 3.0])
    assert np.array_equal(as_metres(Table({"x": [1.0, 2.0] * u.km})["x"], "x"), [1000.0, 2000.0])
    bare = [1.0, 2.0]
    assert as_metres(bare, "x") is bare


@pytest.mark.parametrize("value", [1.0 * u.s, [1.0 * u.m, 2.0], 3.0 * u.dimensionless_unscaled])
def test_what_is_no_length_is_refused_by_name(value):
    with pytest.raises(InputError, match="range_m"):
        as_metres(value, "range_m")


def test_a_station():
    assert np.abs(station(itrf_m=ITRF_M / 1e3 * u.km).itrf_m - ITRF_M).max() < 1e-8
    location = EarthLocation.from_geocentric(*ITRF_M, unit="m")
    assert np.array_equal(station(itrf_m=location).itrf_m, ITRF_M)
    assert geodetic_from_itrf(location).height_m == geodetic_from_itrf(ITRF_M).height_m
    assert station(itrf_m=location).location == location
    moving = station(velocity_m_yr=[-15.0, 14.0, 10.0] * u.mm / u.yr, axis_offset_m=70.0 * u.cm)
    assert np.allclose(moving.velocity_m_yr, [-0.015, 0.014, 0.010])
    assert moving.axis_offset_m == pytest.approx(0.7)
    assert station(epoch_year=Time(2010.5, format="jyear", scale="tt")).epoch_year == 2010.5
    for wrong in (
        {"itrf_m": ITRF_M * u.s},
        {"axis_offset_m": "long"},
        {"velocity_m_yr": [1, 2] * u.m / u.yr},
    ):
        with pytest.raises(StationError, match="station OWN: "):
            station(**wrong)


def observed(**changes):
    columns = {
        "epoch": Epochs.from_jd([2460432.5, 2460432.5], [0.25, 0.5], "UTC"),
        "links": [Link("APOLLO", "apollo15", "APOLLO")],
        "value_m": [7.5e8, 7.6e8],
        "sigma_m": 0.01,
    }
    return Observations.from_columns(**(columns | changes))


def test_columns_of_observations_with_units():
    table = observed(
        value_m=[7.5e5, 7.6e5] * u.km,
        sigma_m=10.0 * u.mm,
        pressure_hpa=[72e3, 73e3] * u.Pa,
        temperature_k=280.0 * u.K,
        relative_humidity=30.0 * u.percent,
        wavelength_um=35.7 * u.mm,
        uplink_hz=7.1 * u.GHz,
        count_s=1.0 * u.min,
    )
    for name, expected in {
        "value_m": [7.5e8, 7.6e8], "sigma_m": 0.01, "pressure_hpa": [720.0, 730.0], "temperature_k": 280.0,
        "relative_humidity": 0.3, "wavelength_um": 35.7e3, "uplink_hz": 7.1e9, "count_s": 60.0,
    }.items():  # fmt: skip
        np.testing.assert_allclose(
            getattr(table, name), np.broadcast_to(expected, 2), rtol=1e-15, err_msg=name
        )
    rows = Table({"range": [7.5e5, 7.6e5] * u.km, "sigma": [1.0, 2.0]})
    assert np.array_equal(observed(value_m=rows["range"], sigma_m=rows["sigma"]).value_m, [7.5e8, 7.6e8])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("value_m", [2.5, 2.6] * u.s, "value_m is in s; give m"),
        ("temperature_k", 7.0 * u.deg_C, "temperature_k is in deg_C; give K"),
        ("value_m", ["750000,1", "760000,2"], "with a decimal point, got '750000,1'"),
        ("value_m", np.ma.masked_array([7.5e8, 7.6e8], [False, True]), "observation 2: value_m"),
    ],
)
def test_columns_that_are_not_what_their_name_says(name, value, message):
    with pytest.raises(InputError, match=message):
        observed(**{name: value})


def test_masked_weather_was_not_recorded():
    pressure_hpa = Table({"p": np.ma.masked_array([720.0, 1e5], [False, True])}, units={"p": "hPa"})["p"]
    assert np.array_equal(observed(pressure_hpa=pressure_hpa).pressure_hpa, [720.0, np.nan], equal_nan=True)
