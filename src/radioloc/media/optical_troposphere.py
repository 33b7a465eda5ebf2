"""Delay of laser light in the neutral atmosphere, one way, from surface weather.

The conventional model of the IERS Conventions (2010), section 9.1: the delay at the zenith of Mendes and
Pavlis (2004), good to about a millimetre from 0.355 to 1.064 micrometres, times the mapping function FCULa
of Mendes et al. (2002), which takes in the bending of the ray, down to 3 degrees of elevation. Some 2.4 m
at the zenith at sea level, 1.9 m at 2000 m height, three times as much at 20 degrees of elevation.

Horizontal gradients are not modelled: some millimetres at 20 degrees of elevation as a rule, up to 50 mm at
10 degrees (Hulley and Pavlis 2007).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.media.checks import within
from radioloc.media.mapping_functions import continued_fraction

_MODEL = "the optical delay"

_CO2_PPM = 375.0

_HYDROSTATIC_DISPERSION = (238.0185, 19990.975, 57.362, 579.55174)
"""k0 (um^-2), k1*, k2 (um^-2), k3* of the group refractivity of dry air (Ciddor 1996)."""

_WET_DISPERSION = (295.235, 2.6422, -0.032380, 0.004028)
"""w0 to w3 of the group refractivity of water vapour (Ciddor 1996)."""

_MAPPING = np.array(
    [
        (0.121008e-2, 0.17295e-5, 0.3191e-4, -0.18478e-7),
        (0.304965e-2, 0.2346e-5, -0.1035e-3, -0.1856e-7),
        (0.68777e-1, 0.1972e-4, -0.3458e-2, 0.1060e-6),
    ]
)
"""FCULa: constant, per degree Celsius, per cosine of latitude, per metre (Mendes et al. 2002)."""

_SATURATION = (1.2378847e-5, -1.9121316e-2, 33.93711047, -6.3431645e3)
"""Factors of T^2, T, 1, 1/T in the logarithm of the saturation pressure of water vapour, Pa (Davis 1992)."""

_CELSIUS_K = 273.15


def optical_delay(
    elevation_rad: ArrayLike,
    pressure_hpa: ArrayLike,
    temperature_k: ArrayLike,
    relative_humidity: ArrayLike,
    wavelength_um: ArrayLike,
    latitude_rad: ArrayLike,
    height_m: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Delay of laser light along a ray from or to the ground, one way, m, and its derivative with elevation, m/rad.

    Elevation is without refraction, at least 3 degrees; weather that at the station's reference point; the wavelength
    that in vacuum; the height above the ellipsoid.

    IERS Conventions (2010), section 9.1.
    """
    vapour_hpa = water_vapour_pressure_hpa(temperature_k, relative_humidity, pressure_hpa)
    hydrostatic_m, wet_m = zenith_delay_m(pressure_hpa, vapour_hpa, wavelength_um, latitude_rad, height_m)
    mapping, rate = mapping_function(elevation_rad, temperature_k, latitude_rad, height_m)
    zenith_m = hydrostatic_m + wet_m
    return zenith_m * mapping, zenith_m * rate


def zenith_delay_m(
    pressure_hpa: ArrayLike,
    vapour_pressure_hpa: ArrayLike,
    wavelength_um: ArrayLike,
    latitude_rad: ArrayLike,
    height_m: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Zenith delay of laser light: hydrostatic part and wet part, m.

    Mendes and Pavlis (2004), eq. 20, 24, 26, 32 and 38; IERS Conventions (2010), section 9.1. For 375 ppm
    of CO2; 50 ppm more lengthen the delay by 0.06 mm.
    """
    pressure = within("pressure", pressure_hpa, _MODEL)
    vapour = within("water vapour pressure", vapour_pressure_hpa, _MODEL)
    wavelength = within("wavelength", wavelength_um, _MODEL)
    latitude = within("latitude", latitude_rad, _MODEL)
    height = within("height", height_m, _MODEL)

    sigma2 = wavelength**-2.0
    k0, k1, k2, k3 = _HYDROSTATIC_DISPERSION
    dry = k1 * (k0 + sigma2) / (k0 - sigma2) ** 2 + k3 * (k2 + sigma2) / (k2 - sigma2) ** 2
    dry = 0.01 * dry * (1.0 + 0.534e-6 * (_CO2_PPM - 450.0))
    w0, w1, w2, w3 = _WET_DISPERSION
    moist = 0.003101 * (w0 + 3.0 * w1 * sigma2 + 5.0 * w2 * sigma2**2 + 7.0 * w3 * sigma2**3)
    gravity = column_gravity(latitude, height)
    return 2.416579e-3 * dry * pressure / gravity, 1e-4 * (5.316 * moist - 3.759 * dry) * vapour / gravity


def mapping_function(
    elevation_rad: ArrayLike, temperature_k: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mapping function FCULa and its derivative with respect to elevation, 1/rad, from surface temperature.

    Mendes et al. (2002); IERS Conventions (2010), section 9.1: a continued fraction in the sine of elevation.
    """
    elevation = within("elevation", elevation_rad, _MODEL)
    celsius = within("temperature", temperature_k, _MODEL) - _CELSIUS_K
    cos_latitude = np.cos(within("latitude", latitude_rad, _MODEL))
    height = within("height", height_m, _MODEL)
    abc = (c[0] + c[1] * celsius + c[2] * cos_latitude + c[3] * height for c in _MAPPING)
    return continued_fraction(np.sin(elevation), np.cos(elevation), *abc)


def column_gravity(latitude_rad: ArrayLike, height_m: ArrayLike) -> NDArray[np.float64]:
    """Gravity at the centre of mass of the column of air over a place, as a fraction of its mean.

    Saastamoinen (1972) as refined by Davis et al. (1985).
    """
    return np.asarray(1.0 - 0.00266 * np.cos(2.0 * np.asarray(latitude_rad)) - 0.28e-6 * np.asarray(height_m))


def water_vapour_pressure_hpa(
    temperature_k: ArrayLike, relative_humidity: ArrayLike, pressure_hpa: ArrayLike
) -> NDArray[np.float64]:
    """Partial pressure of water vapour, hPa, from relative humidity over water (also below freezing), 0 to 1.

    Saturation pressure of Davis (1992) with the enhancement factor in air, 1.00062 + 3.14e-6 P + 5.6e-7
    t^2: the formulas of the refractivity of Ciddor (1996) on which the zenith delay rests. Others, such as
    that of Magnus, differ by less than 1 percent above freezing, 0.04 mm of zenith delay in the wettest
    air.
    """
    temperature = within("temperature", temperature_k, _MODEL)
    humidity = within("relative humidity", relative_humidity, _MODEL)
    pressure = within("pressure", pressure_hpa, _MODEL)
    a, b, c, d = _SATURATION
    saturation_hpa = 0.01 * np.exp(a * temperature**2 + b * temperature + c + d / temperature)
    enhancement = 1.00062 + 3.14e-6 * pressure + 5.6e-7 * (temperature - _CELSIUS_K) ** 2
    return np.asarray(humidity * enhancement * saturation_hpa)
