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
from radioloc.media.status import Status, first_of

SHORTEST_RADIO_UM = 1000.0
"""From this wavelength on (300 GHz), refraction is that of radio."""


@dataclass(frozen=True, slots=True)
class SlantDelay:
    """Tropospheric delay along the ray, one way.

    Parameters
    ----------
    delay_m : ndarray, shape (n,)
        Delay, m; zero where the status is not OK.
    by_elevation_m_rad : ndarray, shape (n,)
        Its derivative with respect to elevation.
    by_zenith_wet : ndarray, shape (n,)
        Its derivative with respect to the wet delay at the zenith; zero for light.
    status : ndarray of int8, shape (n,)
        :class:`~radioloc.media.status.Status`: why there is no delay.
    """

    delay_m: NDArray[np.float64]
    by_elevation_m_rad: NDArray[np.float64]
    by_zenith_wet: NDArray[np.float64]
    status: NDArray[np.int8]

    @classmethod
    def none(cls, n: int) -> SlantDelay:
        """No delay for n observations, as when the term is left out."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int8))


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
    status = np.where(high_enough, Status.OK, Status.TOO_LOW).astype(np.int8)
    if not radio.all():
        status = np.where(radio, status, first_of(status, _status_of_light(observations)))
        rows = np.flatnonzero(~radio & (status == Status.OK))
        if len(rows):
            _fill_light(slant, observations, station, elevation_rad, rows)
    if air is not None:
        wanted = radio & high_enough
        _fill_radio(slant, air, elevation_rad, slice(None) if wanted.all() else np.flatnonzero(wanted))
    return SlantDelay(slant.delay_m, slant.by_elevation_m_rad, slant.by_zenith_wet, status)


def _status_of_light(observations: Observations) -> NDArray[np.int8]:
    """Why the optical model cannot be used, but for the elevation."""
    shortest, longest = WAVELENGTH_RANGE_UM
    wavelength = observations.wavelength_um
    wrong = {
        Status.NO_WAVELENGTH: np.isnan(wavelength),
        Status.WAVELENGTH_OUTSIDE: (wavelength < shortest) | (wavelength > longest),
        Status.NO_PRESSURE: np.isnan(observations.pressure_hpa),
        Status.NO_TEMPERATURE: np.isnan(observations.temperature_k),
        Status.NO_HUMIDITY: np.isnan(observations.relative_humidity),
    }
    return np.select(list(wrong.values()), list(wrong), Status.OK).astype(np.int8)


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
