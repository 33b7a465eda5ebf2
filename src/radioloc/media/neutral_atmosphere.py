"""Delays in the neutral atmosphere from the weather on the ground, one way: of laser light, and of radio at the zenith.

Light: the conventional model of the IERS Conventions (2010), section 9.1: the delay at the zenith of Mendes and
Pavlis (2004), good to about a millimetre from 0.355 to 1.064 micrometres, times the mapping function FCULa of Mendes
et al. (2002), which includes the bending of the ray, down to 3 degrees of elevation. Some 2.4 m at the zenith at sea
level, 1.9 m at 2000 m height, three times as much at 20 degrees of elevation. Horizontal gradients are not modelled:
some millimetres at 20 degrees of elevation as a rule, up to 50 mm at 10 degrees (Hulley and Pavlis 2007).

Radio: below some 30 GHz air does not disperse. The hydrostatic part, 2.3 m at sea level, follows from the pressure on
the ground to half a millimetre per 0.2 hPa. The wet part, 0 to 0.4 m, follows from the humidity on the ground to
a few centimetres only, so it is estimated where millimetres count. :mod:`radioloc.media.mapping_functions` maps both
to the elevation of the ray.

Arguments are arrays of one shape, or numbers: pressure and vapour pressure (hPa), temperature (K), relative humidity (0
to 1), latitude (rad), height above the ellipsoid (m), wavelength in vacuum (micrometres).
"""

from __future__ import annotations

import numpy as np

from radioloc.media.mapping_functions import continued_fraction
from radioloc.vectors import Floats

STANDARD_GRAVITY_M_S2 = 9.80665
"""Gravity of the column's centre of mass in the wet delay and in GPT3, m/s^2."""

DRY_AIR_KG_MOL = 28.965e-3
"""Molar mass of dry air, kg/mol."""

GAS_CONSTANT_J_K_MOL = 8.3143
"""Gas constant of GPT3, J/(K mol)."""

_CO2_PPM = 375.0  # 50 ppm more lengthen the zenith delay of light by 0.06 mm
_HYDROSTATIC_DISPERSION = (238.0185, 19990.975, 57.362, 579.55174)
"""k0 (um^-2), k1*, k2 (um^-2), k3* of the group refractivity of dry air (Ciddor 1996)."""

_WET_DISPERSION = (295.235, 2.6422, -0.032380, 0.004028)
"""w0 to w3 of the group refractivity of water vapour (Ciddor 1996)."""

_FCULA = np.array(
    [
        (0.121008e-2, 0.17295e-5, 0.3191e-4, -0.18478e-7),
        (0.304965e-2, 0.2346e-5, -0.1035e-3, -0.1856e-7),
        (0.68777e-1, 0.1972e-4, -0.3458e-2, 0.1060e-6),
    ]
)
"""Constant, per degree Celsius, per cosine of latitude, per metre (Mendes et al. 2002)."""

_SATURATION = (1.2378847e-5, -1.9121316e-2, 33.93711047, -6.3431645e3)
"""Factors of T^2, T, 1, 1/T in the logarithm of the saturation pressure of water vapour, Pa (Davis 1992)."""

_CELSIUS_K = 273.15
_K1_K_HPA = 77.604
_K2_K_HPA = 64.79
_K3_K2_HPA = 377600.0
_WATER_PER_DRY_AIR = 18.0152 / 28.9644


def optical_delay(
    elevation_rad: Floats,
    pressure_hpa: Floats,
    temperature_k: Floats,
    relative_humidity: Floats,
    wavelength_um: Floats,
    latitude_rad: Floats,
    height_m: Floats,
) -> tuple[Floats, Floats]:
    """Return delay of light along a ray, m, and its derivative, m/rad; elevation without refraction, 3 to 90 deg."""
    vapour_hpa = water_vapour_pressure_hpa(temperature_k, relative_humidity, pressure_hpa)
    hydrostatic_m, wet_m = zenith_delay_m(pressure_hpa, vapour_hpa, wavelength_um, latitude_rad, height_m)
    mapping, rate = mapping_function(elevation_rad, temperature_k, latitude_rad, height_m)
    zenith_m = hydrostatic_m + wet_m
    return zenith_m * mapping, zenith_m * rate


