"""An arc of tracking: predictions of ranges, VLBI delays and Doppler for one target, with partials.

The target is a point fixed to the Moon, or a spacecraft on a trajectory (:class:`~radioloc.ephemeris.Trajectory`).

What is measured is said by each type of measurement (:mod:`~radioloc.measurements.registry`), all in metres and by
the stations' atomic clocks (TT rate, as UTC has). Tags and values are those at the stations' reference points, unless
the model has delays of equipment that the data still contain (:mod:`~radioloc.measurements.equipment_delays`): then
they are those of the clocks behind it.

An arc is prepared once (:class:`ExactPredictor`): the motion of the stations and of the Moon near each event does not
depend on where the point is, but for the few microseconds by which the light time changes with it. A prediction for a
given position is then a light-time solution between straight motions.

Of n light paths the two ends are one list of 2 n events: all that happens at a first station, then all at a second one.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.earth.stations import Station
from radioloc.ephemeris.trajectory import AdjustableTrajectory, AnyTrajectory
from radioloc.errors import InputError
from radioloc.measurements.light_path import (
    BOUNCE,
    TRANSMIT,
    LightPath,
    MovingPoint,
    delay_by_bodies_m,
    path_length_partials,
    solve_light_path,
)
from radioloc.measurements.lunar_motion import LunarMotion, lunar_motion
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.proper_time import SHORTEST_GAP_S, station_rate, target_clock
from radioloc.measurements.proper_time import clock_epoch as clock_epoch_of
from radioloc.measurements.ramps import RampTerm, ramp_term
from radioloc.measurements.records import joined, rows_of
from radioloc.measurements.registry import is_combined, is_differenced, is_integrated, is_one_way
from radioloc.measurements.sources import with_galactic_aberration
from radioloc.measurements.station_motion import StationMotion, rough_station_motion, station_motion
from radioloc.media.ionosphere import delay_by_content_m
from radioloc.media.medium import Leg, LegEnd, LineOfSight, Weather, line_of_sight, prepared_media
from radioloc.media.status import first_of
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt, utc_to_tt
from radioloc.vectors import dot, length, rotated

Floats = NDArray[np.float64]

_SHORTEST_RADIO_UM = 1000.0
"""From this wavelength on (300 GHz), the signal is radio."""
_FAR_M = 1e18
"""Where the direction to a source at infinity is looked at from."""
_MARGIN_S = 60.0
"""Of a trajectory beyond the tags: the light time of targets within 20 million km, and less."""
_ROUGHLY_S = 1e-9
"""Light times of the path without delays settle to 1e-13 s, in which nothing moves by more than 3e-9 m."""
_BLOCK = 8192
"""Events for which stations are prepared at a time, so that memory holds the terms of all tides for these alone."""


class ExactPredictor(Predictor):
    """The observations of one arc, prepared for predictions from any position near an approximate one.

    Parameters
    ----------
    model, observations, trajectory, targets, more_partials
        As the attributes; the measured values are not looked at. A trajectory has to hold the time tags and the
        instants at which the signals meet the spacecraft.
    approximate_pa_m : ndarray, shape (3,) or (n_targets, 3)
        A position within some hundred kilometres of the point, principal axes.
    clock_epoch : Epochs, optional
        When the clock of a target that transmits by its own agrees with TT, TDB, one; as a rule that of
        :func:`~radioloc.measurements.proper_time.clock_epoch`.

    Raises
    ------
    StationError
        A station is not in the catalogue; the message names the file and line.
    CoverageError
        An epoch lies outside the kernels, the trajectory or the Earth orientation table.
    KernelError, InputError
        The trajectory cannot be evaluated, or leads too far from the Earth; an observation is a combination of others.
    """

    _moon: LunarMotion

    @bare_arguments
    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        approximate_pa_m: Floats,
        trajectory: AnyTrajectory | None = None,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, trajectory, targets, more_partials)
        self._clock_epoch = clock_epoch or clock_epoch_of(observations, trajectory)
        self._orbit, self._orbit_of, self._orbit_x = trajectory, trajectory, np.full(1, np.nan)
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
        self._far = self._source[self._rows]
        if model.has("galactic_aberration"):
            far = np.flatnonzero(self._target < 0)
            self._far[far] = with_galactic_aberration(self._far[far], self._reference[far])
        self._gained_s, self._gained_rate = self._free_clocks()
        self._place(self._beside(np.asarray(approximate_pa_m, dtype=np.float64)))

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        n = len(self.observations)
        predicted = self._ends.predicted_eop.reshape(2, -1).any(axis=0)
        out = predicted[:n].copy()
        out[self._integrated] |= predicted[n:]
        return out

    @bare_arguments
    def at(self, lander_pa_m: Floats) -> Computed:
        """Predict all observations for a position; a ConvergenceError where the light times do not settle."""
        lander_pa_m = self._beside(lander_pa_m)
        path, relay, views = self._solve(lander_pa_m)
        if not (self._ends.point.holds_at(path.ends_s) and self._moon.centre.holds_at(path.bounce_s)):
            self._place(lander_pa_m)
            path, relay, views = self._solve(lander_pa_m)
        ramp, one_way, tdb_tt = self._ramp(path), self._sign == 0.0, self.model.has("tdb_tt")
        up, down = _split(self._ends.point)
        partials = path_length_partials(path, up, relay, down, self._tag, self._sign)
        partials = partials.scaled(ramp.scale)

        ahead_s, ahead_rate, ahead_by_place = self._clock.at(self._moon.origin, relay, path.bounce_s)
        first_ahead_s, second_ahead_s = np.split(self._gained_s + self._gained_rate * path.ends_s, 2)
        gained_s = second_ahead_s - first_ahead_s - ahead_s
        flight_s = self._sign * path.up_s + (path.down_s + self._equipment.in_value_s) + gained_s
        length_m = C_M_S * flight_s - ramp.excess_m
        if tdb_tt:
            first_s, second_s = np.split(self._ends.tdb_minus_tt_at(path.ends_s), 2)
            first_s = np.where(one_way, self._geocentric_tdb_minus_tt_s(path.bounce_s), first_s)
            length_m = length_m - C_M_S * (second_s - first_s)

        first_rate, second_rate = np.split(self._gained_rate, 2)
        by_time = partials.by_tag + C_M_S * (second_rate - first_rate - ahead_rate)
        if tdb_tt:
            # 1e-5 m/s in two-way, but up to 0.1 m/s between two stations, whose velocities differ.
            first_rate, second_rate = np.split(self._ends.tdb_rate, 2)
            geocentric_rate = np.split(self._ends.geocentric_tdb_rate, 2)[0]
            first_rate = np.where(one_way, geocentric_rate, first_rate)
            by_time = by_time - C_M_S * ramp.scale * (second_rate - first_rate)
        by_delay = np.concatenate([partials.by_up_delay, partials.by_down_delay])
        by_media = by_delay * self._drag(path)
        by_time = by_time + ramp.by_tag_m_s + _both(by_media * views.rate_m_s)
        by_position = partials.by_position - C_M_S * ahead_by_place
        by_position = by_position + _both(by_media[:, None] * views.by_position)
        by_position = by_position * (self._target >= 0)[:, None]
        by_position_pa = rotated(np.swapaxes(self._moon.rot_pa_to_icrf, -1, -2), by_position)

        n = len(self.observations)
        elevation_rad = views.leg.elevation.angle_rad.reshape(2, -1).T.copy()
        elevation_rad[one_way, 0] = elevation_rad[one_way, 1]
        status = views.status.reshape(2, -1).T.copy()
        status[:, 0] = first_of(np.where(one_way, 0, status[:, 0]), ramp.status)
        if len(self._integrated):
            late, early = elevation_rad[self._integrated], elevation_rad[n:]
            elevation_rad[self._integrated] = np.where((late >= 0.0) & (early < 0.0), early, late)
            status[self._integrated] = first_of(status[self._integrated], status[n:])
        by_station, by_content, mean = np.zeros((n, 0, 3)), np.zeros((n, 0)), np.zeros((n, 0))
        if self.more_partials:
            by_station = self._by_stations(path, by_delay)
            by_content_m = np.where(by_delay == 0.0, 0.0, by_media * delay_by_content_m(views.leg))
            by_content = self._observed(by_content_m.reshape(2, -1).T)
            mean = self._observed(by_position_pa, mean=True)
        return Computed(
            value_m=self._observed(length_m),
            by_position_pa=self._observed(by_position_pa),
            by_time_m_s=self._observed(by_time),
            by_transponder_delay_m_s=self._observed(np.where(self._sign > 0.0, partials.by_hold, 0.0)),
            by_zenith_wet=self._observed((by_media * views.by_zenith_wet).reshape(2, -1).T),
            elevation_rad=elevation_rad[:n],
            status=status[:n],
            by_station_itrf=by_station,
            by_electron_content_m=by_content,
            mean_by_position_pa=mean,
            by_orbit=self._by_orbit(path, by_position),
        )

    @bare_arguments
    def light_path(self, lander_pa_m: Floats) -> tuple[LightPath, StationMotion, StationMotion]:
        """The solved light paths for a position, and both stations near their events.

        Where observations have a count interval the paths at its starts follow those at its ends.
        """
        self.at(lander_pa_m)  # places the motions at the events
        n = len(self._tag)
        ends = rows_of(self._ends, slice(n)), rows_of(self._ends, slice(n, None))
        return self._solve(self._beside(lander_pa_m))[0], *ends

    def _ramp(self, path: LightPath) -> RampTerm:
        """What ramps of the transmitted frequency do to the paths' values."""
        paths, n = self._paths, len(self.observations)
        if not paths.ramped.any():
            return RampTerm.none(len(paths))
        # The transmitter's clock reads TT, from the epoch that the tag says, or the end of the count.
        one_way = self._sign == 0.0
        sent_s = np.where(one_way, path.bounce_s, path.transmit_s - self._equipment.transmit_s)
        at_station_s = np.split(self._ends.tdb_minus_tt_at(_twice(sent_s)), 2)[0]
        ahead_s = np.where(one_way, self._geocentric_tdb_minus_tt_s(sent_s), at_station_s)
        sent_s = sent_s + self._geocentric_tdb_minus_tt_s(0.0 * sent_s) - ahead_s
        other = np.arange(len(paths))
        other[self._integrated], other[n:] = other[n:], self._integrated
        reference_hz = np.where(one_way, 1e6 * C_M_S / paths.wavelength_um, paths.uplink_hz)
        sender = np.array([self._name(link.transmitter or link.target) for link in paths.links])[paths.link]
        sender = np.where(paths.ramped, sender, "")
        other = np.where(is_integrated(paths.kind), other, -1)
        return ramp_term(self._frequencies, sender, self._tt, sent_s, other, reference_hz)

    def _geocentric_tdb_minus_tt_s(self, offset_s: Floats) -> Floats:
        """TDB - TT at the geocentre near the first events."""
        return np.split(self._ends.geocentric_tdb_minus_tt_at(_twice(offset_s)), 2)[0]

    def _name(self, transmitter: str) -> str:
        """The catalogue's name of a station; a target keeps its own."""
        catalogue = self.model.catalogue
        return catalogue.get(transmitter).name if transmitter in catalogue else transmitter

    def _beside(self, x: Floats) -> Floats:
        """Position beside the trajectory; one that is adjustable goes where changes of its parameters take it."""
        if not isinstance(self.trajectory, AdjustableTrajectory):
            return x
        if self._orbit_of is not self.trajectory or not np.array_equal(x, self._orbit_x):
            self._orbit = self.trajectory.corrected(x) if np.any(x) else self.trajectory
            self._orbit_of, self._orbit_x = self.trajectory, np.array(x)
            if hasattr(self, "_moon"):
                self._moon = self._moon.with_craft(self._orbit, self.model, self._reference)
        return np.zeros(3)

    def _by_orbit(self, path: LightPath, by_position: Floats) -> Floats:
        """Partials by the parameters of an adjustable trajectory, shape (n, p)."""
        if not isinstance(self._orbit, AdjustableTrajectory):
            return np.zeros((len(self.observations), 0))
        moved = self._orbit.position_partials(self._reference.shifted(path.bounce_s))
        return self._observed(np.einsum("ni,nip->np", by_position, moved))

    def _by_stations(self, path: LightPath, by_delay: Floats) -> Floats:
        """Partials by the ITRF coordinates of both stations, shape (n, 2, 3)."""
        by_place = by_delay[:, None] * np.concatenate([-path.up_unit, path.down_unit])
        if self.model.has("tdb_tt"):
            # TDB - TT at a station has v_E . r / c^2, 1e-4 of a displacement; in two-way it cancels.
            clocks = np.concatenate([self._sign != 0.0, np.full(len(self._sign), -1.0)])
            by_place = by_place + _twice(self._earth.velocity_m_s / C_M_S) * clocks[:, None]
        by_itrf = rotated(np.swapaxes(self._ends.rot_itrf_to_gcrs, -1, -2), by_place)
        return self._observed(np.swapaxes(by_itrf.reshape(2, -1, 3), 0, 1))

    def select(self, which: Any) -> ExactPredictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        n = len(self.observations)
        rows = np.arange(n)[which]
        second = np.full(n, -1)
        second[self._integrated] = n + np.arange(len(self._integrated))
        paths = np.concatenate([rows, second[rows][second[rows] >= 0]])
        part = self._of([self], self.observations.select(rows), paths)
        if isinstance(self.trajectory, AdjustableTrajectory) and len(rows):
            seconds = (self._reference.jd[paths] - self._reference.jd[0]) + self._reference.fraction[paths]
            ends = part._reference[[int(seconds.argmin()), int(seconds.argmax())]]
            first, last = ends[0].shifted(-_MARGIN_S), ends[1].shifted(_MARGIN_S)
            part.trajectory = self.trajectory.over(first, last)
        return part

    @classmethod
    def concatenate(cls, arcs: Sequence[ExactPredictor]) -> ExactPredictor:
        """Join prepared arcs of one model, in order; at least one."""
        # The paths of each arc are its observations and then the second paths of what is counted; so are the whole's.
        second = np.concatenate([np.arange(len(arc._tag)) >= len(arc.observations) for arc in arcs])
        observations = Observations.concatenate([arc.observations for arc in arcs])
        whole = cls._of(arcs, observations, np.argsort(second, kind="stable"))
        whole._orbit_x = np.full(1, np.nan)  # each may have left its trajectory elsewhere
        return whole

    @staticmethod
    def _of(
        arcs: Sequence[ExactPredictor], observations: Observations, paths: NDArray[np.intp]
    ) -> ExactPredictor:
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

    @bare_arguments
    def with_model(self, model: PhysicalModel, lander_pa_m: Floats) -> ExactPredictor:
        """The same observations prepared with another model, for values only."""
        observations, epoch = self.observations, self._clock_epoch
        return ExactPredictor(
            model, observations, lander_pa_m, self.trajectory, self.targets, clock_epoch=epoch
        )

    def _take(self, observations: Observations) -> None:
        super()._take(observations)
        self._integrated = np.flatnonzero(is_integrated(observations.kind))
        self._rows = np.concatenate([np.arange(len(observations)), self._integrated])
        self._which = np.concatenate([self.transmitters[self._rows], self.receivers[self._rows]])
        self._target = self.target[self._rows]
        ramps = observations.ramps
        self._frequencies = {self._name(name): ramps.of_station(name) for name in ramps.stations}

    def _half(self, end: int) -> slice:
        n = len(self._tag)
        return slice(end * n, (end + 1) * n)

    def _observed(self, of_paths: Floats, *, mean: bool = False) -> Floats:
        """From paths to observations: the path itself; of the two of a count interval the difference, or the mean."""
        n = len(self.observations)
        out = of_paths[:n].copy()
        late, early = out[self._integrated], of_paths[n:]
        out[self._integrated] = 0.5 * (late + early) if mean else late - early
        return out

    def _place(self, lander_pa_m: Floats) -> None:
        """Place the straight motions at the events of the path to this position."""
        path = self._rough_path(lander_pa_m)
        row, ends_s = _twice(np.arange(len(self._tag))), path.ends_s
        blocks = [slice(first, first + _BLOCK) for first in range(0, max(len(row), 1), _BLOCK)]
        self._ends = joined([self._stations_at(row, ends_s, block) for block in blocks])
        self._place_target(path.bounce_s, lander_pa_m)
        for name in ("_ends", "_moon", "_clock"):
            setattr(self, name, rows_of(getattr(self, name), slice(None)))  # by component
        self.model.earth.warn_of_predictions(self._tt[: len(self.observations)], self.predicted_eop)

    def _stations_at(self, row: NDArray[np.intp], offset_s: Floats, block: slice) -> StationMotion:
        reference, earth = self._reference[row[block]], rows_of(self._earth, row[block])
        return station_motion(
            self.model, self._stations, self._which[block], reference, earth, offset_s[block]
        )

    def _rough_path(self, lander_pa_m: Floats) -> LightPath:
        """The path to 0.1 microseconds, from motions that are straight from the reference epochs on."""
        ends = rough_station_motion(self.model, self._stations, self._which, self._tt, self._earth)
        self._place_target(np.zeros(len(self._tag)), lander_pa_m)
        places_s = topocentric_tdb_minus_tt(_twice(self._earth.velocity_m_s), ends.position_m)
        return self._solver(ends, self._relay(lander_pa_m), places_s)(0.0, 0.0, tolerance_s=_ROUGHLY_S)

    def _place_target(self, offset_s: Floats, lander_pa_m: Floats) -> None:
        """The motion of the Moon, or of the spacecraft, and the target's clock."""
        self._moon = lunar_motion(self.model, self._reference, self._earth, offset_s)
        if self._orbit is not None:
            self._moon = self._moon.with_craft(self._orbit, self.model, self._reference)
        keeps = (self._sign == 0.0) & self.model.has("target_proper_time")
        # Counts need no common zero, so that a trajectory may have gaps between the passes.
        counted = is_integrated(self._paths.kind) & (self._paths.count_s < SHORTEST_GAP_S)
        epoch = None if counted[keeps].all() else self._clock_epoch
        radius_m = length(np.atleast_2d(lander_pa_m))[self._target]
        tdb = self._reference.shifted(offset_s)
        self._clock = target_clock(self.model, tdb, keeps, radius_m, epoch, self._orbit)

    def _free_clocks(self) -> tuple[Floats, Floats]:
        """By how much clocks of stations that run free are ahead at the reference epochs, s, and rates; of both ends.

        A one-way path has none at its first end.
        """
        free = self.model.free_clocks if self.model.has("station_proper_time") else ()
        rate = np.array([station_rate(one) if one.name in free else 0.0 for one in self._stations])[
            self._which
        ]
        rate[self._half(0)][self._sign == 0.0] = 0.0
        since_s = np.zeros(len(self._tag))
        if rate.any() and self._clock_epoch is not None:
            since_s = self._reference.seconds_since(self._clock_epoch)
        return rate * _twice(since_s), rate

    def _both_ends(self) -> LegEnd:
        """Stations and signals at both ends of the paths."""
        paths, which = self._paths, self._which
        sent = np.append(self._sign > 0.0, np.zeros(len(paths), dtype=bool))
        # Of a leg that goes up the recorded uplink's frequency, where that was recorded, else the downlink's.
        down_hz, uplink_hz = _twice(C_M_S / (paths.wavelength_um * 1e-6)), _twice(paths.uplink_hz)
        weather = (paths.pressure_hpa, paths.temperature_k, paths.relative_humidity)
        return LegEnd(
            self._stations,
            which,
            self._tt[_twice(np.arange(len(paths)))],
            _twice(is_radio(paths.wavelength_um, self._stations, which[self._half(1)])),
            _twice(is_integrated(paths.kind)),
            np.where(sent & ~np.isnan(uplink_hz), uplink_hz, down_hz),
            _twice(paths.wavelength_um),
            Weather(*map(_twice, weather)),
            which == _twice(which[self._half(1)]),
        )

    def _relay(self, lander_pa_m: Floats) -> MovingPoint:
        """The motion of the target, as the Moon is placed; a source at infinity stands still."""
        lander_pa_m = np.asarray(lander_pa_m, dtype=np.float64)
        if not np.isfinite(lander_pa_m).all():
            raise InputError(
                f"a position is {lander_pa_m.tolist()}; give finite coordinates in principal axes, m"
            )
        if lander_pa_m.ndim == 2:
            lander_pa_m = lander_pa_m[self._target]
        relay = self._moon.point(self.model, lander_pa_m)
        return replace(relay, velocity_m_s=relay.velocity_m_s * (self._target >= 0)[:, None])

    @property
    def _at_infinity(self) -> Floats | None:
        """Directions of sources at infinity, zeros of other targets; None where there are no sources."""
        return None if (self._target >= 0).all() else self._far

    def _solver(
        self, ends: MovingPoint, relay: MovingPoint, topocentric_s: Floats
    ) -> Callable[..., LightPath]:
        """:func:`solve_light_path` between motions, but for the delays."""
        # The reference epoch reads the tag as the geocentre's TT; the station's differs by up to 2 microseconds. A
        # one-way transmission, with which the path begins, is tagged by the target's clock.
        zero = np.zeros(len(self._tag))
        ahead_s, _, _ = self._clock.at(self._moon.origin, relay, zero)
        first_s, second_s = np.split(topocentric_s - self._gained_s, 2)
        tagged_s = np.choose(self._tag, (first_s, second_s, -ahead_s)) + self._equipment.after_tag_s
        up, down = _split(ends)
        return partial(
            solve_light_path,
            up,
            relay,
            down,
            self._tag,
            tagged_s,
            sign=self._sign,
            hold_s=self._equipment.hold_s,
            source=self._at_infinity,
        )

    def _solve(self, lander_pa_m: Floats) -> tuple[LightPath, MovingPoint, LineOfSight]:
        """The path, the motion of the point, and the views from both ends.

        The views are those along the path without delays, in which elevations are off by 1e-10 rad.
        """
        relay = self._relay(lander_pa_m)
        solve = self._solver(self._ends.point, relay, self._ends.topocentric_s)
        path = solve(0.0, 0.0, tolerance_s=_ROUGHLY_S)
        views = self._lines_of_sight(path, relay)
        delay_m = self._gravity(path, relay) + self._drag(path) * views.delay_m
        return solve(*np.split(delay_m, 2), near=path), relay, views

    def _drag(self, path: LightPath) -> Floats:
        """Media's delay of legs in the barycentric frame, over that in the frame in which the media rest.

        While the signal is delayed the medium carries it along with the station, at up to 1e-4 of the speed of light.
        """
        along = np.concatenate([self._sign[:, None] * path.up_unit, path.down_unit])
        return 1.0 - dot(along, self._ends.point.velocity_m_s) / C_M_S

    def _gravity(self, path: LightPath, relay: MovingPoint) -> Floats:
        """Gravitational delay of both legs, m.

        The Sun and the planets stand still in the barycentric frame to what matters; for the Earth and the Moon, which
        do not, the frame that moves with the Earth is the one in which they do.
        """
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
            lander_gcrs_m[far] = _FAR_M * (source + v - source * dot(source, v)[:, None])
            velocity_m_s[far] = 0.0
        moon_gcrs_m = None if self.trajectory is None else _twice(self._moon.moon_gcrs_m)
        leg = Leg(self._end, self._ends, _twice(lander_gcrs_m), _twice(velocity_m_s))
        return line_of_sight(leg, self.model.media, self._media, moon_gcrs_m)


def _twice(of_paths: NDArray[Any]) -> NDArray[Any]:
    """What belongs to paths, for both of their ends."""
    return np.concatenate([of_paths, of_paths])


def _both(of_ends: Floats) -> Floats:
    """What belongs to the ends of paths, summed."""
    first, second = np.split(of_ends, 2)
    return np.asarray(first + second)


def _split(ends: MovingPoint) -> tuple[MovingPoint, MovingPoint]:
    """The motions of the first and of the second stations."""
    columns = (np.split(column, 2) for column in (ends.offset_s, ends.position_m, ends.velocity_m_s))
    up, down = (MovingPoint(*half) for half in zip(*columns, strict=True))
    return up, down


def is_radio(
    wavelength_um: Floats, stations: Sequence[Station], receiver: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Whether signals are radio, shape (n,); without a recorded wavelength those to laser stations are light."""
    laser = np.array([station.kind == "llr" for station in stations], dtype=bool)[receiver]
    return np.where(np.isnan(wavelength_um), ~laser, wavelength_um >= _SHORTEST_RADIO_UM)


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
"""What an arc holds for each light path."""
_PER_END = ("_media", "_ends", "_gained_s", "_gained_rate")
"""What it holds for each end of one."""
