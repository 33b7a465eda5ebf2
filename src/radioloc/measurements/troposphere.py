"""Delay by the neutral atmosphere at one end of a path, and why it cannot be had where it cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.optical_troposphere import LEAST_ELEVATION_RAD, WAVELENGTH_RANGE_UM, optical_delay
from radioloc.measurements.observations import Observations
from radioloc.measurements.station_motion import StationMotion


@dataclass(frozen=True, slots=True)
class SlantDelay:
    """Tropospheric delay along the ray, one way.

    Parameters
    ----------
    delay_m : ndarray, shape (n,)
        Delay, m; zero where there is a problem.
    by_elevation_m_rad : ndarray, shape (n,)
        Its derivative with respect to elevation.
    problem : ndarray of str, shape (n,)
        Why there is no delay; empty where there is one.
    """

    delay_m: NDArray[np.float64]
    by_elevation_m_rad: NDArray[np.float64]
    problem: NDArray[np.str_]

    @classmethod
    def none(cls, n: int) -> SlantDelay:
        """No delay for n observations, as when the term is left out."""
        return cls(np.zeros(n), np.zeros(n), np.full(n, "", dtype=np.str_))


def troposphere_delay(
    observations: Observations, station: StationMotion, elevation_rad: NDArray[np.float64]
) -> SlantDelay:
    """Tropospheric delay of laser light with the weather recorded with each observation.

    Parameters
    ----------
    observations : Observations
        Pressure, temperature, humidity and wavelength are used.
    station : StationMotion
        Latitude and height of the station at this end.
    elevation_rad : ndarray, shape (n,)
        Elevation without refraction.

    Notes
    -----
    :func:`radioloc.earth.optical_troposphere.optical_delay`.
    """
    n = len(observations)
    delay_m, by_elevation, problem = np.zeros(n), np.zeros(n), np.full(n, "", dtype=object)
    shortest, longest = WAVELENGTH_RANGE_UM
    wavelength = observations.wavelength_um
    for wrong, text in (
        (elevation_rad < LEAST_ELEVATION_RAD, "too low for the troposphere model (below 3 degrees)"),
        (np.isnan(wavelength), "no wavelength recorded, which the troposphere model needs"),
        (
            (wavelength < shortest) | (wavelength > longest),
            f"no troposphere model but for {shortest}-{longest} um",
        ),
        (np.isnan(observations.pressure_hpa), "no pressure recorded, which the troposphere model needs"),
        (np.isnan(observations.temperature_k), "no temperature recorded, which the troposphere model needs"),
        (np.isnan(observations.relative_humidity), "no humidity recorded, which the troposphere model needs"),
    ):
        problem[wrong & (problem == "")] = text
    rows = np.flatnonzero(problem == "")
    if len(rows):
        found = optical_delay(
            elevation_rad[rows],
            observations.pressure_hpa[rows],
            observations.temperature_k[rows],
            observations.relative_humidity[rows],
            wavelength[rows],
            station.latitude_rad[rows],
            station.height_m[rows],
        )
        delay_m[rows], by_elevation[rows] = found.total_m, found.elevation_rate_m_rad
    return SlantDelay(delay_m, by_elevation, problem.astype(np.str_))
