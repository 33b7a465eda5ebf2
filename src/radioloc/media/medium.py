"""What a medium is: something near a station that delays the signal on its way there or from there.

A leg of a light path touches one station. A :class:`Medium` is asked twice about many legs at once: to prepare what
does not depend on where exactly the target is (:class:`LegEnd`), then, for each position of the target, for the delay
with its derivatives (:class:`Leg`). It knows neither measurements nor parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.time import Epochs
from radioloc.vectors import cross, dot, length

Floats = NDArray[np.float64]


class Weather(Protocol):
    """Recorded weather, NaN where there is none; arrays of shape (n,)."""

    @property
    def pressure_hpa(self) -> Floats:
        """Pressure, hPa."""

    @property
    def temperature_k(self) -> Floats:
        """Temperature, K."""

    @property
    def relative_humidity(self) -> Floats:
        """Relative humidity, a fraction."""


class StationState(Protocol):
    """The stations at their events, in the GCRS; arrays of shape (n, 3), of latitude and height (n,)."""

    @property
    def gcrs_m(self) -> Floats:
        """Position."""

    @property
    def gcrs_velocity_m_s(self) -> Floats:
        """Velocity."""

    @property
    def up_gcrs(self) -> Floats:
        """Unit vector along the ellipsoid's normal."""

    @property
    def up_rate_gcrs(self) -> Floats:
        """Its rate, 1/s."""

    @property
    def pole_gcrs(self) -> Floats:
        """Unit vector along the ITRF's z axis."""

    @property
    def latitude_rad(self) -> Floats:
        """Geodetic latitude."""

    @property
    def height_m(self) -> Floats:
        """Height above the ellipsoid."""


@dataclass(frozen=True, slots=True, eq=False)
class LegEnd:
    """Stations at one end of n light paths, and the signals there.

    Parameters
    ----------
    stations : sequence of Station
    which : ndarray of int, shape (n,)
        Index into `stations`.
    epoch : Epochs
        TT of the events.
    radio : ndarray of bool, shape (n,)
        Whether the signal is radio, not light.
    phase : ndarray of bool, shape (n,)
        Whether the phase is measured and not a code or a pulse, which travel with the group velocity.
    frequency_hz : ndarray, shape (n,)
        Of radio on this leg; NaN where it was not recorded.
    wavelength_um : ndarray, shape (n,)
        Of light, in vacuum, micrometres; NaN where it was not recorded.
    weather : Weather
        As recorded.
    weather_is_here : ndarray of bool, shape (n,)
        Whether it was recorded at this end.
    """

    stations: Sequence[Station]
    which: NDArray[np.int32]
    epoch: Epochs
    radio: NDArray[np.bool_]
    phase: NDArray[np.bool_]
    frequency_hz: Floats
    wavelength_um: Floats
    weather: Weather
    weather_is_here: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.which)

    def of_station(self, values: Sequence[Any]) -> NDArray[Any]:
        """Values of the stations, one for each leg."""
        return np.asarray(np.array(values)[self.which])


