"""Light paths prepared for targets near approximate motions: motions at the events, and solution of the paths.

An arc has a path for each observation, and a second path for each count interval. The motions of stations and Moon near
an event depend on the position of the target only by the few microseconds by which the light time changes. The ends of
n light paths are a list of 2 n events: those at first stations, then those at second stations.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.earth.stations import Station
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.errors import InputError
from radioloc.measurements.light_path import (
    BOUNCE,
    TRANSMIT,
    LightPath,
    MovingPoint,
    Signal,
    delay_by_bodies_m,
    solve_light_path,
    split_ends,
    stack_ends,
)
from radioloc.measurements.lunar_motion import LunarMotion, Rows, lunar_motion
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.proper_time import MIN_GAP_S, TargetClock, station_rate, target_clock
from radioloc.measurements.proper_time import clock_epoch as clock_epoch_of
from radioloc.measurements.registry import is_combined, is_differenced, is_integrated, is_one_way
from radioloc.measurements.sources import with_galactic_aberration
from radioloc.measurements.station_motion import rough_station_motion, station_motion
from radioloc.measurements.target_motion import Motions, MotionsLike, positions_pa_m
from radioloc.media.medium import Leg, LegEnd, LineOfSight, Weather, line_of_sight, prepared_media
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask, by_component, dot, length

_MIN_RADIO_WAVELENGTH_UM = 1000.0  # 300 GHz; shorter waves are light
_SOURCE_DISTANCE_M = 1e18  # nominal distance of sources at infinity
_TRAJECTORY_MARGIN_S = 60.0  # beyond the tags; above the light time of targets within 20 million km
_ROUGH_TOLERANCE_S = 1e-9  # light times are then accurate to 1e-13 s, in which motions are below 3e-9 m
_EVENTS_PER_BLOCK = 8192  # events prepared together, which limits the memory of tidal terms


class PreparedPaths(Predictor):
    """Light paths of an arc; parameters and errors are those of ``ExactPredictor``."""

    _moon: LunarMotion
    _clock: TargetClock

    @accepts_quantities
    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: MotionsLike,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, motions, targets, more_partials)
        self._limits: dict[int, Epochs] = {}  # first and last instant of interest of each spacecraft, TDB
        # As given, and restricted to the limits.
        self._current_motions = self._restricted_motions = self.motions
        self._clock_epochs = [
            clock_epoch or clock_epoch_of(self._observations_of(rows), trajectory)
            for trajectory, rows in self._groups()
        ]
        is_single = len(self._clock_epochs) == 1
        self._station_epoch = (
            self._clock_epochs[0] if is_single else clock_epoch or clock_epoch_of(observations)
        )
        if is_combined(observations.kind).any():
            raise InputError(
                "observations: expected simple types, got combined ones; use radioloc.measurements.prepare_predictor"
            )
        # An observation has a path, or two at the ends of its count interval.
        tt = utc_to_tt(observations.epoch)
        half_s = np.where(is_integrated(observations.kind), 0.5 * observations.count_s, 0.0)
        half_s = np.concatenate([half_s, -half_s[self._integrated]])
        self._tt = tt = tt[self._rows].shifted(half_s)
        self._paths = paths = observations.select(self._rows)
        differenced, one_way = is_differenced(paths.kind), is_one_way(paths.kind)
        self._sign = np.where(differenced, -1.0, np.where(one_way, 0.0, 1.0))
        # A one-way signal begins with the bounce.
        sent = np.where(one_way & (paths.tag == TRANSMIT), BOUNCE, paths.tag)
        self._tag = np.where(differenced, TRANSMIT, sent).astype(np.int8)
        self._end = self._both_ends()
        self._media = prepared_media(model.media, self._end)
        self._equipment = model.delays.delays_on_paths(
            self.stations, self._station_index, self._tag, self._sign, model.terms
        )
        self._reference = Epochs.from_jd(
            tt.jd, tt.fraction + geocentric_tdb_minus_tt(tt) / SECONDS_PER_DAY, "TDB"
        )
        self._earth = model.ephemeris.earth(self._reference)
        self._source = self._directions[self.observations.link[self._rows]]
        if model.has("galactic_aberration"):
            rows = np.flatnonzero(self._target < 0)
            self._source[rows] = with_galactic_aberration(self._source[rows], self._reference[rows])
        self._station_clock_s, self._station_clock_rate = self._free_clocks()
        self._place()

    @property
    def predicted_eop(self) -> Mask:
        """Mask of observations with predicted Earth orientation, shape (n,)."""
        # The first paths are those of the ends of count intervals; only later orientation is predicted.
        return self._ends.predicted_eop.reshape(2, -1)[:, : len(self.observations)].any(axis=0)

    def select(self, rows: Any) -> Self:
        """Return the prepared arc of some observations by a mask, a slice or indices."""
        n = len(self.observations)
        rows = np.arange(n)[rows]
        second = np.full(n, -1)
        second[self._integrated] = n + np.arange(len(self._integrated))
        paths = np.concatenate([rows, second[rows][second[rows] >= 0]])
        part = self._combined([self], self.observations.select(rows), paths)
        part._limits = dict(self._limits)
        for k, motion in enumerate(self.motions):
            paths_of_motion = np.flatnonzero(part._motion_of == k)
            if motion.trajectory is not None and len(paths_of_motion):
                reference = part._reference[paths_of_motion]
                seconds = (reference.jd - self._reference.jd[0]) + reference.fraction
                part._limits[k] = reference[[int(seconds.argmin()), int(seconds.argmax())]].shifted(
                    np.array([-_TRAJECTORY_MARGIN_S, _TRAJECTORY_MARGIN_S])
                )
        part.motions = part._restricted(self.motions)
        return part

    @classmethod
    def concatenate(cls, arcs: Sequence[Self]) -> Self:
        """Join one or more prepared arcs of the same model, in order."""
        # Paths of observations precede second paths of count intervals, in each arc and in the joined arc.
        second = np.concatenate([np.arange(len(arc._tag)) >= len(arc.observations) for arc in arcs])
        observations = Observations.concatenate([arc.observations for arc in arcs])
        joined_arc = cls._combined(arcs, observations, np.argsort(second, kind="stable"))
        joined_arc._current_motions = ()  # trajectories of the arcs may differ
        return joined_arc

    @classmethod
    def _combined(cls, arcs: Sequence[Self], observations: Observations, paths: Indices) -> Self:
        """Return the arc of observations with paths of some arcs, by index in their concatenation."""
        out = copy.copy(arcs[0])
        out._set_observations(observations)
        size = np.array([len(arc._tag) for arc in arcs])
        first = np.arange(size.sum()) + np.repeat(np.cumsum(size) - size, size)
        ends = np.concatenate([first[paths], (first + np.repeat(size, size))[paths]])
        for names, rows in ((_PER_PATH, paths), (_PER_END, ends)):
            for name in names:
                setattr(out, name, rows_of(joined([getattr(arc, name) for arc in arcs]), rows))
        out._end = out._both_ends()
        return out

    @accepts_quantities
    def with_model(self, model: PhysicalModel, motions: MotionsLike | None = None) -> Self:
        """Prepare the same observations with another model, for values only."""
        epoch = self._clock_epochs[0] if len(self._clock_epochs) == 1 else None
        return type(self)(model, self.observations, self._given(motions), self.targets, clock_epoch=epoch)

    def _set_observations(self, observations: Observations) -> None:
        super()._set_observations(observations)
        self._integrated = np.flatnonzero(is_integrated(observations.kind))
        self._rows = np.concatenate([np.arange(len(observations)), self._integrated])
        self._station_index = np.concatenate([self.transmitters[self._rows], self.receivers[self._rows]])
        self._target = self.target[self._rows]
        # Sources at infinity are at rest at the position of the last target.
        self._motion_of = np.where(self._target < 0, len(self.motions) - 1, self._target)
        ramps = observations.ramps
        self._frequencies = {self._name(name): ramps.of_station(name) for name in ramps.stations}

    def _name(self, transmitter: str) -> str:
        """Return the catalogue's name of a station, or the name of a target."""
        catalogue = self.model.catalogue
        return catalogue.get(transmitter).name if transmitter in catalogue else transmitter

    def _groups(self) -> list[tuple[SpacecraftTrajectory | None, Rows]]:
        """Return the paths of all points fixed to the Moon, and of each spacecraft with its trajectory."""
        trajectories = [motion.trajectory for motion in self._restricted_motions]
        if not any(trajectory is not None for trajectory in trajectories):
            return [(None, slice(None))]
        if len(trajectories) == 1:
            return [(trajectories[0], slice(None))]
        flying = [k for k, trajectory in enumerate(trajectories) if trajectory is not None]
        groups: list[tuple[SpacecraftTrajectory | None, Rows]] = [
            (trajectories[k], np.flatnonzero(self._motion_of == k)) for k in flying
        ]
        if len(flying) < len(trajectories):
            groups.insert(0, (None, np.flatnonzero(~np.isin(self._motion_of, flying))))
        return groups

    def _observations_of(self, paths: Rows) -> Observations:
        if isinstance(paths, slice):
            return self.observations
        return self.observations.select(paths[paths < len(self.observations)])

    def _restricted(self, motions: Motions) -> Motions:
        """Return motions restricted to the instants of interest, to shorten integrations of orbits."""
        limits = self._limits
        return tuple(
            motion.restricted_to(limits[k][0], limits[k][1]) if k in limits else motion
            for k, motion in enumerate(motions)
        )

    def _set_motions(self, motions: MotionsLike | None) -> None:
        """Apply motions to the targets; the motion of spacecraft on other trajectories is computed anew."""
        motions, previous = self._given(motions), self._current_motions
        if [new.path_key for new in motions] == [old.path_key for old in previous]:
            # The trajectories are the same, but points and offsets may differ.
            self._restricted_motions = tuple(
                old if np.array_equal(new.position_pa_m, old.position_pa_m) else new
                for new, old in zip(self._restricted(motions), self._restricted_motions, strict=True)
            )
            return
        kinds = [[motion.trajectory is None for motion in items] for items in (motions, previous)]
        if previous and kinds[0] != kinds[1]:
            raise InputError(
                "motions: expected points on the Moon and spacecraft in the order of the prepared arc; prepare another "
                "predictor"
            )
        self._current_motions, self._restricted_motions = motions, self._restricted(motions)
        self._moon = self._with_craft(self._moon)

    def _place(self) -> None:
        """Compute the straight motions at the events of the paths."""
        path = self._rough_path()
        row, ends_s, ends = stack_ends(np.arange(len(self._tag))), path.ends_s, []
        for first in range(0, max(len(row), 1), _EVENTS_PER_BLOCK):
            block = slice(first, first + _EVENTS_PER_BLOCK)
            reference, earth = self._reference[row[block]], rows_of(self._earth, row[block])
            index = self._station_index[block]
            ends.append(station_motion(self.model, self._stations, index, reference, earth, ends_s[block]))
        self._ends = joined(ends)
        self._place_targets(path.bounce_s)
        for name in ("_ends", "_moon", "_clock"):
            setattr(self, name, rows_of(getattr(self, name), slice(None)))  # by component
        self.model.earth.warn_of_predictions(self._tt[: len(self.observations)], self.predicted_eop)

    def _rough_path(self) -> LightPath:
        """Return the path to 0.1 microseconds, from straight motions at the reference epochs."""
        ends = rough_station_motion(self.model, self._stations, self._station_index, self._tt, self._earth)
        self._place_targets(np.zeros(len(self._tag)))
        topocentric_s = topocentric_tdb_minus_tt(stack_ends(self._earth.velocity_m_s), ends.position_m)
        signal = self._signal(ends, self._target_points(), topocentric_s)
        return solve_light_path(signal, 0.0, 0.0, tolerance_s=_ROUGH_TOLERANCE_S)

    def _place_targets(self, offset_s: Floats) -> None:
        """Compute the motions of Moon and spacecraft, and the targets' clocks."""
        self._moon = self._with_craft(lunar_motion(self.model, self._reference, self._earth, offset_s))
        is_one_way = (self._sign == 0.0) & self.model.has("target_proper_time")
        counted = is_integrated(self._paths.kind) & (self._paths.count_s < MIN_GAP_S)
        radius_m = length(positions_pa_m(self._restricted_motions))[self._motion_of]
        tdb = self._reference.shifted(offset_s)
        clocks = []
        for (trajectory, rows), zero in zip(self._groups(), self._clock_epochs, strict=True):
            mask = np.zeros(len(is_one_way), dtype=bool)
            mask[rows] = is_one_way[rows]
            # Counts do not need a common zero, so a trajectory may have gaps between the passes.
            epoch = None if counted[mask].all() else zero
            clocks.append(target_clock(self.model, tdb, mask, radius_m, epoch, trajectory))
        self._clock = clocks[0].merged_with(clocks[1:])

    def _with_craft(self, moon: LunarMotion) -> LunarMotion:
        """Return the motion of the Moon with that of the spacecraft."""
        for trajectory, rows in self._groups():
            if trajectory is not None and len(self._tag[rows]):
                moon = moon.with_craft(trajectory, self.model, self._reference, rows)
        return moon

    def _free_clocks(self) -> tuple[Floats, Floats]:
        """Return offsets, s, and rates of free-running clocks at both ends; zero at the first end of one-way paths."""
        free = self.model.free_clocks if self.model.has("station_proper_time") else ()
        rates = [station_rate(station) if station.name in free else 0.0 for station in self._stations]
        rate = np.array(rates)[self._station_index]
        split_ends(rate)[0][self._sign == 0.0] = 0.0
        since_s = np.zeros(len(self._tag))
        if rate.any() and self._station_epoch is not None:
            since_s = self._reference.seconds_since(self._station_epoch)
        return rate * stack_ends(since_s), rate

    def _both_ends(self) -> LegEnd:
        """Return stations and signals at both ends of the paths."""
        paths, index = self._paths, self._station_index
        sent = np.append(self._sign > 0.0, np.zeros(len(paths), dtype=bool))
        # Legs that go up have the recorded frequency of the uplink; without a record that of the downlink.
        down_hz, uplink_hz = stack_ends(C_M_S / (paths.wavelength_um * 1e-6)), stack_ends(paths.uplink_hz)
        weather = (paths.pressure_hpa, paths.temperature_k, paths.relative_humidity)
        return LegEnd(
            self._stations,
            index,
            self._tt[stack_ends(np.arange(len(paths)))],
            stack_ends(is_radio(paths.wavelength_um, self._stations, split_ends(index)[1])),
            stack_ends(is_integrated(paths.kind)),
            np.where(sent & ~np.isnan(uplink_hz), uplink_hz, down_hz),
            stack_ends(paths.wavelength_um),
            Weather(*map(stack_ends, weather)),
            index == stack_ends(split_ends(index)[1]),
        )

    def _target_points(self) -> MovingPoint:
        """Return the motions of the targets; a source at infinity is at rest."""
        places_pa_m = positions_pa_m(self._restricted_motions)
        place_pa_m = places_pa_m[0] if len(places_pa_m) == 1 else places_pa_m[self._motion_of]
        target = self._moon.point(self.model, place_pa_m)
        return replace(target, velocity_m_s=target.velocity_m_s * (self._target >= 0)[:, None])

    @property
    def _source_directions(self) -> Floats | None:
        """Directions of sources at infinity, zeros for targets; None without sources."""
        return None if (self._target >= 0).all() else self._source

    def _signal(self, ends: MovingPoint, target: MovingPoint, topocentric_s: Floats) -> Signal:
        """Return the signals between both ends and the target, with their tagged events."""
        # The reference epoch takes the tag as TT at the geocentre; TT at the station differs by up to 2 microseconds. A
        # one-way transmission, the start of the path, is tagged by the target's clock.
        zero = np.zeros(len(self._tag))
        clock_s, _, _ = self._clock.reading_at(self._moon.origin, target, zero)
        first_s, second_s = split_ends(topocentric_s - self._station_clock_s)
        tagged_s = np.choose(self._tag, (first_s, second_s, -clock_s)) + self._equipment.after_tag_s
        up, down = ends.split_ends()
        hold_s = self._equipment.hold_s
        return Signal(up, target, down, self._tag, tagged_s, self._sign, hold_s, self._source_directions)

    def _solve(self) -> tuple[LightPath, MovingPoint, LineOfSight, Floats]:
        """Return the path, the motion of the target, the views from both ends and the drag of the media."""
        # Views are along the path without delays, with errors of 1e-10 rad in elevation.
        target = self._target_points()
        signal = self._signal(self._ends.point, target, self._ends.topocentric_s)
        path = solve_light_path(signal, 0.0, 0.0, tolerance_s=_ROUGH_TOLERANCE_S)
        views = self._lines_of_sight(path, target)
        drag = self._drag(path)
        delay_m = self._gravity(path, target) + drag * views.delay_m
        return solve_light_path(signal, *split_ends(delay_m), path), target, views, drag

    def _drag(self, path: LightPath) -> Floats:
        """Return the ratio of the media's delay in the barycentric frame to that in their rest frame."""
        # The medium moves with the station, at up to 1e-4 of the speed of light, during the delay.
        direction = np.concatenate([self._sign[:, None] * path.up_unit, path.down_unit])
        return 1.0 - dot(direction, self._ends.point.velocity_m_s) / C_M_S

    def _gravity(self, path: LightPath, target: MovingPoint) -> Floats:
        """Return the gravitational delay of both legs, m."""
        # The Sun and the planets are at rest in the barycentric frame to sufficient accuracy, the Earth and the Moon
        # in the frame that moves with the Earth.
        if not self.model.has("shapiro"):
            return np.zeros(len(self._station_index))
        gm, target_m = self.model.ephemeris.constants.gm_m3_s2, target.position_at(path.bounce_s)
        target_gcrs_m, _ = self._moon.geocentric(target, path.bounce_s)
        geocentric_bodies_m = {"earth": np.zeros_like(target_m), "moon": self._moon.moon_gcrs_m}
        ends_m, ends_gcrs_m = self._ends.point.position_at(path.ends_s), self._ends.gcrs_m
        source = self._source_directions
        delay_m = delay_by_bodies_m(self._moon.bodies_m, target_m, ends_m, gm, source)
        return delay_m + delay_by_bodies_m(geocentric_bodies_m, target_gcrs_m, ends_gcrs_m, gm, source)

    def _lines_of_sight(self, path: LightPath, target: MovingPoint) -> LineOfSight:
        """Return the views from both ends."""
        target_gcrs_m, velocity_m_s = self._moon.geocentric(target, path.bounce_s)
        rows = np.flatnonzero(self._target < 0)
        if len(rows):
            # Aberration changes the direction to that in the frame of the Earth.
            v, source = self._earth.velocity_m_s[rows] / C_M_S, self._source[rows]
            target_gcrs_m[rows] = _SOURCE_DISTANCE_M * (source + v - source * dot(source, v)[:, None])
            velocity_m_s[rows] = 0.0
        leg = Leg(self._end, self._ends, stack_ends(target_gcrs_m), stack_ends(velocity_m_s))
        is_craft = self._moon.is_craft
        if is_craft is None:
            return line_of_sight(leg, self.model.media, self._media)
        moon_gcrs_m = stack_ends(self._moon.moon_gcrs_m)
        return line_of_sight(leg, self.model.media, self._media, moon_gcrs_m, stack_ends(is_craft))


