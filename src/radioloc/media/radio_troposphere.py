"""Delay of radio waves in the neutral atmosphere at the zenith, and weather where none was measured.

Below some 30 GHz air does not disperse: phase and group delays are the same and do not depend on frequency.
The hydrostatic part, 2.3 m at sea level, follows from the pressure on the ground to half a millimetre per
0.2 hPa. The wet part, nothing to 0.4 m, follows from the humidity on the ground to a few centimetres only, so
it is estimated where millimetres count. :mod:`radioloc.media.mapping_functions` takes both to the ray's elevation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.media.checks import within
from radioloc.media.optical_troposphere import column_gravity

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


def zenith_hydrostatic_delay_m(
    pressure_hpa: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike
) -> NDArray[np.float64]:
    """Hydrostatic delay at the zenith, one way, m, from the total pressure at the antenna's reference point.

    Saastamoinen (1972) as refined by Davis et al. (1985); IERS Conventions (2010), eq. 9.11. Whether the height is
    above the geoid or the ellipsoid makes 0.1 mm at most.
    """
    pressure = within("pressure", pressure_hpa, "the hydrostatic delay")
    latitude = within("latitude", latitude_rad, "the hydrostatic delay")
    height = within("height", height_m, "the hydrostatic delay")
    return np.asarray(_HYDROSTATIC_M_HPA * pressure / column_gravity(latitude, height))


def zenith_wet_delay_m(vapour_pressure_hpa: ArrayLike, temperature_k: ArrayLike) -> NDArray[np.float64]:
    """Wet delay at the zenith from weather on the ground alone, one way, m.

    Saastamoinen (1972), eq. 19a: 0.002277 (1255/T + 0.05) e, for the mean decrease of humidity with height at
    middle latitudes. Off by 2 to 5 cm as weather goes.
    """
    vapour = within("water vapour pressure", vapour_pressure_hpa, "the wet delay")
    temperature = within("temperature", temperature_k, "the wet delay")
    return np.asarray(_WET_M_HPA * (1255.0 / temperature + 0.05) * vapour)


def zenith_wet_delay_askne_nordius_m(
    vapour_pressure_hpa: ArrayLike, mean_temperature_k: ArrayLike, vapour_decrease_factor: ArrayLike
) -> NDArray[np.float64]:
    """Wet delay at the zenith where mean temperature and decrease of the vapour are known, one way, m.

    The mean temperature of the column is weighted with its water vapour; the decrease factor lambda is the exponent
    with which vapour pressure falls relative to pressure; both as GPT3 gives them.

    Askne and Nordius (1987), eq. 22, with their refractivity constants.
    """
    vapour = within("water vapour pressure", vapour_pressure_hpa, "the wet delay")
    mean_temperature = within("mean temperature", mean_temperature_k, "the wet delay")
    decrease = within("water vapour decrease factor", vapour_decrease_factor, "the wet delay")
    k2_prime = _K2_K_HPA - _K1_K_HPA * _WATER_PER_DRY_AIR
    dry_gas_constant = GAS_CONSTANT_J_K_MOL / DRY_AIR_KG_MOL
    refractivity = 1e-6 * (k2_prime + _K3_K2_HPA / mean_temperature) * vapour
    return np.asarray(refractivity * dry_gas_constant / ((decrease + 1.0) * STANDARD_GRAVITY_M_S2))


def standard_weather(height_m: ArrayLike) -> tuple[NDArray[np.float64], ...]:
    """Pressure (hPa), temperature (K) and relative humidity at heights above the geoid, where none was measured.

    Berg (1948): 1013.25 hPa, 18 degrees Celsius and 50 % at sea level, the usual one of GNSS. True pressure departs
    from it by 10 hPa as a rule and by up to 40, so by 23 to 90 mm of delay at the zenith; a height above the
    ellipsoid, which is off by up to 100 m, adds 12 hPa.
    """
    height = within("height", height_m, "the standard atmosphere")
    pressure = 1013.25 * (1.0 - 2.26e-5 * height) ** 5.225
    temperature = 291.15 - 0.0065 * height
    humidity = 0.5 * np.exp(-0.0006396 * height)
    return pressure, temperature, np.asarray(humidity)
