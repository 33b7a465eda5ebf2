"""Delay of radio waves in the ionosphere, first order in electron content.

The group delay falls with the square of frequency. In metres, for slant contents of 10 (night), 50 (day) and 150 TECU
(day at solar maximum, at 20 degrees of elevation), on the way to the Moon as to any satellite above it:

====================  =======  =======  ========
band                  10 TECU  50 TECU  150 TECU
====================  =======  =======  ========
S, 2.2 GHz             0.83     4.2      12.5
X up, 7.2 GHz          0.078    0.39      1.17
X down, 8.4 GHz        0.057    0.29      0.86
Ka, 32 GHz             0.0039   0.020     0.059
====================  =======  =======  ========

Terms of the second order are left out: for 100 TECU some 6 mm at S band and 0.1 mm at X band. Maps from GNSS reach up
to 20 000 km; the solar wind beyond, with 5 electrons per cubic centimetre, adds 0.2 TECU on the way to the Moon.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError
from radioloc.media.csp import REFERENCE_HZ, MediaCalibrations
from radioloc.media.medium import MIN_ELEVATION_RAD, Leg, LegDelay, LegEnd, Status
from radioloc.quantities import EpochsLike, accepts_quantities, convert_fields
from radioloc.time import Epochs
from radioloc.vectors import Floats, dot

GROUP_DELAY_M3_S2 = 40.308193022
"""Delay (m) times squared frequency per electron content (1/m^2): e^2 / (8 pi^2 eps0 m_e), CODATA 2018."""

TECU_PER_M2 = 1e16
"""Electrons per square metre in one unit of total electron content."""

SHELL_HEIGHT_M = 450e3
"""Usual height of the shell of maps of the ionosphere above `BASE_RADIUS_M`, m."""

BASE_RADIUS_M = 6371e3
"""Usual base radius of maps, m."""

_MODIFIED_HEIGHT_M = 506.7e3
_MODIFIED_SCALE = 0.9782
_FREQUENCY_LIMITS_HZ = (1e8, 1e12)  # of the first-order model; outside of it the unit is wrong
_MAX_SLANT_TECU = 5000.0  # three times the largest slant content at solar maximum


def ionosphere_delay_m(stec_tecu: Floats, frequency_hz: Floats) -> Floats:
    """Return the group delay along a ray, one way, m; the phase advance is equal (IERS 2010, section 9.4)."""
    if not np.all((stec_tecu >= 0.0) & (stec_tecu <= _MAX_SLANT_TECU)):
        raise InputError(
            f"electron content: expected 0 to {_MAX_SLANT_TECU:g} TECU (1e16 per square metre), got "
            f"{np.min(stec_tecu):.6g} to {np.max(stec_tecu):.6g}"
        )
    if not np.all((frequency_hz >= _FREQUENCY_LIMITS_HZ[0]) & (frequency_hz <= _FREQUENCY_LIMITS_HZ[1])):
        raise InputError(
            f"frequency of the signal: expected {_FREQUENCY_LIMITS_HZ[0]:g} to {_FREQUENCY_LIMITS_HZ[1]:g} Hz, got "
            f"{np.min(frequency_hz):.6g} to {np.max(frequency_hz):.6g}"
        )
    return GROUP_DELAY_M3_S2 * TECU_PER_M2 * stec_tecu / frequency_hz**2


def modified_shell_mapping(elevation_rad: ArrayLike) -> tuple[Floats, Floats]:
    """Return slant per vertical electron content by the modified single layer model, and its derivative, 1/rad."""
    # 1 / cos z' with sin z' = R / (R + 506.7 km) sin(0.9782 z) and R = 6371 km, fitted by CODE to the extended slab
    # model of JPL (Dach et al. 2015, Bernese GNSS Software 5.2, chapter 12). Less than a thin shell at 450 km by 2 % at
    # 45 degrees of elevation, 6 % at 20 and 7 % at 10.
    ratio = BASE_RADIUS_M / (BASE_RADIUS_M + _MODIFIED_HEIGHT_M)
    angle = _MODIFIED_SCALE * (np.pi / 2 - np.asarray(elevation_rad, dtype=np.float64))
    sine = ratio * np.sin(angle)
    mapping = (1.0 - sine**2) ** -0.5
    return mapping, -_MODIFIED_SCALE * mapping**3 * sine * ratio * np.cos(angle)


def pierce_point(
    station_itrf_m: ArrayLike,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    shell_height_m: float = SHELL_HEIGHT_M,
    base_radius_m: float = BASE_RADIUS_M,
) -> tuple[Floats, Floats]:
    """Return geocentric latitude and longitude, rad, (n,), at which rays from a station (ITRF, m) pierce the shell."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    station = np.asarray(station_itrf_m, dtype=np.float64)
    enu = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1
    )
    # The transpose of the rotation is from east, north, up to the ITRF.
    direction = np.einsum("...ji,...j->...i", rot_itrf_to_enu(station), enu)
    upward_m = dot(station, direction)
    clearance_m2 = require_shell(shell_height_m, base_radius_m) ** 2 - dot(station, station)
    # Solution of the quadratic equation for the distance to the sphere ahead.
    distance = clearance_m2 / (upward_m + np.sqrt(upward_m**2 + clearance_m2))
    x, y, z = np.moveaxis(station + distance[..., None] * direction, -1, 0)
    return np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)


