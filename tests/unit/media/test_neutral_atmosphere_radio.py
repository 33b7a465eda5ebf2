import numpy as np
import pytest

from radioloc.media.neutral_atmosphere import (
    standard_weather,
    water_vapour_pressure_hpa,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_askne_nordius_m,
    zenith_wet_delay_m,
)


def test_hydrostatic_delay_at_middle_latitude_is_the_constant() -> None:
    """At 45 degrees and sea level gravity is the mean, so the constant alone is left."""
    assert zenith_hydrostatic_delay_m(1000.0, np.pi / 4, 0.0) == pytest.approx(2.2768, abs=1e-12)


def test_hydrostatic_delay_of_the_published_example() -> None:
    """Header of saasthyd.m of TU Wien, in its correction of 2025: 2.2763 m."""
    assert zenith_hydrostatic_delay_m(1000.0, np.deg2rad(48.0), 200.0) == pytest.approx(2.2763, abs=5e-5)


def test_hydrostatic_delay_grows_where_gravity_is_less() -> None:
    equator, pole = zenith_hydrostatic_delay_m(1000.0, np.array([0.0, np.pi / 2]), 0.0)
    # 0.266 percent of 2.277 m either way.
    assert equator - 2.2768 == pytest.approx(0.00607, abs=2e-5)
    assert 2.2768 - pole == pytest.approx(0.00604, abs=2e-5)
    low, high = zenith_hydrostatic_delay_m(1000.0, np.pi / 4, np.array([0.0, 1000.0]))
    assert high - low == pytest.approx(2.2768 * 0.28e-3, abs=1e-6)


def test_wet_delay_of_saastamoinen() -> None:
    # By hand: 0.002277 * (1255 / 291.15 + 0.05) * 10.
    assert zenith_wet_delay_m(10.0, 291.15) == pytest.approx(0.0992884, abs=1e-6)
    assert zenith_wet_delay_m(0.0, 250.0) == 0.0


def test_wet_delay_of_askne_and_nordius() -> None:
    """The example published with the function asknewet (J. Boehm 2013), to the digits it gives."""
    assert zenith_wet_delay_askne_nordius_m(10.9621, 273.8720, 2.8071) == pytest.approx(0.1176, abs=5e-5)


def test_the_two_wet_delays_agree_in_usual_weather() -> None:
    """Lambda 3 and a mean temperature 10 K below that on the ground are usual at middle latitudes."""
    both = zenith_wet_delay_m(12.0, 288.0), zenith_wet_delay_askne_nordius_m(12.0, 278.0, 3.0)
    assert abs(both[0] - both[1]) < 0.01


def test_standard_weather() -> None:
    sea, mountain = 0.0, 2000.0
    pressure, temperature, humidity = standard_weather(np.array([sea, mountain]))
    np.testing.assert_allclose(pressure[0], 1013.25)
    # ICAO's standard atmosphere has 795.0 hPa at 2000 m.
    np.testing.assert_allclose(pressure[1], 795.0, atol=3.0)
    np.testing.assert_allclose(temperature, [291.15, 278.15])
    np.testing.assert_allclose(humidity, [0.5, 0.5 * np.exp(-1.2792)])
    vapour = water_vapour_pressure_hpa(temperature, humidity, pressure)
    # 20.6 hPa of saturated vapour at 18 degrees Celsius.
    assert vapour[0] == pytest.approx(10.3, abs=0.1)


def test_standard_pressure_is_hydrostatic() -> None:
    """Pressure falls as the weight of the air of that pressure and temperature, within 0.7 percent."""
    height, step = np.array([0.0, 1500.0, 3000.0]), 1.0
    above, here, below = (standard_weather(height + k * step) for k in (1, 0, -1))
    slope = (above[0] - below[0]) / (2.0 * step)
    weight = -here[0] * 9.80665 / (287.05 * here[1])
    np.testing.assert_allclose(slope, weight, rtol=0.015)
