"""Mutual visibility of target and stations: elevations at both ends, and windows from rise to set.

An elevation is at the instant of the signal at the station. The point on the Moon is one light time earlier, as for a
downlink; for an uplink the direction differs by 2 arcseconds, 0.1 s of rise or set. Refraction is neglected, as in the
measurement model. The horizon of a point on the surface is the Moon's own, that of a spacecraft the Moon's limb.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from radioloc.constants import C_M_S, MEAN_LUNAR_RADIUS_M, SECONDS_PER_DAY
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.target_motion import MotionLike, TargetMotion, as_motion
from radioloc.quantities import DateLike, EpochsLike, accepts_quantities, convert_fields
from radioloc.time import (
    Epochs,
    epochs_from_strings,
    tai_to_tt,
    tai_to_utc,
    tt_to_tdb,
    utc_strings,
    utc_to_tai,
)
from radioloc.vectors import Floats, Indices, Mask, cross, dot, length


@dataclass(frozen=True, slots=True, eq=False)
class AtInfinity:
    """Quasar, for which only the stations' horizons count."""

    direction: Floats  # ICRS, unit vector, shape (3,); 20 arcseconds of aberration are neglected
    trajectory: ClassVar[None] = None


Sighted = TargetMotion | AtInfinity
"""Motion of a target, or a quasar."""

_COARSE_STEP_S = 60.0  # First step of dense series
_MAX_ELEVATION_RATE_RAD_S = 9e-5
"""Bound of the rate of elevations at both ends: the Earth rotates at 7.3e-5 rad/s, the Moon orbits it at up to 3.3e-6,
and the parallax of a station changes at 1.3e-6."""
_BLOCK_EPOCHS = 32768
_SEARCH_STEP_S = 300.0
_ORBIT_SEARCH_STEP_S = 60.0  # For a spacecraft, which the Moon may hide for minutes
_CROSSING_TOLERANCE_S = 0.1  # For rise and set before rounding to whole seconds


@dataclass(frozen=True, slots=True)
class Masks:
    """Lowest elevations of tracking, from -90 to 90 deg."""

    station_deg: float = 10.0  #: of the target above a station's horizon
    target_deg: float = 0.0  #: of a station above the target's horizon, for terrain or antenna at the target
    #: Masks of single stations by catalogue name.
    by_station_deg: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        convert_fields(self)
        for mask_deg in (self.station_deg, self.target_deg, *self.by_station_deg.values()):
            if not -90.0 <= mask_deg <= 90.0:
                raise InputError(f"elevation mask: expected -90 to 90 deg, got {mask_deg!r}")

    def for_station(self, station: str) -> float:
        """Return the mask of a station, deg."""
        return self.by_station_deg.get(station, self.station_deg)


SPHERICAL_HORIZON = (
    "the target's horizon is that of a sphere, without terrain: state its mask, [simulation] target_mask_deg"
)
_MIN_EARTH_SINE = (
    0.34  # 20 degrees of mean elevation of the Earth: librations of 10 degrees, terrain of as much
)


