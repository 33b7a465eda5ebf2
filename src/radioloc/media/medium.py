"""Media that delay the signal near a station.

A leg of a light path touches one station. A :class:`Medium` first prepares what does not depend on the target's
position, for many legs at once (:class:`LegEnd`). For each position of the target it then computes the delays and their
derivatives (:class:`Leg`). The :class:`LineOfSight` is the sum over all media, with the status of each leg.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.earth.stations import Station
from radioloc.lunar.frames import hidden_by_moon
from radioloc.plugins import entry_errors
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices, Mask, cross, dot, length

MIN_ELEVATION_RAD = np.deg2rad(3.0)
"""Lowest elevation at which the mapping functions are valid."""

WAVELENGTH_RANGE_UM = (0.3545, 1.0645)
"""Validity of the refraction of light, 0.355 to 1.064 micrometres; lasers named so emit at 0.3547 and 1.0642."""


class Status(IntEnum):
    """Reason for which an end of a light path cannot be used; kept in arrays of int8."""

    OK = 0
    BELOW_HORIZON = 1
    BEHIND_MOON = 2
    EARTH_BELOW_HORIZON = 3
    TOO_LOW = 4
    NO_WAVELENGTH = 5
    WAVELENGTH_OUTSIDE = 6
    NO_PRESSURE = 7
    NO_TEMPERATURE = 8
    NO_HUMIDITY = 9
    NO_FREQUENCY = 10
    OUTSIDE_MODEL = 11
    NO_RAMP = 12

    def text(self, elevation_deg: float = np.nan, station: str = "") -> str:
        """Return the reason in words; empty for OK. The elevation is the target's, or the Earth's at the target."""
        return _TEXTS[self].format(e=elevation_deg, below=-elevation_deg, station=station)


_TEXTS = {
    Status.OK: "",
    Status.BELOW_HORIZON: "below the horizon ({e:.1f} deg)",
    Status.BEHIND_MOON: "behind the Moon as seen from {station}",
    Status.EARTH_BELOW_HORIZON: "the Earth is {below:.1f} deg below the target's horizon",
    Status.TOO_LOW: "too low for the troposphere model (below 3 degrees)",
    Status.NO_WAVELENGTH: "no wavelength recorded, which the troposphere model needs",
    Status.WAVELENGTH_OUTSIDE: "outside of the troposphere model's {}-{} um, or radio".format(
        *WAVELENGTH_RANGE_UM
    ),
    Status.NO_PRESSURE: "no pressure recorded, which the troposphere model needs",
    Status.NO_TEMPERATURE: "no temperature recorded, which the troposphere model needs",
    Status.NO_HUMIDITY: "no humidity recorded, which the troposphere model needs",
    Status.NO_FREQUENCY: "no frequency recorded, which the ionosphere needs",
    Status.OUTSIDE_MODEL: "outside of the validity of a medium's model",
    Status.NO_RAMP: "transmitted at a time without a ramp",
}


def first_failure(first: NDArray[np.int8], second: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the first status, or the second one where the first is OK."""
    return np.where(first != Status.OK, first, second)


