"""The line of sight from a station to the point: its elevation, what delays a signal along it, what is in its way.

One way and at one end of a path. The delays are those of the troposphere, of the ionosphere and by the offset of the
antenna's axes, each where the model has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.measurements.axis_offset import AxisOffset, axis_offset_delay
from radioloc.measurements.elevation import Elevation, elevation_of
from radioloc.measurements.ionosphere import delay_by_content_m, frequencies_hz, ionosphere_delay
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.radio_atmosphere import ZenithAir
from radioloc.measurements.station_motion import StationMotion
from radioloc.measurements.trajectory_motion import behind_moon
from radioloc.measurements.troposphere import SlantDelay, troposphere_delay
from radioloc.media.status import Status, first_of
from radioloc.vectors import length


@dataclass(frozen=True, slots=True)
class LineOfSight:
    """Elevation of the point, delay of a signal on its way to or from it, and what stands against using it.

    Parameters
    ----------
    elevation : Elevation
        Without refraction.
    delay_m : ndarray, shape (n,)
        Of the troposphere, the ionosphere and the antenna's axes together, m.
    by_elevation_m_rad : ndarray, shape (n,)
        Derivative of that of the troposphere and the ionosphere with respect to elevation.
    by_zenith_wet : ndarray, shape (n,)
        Derivative with respect to the wet delay at the zenith, m/m.
    by_tec_m : ndarray, shape (n,)
        Derivative of the ionosphere's delay with respect to the vertical electron content, m/TECU, by a thin shell at
        450 km; with the phase's sign for what is counted, zero for light and where no frequency was recorded.
    axes : AxisOffset or None
        Delay by the offset of the axes with its derivatives; ``None`` where the model has none.
    status : ndarray of int8, shape (n,)
        :class:`~radioloc.media.status.Status`: whether the model holds, or why not.
    """

    elevation: Elevation
    delay_m: NDArray[np.float64]
    by_elevation_m_rad: NDArray[np.float64]
    by_zenith_wet: NDArray[np.float64]
    by_tec_m: NDArray[np.float64]
    axes: AxisOffset | None
    status: NDArray[np.int8]


def line_of_sight(
    model: PhysicalModel,
    paths: Observations,
    stations: Sequence[Station],
    which: NDArray[np.int32],
    motion: StationMotion,
    point_gcrs_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    *,
    radio: NDArray[np.bool_],
    uplink: NDArray[np.bool_],
    air: ZenithAir | None = None,
    moon_gcrs_m: NDArray[np.float64] | None = None,
) -> LineOfSight:
    """View of the point from the stations at one end.

    Parameters
    ----------
    model : PhysicalModel
        Which terms there are, and the ionosphere.
    paths : Observations
        Epochs, weather, wavelengths and frequencies are used, shape (n,).
    stations : sequence of Station
    which : ndarray of int, shape (n,)
        Index into `stations` of the one at this end.
    motion : StationMotion
        The stations at their events.
    point_gcrs_m, velocity_m_s : ndarray, shape (n, 3)
        Geocentric position and velocity of the point at its event, as for
        :func:`~radioloc.measurements.elevation.elevation_of`.
    radio : ndarray of bool, shape (n,)
        Whether the signal is radio, not light.
    uplink : ndarray of bool, shape (n,)
        Whether it has the frequency of the uplink.
    air : ZenithAir, optional
        Air above the stations, which delays radio signals.
    moon_gcrs_m : ndarray, shape (n, 3), optional
        Geocentric position of the Moon where it can hide the point, a spacecraft.
    """
    elevation = elevation_of(motion, point_gcrs_m, velocity_m_s)
    elevation_rad = elevation.angle_rad
    if model.has("troposphere"):
        troposphere = troposphere_delay(paths, motion, elevation_rad, radio, air)
    else:
        troposphere = SlantDelay.none(len(elevation_rad))
    delay_m, by_elevation_m_rad = troposphere.delay_m, troposphere.by_elevation_m_rad
    status = troposphere.status
    frequency_hz = frequencies_hz(paths, uplink=uplink)
    if model.has("ionosphere") and model.ionosphere is not None:
        away_m = point_gcrs_m - motion.gcrs_m
        ionosphere_m, by_elevation, no_frequency = ionosphere_delay(
            model.ionosphere,
            paths,
            motion,
            np.array([station.itrf_m for station in stations])[which],
            away_m / length(away_m)[:, None],
            elevation_rad,
            frequency_hz,
            radio,
        )
        delay_m, by_elevation_m_rad = delay_m + ionosphere_m, by_elevation_m_rad + by_elevation
        status = first_of(status, no_frequency)
    axes = None
    if model.has("antenna_axis_offset"):
        axes = axis_offset_delay(stations, which, motion, point_gcrs_m, velocity_m_s)
        delay_m = delay_m + axes.delay_m
    if moon_gcrs_m is not None:
        hidden = behind_moon(point_gcrs_m, motion.gcrs_m, moon_gcrs_m)
        status = np.where(hidden, Status.BEHIND_MOON, status).astype(np.int8)
    status = np.where(elevation_rad < 0.0, Status.BELOW_HORIZON, status).astype(np.int8)
    by_tec_m = delay_by_content_m(paths, elevation_rad, frequency_hz, radio)
    return LineOfSight(
        elevation, delay_m, by_elevation_m_rad, troposphere.by_zenith_wet, by_tec_m, axes, status
    )
