import numpy as np
import pytest

from radioloc.media.neutral_atmosphere import (
    mapping_function,
    optical_delay,
    water_vapour_pressure_hpa,
    zenith_delay_m,
)

APACHE_POINT = {
    "pressure_hpa": 725.0,
    "temperature_k": 283.15,
    "relative_humidity": 0.3,
    "wavelength_um": 0.532,
    "latitude_rad": np.deg2rad(32.78),
    "height_m": 2788.0,
}


def test_total_is_zenith_times_mapping() -> None:
    elevation = np.deg2rad([15.0, 20.0, 45.0, 90.0])
    delay_m, _ = optical_delay(elevation, **APACHE_POINT)
    assert delay_m.shape == (4,)
    vapour_hpa = water_vapour_pressure_hpa(
        *(APACHE_POINT[k] for k in ("temperature_k", "relative_humidity", "pressure_hpa"))
    )
    zenith_m = sum(zenith_delay_m(725.0, vapour_hpa, 0.532, np.deg2rad(32.78), 2788.0))
    mapping, _ = mapping_function(elevation, 283.15, np.deg2rad(32.78), 2788.0)
    np.testing.assert_allclose(delay_m, zenith_m * mapping, rtol=1e-15)
    assert mapping[-1] == 1.0
    assert delay_m[-1] == pytest.approx(1.757, abs=0.01)
    # Flat-Earth mapping, from which the curvature takes less than 1 percent at 20 degrees.
    assert mapping[1] == pytest.approx(1.0 / np.sin(elevation[1]), rel=0.01)
    assert (mapping[:-1] < 1.0 / np.sin(elevation[:-1])).all()


def test_takes_one_weather_or_one_for_each_ray() -> None:
    elevation = np.deg2rad([20.0, 50.0])
    one, _ = optical_delay(elevation, **APACHE_POINT)
    each, _ = optical_delay(elevation, **{key: np.full(2, value) for key, value in APACHE_POINT.items()})
    np.testing.assert_array_equal(one, each)
    assert optical_delay(elevation[0], **APACHE_POINT)[0].shape == ()


@pytest.mark.parametrize("elevation_deg", [3.0001, 10.0, 20.0, 45.0, 80.0, 89.0])
def test_rate_is_the_derivative(elevation_deg: float) -> None:
    elevation, step = np.deg2rad(elevation_deg), 1e-6
    there = optical_delay(elevation + step, **APACHE_POINT)[0]
    back = optical_delay(elevation - step, **APACHE_POINT)[0]
    rate = optical_delay(elevation, **APACHE_POINT)[1]
    # Truncation of the central difference at 3 degrees, where the third derivative is 3e6 m.
    assert rate == pytest.approx((there - back) / (2 * step), rel=1e-8, abs=1e-7)
    assert rate < 0.0


def test_rate_at_zenith_is_nought() -> None:
    assert abs(optical_delay(np.pi / 2, **APACHE_POINT)[1]) < 1e-15


def test_shorter_waves_are_slower() -> None:
    """Against the dispersion of Marini and Murray (1973), off by 0.2 % at 355 nm."""
    wavelengths_um = np.array([0.355, 0.532, 0.6943, 1.064])
    hydrostatic_m, _ = zenith_delay_m(1013.25, 0.0, wavelengths_um, 0.7, 0.0)
    older = 0.9650 + 0.0164 / wavelengths_um**2 + 0.000228 / wavelengths_um**4
    np.testing.assert_allclose(hydrostatic_m / hydrostatic_m[1], older / older[1], rtol=0.0, atol=0.0025)
    assert (np.diff(hydrostatic_m) < 0.0).all()


def test_zenith_delay_at_sea_level() -> None:
    """Marini and Murray (1973), the older standard, at 45 degrees and 532 nm: 2.4236 m within 2 mm."""
    hydrostatic_m, _ = zenith_delay_m(1013.25, 0.0, 0.532, np.pi / 4, 0.0)
    dispersion = 0.9650 + 0.0164 / 0.532**2 + 0.000228 / 0.532**4
    assert hydrostatic_m == pytest.approx(dispersion * 0.002357 * 1013.25, abs=0.002)


@pytest.mark.parametrize(
    ("celsius", "saturation_hpa"),
    [(0.01, 6.1166), (10.0, 12.282), (20.0, 23.393), (30.0, 42.470), (40.0, 73.849)],
)
def test_saturation_pressure(celsius: float, saturation_hpa: float) -> None:
    """IAPWS (Wagner and Pruss 2002); the enhancement in air of 1 bar, 0.4 percent, comes on top."""
    vapour = water_vapour_pressure_hpa(celsius + 273.15, 1.0, 1000.0)
    assert vapour / (1.00062 + 3.14e-3 + 5.6e-7 * celsius**2) == pytest.approx(saturation_hpa, rel=1e-3)


def test_choice_of_humidity_formula_is_immaterial() -> None:
    """Against that of Marini and Murray (Magnus): below 0.05 mm at zenith in any weather."""
    for celsius in (-20.0, 0.0, 20.0, 35.0):
        ours = water_vapour_pressure_hpa(celsius + 273.15, 0.9, 800.0)
        magnus = 0.9 * 6.11 * 10.0 ** (7.5 * celsius / (237.3 + celsius))
        wet_m = [zenith_delay_m(800.0, vapour, 0.532, 0.5, 2000.0)[1] for vapour in (ours, magnus)]
        assert abs(wet_m[0] - wet_m[1]) < 5e-5


def test_limits_themselves_are_allowed() -> None:
    for wavelength in (0.3547, 1.06415):
        optical_delay(np.deg2rad(3.0), **(APACHE_POINT | {"wavelength_um": wavelength}))
    mapping, _ = mapping_function(np.deg2rad(90.0), 283.15, 0.5, 0.0)
    assert mapping == 1.0
