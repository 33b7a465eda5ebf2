"""Delays of light and radio in the neutral atmosphere; reference/test_iers_troposphere.py has the IERS' own values."""

import numpy as np
import pytest

from radioloc.media.neutral_atmosphere import (
    optical_delay,
    standard_weather,
    water_vapour_pressure_hpa,
    zenith_delay_m,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_askne_nordius_m,
    zenith_wet_delay_m,
)

PRESSURE_HPA, TEMPERATURE_K, HUMIDITY = 725.0, 283.15, 0.3
APACHE_POINT = np.deg2rad(32.78), 2788.0


def delay_at(elevation):
    return optical_delay(elevation, PRESSURE_HPA, TEMPERATURE_K, HUMIDITY, 0.532, *APACHE_POINT)


@pytest.mark.parametrize("elevation_deg", [3.0001, 10.0, 45.0, 89.0])
def test_rate_is_the_derivative(elevation_deg: float) -> None:
    elevation, step = np.deg2rad(elevation_deg), 1e-6
    difference = (delay_at(elevation + step)[0] - delay_at(elevation - step)[0]) / (2 * step)
    # Truncation of the central difference at 3 degrees, where the third derivative is 3e6 m.
    assert delay_at(elevation)[1] == pytest.approx(difference, rel=1e-8, abs=1e-7)


def test_shorter_waves_are_slower() -> None:
    """Against the dispersion of Marini and Murray (1973), off by 0.2 % at 355 nm."""
    wavelengths_um = np.array([0.355, 0.532, 0.6943, 1.064])
    hydrostatic_m, _ = zenith_delay_m(1013.25, 0.0, wavelengths_um, 0.7, 0.0)
    older = 0.9650 + 0.0164 / wavelengths_um**2 + 0.000228 / wavelengths_um**4
    np.testing.assert_allclose(hydrostatic_m / hydrostatic_m[1], older / older[1], rtol=0.0, atol=0.0025)


@pytest.mark.parametrize(
    ("celsius", "saturation_hpa"),
    [(0.01, 6.1166), (10.0, 12.282), (20.0, 23.393), (30.0, 42.470), (40.0, 73.849)],
)
def test_saturation_pressure(celsius: float, saturation_hpa: float) -> None:
    """IAPWS (Wagner and Pruss 2002); the enhancement in air of 1 bar adds 0.4 percent."""
    vapour = water_vapour_pressure_hpa(celsius + 273.15, 1.0, 1000.0)
    assert vapour / (1.00062 + 3.14e-3 + 5.6e-7 * celsius**2) == pytest.approx(saturation_hpa, rel=1e-3)


def test_hydrostatic_delay_of_radio() -> None:
    """Header of saasthyd.m of TU Wien, in its correction of 2025: 2.2763 m; gravity is 0.266 % less at the equator."""
    assert zenith_hydrostatic_delay_m(1000.0, np.deg2rad(48.0), 200.0) == pytest.approx(2.2763, abs=5e-5)
    equator, pole = zenith_hydrostatic_delay_m(1000.0, np.array([0.0, np.pi / 2]), 0.0)
    assert equator - 2.2768 == pytest.approx(0.00607, abs=2e-5)
    assert 2.2768 - pole == pytest.approx(0.00604, abs=2e-5)


def test_wet_delays_of_radio() -> None:
    """Saastamoinen by hand; Askne and Nordius as published with the function asknewet (J. Boehm 2013)."""
    assert zenith_wet_delay_m(10.0, 291.15) == pytest.approx(0.0992884, abs=1e-6)
    assert zenith_wet_delay_askne_nordius_m(10.9621, 273.8720, 2.8071) == pytest.approx(0.1176, abs=5e-5)


def test_standard_weather() -> None:
    pressure, temperature, humidity = standard_weather(np.array([0.0, 2000.0]))
    # ICAO's standard atmosphere has 1013.25 hPa at sea level and 795.0 hPa at 2000 m.
    np.testing.assert_allclose(pressure, [1013.25, 795.0], atol=3.0)
    assert pressure[0] == 1013.25
    np.testing.assert_allclose(temperature, [291.15, 278.15])
    np.testing.assert_allclose(humidity, [0.5, 0.5 * np.exp(-1.2792)])
