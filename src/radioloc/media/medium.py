"""Media: objects near a station that delay the signal on its way there or from there.

A leg of a light path touches one station. A :class:`Medium` is asked twice about many legs at once: to prepare what
does not depend on where exactly the target is (:class:`LegEnd`), then, for each position of the target, for the delay
with its derivatives (:class:`Leg`). It knows neither measurements nor parameters. What the media on a leg do together,
and what is in its way, is the :class:`LineOfSight`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.earth.stations import Station
from radioloc.lunar.visibility import hidden_by_moon
from radioloc.media.status import Status, first_of
from radioloc.plugins import entry_errors
from radioloc.time import Epochs
from radioloc.vectors import Floats, cross, dot, length

_DEEPEST_M = 2e4  # below any terrain of the Moon: heights about the sphere reach down to -9.2 km


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """Recorded weather, NaN where there is none; arrays of shape (n,)."""

    pressure_hpa: Floats
    temperature_k: Floats
    relative_humidity: Floats  # a fraction


@dataclass(frozen=True, slots=True, eq=False)
class StationState:
    """The stations at their events, in the GCRS: vectors of shape (n, 3), latitude and height (n,)."""

    gcrs_m: Floats
    gcrs_velocity_m_s: Floats
    up_gcrs: Floats  # unit vector along the ellipsoid's normal
    up_rate_gcrs: Floats  # its rate, 1/s
    pole_gcrs: Floats  # unit vector along the ITRF's z axis
    latitude_rad: Floats  # geodetic
    height_m: Floats  # above the ellipsoid


@dataclass(frozen=True, slots=True, eq=False)
class LegEnd:
    """Stations at one end of n light paths, and the signals there; arrays of shape (n,)."""

    stations: Sequence[Station]
    which: NDArray[np.int32]  # index into the stations
    epoch: Epochs  # TT of the events
    radio: NDArray[np.bool_]  # whether the signal is radio, not light
    phase: NDArray[np.bool_]  # whether the phase is measured, not a code or pulse with the group velocity
    frequency_hz: Floats  # of radio on this leg; NaN where it was not recorded
    wavelength_um: Floats  # of light, in vacuum, micrometres; NaN where it was not recorded
    weather: Weather  # as recorded
    weather_is_here: NDArray[np.bool_]  # whether it was recorded at this end

    def __len__(self) -> int:
        return len(self.which)

    def of_station(self, values: Sequence[Any]) -> NDArray[Any]:
        """Values of the stations, one for each leg."""
        return np.asarray(np.array(values)[self.which])


@dataclass(frozen=True, slots=True)
class Elevation:
    """Elevation without refraction, and its derivatives."""

    angle_rad: Floats
    rate_rad_s: Floats  # with time
    by_position_rad_m: Floats  # with the target's position, celestial axes, shape (n, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Legs of n light paths seen from their stations; vectors of shape (n, 3).

    Station and target are geocentric at their own instants, so the direction between them is the one seen in the frame
    that moves with the Earth (aberration is contained).
    """

    end: LegEnd
    station: StationState  # at their events
    target_gcrs_m: Floats  # at its event
    target_velocity_m_s: Floats
    distance_m: Floats = field(init=False)  # shape (n, 1)
    unit: Floats = field(init=False)  # direction from the station to the target
    velocity_m_s: Floats = field(init=False)  # of the target less that of the station
    elevation: Elevation = field(init=False)  # above the plane normal to the ellipsoid's vertical

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
    """Delay of n legs by one medium, one way; of what is ``None`` there is none. Shapes are (n,), of vectors (n, 3)."""

    delay_m: Floats  # zero where the status is not OK
    status: NDArray[np.int8] | None = None  # Status
    by_elevation_m_rad: Floats | None = None  # derivative, from which those by time and position follow
    rate_m_s: Floats | None = None  # derivative with time that does not come by way of elevation
    by_position: Floats | None = None  # by the target's position, celestial axes, beside that by elevation
    by_zenith_wet: Floats | None = None  # with the wet tropospheric delay at the zenith, m/m