def zenith_delay_m(
    pressure_hpa: Floats,
    vapour_pressure_hpa: Floats,
    wavelength_um: Floats,
    latitude_rad: Floats,
    height_m: Floats,
) -> tuple[Floats, Floats]:
    """Return hydrostatic and wet zenith delay of light, m: Mendes and Pavlis (2004), eq. 20, 24, 26, 32 and 38."""
    sigma2 = wavelength_um**-2.0
    k0, k1, k2, k3 = _HYDROSTATIC_DISPERSION
    dry = k1 * (k0 + sigma2) / (k0 - sigma2) ** 2 + k3 * (k2 + sigma2) / (k2 - sigma2) ** 2
    dry = 0.01 * dry * (1.0 + 0.534e-6 * (_CO2_PPM - 450.0))
    w0, w1, w2, w3 = _WET_DISPERSION
    moist = 0.003101 * (w0 + 3.0 * w1 * sigma2 + 5.0 * w2 * sigma2**2 + 7.0 * w3 * sigma2**3)
    gravity = column_gravity(latitude_rad, height_m)
    wet_m = 1e-4 * (5.316 * moist - 3.759 * dry) * vapour_pressure_hpa / gravity
    return 2.416579e-3 * dry * pressure_hpa / gravity, wet_m


def mapping_function(
    elevation_rad: Floats, temperature_k: Floats, latitude_rad: Floats, height_m: Floats
) -> tuple[Floats, Floats]:
    """Return FCULa of Mendes et al. (2002) for light, and its derivative with respect to elevation, 1/rad."""
    celsius, cos_latitude = temperature_k - _CELSIUS_K, np.cos(latitude_rad)
    abc = (c[0] + c[1] * celsius + c[2] * cos_latitude + c[3] * height_m for c in _FCULA)
    return continued_fraction(np.sin(elevation_rad), np.cos(elevation_rad), *abc)


def water_vapour_pressure_hpa(
    temperature_k: Floats, relative_humidity: Floats, pressure_hpa: Floats
) -> Floats:
    """Return the partial pressure of water vapour, hPa, from relative humidity over water (also below freezing)."""
    # Davis (1992) with the enhancement factor in air: the formulas of the refractivity of Ciddor (1996) on which the
    # zenith delay rests. Magnus' formula differs by less than 1 %, 0.04 mm of zenith delay in the wettest air.
    a, b, c, d = _SATURATION
    saturation_hpa = 0.01 * np.exp(a * temperature_k**2 + b * temperature_k + c + d / temperature_k)
    enhancement = 1.00062 + 3.14e-6 * pressure_hpa + 5.6e-7 * (temperature_k - _CELSIUS_K) ** 2
    return relative_humidity * enhancement * saturation_hpa


def column_gravity(latitude_rad: Floats | float, height_m: Floats | float) -> Floats:
    """Return gravity at the centre of mass of the column of air, relative to its mean (Davis et al. 1985)."""
    return 1.0 - 0.00266 * np.cos(2.0 * latitude_rad) - 0.28e-6 * height_m


def zenith_hydrostatic_delay_m(
    pressure_hpa: Floats, latitude_rad: Floats | float, height_m: Floats | float
) -> Floats:
    """Return the hydrostatic zenith delay of radio, m, from total pressure (Saastamoinen 1972; IERS 2010, eq. 9.11)."""
    # A height above the geoid in place of the ellipsoid changes it by 0.1 mm at most.
    return 0.0022768 * pressure_hpa / column_gravity(latitude_rad, height_m)


def zenith_wet_delay_m(vapour_pressure_hpa: Floats, temperature_k: Floats) -> Floats:
    """Return the wet zenith delay of radio from ground weather, m, good to 2 to 5 cm (Saastamoinen 1972, eq. 19a)."""
    return 0.002277 * (1255.0 / temperature_k + 0.05) * vapour_pressure_hpa


def zenith_wet_delay_askne_nordius_m(
    vapour_pressure_hpa: Floats, mean_temperature_k: Floats, vapour_decrease_factor: Floats
) -> Floats:
    """Return the wet zenith delay of radio from mean temperature and decrease factor of the vapour, m."""
    # Askne and Nordius (1987), eq. 22, with their refractivity constants. The mean temperature is weighted with vapour;
    # the decrease factor is the exponent with which vapour pressure falls relative to pressure.
    k2_prime = _K2_K_HPA - _K1_K_HPA * _WATER_PER_DRY_AIR
    refractivity = 1e-6 * (k2_prime + _K3_K2_HPA / mean_temperature_k) * vapour_pressure_hpa
    dry_gas_constant = GAS_CONSTANT_J_K_MOL / DRY_AIR_KG_MOL
    return refractivity * dry_gas_constant / ((vapour_decrease_factor + 1.0) * STANDARD_GRAVITY_M_S2)


def standard_weather(height_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return standard pressure (hPa), temperature (K) and relative humidity at a height above the geoid, m."""
    # Berg (1948), as usual for GNSS. True pressure differs by 10 hPa as a rule and by up to 40, which is 23 to 90 mm
    # of zenith delay; a height above the ellipsoid in place of the geoid adds up to 12 hPa.
    pressure = 1013.25 * (1.0 - 2.26e-5 * height_m) ** 5.225
    return pressure, 291.15 - 0.0065 * height_m, 0.5 * np.exp(-0.0006396 * height_m)