def require_shell(shell_height_m: float, base_radius_m: float) -> float:
    """Return the radius of the shell, m; raise an InputError for a shell outside of the ionosphere."""
    if not (1e5 <= shell_height_m <= 2e6 and 6.3e6 <= base_radius_m <= 6.4e6):
        raise InputError(
            "shell of the ionosphere: expected 100 to 2000 km above a sphere of some 6371 km, got "
            f"{1e-3 * shell_height_m:g} km above {1e-3 * base_radius_m:g} km; correct the unit (IONEX files have km)"
        )
    return base_radius_m + shell_height_m


class ElectronContent(Protocol):
    """Source of slant electron content, such as :class:`radioloc.media.ionex.IonexMaps`."""

    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: Epochs
    ) -> Floats:
        """Return the electron content along rays from stations, TECU, shape (n,)."""


@dataclass(frozen=True, slots=True)
class UniformTec:
    """Constant vertical electron content, 0 to 1000 TECU (1e16 electrons per square metre)."""

    vertical_tecu: float

    def __post_init__(self) -> None:
        convert_fields(self)
        if not 0.0 <= self.vertical_tecu <= 1000.0:
            raise InputError(f"vertical_tecu: expected 0 to 1000 TECU, got {self.vertical_tecu!r}")

    @accepts_quantities
    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: EpochsLike
    ) -> Floats:
        """Return the vertical content times the modified single layer mapping, TECU, shape (n,)."""
        return self.vertical_tecu * modified_shell_mapping(elevation_rad)[0]


@dataclass(frozen=True, slots=True)
class Ionosphere:
    """Ionosphere on the path of radio signals: calibrations of stations that have cards, else the `source`."""

    source: ElectronContent | None = None
    calibrations: MediaCalibrations | None = None

    name: ClassVar[str] = "ionosphere"
    description: ClassVar[str] = (
        "refraction of radio signals by the ionosphere, where maps or a content are given"
    )

    @property
    def limits_rad(self) -> tuple[float, ...]:
        """Lowest elevation of the mapping."""
        return () if self.source is None else (MIN_ELEVATION_RAD,)

    def prepare(self, end: LegEnd) -> Floats | None:
        """Return calibrated delays of a code at 2295 MHz and their rates, shape (n, 2); NaN without a calibration."""
        if self.calibrations is None:
            return None
        delay_and_rate = np.full((len(end), 2), np.nan)
        for i, station in enumerate(end.stations):
            for phase in (False, True):
                rows = np.flatnonzero(end.radio & (end.station_index == i) & (end.phase == phase))
                charged = (
                    self.calibrations.charged_delay(station, end.epoch[rows], phase) if len(rows) else None
                )
                if charged is not None:
                    delay_and_rate[rows] = charged.T
        return delay_and_rate

    def delay(self, leg: Leg, prepared: Floats | None) -> LegDelay | None:
        """Return the group delay, with the opposite sign for phases, and its derivatives by elevation or time."""
        # The derivatives neglect the change of the vertical content with the pierce point.
        calibrated = np.zeros(len(leg), dtype=bool) if prepared is None else ~np.isnan(prepared[:, 0])
        if self.source is None and not calibrated.any():
            return None
        end, elevation_rad = leg.end, leg.elevation.angle_rad
        modelled = calibrated | (self.source is not None)
        unknown = end.radio & np.isnan(end.frequency_hz) & modelled
        delay_m, by_elevation_m_rad = np.zeros((2, len(leg)))
        rate_m_s = None
        if prepared is not None and calibrated.any():
            at_frequency = np.where(
                calibrated & ~unknown, _delay_sign(end) * (REFERENCE_HZ / end.frequency_hz) ** 2, 0.0
            )
            delay_m, rate_m_s = np.where(calibrated, at_frequency * prepared.T, 0.0)
        rows = np.flatnonzero(end.radio & ~unknown & ~calibrated & (elevation_rad >= MIN_ELEVATION_RAD))
        if self.source is not None and len(rows):
            itrf_m = end.per_leg([station.itrf_m for station in end.stations])[rows]
            tec = self.source.slant_tec(itrf_m, leg.azimuth_rad(rows), elevation_rad[rows], end.epoch[rows])
            delay_m[rows] = _delay_sign(end)[rows] * ionosphere_delay_m(tec, end.frequency_hz[rows])
            mapping, slope = modified_shell_mapping(elevation_rad[rows])
            by_elevation_m_rad[rows] = delay_m[rows] * slope / mapping
        status = np.where(unknown, Status.NO_FREQUENCY, Status.OK).astype(np.int8)
        return LegDelay(delay_m, status, by_elevation_m_rad, rate_m_s)


def delay_by_content_m(leg: Leg) -> Floats:
    """Return the delay of a leg by 1 TECU of vertical content, m, (n,); zero for light, NaN without a frequency."""
    mapping, _ = modified_shell_mapping(np.maximum(leg.elevation.angle_rad, MIN_ELEVATION_RAD))
    at_frequency_m = GROUP_DELAY_M3_S2 * TECU_PER_M2 / leg.end.frequency_hz**2
    return np.where(leg.end.radio, _delay_sign(leg.end) * mapping * at_frequency_m, 0.0)


def _delay_sign(end: LegEnd) -> Floats:
    """Return -1 for phases, which are advanced, and 1 for codes, which are delayed."""
    return np.where(end.phase, -1.0, 1.0)