@runtime_checkable
class Medium(Protocol):
    """Something that delays the signal near a station."""

    @property
    def name(self) -> str:
        """Name of the model's term, by which it is switched off."""

    @property
    def description(self) -> str:
        """Description of the term, half a sentence."""

    @property
    def limits_rad(self) -> tuple[float, ...]:
        """Elevations at which the delay begins or ceases to hold, or is not smooth."""

    def prepare(self, end: LegEnd) -> Any:
        """Prepare what does not depend on the target's place: ``None``, or a record of arrays with a row for each leg.

        :class:`CoverageError` or :class:`InputError` where the medium is not known at a station or an epoch.
        """

    def delay(self, leg: Leg, prepared: Any) -> LegDelay | None:
        """Delay and derivatives; ``None`` where there is none at all."""


@dataclass(frozen=True, slots=True, eq=False)
class LineOfSight:
    """Delay of a signal on its way to the target or from it, and what stands against using it."""

    leg: Leg
    delay_m: Floats  # of all media together, shape (n,)
    rate_m_s: Floats  # derivatives with respect to time,
    by_position: Floats  # to the target's position, celestial axes, shape (n, 3),
    by_zenith_wet: Floats  # and to the wet delay at the zenith, m/m
    status: NDArray[np.int8]  # radioloc.media.status.Status: whether the model holds, or why not


def prepared_media(media: Iterable[Medium], end: LegEnd) -> dict[str, Any]:
    """Prepare all media for legs at one end, by name."""
    prepared = {}
    for medium in media:
        with entry_errors(f"medium {medium.name}", "prepare"):
            prepared[medium.name] = medium.prepare(end)
    return prepared


def line_of_sight(
    leg: Leg,
    media: Iterable[Medium],
    prepared: Mapping[str, Any],
    moon_gcrs_m: Floats | None = None,
    is_craft: NDArray[np.bool_] | bool = True,
) -> LineOfSight:
    """Sum the delays of a leg by media, each with what it prepared, by name; the first status not OK counts."""
    # `moon_gcrs_m`, shape (n, 3): geocentric Moon, which hides targets that are spacecraft; None without any.
    n = len(leg)
    delay_m, rate_m_s, by_elevation_m_rad, by_zenith_wet = sums = np.zeros((4, n))
    names = ("delay_m", "rate_m_s", "by_elevation_m_rad", "by_zenith_wet")
    by_position: Floats | float = 0.0
    status = np.zeros(n, dtype=np.int8)
    for medium in media:
        with entry_errors(f"medium {medium.name}", "delay"):
            found = medium.delay(leg, prepared.get(medium.name))
        if found is None:
            continue
        for total, name in zip(sums, names, strict=True):
            part = getattr(found, name)
            if part is not None:
                total += part
        if found.by_position is not None:
            by_position = by_position + found.by_position
        if found.status is not None:
            status = first_of(status, found.status)
    elevation = leg.elevation
    rate_m_s = rate_m_s + by_elevation_m_rad * elevation.rate_rad_s
    by_position = by_position + by_elevation_m_rad[:, None] * elevation.by_position_rad_m
    if moon_gcrs_m is not None:
        hidden = behind_moon(leg.target_gcrs_m, leg.station.gcrs_m, moon_gcrs_m)
        status = np.where(hidden & is_craft, Status.BEHIND_MOON, status).astype(np.int8)
    status = np.where(elevation.angle_rad < 0.0, Status.BELOW_HORIZON, status).astype(np.int8)
    return LineOfSight(leg, delay_m, rate_m_s, by_position, by_zenith_wet, status)


def behind_moon(point_gcrs_m: Floats, station_gcrs_m: Floats, moon_gcrs_m: Floats) -> NDArray[np.bool_]:
    """Determine whether the Moon hides a spacecraft from a station; geocentric positions at the events, m."""
    # The Moon is the 1737.4 km sphere, or a smaller one through a spacecraft that is lower, as on a landing.
    from_moon_m = point_gcrs_m - moon_gcrs_m
    # The sphere must not hold the spacecraft itself, by rounding.
    radius_m = np.minimum(MEAN_LUNAR_RADIUS_M, np.linalg.norm(from_moon_m, axis=-1) - 1e-3)
    radius_m = np.maximum(radius_m, MEAN_LUNAR_RADIUS_M - _DEEPEST_M)
    return hidden_by_moon(from_moon_m, station_gcrs_m - moon_gcrs_m, radius_m)
