"""Troposphere at one end of a path, and the status of legs outside of its validity."""

import dataclasses

import numpy as np
import pytest
from arc_cases import LASER
from legs import end, leg

from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.errors import InputError
from radioloc.media.medium import Status
from radioloc.media.neutral_atmosphere import (
    standard_weather,
    water_vapour_pressure_hpa,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_m,
)
from radioloc.media.troposphere import Troposphere

KASHI = geodetic_from_itrf(end(1).stations[0].itrf_m)


def delay(elevation_deg, **changes):
    of_light = leg(elevation_deg, radio=False, **LASER | changes)
    return Troposphere().delay(of_light, Troposphere().prepare(of_light.end))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wavelength_um": np.nan}, "no wavelength"),
        ({"wavelength_um": 10.6}, "0.3545-1.0645 um"),
        ({"pressure_hpa": np.nan}, "no pressure"),
        ({"temperature_k": np.nan}, "no temperature"),
        ({"relative_humidity": np.nan}, "no humidity"),
    ],
)
def test_status_of_missing_records(changes, words):
    result = delay([30.0], **changes)
    assert words in Status(result.status[0]).text()
    assert result.delay_m.tolist() == [0.0]
    assert result.by_elevation_m_rad.tolist() == [0.0]


@pytest.mark.parametrize(
    ("recorded", "wet_temperature_k"),
    [
        ({"pressure_hpa": 870.0}, None),  # 10 hPa are 23 mm at the zenith
        ({"pressure_hpa": 870.0, "temperature_k": 280.0, "relative_humidity": 0.3}, 280.0),
        ({"relative_humidity": 0.3}, None),  # needs the temperature
    ],
)
def test_radio_uses_pressure_alone_and_temperature_with_humidity(recorded, wet_temperature_k):
    zenith, standard = leg(90.0), standard_weather(np.float64(KASHI.height_m))
    pressure_hpa = recorded.get("pressure_hpa", standard[0])
    temperature_k, humidity = standard[1:] if wet_temperature_k is None else (wet_temperature_k, 0.3)
    expected_m = zenith_hydrostatic_delay_m(
        pressure_hpa, KASHI.latitude_rad, KASHI.height_m
    ) + zenith_wet_delay_m(water_vapour_pressure_hpa(temperature_k, humidity, pressure_hpa), temperature_k)
    result = Troposphere().delay(zenith, Troposphere().prepare(end(1, **recorded)))
    assert result.delay_m[0] == pytest.approx(expected_m, rel=1e-12)


@pytest.mark.parametrize(
    ("recorded", "words"),
    [
        ({"pressure_hpa": 101325.0}, "pressure_hpa: .* got 101325"),
        ({"temperature_k": 18.0}, "temperature_k: .* got 18"),
    ],
)
def test_impossible_weather_is_an_error(recorded, words):
    with pytest.raises(InputError, match=words):
        Troposphere().prepare(end(1, **recorded))


def test_station_above_the_atmosphere_is_an_error():
    legs = end(1)
    station = dataclasses.replace(legs.stations[0], itrf_m=legs.stations[0].itrf_m * 1.0013)
    with pytest.raises(InputError, match=r"KASHI:.*-500.*9000"):
        Troposphere().prepare(dataclasses.replace(legs, stations=[station]))