def horizon_notes(masks: Masks, points_pa_m: Iterable[Floats]) -> list[str]:
    """Return a note if the Earth is low above the horizon of a point, and the masks have no terrain."""
    is_low = any(point[0] < _MIN_EARTH_SINE * np.linalg.norm(point) for point in points_pa_m)
    return [SPHERICAL_HORIZON] * (is_low and masks.target_deg == 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Elevations:
    """Elevations at both ends of n signals at k stations."""

    stations: tuple[str, ...]  #: catalogue names
    #: Of the target above each station's horizon (the plane normal to the ellipsoid's vertical), shape (n, k).
    at_station_rad: Floats
    #: Of each station above the target's horizon (the plane normal to its radius; of a spacecraft, the Moon's limb).
    at_target_rad: Floats

    def margin_rad(self, masks: Masks) -> Floats:
        """Return the smaller margin of both elevations above their masks, shape (n, k); negative if not visible."""
        station_rad = np.radians([masks.for_station(name) for name in self.stations])
        return np.minimum(
            self.at_station_rad - station_rad, self.at_target_rad - np.radians(masks.target_deg)
        )


@accepts_quantities
def elevations(
    model: PhysicalModel, target: MotionLike, stations: Sequence[str], tt: EpochsLike
) -> Elevations:
    """Compute elevations of the target and of the stations above each other's horizons.

    Parameters
    ----------
    model : PhysicalModel
        Positions of Earth, Moon and stations; its terms (tides, media) have no effect.
    target : LunarPosition, SpacecraftTrajectory or TargetMotion
        Point on the Moon; or a spacecraft, whose horizon is the Moon's limb, the sphere of 1737.4 km.
    stations : sequence of str
        Names or aliases.
    tt : Epochs
        TT at the stations, n epochs.

    Raises
    ------
    InputError
        The target is an array, whose axes are unknown: give a position, or ``FixedPoint(position_pa_m)``.
    StationError
        A station is not in the catalogue.
    CoverageError
        An epoch lies outside the kernels, the trajectory or the Earth orientation table.

    Examples
    --------
    >>> import radioloc
    >>> from radioloc.measurements import PhysicalModel
    >>> from radioloc.simulation import elevations
    >>> lander = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    >>> from radioloc.time import epochs_from_strings
    >>> tt = epochs_from_strings("2020-12-01T18:00:00", "TT")
    >>> angles = elevations(PhysicalModel.build(), lander, ["KASHI"], tt)
    >>> angles.at_station_rad.round(3).tolist()
    [[1.087]]
    """
    return StationFrames.at_epochs(model, stations, tt).elevations(as_motion(target, model))


@dataclass(frozen=True, slots=True, eq=False)
class StationFrames:
    """Positions and verticals of k stations at n epochs, from which several targets are seen."""

    model: PhysicalModel
    names: tuple[str, ...]  # in the catalogue
    tdb: Epochs
    positions_m: tuple[Floats, ...]  # GCRS, of each station (n, 3)
    verticals: tuple[Floats, ...]  # normals of the ellipsoid, GCRS, of each station (n, 3)
    moon_m: Floats  # one light time earlier, GCRS, (n, 3)
    rot_icrf_to_pa: Floats  # one light time earlier, (n, 3, 3)

    @classmethod
    def at_epochs(cls, model: PhysicalModel, stations: Sequence[str], tt: Epochs) -> StationFrames:
        """Compute the frames at epochs at the stations, TT."""
        rot_itrf_to_gcrs = model.earth.evaluate(tt).rot_itrf_to_gcrs
        entries, tdb = [model.catalogue.get(name) for name in stations], tt_to_tdb(tt)
        moon_m, velocity_m_s = model.ephemeris.geocentric("moon", tdb)
        light_time_s = np.linalg.norm(moon_m, axis=-1) / C_M_S
        return cls(
            model,
            tuple(station.name for station in entries),
            tdb,
            tuple(np.einsum("nij,nj->ni", rot_itrf_to_gcrs, item.position_at(tt)) for item in entries),
            tuple(rot_itrf_to_gcrs @ rot_itrf_to_enu(item.itrf_m)[2] for item in entries),
            moon_m - velocity_m_s * light_time_s[:, None],
            rot_icrf_to_pa(model.libration.angles(tdb.shifted(-light_time_s))[0]),
        )

    def elevations(self, target: Sighted) -> Elevations:
        """Compute elevations of a target and of the stations above each other's horizons."""
        shape = (len(self.moon_m), len(self.names))
        at_station, at_target = np.empty(shape), np.full(shape, 0.5 * np.pi)
        if isinstance(target, AtInfinity):
            towards = np.broadcast_to(target.direction, (len(self.moon_m), 3))
            for k, vertical in enumerate(self.verticals):
                at_station[:, k] = _elevation_rad(towards, vertical)
            return Elevations(self.names, at_station, at_target)
        target_gcrs_m, from_moon_m, dip_rad = self._target(target)
        moon_distance_m = np.linalg.norm(from_moon_m, axis=-1)
        target_up = from_moon_m / moon_distance_m[:, None]
        for k, (position_m, vertical) in enumerate(zip(self.positions_m, self.verticals, strict=True)):
            to_target_m = target_gcrs_m - position_m
            at_station[:, k] = _elevation_rad(to_target_m, vertical)
            # The Moon hides nothing if it is farther away than the station.
            before_moon = np.linalg.norm(to_target_m, axis=-1) > moon_distance_m
            at_target[:, k] = np.where(
                before_moon, _elevation_rad(-to_target_m, target_up) + dip_rad, 0.5 * np.pi
            )
        return Elevations(self.names, at_station, at_target)

    def _target(self, target: TargetMotion) -> tuple[Floats, Floats, Floats | float]:
        """Return the target one light time earlier from geocentre and Moon, GCRS, m, and its horizon's dip, rad."""
        trajectory = target.trajectory
        if trajectory is None:
            from_moon_m = np.einsum("nji,j->ni", self.rot_icrf_to_pa, target.position_pa_m)
            return self.moon_m + from_moon_m, from_moon_m, 0.0
        ephemeris, tdb = self.model.ephemeris, self.tdb
        distance_m = np.linalg.norm(trajectory.geocentric(ephemeris, tdb)[0], axis=-1)
        departure = tdb.shifted(-distance_m / C_M_S)
        target_gcrs_m, _ = trajectory.geocentric(ephemeris, departure)
        from_moon_m = target_gcrs_m - ephemeris.geocentric("moon", departure)[0]
        ratio = MEAN_LUNAR_RADIUS_M / np.linalg.norm(from_moon_m, axis=-1)
        return target_gcrs_m, from_moon_m, np.arccos(np.minimum(ratio, 1.0))


def _elevation_rad(away_m: Floats, up: Floats) -> Floats:
    # arctan2 keeps its digits near the zenith, where arcsin loses half of them.
    return np.arctan2(dot(up, away_m), length(cross(up, away_m)))


class Sight:
    """Stations at ordered epochs, with the frames that targets have in common."""

    def __init__(self, model: PhysicalModel, stations: Sequence[str], tt: Epochs) -> None:
        self._model, self._stations, self._tt = model, stations, tt
        self._frames: dict[int, list[StationFrames]] = {}

    def is_visible(self, target: Sighted, masks: Masks) -> Mask:
        """Return True for visible stations and target above the masks, shape (n, k)."""
        # Dense series are first computed once a minute. The sign cannot change between two margins a and b of one sign
        # if |a| + |b| exceeds the largest change in that time; otherwise all epochs between are computed. The
        # elevations of a spacecraft are not bounded.
        tt = self._tt
        n, stride = len(tt), 1
        length_s = float(tt[-1].seconds_since(tt[0])[0]) if n else 0.0
        if length_s > 0.0 and target.trajectory is None:
            stride = max(1, int(_COARSE_STEP_S * (n - 1) / length_s))

        def margin_rad(frames: Iterable[StationFrames]) -> Floats:
            return np.concatenate([part.elevations(target).margin_rad(masks) for part in frames])

        coarse = np.unique(np.append(np.arange(0, n, stride), n - 1)) if n else np.arange(0)
        if stride not in self._frames:
            self._frames[stride] = list(self._frames_at(coarse))
        margin = margin_rad(self._frames[stride])
        if stride == 1:
            return margin >= 0.0
        between = np.diff(coarse)
        out = np.append(np.repeat(margin[:-1] >= 0.0, between, axis=0), margin[-1:] >= 0.0, axis=0)
        interval_s = tt[coarse[1:]].seconds_since(tt[coarse[:-1]])
        unchanged = (margin[1:] >= 0.0) == (margin[:-1] >= 0.0)
        excludes_crossing = (
            np.abs(margin[1:]) + np.abs(margin[:-1]) > _MAX_ELEVATION_RATE_RAD_S * interval_s[:, None]
        )
        doubtful = np.flatnonzero(np.repeat(~(unchanged & excludes_crossing).all(axis=1), between))
        if len(doubtful):
            out[doubtful] = margin_rad(self._frames_at(doubtful)) >= 0.0
        return out

    def _frames_at(self, rows: Indices) -> Iterator[StationFrames]:
        for part in np.split(rows, range(_BLOCK_EPOCHS, len(rows), _BLOCK_EPOCHS)):
            yield StationFrames.at_epochs(self._model, self._stations, self._tt[part])


@dataclass(frozen=True, slots=True)
class Window:
    """Interval of common visibility of the target, from the first to the last whole second."""

    start_utc: str
    stop_utc: str
    rises: bool  #: at its begin; false at the limit of the search
    sets: bool  #: at its end; false at the limit of the search


@accepts_quantities
def windows(
    model: PhysicalModel,
    target: MotionLike,
    stations: Sequence[str],
    start_utc: DateLike,
    stop_utc: DateLike,
    masks: Masks | None = None,
) -> list[Window]:
    """Find the windows of common visibility of the target from all stations, with rise and set to the second.

    Windows and gaps shorter than five minutes (spacecraft: one minute) can be missed.

    Parameters
    ----------
    model, target
        As in :func:`elevations`, with its errors.
    stations : sequence of str
        Names or aliases, at least one.
    start_utc, stop_utc : str
        Limits of the search, in order.
    masks : Masks, optional
        By default 10 deg at the stations and the horizon at the target.

    Examples
    --------
    >>> import radioloc
    >>> from radioloc.measurements import PhysicalModel
    >>> from radioloc.simulation import windows
    >>> lander = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    >>> windows(PhysicalModel.build(), lander, ["KASHI", "JIAMUSI"], "2020-12-01T15:00:00", "2020-12-02T03:00:00")
    [Window(start_utc='2020-12-01T15:00:00', stop_utc='2020-12-01T23:02:30', rises=False, sets=True)]
    """
    masks, motion = masks or Masks(), as_motion(target, model)
    if not stations:
        raise InputError("stations: expected at least one, got none")
    limits = utc_to_tai(epochs_from_strings([start_utc, stop_utc], "UTC"))
    length_s = float(limits[1].seconds_since(limits[0])[0])
    if not length_s > 0.0:
        raise InputError(f"stop_utc: expected an epoch after the start {start_utc}, got {stop_utc}")

    def margin_rad(offset_s: Floats) -> Floats:
        tt = tai_to_tt(limits[:1].shifted(offset_s))
        return elevations(model, motion, stations, tt).margin_rad(masks).min(axis=-1)

    step_s = _SEARCH_STEP_S if motion.trajectory is None else _ORBIT_SEARCH_STEP_S
    grid_s = np.linspace(0.0, length_s, max(2, int(np.ceil(length_s / step_s)) + 1))
    visible = margin_rad(grid_s) >= 0.0
    changes = np.flatnonzero(visible[1:] != visible[:-1])
    low_s, high_s = grid_s[changes], grid_s[changes + 1]
    while len(changes) and float((high_s - low_s).max()) > _CROSSING_TOLERANCE_S:
        middle_s = 0.5 * (low_s + high_s)
        unchanged = (margin_rad(middle_s) >= 0.0) == visible[changes]
        low_s, high_s = np.where(unchanged, middle_s, low_s), np.where(unchanged, high_s, middle_s)
    crossings_s = 0.5 * (low_s + high_s)
    starts_s = np.concatenate([[0.0] * bool(visible[0]), crossings_s[~visible[changes]]])
    stops_s = np.concatenate([crossings_s[visible[changes]], [length_s] * bool(visible[-1])])
    return [
        Window(
            _text(limits[0], start, up=True), _text(limits[0], stop, up=False), start > 0.0, stop < length_s
        )
        for start, stop in zip(starts_s.tolist(), stops_s.tolist(), strict=True)
    ]


def _text(origin_tai: Epochs, offset_s: float, *, up: bool) -> str:
    """Return UTC at the nearest whole second within the window; seconds of UTC are those of TAI."""
    day_s = float(origin_tai.fraction[0]) * SECONDS_PER_DAY + offset_s
    rounded = np.ceil(day_s - _CROSSING_TOLERANCE_S) if up else np.floor(day_s + _CROSSING_TOLERANCE_S)
    return str(utc_strings(tai_to_utc(origin_tai.shifted(offset_s + rounded - day_s)), decimals=0)[0])
