"""Delay by the ionosphere at one end of a path of a radio signal, from a source of electron content."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.earth.checks import LEAST_ELEVATION_RAD
from radioloc.earth.ionosphere import (
    BASE_RADIUS_M,
    GROUP_DELAY_M3_S2,
    SHELL_HEIGHT_M,
    TECU_PER_M2,
    ionosphere_delay_m,
    modified_shell_mapping,
)
from radioloc.measurements.electron_content import ElectronContent
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.station_motion import StationMotion
from radioloc.media.status import Status
from radioloc.vectors import cross, dot


def ionosphere_delay(
    source: ElectronContent,
    observations: Observations,
    station: StationMotion,
    itrf_m: NDArray[np.float64],
    unit_gcrs: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    frequency_hz: NDArray[np.float64],
    radio: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """Delay of radio signals by the ionosphere at one end.

    Parameters
    ----------
    source : ElectronContent
    observations : Observations
        Epochs and kinds are used.
    station : StationMotion
        The station at this end.
    itrf_m : ndarray, shape (n, 3)
        Its ITRF position.
    unit_gcrs : ndarray, shape (n, 3)
        Direction to the point.
    elevation_rad : ndarray, shape (n,)
    frequency_hz : ndarray, shape (n,)
        Frequency on this leg; NaN where it was not recorded.
    radio : ndarray of bool, shape (n,)
        Which signals are radio; light has none of this.

    Returns
    -------
    delay_m : ndarray, shape (n,)
        Group delay; for Doppler and delay rates, which count the phase, its opposite. Zero where the status is not OK.
    by_elevation_m_rad : ndarray, shape (n,)
        Its derivative with respect to elevation at one vertical content: how the content differs where the ray then
        pierces the maps' shell is left out.
    status : ndarray of int8, shape (n,)
        :class:`~radioloc.media.status.Status`: why there is no delay where one is due.

    Notes
    -----
    First order, 40.3 m^3/s^2 TEC / f^2 (IERS Conventions 2010, section 9.4).
    """
    delay_m, by_elevation_m_rad = np.zeros(len(observations)), np.zeros(len(observations))
    status = np.where(radio & np.isnan(frequency_hz), Status.NO_FREQUENCY, Status.OK).astype(np.int8)
    rows = np.flatnonzero(radio & (status == Status.OK) & (elevation_rad >= LEAST_ELEVATION_RAD))
    if len(rows):
        east = cross(station.pole_gcrs[rows], station.up_gcrs[rows])
        north = cross(station.up_gcrs[rows], east)
        azimuth_rad = np.arctan2(dot(east, unit_gcrs[rows]), dot(north, unit_gcrs[rows]))
        tec = source.slant_tec(
            itrf_m[rows], azimuth_rad % (2.0 * np.pi), elevation_rad[rows], observations.epoch[rows]
        )
        phase = np.where(is_integrated(observations.kind[rows]), -1.0, 1.0)
        delay_m[rows] = phase * ionosphere_delay_m(tec, frequency_hz[rows])
        mapping, slope = modified_shell_mapping(elevation_rad[rows])
        by_elevation_m_rad[rows] = delay_m[rows] * slope / mapping
    return delay_m, by_elevation_m_rad, status


def delay_by_content_m(
    observations: Observations,
    elevation_rad: NDArray[np.float64],
    frequency_hz: NDArray[np.float64],
    radio: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Delay by one TECU of vertical content in a thin shell at 450 km, m, shape (n,).

    Its sign is that of :func:`ionosphere_delay`; zero for light and where no frequency was recorded.
    """
    by_content_m = np.zeros(len(observations))
    rows = np.flatnonzero(radio & ~np.isnan(frequency_hz))
    sine = BASE_RADIUS_M / (BASE_RADIUS_M + SHELL_HEIGHT_M) * np.cos(elevation_rad[rows])
    phase = np.where(is_integrated(observations.kind[rows]), -1.0, 1.0)
    at_frequency_m = GROUP_DELAY_M3_S2 * TECU_PER_M2 / frequency_hz[rows] ** 2
    by_content_m[rows] = phase * at_frequency_m / np.sqrt(1.0 - sine**2)
    return by_content_m


def frequencies_hz(observations: Observations, *, uplink: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Frequency of a leg: the recorded uplink's where it goes up and that was recorded, else the downlink's."""
    down_hz = C_M_S / (observations.wavelength_um * 1e-6)
    return np.where(uplink & ~np.isnan(observations.uplink_hz), observations.uplink_hz, down_hz)
