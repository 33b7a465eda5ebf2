"""Delay of radio waves in the neutral atmosphere at the zenith, and weather where none was measured.

Below some 30 GHz air does not disperse: phase and group delays are the same and do not depend on frequency.
The hydrostatic part, 2.3 m at sea level, follows from the pressure on the ground to half a millimetre per
0.2 hPa. The wet part, nothing to 0.4 m, follows from the humidity on the ground to a few centimetres only, so
it is estimated where millimetres count. :mod:`radioloc.media.mapping_functions` takes both to the ray's elevation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.media.checks import within
from radioloc.media.optical_troposphere import water_vapour_pressure_hpa

STANDARD_GRAVITY_M_S2 = 9.80665
"""Gravity of the column's centre of mass in the wet delay and in GPT3, m/s^2."""

DRY_AIR_KG_MOL = 28.965e-3
"""Molar mass of dry air, kg/mol."""

GAS_CONSTANT_J_K_MOL = 8.3143
"""Gas constant as used with GPT3, J/(K mol)."""

_HYDROSTATIC_M_HPA = 0.0022768
_WET_M_HPA = 0.002277
_K1_K_HPA = 77.604
_K2_K_HPA = 64.79
_K3_K2_HPA = 377600.0
_WATER_PER_DRY_AIR = 18.0152 / 28.9644


@dataclass(frozen=True, slots=True, eq=False)
class StandardWeather:
    """Weather of the standard atmosphere; arrays of one shape.

    Parameters
    ----------
    pressure_hpa : ndarray
        Pressure, hPa.
    temperature_k : ndarray
        Temperature, K.
    relative_humidity : ndarray
        Relative humidity, a fraction.
    vapour_pressure_hpa : ndarray
        Partial pressure of water vapour, hPa.
    """

    pressure_hpa: NDArray[np.float64]
    temperature_k: NDArray[np.float64]
    relative_humidity: NDArray[np.float64]
    vapour_pressure_hpa: NDArray[np.float64]


def zenith_hydrostatic_delay_m(
    pressure_hpa: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> NDArray[np.float64]:
    """Hydrostatic delay at the zenith, one way, m.

    Parameters
    ----------
    pressure_hpa : array_like
        Total pressure at the antenna's reference point, hPa.
    latitude_rad : array_like
        Geodetic latitude, rad.
    height_m : array_like
        Height, m; whether above the geoid or the ellipsoid makes 0.1 mm at most.

    Raises
    ------
    InputError
        A quantity is outside of what the model covers, or not finite.

    Notes
    -----
    Saastamoinen (1972) as refined by Davis et al. (1985); IERS Conventions (2010), eq. 9.11.
    """
    pressure = within("pressure", pressure_hpa, "the hydrostatic delay")
    latitude = within("latitude", latitude_rad, "the hydrostatic delay")
    height = within("height", height_m, "the hydrostatic delay")
    return np.asarray(_HYDROSTATIC_M_HPA * pressure / column_gravity(latitude, height))


def column_gravity(latitude_rad: ArrayLike, height_m: ArrayLike) -> NDArray[np.float64]:
    """Gravity at the centre of mass of the column of air over a place, as a fraction of its mean."""
    return np.asarray(1.0 - 0.00266 * np.cos(2.0 * np.asarray(latitude_rad)) - 0.28e-6 * np.asarray(height_m))


def zenith_wet_delay_m(vapour_pressure_hpa: ArrayLike, temperature_k: ArrayLike) -> NDArray[np.float64]:
    """Wet delay at the zenith from weather on the ground alone, one way, m.

    Parameters
    ----------
    vapour_pressure_hpa : array_like
        Partial pressure of water vapour at the antenna, hPa.
    temperature_k : array_like
        Temperature there, K.

    Raises
    ------
    InputError
        A quantity is outside of what can be, or not finite.

    Notes
    -----
    Saastamoinen (1972), eq. 19a: 0.002277 (1255/T + 0.05) e, for the mean decrease of humidity with height at
    middle latitudes. Off by 2 to 5 cm as weather goes.
    """
    vapour = within("water vapour pressure", vapour_pressure_hpa, "the wet delay")
    temperature = within("temperature", temperature_k, "the wet delay")
    return np.asarray(_WET_M_HPA * (1255.0 / temperature + 0.05) * vapour)


def zenith_wet_delay_askne_nordius_m(
    vapour_pressure_hpa: ArrayLike, mean_temperature_k: ArrayLike, vapour_decrease_factor: ArrayLike
) -> NDArray[np.float64]:
    """Wet delay at the zenith where the mean temperature and decrease of the vapour are known, one way, m.

    Parameters
    ----------
    vapour_pressure_hpa : array_like
        Partial pressure of water vapour at the antenna, hPa.
    mean_temperature_k : array_like
        Mean temperature of the column, weighted with its water vapour, K.
    vapour_decrease_factor : array_like
        Exponent with which vapour pressure falls relative to pressure, lambda; both as GPT3 gives them.

    Raises
    ------
    InputError
        A quantity is outside of what can be, or not finite.

    Notes
    -----
    Askne and Nordius (1987), eq. 22, with their refractivity constants.
    """
    vapour = within("water vapour pressure", vapour_pressure_hpa, "the wet delay")
    mean_temperature = within("mean temperature", mean_temperature_k, "the wet delay")
    decrease = within("water vapour decrease factor", vapour_decrease_factor, "the wet delay")
    k2_prime = _K2_K_HPA - _K1_K_HPA * _WATER_PER_DRY_AIR
    dry_gas_constant = GAS_CONSTANT_J_K_MOL / DRY_AIR_KG_MOL
    refractivity = 1e-6 * (k2_prime + _K3_K2_HPA / mean_temperature) * vapour
    return np.asarray(refractivity * dry_gas_constant / ((decrease + 1.0) * STANDARD_GRAVITY_M_S2))


def standard_weather(height_m: ArrayLike) -> StandardWeather:
    """Weather of the standard atmosphere, for a station that has measured none.

    Parameters
    ----------
    height_m : array_like
        Height above the geoid, m.

    Raises
    ------
    InputError
        A height is outside -500 to 9000 m, or not finite.

    Notes
    -----
    Berg (1948): 1013.25 hPa, 18 degrees Celsius and 50 % at sea level, the usual one of GNSS. True pressure departs
    from it by 10 hPa as a rule and by up to 40, so by 23 to 90 mm of delay at the zenith; a height above the
    ellipsoid, which is off by up to 100 m, adds 12 hPa.
    """
    height = within("height", height_m, "the standard atmosphere")
    pressure = 1013.25 * (1.0 - 2.26e-5 * height) ** 5.225
    temperature = 291.15 - 0.0065 * height
    humidity = 0.5 * np.exp(-0.0006396 * height)
    vapour = water_vapour_pressure_hpa(temperature, humidity, pressure)
    return StandardWeather(
        np.asarray(pressure), np.asarray(temperature), np.asarray(humidity), np.asarray(vapour)
    )