@dataclass(frozen=True, slots=True)
class Elevation:
    """Elevation and its derivatives.

    Parameters
    ----------
    angle_rad : ndarray, shape (n,)
        Without refraction.
    rate_rad_s : ndarray, shape (n,)
        With time.
    by_position_rad_m : ndarray, shape (n, 3)
        With the target's position, celestial axes.
    """

    angle_rad: Floats
    rate_rad_s: Floats
    by_position_rad_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Legs of n light paths seen from their stations.

    Parameters
    ----------
    end : LegEnd
    station : StationState
        The stations at their events.
    target_gcrs_m, target_velocity_m_s : ndarray, shape (n, 3)
        Geocentric position and velocity of the target at its event. Station and target are geocentric at their own
        instants, so the direction between them is the one seen in the frame that moves with the Earth (aberration is
        contained).

    Attributes
    ----------
    distance_m : ndarray, shape (n, 1)
    unit : ndarray, shape (n, 3)
        Direction from the station to the target.
    velocity_m_s : ndarray, shape (n, 3)
        Velocity of the target less that of the station.
    elevation : Elevation
    """

    end: LegEnd
    station: StationState
    target_gcrs_m: Floats
    target_velocity_m_s: Floats
    distance_m: Floats = field(init=False)
    unit: Floats = field(init=False)
    velocity_m_s: Floats = field(init=False)
    elevation: Elevation = field(init=False)

    def __post_init__(self) -> None:
        away_m = self.target_gcrs_m - self.station.gcrs_m
        distance_m = length(away_m)[:, None]
        object.__setattr__(self, "distance_m", distance_m)
        object.__setattr__(self, "unit", away_m / distance_m)
        object.__setattr__(self, "velocity_m_s", self.target_velocity_m_s - self.station.gcrs_velocity_m_s)
        object.__setattr__(self, "elevation", self._elevation())

    def __len__(self) -> int:
        return len(self.unit)

    def azimuth_rad(self, rows: NDArray[np.intp]) -> Floats:
        """Azimuth of the target for some rows, from north through east, 0 to 2 pi."""
        up, unit = self.station.up_gcrs[rows], self.unit[rows]
        east = cross(self.station.pole_gcrs[rows], up)
        return np.asarray(np.arctan2(dot(east, unit), dot(cross(up, east), unit)) % (2.0 * np.pi))

    def _elevation(self) -> Elevation:
        """Above the plane normal to the ellipsoid's vertical."""
        up, unit = self.station.up_gcrs, self.unit
        sine = dot(up, unit)
        # arctan2 keeps its digits near the zenith, where arcsin loses half of them.
        cosine = length(cross(up, unit))
        slope = 1.0 / np.maximum(cosine, 1e-9)
        by_position = (up - unit * sine[:, None]) * slope[:, None] / self.distance_m
        turning = dot(self.station.up_rate_gcrs, unit) * slope
        return Elevation(np.arctan2(sine, cosine), dot(by_position, self.velocity_m_s) + turning, by_position)


@dataclass(frozen=True, slots=True, eq=False)
class LegDelay:
    """Delay of n legs by one medium, one way; of what is ``None`` there is none.

    Parameters
    ----------
    delay_m : ndarray, shape (n,)
        Zero where the status is not OK.
    status : ndarray of int8, shape (n,), optional
        :class:`~radioloc.media.status.Status`.
    by_elevation_m_rad : ndarray, shape (n,), optional
        Derivative with respect to elevation, from which those with respect to time and position follow.
    rate_m_s : ndarray, shape (n,), optional
        Derivative with respect to time that does not come by way of elevation.
    by_position : ndarray, shape (n, 3), optional
        Derivative with respect to the target's position, celestial axes, that does not come by way of elevation.
    by_zenith_wet : ndarray, shape (n,), optional
        Derivative with respect to the wet tropospheric delay at the zenith, m/m.
    """

    delay_m: Floats
    status: NDArray[np.int8] | None = None
    by_elevation_m_rad: Floats | None = None
    rate_m_s: Floats | None = None
    by_position: Floats | None = None
    by_zenith_wet: Floats | None = None


@runtime_checkable
class Medium(Protocol):
    """Something that delays the signal near a station."""

    @property
    def name(self) -> str:
        """Name of the model's term, by which it is switched off."""

    @property
    def description(self) -> str:
        """What the term is, half a sentence."""

    @property
    def limits_rad(self) -> tuple[float, ...]:
        """Elevations at which the delay begins or ceases to hold, or is not smooth."""

    def prepare(self, end: LegEnd) -> Any:
        """What does not depend on where the target is: ``None``, or a record of arrays with a row for each leg.

        Raises
        ------
        CoverageError, InputError
            The medium is not known at a station or an epoch.
        """

    def delay(self, leg: Leg, prepared: Any) -> LegDelay | None:
        """Delay and derivatives; ``None`` where there is none at all."""
