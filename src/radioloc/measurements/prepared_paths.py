"""Light paths prepared for targets near approximate motions: the motions at their events, and their solution.

An arc has one path for each observation, and a second one for each count interval. The motion of the stations and of
the Moon near each event does not depend on where the point is, but for the few microseconds by which the light time
changes with it. The ends of n light paths are one list of 2 n events: those at first stations, then at second ones.
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
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.errors import InputError
from radioloc.measurements.light_path import (
    BOUNCE,
    TRANSMIT,
    LightPath,
    MovingPoint,
    Signal,
    delay_by_bodies_m,
    halves,
    solve_light_path,
    twice,
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
from radioloc.measurements.target_motion import GivenMotions, Motions, positions_pa_m
from radioloc.media.medium import Leg, LegEnd, LineOfSight, Weather, line_of_sight, prepared_media
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt, utc_to_tt
from radioloc.vectors import Floats, by_component, dot, length

_MIN_RADIO_WAVELENGTH_UM = 1000.0  # from this wavelength on (300 GHz), the signal is radio
_SOURCE_DISTANCE_M = 1e18  # where the direction to a source at infinity is looked at from
_TRAJECTORY_MARGIN_S = 60.0  # beyond the tags: the light time of targets within 20 million km is less
_ROUGH_TOLERANCE_S = 1e-9  # light times then settle to 1e-13 s, in which nothing moves by more than 3e-9 m
_EVENTS_PER_BLOCK = 8192  # events prepared at a time: memory holds all tidal terms of these alone


class PreparedPaths(Predictor):
    """The light paths of an arc; parameters and errors are those of ``ExactPredictor``."""

    _moon: LunarMotion
    _clock: TargetClock

    @accepts_quantities
    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: GivenMotions,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, motions, targets, more_partials)
        self._limits: dict[int, Epochs] = {}  # first and last instant of interest of each spacecraft, TDB
        self._aimed_from = self._aimed = self.motions  # as they were given, and restricted to the limits
        self._clock_epochs = [
            clock_epoch or clock_epoch_of(self._observations_of(rows), trajectory)
            for trajectory, rows in self._groups()
        ]
        alone = len(self._clock_epochs) == 1
        self._station_epoch = self._clock_epochs[0] if alone else clock_epoch or clock_epoch_of(observations)
        if is_combined(observations.kind).any():
            raise InputError(
                "some observations combine others; radioloc.measurements.prepare_predictor takes them"
            )
        # One path per observation; one with a count interval is the difference of two, at its ends.
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
        self._equipment = model.delays.on_paths(
            self.stations, self._which, self._tag, self._sign, model.terms
        )
        self._reference = Epochs.from_jd(
            tt.jd, tt.fraction + geocentric_tdb_minus_tt(tt) / SECONDS_PER_DAY, "TDB"
        )
        self._earth = model.ephemeris.earth(self._reference)
        self._far = self._directions[self.observations.link[self._rows]]
        if model.has("galactic_aberration"):
            far = np.flatnonzero(self._target < 0)
            self._far[far] = with_galactic_aberration(self._far[far], self._reference[far])
        self._gained_s, self._gained_rate = self._free_clocks()
        self._place()

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        n = len(self.observations)
        predicted = self._ends.predicted_eop.reshape(2, -1).any(axis=0)
        out = predicted[:n].copy()
        out[self._integrated] |= predicted[n:]
        return out

    def select(self, which: Any) -> Self:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        n = len(self.observations)
        rows = np.arange(n)[which]
        second = np.full(n, -1)
        second[self._integrated] = n + np.arange(len(self._integrated))
        paths = np.concatenate([rows, second[rows][second[rows] >= 0]])
        part = self._of([self], self.observations.select(rows), paths)
        part._limits = dict(self._limits)
        for k, motion in enumerate(self.motions):
            mine = np.flatnonzero(part._motion_of == k)
            if motion.trajectory is not None and len(mine):
                reference = part._reference[mine]
                seconds = (reference.jd - self._reference.jd[0]) + reference.fraction
                part._limits[k] = reference[[int(seconds.argmin()), int(seconds.argmax())]].shifted(
                    np.array([-_TRAJECTORY_MARGIN_S, _TRAJECTORY_MARGIN_S])
                )
        part.motions = part._restricted(self.motions)
        return part

    @classmethod
    def concatenate(cls, arcs: Sequence[Self]) -> Self:
        """Join prepared arcs of one model, in order; at least one."""
        # The paths of each arc are its observations and then the second paths of what is counted; so are the whole's.
        second = np.concatenate([np.arange(len(arc._tag)) >= len(arc.observations) for arc in arcs])
        observations = Observations.concatenate([arc.observations for arc in arcs])
        whole = cls._of(arcs, observations, np.argsort(second, kind="stable"))
        whole._aimed_from = ()  # each may have left its trajectory elsewhere
        return whole

    @classmethod
    def _of(cls, arcs: Sequence[Self], observations: Observations, paths: NDArray[np.intp]) -> Self:
        """The arc of observations whose paths are these of some arcs, counted through."""
        out = copy.copy(arcs[0])
        out._take(observations)
        size = np.array([len(arc._tag) for arc in arcs])
        first = np.arange(size.sum()) + np.repeat(np.cumsum(size) - size, size)
        ends = np.concatenate([first[paths], (first + np.repeat(size, size))[paths]])
        for names, rows in ((_PER_PATH, paths), (_PER_END, ends)):
            for name in names:
                setattr(out, name, rows_of(joined([getattr(arc, name) for arc in arcs]), rows))
        out._end = out._both_ends()
        return out

    @accepts_quantities
    def with_model(self, model: PhysicalModel, motions: GivenMotions | None = None) -> Self:
        """The same observations prepared with another model, for values only."""
        epoch = self._clock_epochs[0] if len(self._clock_epochs) == 1 else None
        return type(self)(model, self.observations, self._given(motions), self.targets, clock_epoch=epoch)

    def _take(self, observations: Observations) -> None:
        super()._take(observations)
        self._integrated = np.flatnonzero(is_integrated(observations.kind))
        self._rows = np.concatenate([np.arange(len(observations)), self._integrated])
        self._which = np.concatenate([self.transmitters[self._rows], self.receivers[self._rows]])
        self._target = self.target[self._rows]
        # Sources at infinity stand still where the last target is.
        self._motion_of = np.where(self._target < 0, len(self.motions) - 1, self._target)
        ramps = observations.ramps
        self._frequencies = {self._name(name): ramps.of_station(name) for name in ramps.stations}

    def _name(self, transmitter: str) -> str:
        """The catalogue's name of a station; a target keeps its own."""
        catalogue = self.model.catalogue
        return catalogue.get(transmitter).name if transmitter in catalogue else transmitter

    def _groups(self) -> list[tuple[AnyTrajectory | None, Rows]]:
        """Paths of all points fixed to the Moon, and of each spacecraft, with its trajectory."""
        trajectories = [motion.trajectory for motion in self._aimed]
        if not any(trajectory is not None for trajectory in trajectories):
            return [(None, slice(None))]
        if len(trajectories) == 1:
            return [(trajectories[0], slice(None))]
        flying = [k for k, trajectory in enumerate(trajectories) if trajectory is not None]
        found: list[tuple[AnyTrajectory | None, Rows]] = [
            (trajectories[k], np.flatnonzero(self._motion_of == k)) for k in flying
        ]
        if len(flying) < len(trajectories):
            found.insert(0, (None, np.flatnonzero(~np.isin(self._motion_of, flying))))
        return found

    def _observations_of(self, paths: Rows) -> Observations:
        """Observations of some paths."""
        if isinstance(paths, slice):
            return self.observations
        return self.observations.select(paths[paths < len(self.observations)])

    def _restricted(self, motions: Motions) -> Motions:
        """Motions restricted to the instants of interest, so that no more of an orbit is integrated."""
        limits = self._limits
        return tuple(
            motion.restricted_to(limits[k][0], limits[k][1]) if k in limits else motion
            for k, motion in enumerate(motions)
        )

    def _aim(self, given: GivenMotions | None) -> None:
        """Put the targets on the motions; spacecraft on other trajectories than before are placed anew."""
        motions, before = self._given(given), self._aimed_from
        if [new.path_key for new in motions] == [old.path_key for old in before]:
            # On the same trajectories, but points and offsets may have moved.
            self._aimed = tuple(
                old if np.array_equal(new.position_pa_m, old.position_pa_m) else new
                for new, old in zip(self._restricted(motions), self._aimed, strict=True)
            )
            return
        kinds = [[motion.trajectory is None for motion in some] for some in (motions, before)]
        if before and kinds[0] != kinds[1]:
            raise InputError(
                "motions: expected the kinds that the arc was prepared at, points on the Moon and spacecraft in the "
                "same order; prepare another predictor"
            )
        self._aimed_from, self._aimed = motions, self._restricted(motions)
        self._moon = self._with_craft(self._moon)

    def _place(self) -> None:
        """Place the straight motions at the events of the paths to the targets."""
        path = self._rough_path()
        row, ends_s, ends = twice(np.arange(len(self._tag))), path.ends_s, []
        for first in range(0, max(len(row), 1), _EVENTS_PER_BLOCK):
            block = slice(first, first + _EVENTS_PER_BLOCK)
            reference, earth = self._reference[row[block]], rows_of(self._earth, row[block])
            which = self._which[block]
            ends.append(station_motion(self.model, self._stations, which, reference, earth, ends_s[block]))
        self._ends = joined(ends)
        self._place_targets(path.bounce_s)
        for name in ("_ends", "_moon", "_clock"):
            setattr(self, name, rows_of(getattr(self, name), slice(None)))  # by component
        self.model.earth.warn_of_predictions(self._tt[: len(self.observations)], self.predicted_eop)

    def _rough_path(self) -> LightPath:
        """The path to 0.1 microseconds, from motions that are straight from the reference epochs on."""
        ends = rough_station_motion(self.model, self._stations, self._which, self._tt, self._earth)
        self._place_targets(np.zeros(len(self._tag)))
        places_s = topocentric_tdb_minus_tt(twice(self._earth.velocity_m_s), ends.position_m)
        signal = self._signal(ends, self._relay(), places_s)
        return solve_light_path(signal, 0.0, 0.0, tolerance_s=_ROUGH_TOLERANCE_S)

    def _place_targets(self, offset_s: Floats) -> None:
        """The motion of the Moon, and of the spacecraft, and the targets' clocks."""
        self._moon = self._with_craft(lunar_motion(self.model, self._reference, self._earth, offset_s))
        keeps = (self._sign == 0.0) & self.model.has("target_proper_time")
        counted = is_integrated(self._paths.kind) & (self._paths.count_s < MIN_GAP_S)
        radius_m = length(positions_pa_m(self._aimed))[self._motion_of]
        tdb = self._reference.shifted(offset_s)
        clocks = []
        for (trajectory, rows), zero in zip(self._groups(), self._clock_epochs, strict=True):
            mine = np.zeros(len(keeps), dtype=bool)
            mine[rows] = keeps[rows]
            # Counts need no common zero, so that a trajectory may have gaps between the passes.
            epoch = None if counted[mine].all() else zero
            clocks.append(target_clock(self.model, tdb, mine, radius_m, epoch, trajectory))
        self._clock = clocks[0].together(clocks[1:])

    def _with_craft(self, moon: LunarMotion) -> LunarMotion:
        """The motion of the Moon, and of the spacecraft."""
        for trajectory, rows in self._groups():
            if trajectory is not None and len(self._tag[rows]):
                moon = moon.with_craft(trajectory, self.model, self._reference, rows)
        return moon

    def _free_clocks(self) -> tuple[Floats, Floats]:
        """Return the offsets, s, and rates of free-running clocks at both ends; one-way paths have only the second."""
        free = self.model.free_clocks if self.model.has("station_proper_time") else ()
        rate = np.array([station_rate(one) if one.name in free else 0.0 for one in self._stations])[
            self._which
        ]
        halves(rate)[0][self._sign == 0.0] = 0.0
        since_s = np.zeros(len(self._tag))
        if rate.any() and self._station_epoch is not None:
            since_s = self._reference.seconds_since(self._station_epoch)
        return rate * twice(since_s), rate

    def _both_ends(self) -> LegEnd:
        """Stations and signals at both ends of the paths."""
        paths, which = self._paths, self._which
        sent = np.append(self._sign > 0.0, np.zeros(len(paths), dtype=bool))
        # Of a leg that goes up the recorded uplink's frequency, where that was recorded, else the downlink's.
        down_hz, uplink_hz = twice(C_M_S / (paths.wavelength_um * 1e-6)), twice(paths.uplink_hz)
        weather = (paths.pressure_hpa, paths.temperature_k, paths.relative_humidity)
        return LegEnd(
            self._stations,
            which,
            self._tt[twice(np.arange(len(paths)))],
            twice(is_radio(paths.wavelength_um, self._stations, halves(which)[1])),
            twice(is_integrated(paths.kind)),
            np.where(sent & ~np.isnan(uplink_hz), uplink_hz, down_hz),
            twice(paths.wavelength_um),
            Weather(*map(twice, weather)),
            which == twice(halves(which)[1]),
        )

    def _relay(self) -> MovingPoint:
        """The motions of the targets, as the Moon is placed; a source at infinity stands still."""
        places_pa_m = positions_pa_m(self._aimed)
        place_pa_m = places_pa_m[0] if len(places_pa_m) == 1 else places_pa_m[self._motion_of]
        relay = self._moon.point(self.model, place_pa_m)
        return replace(relay, velocity_m_s=relay.velocity_m_s * (self._target >= 0)[:, None])

    @property
    def _at_infinity(self) -> Floats | None:
        """Directions of sources at infinity, zeros of other targets; None where there are no sources."""
        return None if (self._target >= 0).all() else self._far

    def _signal(self, ends: MovingPoint, relay: MovingPoint, topocentric_s: Floats) -> Signal:
        """Return the signals between both ends and the point, with their tagged events."""
        # The reference epoch reads the tag as the geocentre's TT; the station's differs by up to 2 microseconds. A
        # one-way transmission, with which the path begins, is tagged by the target's clock.
        zero = np.zeros(len(self._tag))
        ahead_s, _, _ = self._clock.at(self._moon.origin, relay, zero)
        first_s, second_s = halves(topocentric_s - self._gained_s)
        tagged_s = np.choose(self._tag, (first_s, second_s, -ahead_s)) + self._equipment.after_tag_s
        up, down = ends.halves()
        hold_s = self._equipment.hold_s
        return Signal(up, relay, down, self._tag, tagged_s, self._sign, hold_s, self._at_infinity)

    def _solve(self) -> tuple[LightPath, MovingPoint, LineOfSight, Floats]:
        """Return the path, the motion of the point, the views from both ends and the drag of the media."""
        # Views are those along the path without delays, in which elevations are off by 1e-10 rad.
        relay = self._relay()
        signal = self._signal(self._ends.point, relay, self._ends.topocentric_s)
        path = solve_light_path(signal, 0.0, 0.0, tolerance_s=_ROUGH_TOLERANCE_S)
        views = self._lines_of_sight(path, relay)
        drag = self._drag(path)
        delay_m = self._gravity(path, relay) + drag * views.delay_m
        return solve_light_path(signal, *halves(delay_m), path), relay, views, drag

    def _drag(self, path: LightPath) -> Floats:
        """Return the ratio of the media's delay in the barycentric frame to that in their rest frame."""
        # While the signal is delayed the medium carries it along with the station, at up to 1e-4 of the speed of light.
        along = np.concatenate([self._sign[:, None] * path.up_unit, path.down_unit])
        return 1.0 - dot(along, self._ends.point.velocity_m_s) / C_M_S

    def _gravity(self, path: LightPath, relay: MovingPoint) -> Floats:
        """Return the gravitational delay of both legs, m."""
        # The Sun and the planets are at rest in the barycentric frame to sufficient accuracy, the Earth and the Moon
        # in the frame that moves with the Earth.
        if not self.model.has("shapiro"):
            return np.zeros(len(self._which))
        gm, lander_m = self.model.ephemeris.constants.gm_m3_s2, relay.at(path.bounce_s)
        lander_gcrs_m, _ = self._moon.geocentric(relay, path.bounce_s)
        near = {"earth": np.zeros_like(lander_m), "moon": self._moon.moon_gcrs_m}
        ends_m = self._ends.point.at(path.ends_s)
        far = self._at_infinity
        delay_m = delay_by_bodies_m(self._moon.bodies_m, lander_m, ends_m, gm, far)
        return delay_m + delay_by_bodies_m(near, lander_gcrs_m, self._ends.gcrs_m, gm, far)

    def _lines_of_sight(self, path: LightPath, relay: MovingPoint) -> LineOfSight:
        """The views from both ends."""
        lander_gcrs_m, velocity_m_s = self._moon.geocentric(relay, path.bounce_s)
        far = np.flatnonzero(self._target < 0)
        if len(far):
            # Aberration turns its direction into that of the frame that moves with the Earth.
            v, source = self._earth.velocity_m_s[far] / C_M_S, self._far[far]
            lander_gcrs_m[far] = _SOURCE_DISTANCE_M * (source + v - source * dot(source, v)[:, None])
            velocity_m_s[far] = 0.0
        leg, is_craft = (
            Leg(self._end, self._ends, twice(lander_gcrs_m), twice(velocity_m_s)),
            self._moon.is_craft,
        )
        if is_craft is None:
            return line_of_sight(leg, self.model.media, self._media)
        moon_gcrs_m = twice(self._moon.moon_gcrs_m)
        return line_of_sight(leg, self.model.media, self._media, moon_gcrs_m, twice(is_craft))


def is_radio(
    wavelength_um: Floats, stations: Sequence[Station], receiver: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Whether signals are radio, shape (n,); without a recorded wavelength those to laser stations are light."""
    laser = np.array([station.kind == "llr" for station in stations], dtype=bool)[receiver]
    return np.where(np.isnan(wavelength_um), ~laser, wavelength_um >= _MIN_RADIO_WAVELENGTH_UM)


def joined(parts: list[Any]) -> Any:
    """Arrays, or records of them, joined row after row."""
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


def rows_of(value: Any, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Any:
    """Some rows of an array, or of all arrays of a record, which have one row per path; laid out by component."""
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


# Attributes with one row for each light path, and for each end of one.
_PER_PATH = (
    "_paths",
    "_tt",
    "_sign",
    "_tag",
    "_equipment",
    "_reference",
    "_earth",
    "_moon",
    "_far",
    "_clock",
)
_PER_END = ("_media", "_ends", "_gained_s", "_gained_rate")