def is_radio(wavelength_um: Floats, stations: Sequence[Station], receiver: NDArray[np.int32]) -> Mask:
    """Return the mask of radio signals, (n,); without a recorded wavelength signals to laser stations are light."""
    laser = np.array([station.kind == "llr" for station in stations], dtype=bool)[receiver]
    return np.where(np.isnan(wavelength_um), ~laser, wavelength_um >= _MIN_RADIO_WAVELENGTH_UM)


def joined(parts: list[Any]) -> Any:
    """Return arrays, or records of arrays, joined by rows."""
    first = parts[0]
    if first is None or len(parts) == 1:
        return first
    if isinstance(first, tuple):
        return tuple(joined([part[i] for part in parts]) for i in range(len(first)))
    if isinstance(first, Observations | Epochs):
        return type(first).concatenate(parts)
    if is_dataclass(first):
        columns = {f.name: joined([getattr(part, f.name) for part in parts]) for f in fields(first)}
        return replace(first, **columns)  # type: ignore[type-var]
    if isinstance(first, dict):
        return {key: joined([part[key] for part in parts]) for key in first}
    return np.concatenate(parts)


def rows_of(value: Any, rows: Indices | Mask | slice) -> Any:
    """Return rows of an array, or of all arrays of a record; the memory layout is by component."""
    if value is None:
        return None
    if isinstance(value, tuple):
        return tuple(rows_of(item, rows) for item in value)
    if isinstance(value, Observations):
        return value.select(rows)
    if isinstance(value, Epochs):
        return value[rows]
    if is_dataclass(value):
        parts = {field.name: rows_of(getattr(value, field.name), rows) for field in fields(value)}
        return replace(value, **parts)  # type: ignore[type-var]
    if isinstance(value, dict):
        return {key: rows_of(item, rows) for key, item in value.items()}
    return by_component(value[rows])


# Attributes with a row for each light path, and for each end of a path.
_PER_PATH = (
    "_paths",
    "_tt",
    "_sign",
    "_tag",
    "_equipment",
    "_reference",
    "_earth",
    "_moon",
    "_source",
    "_clock",
)
_PER_END = ("_media", "_ends", "_station_clock_s", "_station_clock_rate")
