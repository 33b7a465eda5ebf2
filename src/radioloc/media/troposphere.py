"""Delay by the neutral atmosphere at one end of a path.

Light: zenith delay of Mendes and Pavlis with the mapping function FCULa, from recorded weather. Radio: zenith delays
and mapping functions of :mod:`radioloc.media.radio_atmosphere`, which do not depend on the target's position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.media.csp import MediaCalibrations
from radioloc.media.medium import (
    MIN_ELEVATION_RAD,
    WAVELENGTH_RANGE_UM,
    Leg,
    LegDelay,
    LegEnd,
    Status,
    first_failure,
)
from radioloc.media.neutral_atmosphere import optical_delay
from radioloc.media.radio_atmosphere import RadioAtmosphere, ZenithAir, zenith_air
from radioloc.vectors import Indices

_WEATHER_LIMITS = {"pressure_hpa": (300.0, 1100.0, "hPa"), "temperature_k": (200.0, 340.0, "K")}
"""Validity of the models of the air: lowest and highest value, unit."""


@dataclass(frozen=True, slots=True)
class Troposphere:
    """Neutral atmosphere: of light by IERS Conventions (2010), section 9.1, of radio by section 9.2."""

    files: RadioAtmosphere | None = None
    calibrations: MediaCalibrations | None = None

    name: ClassVar[str] = "troposphere"
    description: ClassVar[str] = "refraction by the neutral atmosphere at each station"
    limits_rad: ClassVar[tuple[float, ...]] = (MIN_ELEVATION_RAD,)

    def prepare(self, end: LegEnd) -> ZenithAir:
        """Prepare the air above the stations for radio signals."""
        for name, (low, high, unit) in _WEATHER_LIMITS.items():
            recorded = getattr(end.weather, name)
            wrong = recorded[(recorded < low) | (recorded > high)]
            if len(wrong):
                raise InputError(
                    f"{name}: expected {low:g} to {high:g} {unit}, got {wrong[0]:.6g}; correct the weather"
                )
        return zenith_air(end, self.files, self.calibrations)

    def delay(self, leg: Leg, prepared: ZenithAir) -> LegDelay:
        """Return the delay along the ray and its derivatives by elevation and, of radio, by the wet zenith delay."""
        elevation_rad, radio = leg.elevation.angle_rad, leg.end.radio
        high_enough = elevation_rad >= MIN_ELEVATION_RAD
        status = np.where(high_enough, Status.OK, Status.TOO_LOW).astype(np.int8)
        delay_m, by_elevation_m_rad, by_zenith_wet = np.zeros((3, len(leg)))
        if not radio.all():
            status = np.where(radio, status, first_failure(status, _status_of_light(leg.end)))
            rows = np.flatnonzero(~radio & (status == Status.OK))
            weather = leg.end.weather
            delay_m[rows], by_elevation_m_rad[rows] = optical_delay(
                elevation_rad[rows],
                weather.pressure_hpa[rows],
                weather.temperature_k[rows],
                weather.relative_humidity[rows],
                leg.end.wavelength_um[rows],
                leg.station.latitude_rad[rows],
                leg.station.height_m[rows],
            )
        valid = radio & high_enough
        rows_of_radio: Indices | slice = slice(None) if valid.all() else np.flatnonzero(valid)
        dry_m, wet_m = prepared.hydrostatic_m[rows_of_radio], prepared.wet_m[rows_of_radio]
        mapping = prepared.mapping(elevation_rad[rows_of_radio], rows_of_radio)
        delay_m[rows_of_radio] = dry_m * mapping.hydrostatic + wet_m * mapping.wet
        by_elevation_m_rad[rows_of_radio] = (
            dry_m * mapping.hydrostatic_rate_rad + wet_m * mapping.wet_rate_rad
        )
        by_zenith_wet[rows_of_radio] = mapping.wet
        return LegDelay(delay_m, status, by_elevation_m_rad, by_zenith_wet=by_zenith_wet)


def _status_of_light(end: LegEnd) -> NDArray[np.int8]:
    """Return the reason other than the elevation for which the optical model is not valid."""
    shortest, longest = WAVELENGTH_RANGE_UM
    wavelength_um, weather = end.wavelength_um, end.weather
    wrong = {
        Status.NO_WAVELENGTH: np.isnan(wavelength_um),
        Status.WAVELENGTH_OUTSIDE: (wavelength_um < shortest) | (wavelength_um > longest),
        Status.NO_PRESSURE: np.isnan(weather.pressure_hpa),
        Status.NO_TEMPERATURE: np.isnan(weather.temperature_k),
        Status.NO_HUMIDITY: np.isnan(weather.relative_humidity),
    }
    return np.select(list(wrong.values()), list(wrong), Status.OK).astype(np.int8)
