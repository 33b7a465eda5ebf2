"""Delay by the neutral atmosphere at one end of a path, and why it cannot be had where it cannot.

Light: zenith delay of Mendes and Pavlis with the mapping function FCULa, from recorded weather. Radio: the air above
the station as :mod:`radioloc.measurements.radio_atmosphere` has it, which does not depend on where the target is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.checks import LEAST_ELEVATION_RAD, WAVELENGTH_RANGE_UM
from radioloc.earth.optical_troposphere import optical_delay
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
    problem : ndarray of str, shape (n,)
        Why there is no delay; empty where there is one.
    """

    delay_m: NDArray[np.float64]
    by_elevation_m_rad: NDArray[np.float64]
    by_zenith_wet: NDArray[np.float64]
    problem: NDArray[np.str_]

    @classmethod
    def none(cls, n: int) -> SlantDelay:
        """No delay for n observations, as when the term is left out."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, dtype="<U1"))


def troposphere_delay(
    observations: Observations,
    station: StationMotion,
    elevation_rad: NDArray[np.float64],
    radio: NDArray[np.bool_],
    air: ZenithAir | None,
) -> SlantDelay:
    """Tropospheric delay at one end.

    Parameters
    ----------
    observations : Observations
        Weather and wavelength are used, of light.
    station : StationMotion
        Latitude and height of the station at this end are used, of light.
    elevation_rad : ndarray, shape (n,)
        Elevation without refraction.
    radio : ndarray of bool, shape (n,)
        Which observations are of radio signals.
    air : ZenithAir or None
        Air above the station, for radio signals; may be None where there are none.

    Notes
    -----
    :func:`radioloc.earth.optical_troposphere.optical_delay`; for radio IERS Conventions (2010), section 9.2, with
    what :mod:`radioloc.measurements.radio_atmosphere` gives.
    """
    slant = SlantDelay.none(len(observations))
    high_enough = elevation_rad >= LEAST_ELEVATION_RAD
    problem = slant.problem if high_enough.all() else np.where(high_enough, "", _TOO_LOW)
    if not radio.all():
        problem = np.where(radio, problem, _problem_of_light(observations, elevation_rad).astype(np.str_))
        rows = np.flatnonzero(~radio & (problem == ""))
        if len(rows):
            _fill_light(slant, observations, station, elevation_rad, rows)
    if air is not None:
        wanted = radio & high_enough
        _fill_radio(slant, air, elevation_rad, slice(None) if wanted.all() else np.flatnonzero(wanted))
    return SlantDelay(slant.delay_m, slant.by_elevation_m_rad, slant.by_zenith_wet, problem)


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
    slant: SlantDelay, air: ZenithAir, elevation_rad: NDArray[np.float64], rows: NDArray[np.intp] | slice
) -> None:
    dry_m, wet_m = air.hydrostatic_m[rows], air.wet_m[rows]
    mapping = air.mapping(elevation_rad[rows], rows)
    slant.delay_m[rows] = dry_m * mapping.hydrostatic + wet_m * mapping.wet
    slant.by_elevation_m_rad[rows] = dry_m * mapping.hydrostatic_rate_rad + wet_m * mapping.wet_rate_rad
    slant.by_zenith_wet[rows] = mapping.wet
