"""Numbers with units and Times of astropy are honoured or refused, never taken for what they are not."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import Angle, EarthLocation
from astropy.table import Table
from astropy.time import Time

from radioloc.earth import Station, geodetic_from_itrf
from radioloc.errors import InputError, StationError
from radioloc.measurements import Link, Observations
from radioloc.time import Epochs
from radioloc.units import as_metres, in_unit

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
        ("value_m", np.ma.masked_array([7.5e8, 7.6e8], [False, True]), "observation 2: value_m"),
    ],
)
def test_columns_that_are_not_what_their_name_says(name, value, message):
    with pytest.raises(InputError, match=message):
        observed(**{name: value})


def test_masked_weather_was_not_recorded():
    pressure_hpa = Table({"p": np.ma.masked_array([720.0, 1e5], [False, True])}, units={"p": "hPa"})["p"]
    assert np.array_equal(observed(pressure_hpa=pressure_hpa).pressure_hpa, [720.0, np.nan], equal_nan=True)