def describe(
    status: NDArray[np.int8],
    elevation_rad: Floats,
    stations: Sequence[str] = (),
    ends: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Return code and text of the first end at which an observation cannot be used; OK and empty if usable."""
    # Status, elevation of the target (rad) and index of the station's name are those at both ends, shape (n, 2).
    end = (status[:, 0] == Status.OK).astype(np.intp)[:, None]
    code = np.take_along_axis(status, end, axis=1)[:, 0]
    texts = np.zeros(len(code), dtype="<U1")
    if not code.any():
        return code, texts
    # Each different text is made once. Tenths of a degree count only in texts that show them.
    place = np.zeros(len(code)) if ends is None else np.take_along_axis(ends, end, axis=1)[:, 0]
    tenths = np.rint(10.0 * np.degrees(np.take_along_axis(elevation_rad, end, axis=1)[:, 0]))
    place = np.where(code == Status.BEHIND_MOON, place, 0)
    tenths = np.where(code == Status.BELOW_HORIZON, tenths, 0.0)
    names = list(stations) or ["a station"]
    different, text_of_row = np.unique(np.stack([code, place, tenths]), axis=1, return_inverse=True)
    shown = [Status(int(k)).text(tenth / 10.0, names[int(p)]) for k, p, tenth in different.T.tolist()]
    return code, np.array(shown, dtype=np.str_)[text_of_row]


_MAX_DEPTH_M = 2e4  # below any terrain of the Moon, which reaches down to -9.2 km from the sphere


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """Recorded weather, arrays of shape (n,); NaN if not recorded."""

    pressure_hpa: Floats
    temperature_k: Floats
    relative_humidity: Floats  # a fraction


@dataclass(frozen=True, slots=True, eq=False)
class StationState:
    """States of the stations at their events, GCRS: vectors of shape (n, 3), latitude and height (n,)."""

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
    station_index: NDArray[np.int32]  #: into the stations
    epoch: Epochs  #: TT of the events
    radio: Mask  #: whether the signal is radio, not light
    phase: Mask  #: whether the phase is measured, not a code or pulse with the group velocity
    frequency_hz: Floats  #: of radio on this leg; NaN where it was not recorded
    wavelength_um: Floats  #: of light, in vacuum, micrometres; NaN where it was not recorded
    weather: Weather  #: as recorded
    has_weather: Mask  #: whether the weather was recorded at this end

    def __len__(self) -> int:
        return len(self.station_index)

    def per_leg(self, station_values: Sequence[Any]) -> NDArray[Any]:
        """Return for each leg the value of its station, shape (n, ...)."""
        return np.asarray(np.array(station_values)[self.station_index])


@dataclass(frozen=True, slots=True)
class Elevation:
    """Elevation without refraction, and its derivatives; shapes (n,), of vectors (n, 3)."""

    angle_rad: Floats
    rate_rad_s: Floats  # with time
    by_position_rad_m: Floats  # with the target's position, celestial axes, shape (n, 3)


@dataclass(frozen=True, eq=False)
class Leg:
    """Legs of n light paths seen from their stations; vectors of shape (n, 3).

    Station and target are geocentric at their own instants. The direction between them therefore contains aberration,
    as in the frame that moves with the Earth.
    """

    end: LegEnd
    station: StationState  #: at their events
    target_gcrs_m: Floats  #: at its event
    target_velocity_m_s: Floats

    def __len__(self) -> int:
        return len(self.target_gcrs_m)

    @cached_property
    def _separation_m(self) -> Floats:
        return self.target_gcrs_m - self.station.gcrs_m

    @cached_property
    def distance_m(self) -> Floats:
        """Distance of the target, m, shape (n, 1)."""
        return length(self._separation_m)[:, None]

    @cached_property
    def unit(self) -> Floats:
        """Direction from the station to the target."""
        return self._separation_m / self.distance_m

    @cached_property
    def velocity_m_s(self) -> Floats:
        """Velocity of the target relative to the station, m/s."""
        return self.target_velocity_m_s - self.station.gcrs_velocity_m_s

    def azimuth_rad(self, rows: Indices) -> Floats:
        """Return the azimuth of the target for some rows, from north through east, 0 to 2 pi."""
        up, unit = self.station.up_gcrs[rows], self.unit[rows]
        east = cross(self.station.pole_gcrs[rows], up)
        return np.asarray(np.arctan2(dot(east, unit), dot(cross(up, east), unit)) % (2.0 * np.pi))

    @cached_property
    def elevation(self) -> Elevation:
        """Elevation above the plane normal to the ellipsoid's vertical."""
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
    """Delay of n legs by one medium, one way; ``None`` stands for zeros. Shapes are (n,), of vectors (n, 3)."""

    delay_m: Floats  #: zero where the status is not OK
    status: NDArray[np.int8] | None = None  #: Status
    by_elevation_m_rad: Floats | None = None  #: derivative, which implies those by time and position
    rate_m_s: Floats | None = None  #: derivative with time beside that by elevation
    by_position: Floats | None = None  #: by the target's position, celestial axes, beside that by elevation
    by_zenith_wet: Floats | None = None  #: with the wet tropospheric delay at the zenith, m/m


@runtime_checkable
class Medium(Protocol):
    """Model of a medium that delays the signal near a station."""

    @property
    def name(self) -> str:
        """Name of the model's term, by which it is switched off."""

    @property
    def description(self) -> str:
        """Description of the term, half a sentence."""

    @property
    def limits_rad(self) -> tuple[float, ...]:
        """Elevations at which the validity of the model ends or the delay is not smooth."""

    def prepare(self, end: LegEnd) -> Any:
        """Prepare the part independent of the target's position: ``None``, or a record of arrays with a row per leg.

        Raise :class:`CoverageError` or :class:`InputError` for a station or epoch without data of the medium.
        """

    def delay(self, leg: Leg, prepared: Any) -> LegDelay | None:
        """Return the delay and its derivatives, or ``None`` if no leg has a delay."""


@dataclass(frozen=True, slots=True, eq=False)
class LineOfSight:
    """Delay of n legs by all media, and the status of each leg."""

    leg: Leg
    delay_m: Floats  # sum over the media, shape (n,)
    rate_m_s: Floats  # derivative with time
    by_position: Floats  # derivative with the target's position, celestial axes, shape (n, 3)
    by_zenith_wet: Floats  # derivative with the wet delay at the zenith, m/m
    status: NDArray[np.int8]  # radioloc.media.medium.Status


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
    is_craft: Mask | bool = True,
) -> LineOfSight:
    """Sum the delays of legs by media from their prepared data, by name; the first failed status of a leg counts."""
    # `moon_gcrs_m`, shape (n, 3): geocentric Moon, which hides targets that are spacecraft; None without spacecraft.
    n = len(leg)
    delay_m, rate_m_s, by_elevation_m_rad, by_zenith_wet = sums = np.zeros((4, n))
    names = ("delay_m", "rate_m_s", "by_elevation_m_rad", "by_zenith_wet")
    by_position: Floats | float = 0.0
    status = np.zeros(n, dtype=np.int8)
    for medium in media:
        with entry_errors(f"medium {medium.name}", "delay"):
            leg_delay = medium.delay(leg, prepared.get(medium.name))
        if leg_delay is None:
            continue
        for total, name in zip(sums, names, strict=True):
            part = getattr(leg_delay, name)
            if part is not None:
                total += part
        if leg_delay.by_position is not None:
            by_position = by_position + leg_delay.by_position
        if leg_delay.status is not None:
            status = first_failure(status, leg_delay.status)
    elevation = leg.elevation
    rate_m_s = rate_m_s + by_elevation_m_rad * elevation.rate_rad_s
    by_position = by_position + by_elevation_m_rad[:, None] * elevation.by_position_rad_m
    if moon_gcrs_m is not None:
        hidden = behind_moon(leg.target_gcrs_m, leg.station.gcrs_m, moon_gcrs_m)
        status = np.where(hidden & is_craft, Status.BEHIND_MOON, status).astype(np.int8)
    status = np.where(elevation.angle_rad < 0.0, Status.BELOW_HORIZON, status).astype(np.int8)
    return LineOfSight(leg, delay_m, rate_m_s, by_position, by_zenith_wet, status)


def behind_moon(point_gcrs_m: Floats, station_gcrs_m: Floats, moon_gcrs_m: Floats) -> Mask:
    """Return whether the Moon hides a spacecraft from a station; geocentric positions at the events, m."""
    # The Moon is the 1737.4 km sphere, or a smaller one through a spacecraft that is lower, as on a landing.
    from_moon_m = point_gcrs_m - moon_gcrs_m
    # A millimetre less keeps the spacecraft outside of the sphere in spite of rounding.
    radius_m = np.minimum(MEAN_LUNAR_RADIUS_M, np.linalg.norm(from_moon_m, axis=-1) - 1e-3)
    radius_m = np.maximum(radius_m, MEAN_LUNAR_RADIUS_M - _MAX_DEPTH_M)
    return hidden_by_moon(from_moon_m, station_gcrs_m - moon_gcrs_m, radius_m)
