"""Delay by the neutral atmosphere at one end of a path, and why it cannot be had where it cannot.

Light: zenith delay of Mendes and Pavlis with the mapping function FCULa, from recorded weather. Radio: zenith delays of
Saastamoinen, from recorded weather or else from a standard atmosphere, with the mapping functions of Niell; or what
files of VMF3 and GPT3 say (:mod:`radioloc.measurements.radio_atmosphere`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.checks import LEAST_ELEVATION_RAD, WAVELENGTH_RANGE_UM
from radioloc.earth.mapping_functions import MappingFactors, day_of_year, niell
from radioloc.earth.optical_troposphere import optical_delay, water_vapour_pressure_hpa
from radioloc.earth.radio_troposphere import (
    standard_weather,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_m,
)
from radioloc.measurements.observations import Observations
from radioloc.measurements.radio_atmosphere import ZenithAir
from radioloc.measurements.station_motion import StationMotion

SHORTEST_RADIO_UM = 1000.0
"""From this wavelength on (300 GHz), refraction is that of radio."""

_TOO_LOW = "too low for the troposphere model (below 3 degrees)"


@dataclass(frozen=True, slots=True)
class SlantDelay:
    """Tropospheric delay along the ray, one way.

    Parameters
    ----------
    delay_m : ndarray, shape (n,)
        Delay, m; zero where there is a problem.
    by_elevation_m_rad : ndarray, shape (n,)
        Its derivative with respect to elevation.
    by_zenith_wet : ndarray, shape (n,)
        Its derivative with respect to the wet delay at the zenith; zero for light.
    standard : ndarray of bool, shape (n,)
        Whether the standard atmosphere stood in for weather that was not recorded.
    problem : ndarray of str, shape (n,)
        Why there is no delay; empty where there is one.
    """

    delay_m: NDArray[np.float64]
    by_elevation_m_rad: NDArray[np.float64]
    by_zenith_wet: NDArray[np.float64]
    standard: NDArray[np.bool_]
    problem: NDArray[np.str_]

    @classmethod
    def none(cls, n: int) -> SlantDelay:
        """No delay for n observations, as when the term is left out."""
        return cls(
            np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool), np.full(n, "", dtype=np.str_)
        )


def troposphere_delay(
    observations: Observations,
    station: StationMotion,
    elevation_rad: NDArray[np.float64],
    radio: NDArray[np.bool_] | None = None,
    weather_is_here: NDArray[np.bool_] | None = None,
    air: ZenithAir | None = None,
) -> SlantDelay:
    """Tropospheric delay at one end.

    Parameters
    ----------
    observations : Observations
        Epoch, weather and wavelength are used.
    station : StationMotion
        Latitude and height of the station at this end.
    elevation_rad : ndarray, shape (n,)
        Elevation without refraction.
    radio : ndarray of bool, shape (n,), optional
        Which observations are of radio signals; by the recorded wavelength where not given.
    weather_is_here : ndarray of bool, shape (n,), optional
        Whether the recorded weather is this station's; it is where not given.
    air : ZenithAir, optional
        What files say of the air above the station, for radio signals.

    Notes
    -----
    :func:`radioloc.earth.optical_troposphere.optical_delay`; for radio IERS Conventions (2010), section 9.2, with
    zenith delays of Saastamoinen (Davis et al. 1985) and mapping functions of Niell (1996).
    """
    n = len(observations)
    if radio is None:
        radio = observations.wavelength_um >= SHORTEST_RADIO_UM
    here = np.ones(n, dtype=bool) if weather_is_here is None else weather_is_here
    slant = SlantDelay.none(n)
    problem = np.where(radio, np.where(elevation_rad < LEAST_ELEVATION_RAD, _TOO_LOW, ""), "").astype(object)
    light = ~radio
    problem[light] = _problem_of_light(observations, elevation_rad)[light]
    rows = np.flatnonzero(light & (problem == ""))
    if len(rows):
        _fill_light(slant, observations, station, elevation_rad, rows)
    rows = np.flatnonzero(radio & (problem == ""))
    if len(rows) and air is not None:
        _fill_from_files(slant, air, elevation_rad, rows)
    elif len(rows):
        _fill_radio(slant, observations, station, elevation_rad, rows, here)
    return SlantDelay(
        slant.delay_m, slant.by_elevation_m_rad, slant.by_zenith_wet, slant.standard, problem.astype(np.str_)
    )


def _problem_of_light(observations: Observations, elevation_rad: NDArray[np.float64]) -> NDArray[np.object_]:
    """Why the optical model cannot be used; empty where it can."""
    shortest, longest = WAVELENGTH_RANGE_UM
    wavelength = observations.wavelength_um
    problem = np.full(len(observations), "", dtype=object)
    for wrong, text in (
        (elevation_rad < LEAST_ELEVATION_RAD, _TOO_LOW),
        (np.isnan(wavelength), "no wavelength recorded, which the troposphere model needs"),
        (
            (wavelength < shortest) | (wavelength > longest),
            f"no troposphere model but for {shortest}-{longest} um, or radio",
        ),
        (np.isnan(observations.pressure_hpa), "no pressure recorded, which the troposphere model needs"),
        (np.isnan(observations.temperature_k), "no temperature recorded, which the troposphere model needs"),
        (np.isnan(observations.relative_humidity), "no humidity recorded, which the troposphere model needs"),
    ):
        problem[wrong & (problem == "")] = text
    return problem


def _fill_light(
    slant: SlantDelay,
    observations: Observations,
    station: StationMotion,
    elevation_rad: NDArray[np.float64],
    rows: NDArray[np.intp],
) -> None:
    found = optical_delay(
        elevation_rad[rows],
        observations.pressure_hpa[rows],
        observations.temperature_k[rows],
        observations.relative_humidity[rows],
        observations.wavelength_um[rows],
        station.latitude_rad[rows],
        station.height_m[rows],
    )
    slant.delay_m[rows], slant.by_elevation_m_rad[rows] = found.total_m, found.elevation_rate_m_rad


def _fill_radio(
    slant: SlantDelay,
    observations: Observations,
    station: StationMotion,
    elevation_rad: NDArray[np.float64],
    rows: NDArray[np.intp],
    here: NDArray[np.bool_],
) -> None:
    height_m, latitude_rad = station.height_m[rows], station.latitude_rad[rows]
    recorded = [
        observations.pressure_hpa[rows],
        observations.temperature_k[rows],
        observations.relative_humidity[rows],
    ]
    missing = ~here[rows] | np.isnan(np.stack(recorded)).any(axis=0)
    standard = standard_weather(height_m)
    pressure, temperature, humidity = (
        np.where(missing, instead, value)
        for value, instead in zip(
            recorded, (standard.pressure_hpa, standard.temperature_k, standard.relative_humidity), strict=True
        )
    )
    dry_m = zenith_hydrostatic_delay_m(pressure, latitude_rad, height_m)
    wet_m = zenith_wet_delay_m(water_vapour_pressure_hpa(temperature, humidity, pressure), temperature)
    mapping = niell(elevation_rad[rows], latitude_rad, height_m, day_of_year(observations.epoch[rows]))
    _map_to_slant(slant, rows, dry_m, wet_m, mapping)
    slant.standard[rows] = missing


def _fill_from_files(
    slant: SlantDelay, air: ZenithAir, elevation_rad: NDArray[np.float64], rows: NDArray[np.intp]
) -> None:
    _map_to_slant(
        slant, rows, air.hydrostatic_m[rows], air.wet_m[rows], air.mapping(elevation_rad[rows], rows)
    )


def _map_to_slant(
    slant: SlantDelay,
    rows: NDArray[np.intp],
    dry_m: NDArray[np.float64],
    wet_m: NDArray[np.float64],
    mapping: MappingFactors,
) -> None:
    slant.delay_m[rows] = dry_m * mapping.hydrostatic + wet_m * mapping.wet
    slant.by_elevation_m_rad[rows] = dry_m * mapping.hydrostatic_rate_rad + wet_m * mapping.wet_rate_rad
    slant.by_zenith_wet[rows] = mapping.wet
