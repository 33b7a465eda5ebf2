"""An arc of tracking: predictions of ranges, VLBI delays and Doppler for one target, with partials.

The target is a point fixed to the Moon, or a spacecraft on a trajectory (:class:`~radioloc.ephemeris.Trajectory`).

What is measured is said by each type of measurement (:mod:`~radioloc.measurements.registry`), all in metres and by
the stations' atomic clocks (TT rate, as UTC has). Tags and values are those at the stations' reference points, unless
the model has delays of equipment that the data still contain (:mod:`~radioloc.measurements.equipment_delays`): then
they are those of the clocks behind it.

An arc is prepared once (:class:`ExactPredictor`): the motion of the stations and of the Moon near each event does not
depend on where the point is, but for the few microseconds by which the light time changes with it. A prediction for a
given position is then a light-time solution between straight motions.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    PathPartials,
    gravitational_delay_m,
    path_length_partials,
    plane_wave_delay_m,
    solve_light_path,
)
from radioloc.measurements.line_of_sight import LineOfSight, line_of_sight, prepared_media
from radioloc.measurements.lunar_motion import LunarMotion, lunar_motion, with_craft
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.proper_time import SHORTEST_GAP_S, StationClocks, station_rate, target_clock
from radioloc.measurements.proper_time import clock_epoch as clock_epoch_of
from radioloc.measurements.ramps import RampTerm
from radioloc.measurements.records import joined, rows_of
from radioloc.measurements.registry import is_combined, is_differenced, is_integrated, is_one_way
from radioloc.measurements.sources import with_galactic_aberration
from radioloc.measurements.station_motion import StationMotion, rough_station_motion, station_motion
from radioloc.media.ionosphere import delay_by_content_m
from radioloc.media.medium import Leg, LegEnd
from radioloc.media.status import Status, first_of
from radioloc.time import Epochs, geocentric_tdb_minus_tt, tai_to_tt, topocentric_tdb_minus_tt, utc_to_tt
from radioloc.vectors import dot, length, rotated

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
        approximate_pa_m: NDArray[np.float64],
        trajectory: AnyTrajectory | None = None,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, trajectory, targets, more_partials)
        self._clock_epoch = clock_epoch or clock_epoch_of(observations, trajectory)
        self._orbit, self._orbit_x = trajectory, np.full(1, np.nan)
        if is_combined(observations.kind).any():
            raise InputError(
                "some observations combine others; radioloc.measurements.prepare_predictor takes them"
            )
        # One path per observation; one with a count interval is the difference of two, at its ends.
        integrated = is_integrated(observations.kind)
        rows = self._path_rows
        tt = utc_to_tt(observations.epoch)
        half_s = np.where(integrated, 0.5 * observations.count_s, 0.0)
        half_s = np.concatenate([half_s, -half_s[self._integrated]])
        self._tt = tt = tt[rows].shifted(half_s)
        self._paths = observations.select(rows)
        differenced = is_differenced(self._paths.kind)
        self._radio = is_radio(self._paths.wavelength_um, self._stations, self._receiver)
        one_way = is_one_way(self._paths.kind)
        self._sign = np.where(differenced, -1.0, np.where(one_way, 0.0, 1.0))
        # A one-way signal begins with the bounce.
        sent = np.where(one_way & (self._paths.tag == TRANSMIT), BOUNCE, self._paths.tag)
        self._tag = np.where(differenced, TRANSMIT, sent).astype(np.int8)
        self._media = tuple(prepared_media(model.media, end) for end in self._ends())
        ends = self._transmitter, self._receiver
        self._equipment = model.delays.on_paths(self.stations, *ends, self._tag, self._sign, model.terms)
        self._reference = Epochs.from_jd(
            tt.jd, tt.fraction + geocentric_tdb_minus_tt(tt) / SECONDS_PER_DAY, "TDB"
        )
        self._earth = model.ephemeris.earth(self._reference)
        self._far = self._source[rows]
        if model.has("galactic_aberration"):
            far = np.flatnonzero(self._target < 0)
            self._far[far] = with_galactic_aberration(self._far[far], self._reference[far])
        self._clocks = self._station_clocks()
        self._prepare(self._beside(np.asarray(approximate_pa_m, dtype=np.float64)))

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        predicted = self._up.predicted_eop | self._down.predicted_eop
        out = predicted[: len(self.observations)].copy()
        out[self._integrated] |= predicted[len(self.observations) :]
        return out

    @bare_arguments
    def at(self, lander_pa_m: NDArray[np.float64]) -> Computed:
        """Predict all observations for a position; a ConvergenceError where the light times do not settle."""
        lander_pa_m = self._beside(lander_pa_m)
        path, relay, (up, down) = self._solve(lander_pa_m)
        near = self._up.point.holds_at(path.transmit_s) and self._down.point.holds_at(path.receive_s)
        if not (near and self._moon.centre.holds_at(path.bounce_s)):
            self._prepare(lander_pa_m)
            path, relay, (up, down) = self._solve(lander_pa_m)
        ramp = self._ramp(path)
        ahead_s, ahead_rate, ahead_by_place = self._clock.at(self._moon.origin, relay, path.bounce_s)
        first_ahead_s, second_ahead_s = self._clocks.ahead(path.transmit_s, path.receive_s)
        gained_s = second_ahead_s - first_ahead_s - ahead_s
        flight_s = self._sign * path.up_s + (path.down_s + self._equipment.in_value_s) + gained_s
        length_m = C_M_S * flight_s - ramp.excess_m
        if self.model.has("tdb_tt"):
            first_s = np.where(
                self._sign == 0.0,
                self._up.geocentric_tdb_minus_tt_at(path.bounce_s),
                self._up.tdb_minus_tt_at(path.transmit_s),
            )
            length_m = length_m - C_M_S * (self._down.tdb_minus_tt_at(path.receive_s) - first_s)
        partials = path_length_partials(
            path, self._up.point, relay, self._down.point, self._tag, self._sign
        ).scaled(ramp.scale)
        by_position = partials.by_position - C_M_S * ahead_by_place
        gained = self._clocks.second_rate - self._clocks.first_rate - ahead_rate
        by_time = partials.by_tag + C_M_S * gained
        if self.model.has("tdb_tt"):
            # 1e-5 m/s in two-way, but up to 0.1 m/s between two stations, whose velocities differ.
            first_rate = np.where(self._sign == 0.0, self._up.geocentric_tdb_rate, self._up.tdb_rate)
            by_time = by_time - C_M_S * ramp.scale * (self._down.tdb_rate - first_rate)
        by_time = by_time + ramp.by_tag_m_s
        by_zenith_wet = []
        legs = zip((up, down), (partials.by_up_delay, partials.by_down_delay), self._drag(path), strict=True)
        for view, by_delay, drag in legs:
            by_media = by_delay * drag
            by_time = by_time + by_media * view.rate_m_s
            by_position = by_position + by_media[:, None] * view.by_position
            by_zenith_wet.append(by_media * view.by_zenith_wet)
        by_position = by_position * (self._target >= 0)[:, None]
        by_position_pa = rotated(np.swapaxes(self._moon.rot_pa_to_icrf, -1, -2), by_position)
        n = len(self.observations)
        one_way = self._sign == 0.0
        up_rad, down_rad = up.leg.elevation.angle_rad, down.leg.elevation.angle_rad
        elevation_rad = np.stack([np.where(one_way, down_rad, up_rad), down_rad], axis=-1)
        first = first_of(np.where(one_way, 0, up.status), ramp.status)
        status = np.stack([first, down.status], axis=-1).astype(np.int8)
        if len(self._integrated):
            late, early = elevation_rad[self._integrated], elevation_rad[n:]
            elevation_rad[self._integrated] = np.where((late >= 0.0) & (early < 0.0), early, late)
            status[self._integrated] = first_of(status[self._integrated], status[n:])
        by_station, by_content, mean = np.zeros((n, 0, 3)), np.zeros((n, 0)), np.zeros((n, 0))
        if self.more_partials:
            by_station = self._by_stations(path, partials)
            by_content = self._by_electron_content(path, partials, (up, down))
            mean = self._observed(by_position_pa, mean=True)
        return Computed(
            value_m=self._observed(length_m),
            by_position_pa=self._observed(by_position_pa),
            by_time_m_s=self._observed(by_time),
            by_transponder_delay_m_s=self._observed(np.where(self._sign > 0.0, partials.by_hold, 0.0)),
            by_zenith_wet=self._observed(np.stack(by_zenith_wet, axis=-1)),
            elevation_rad=elevation_rad[:n],
            status=status[:n],
            by_station_itrf=by_station,
            by_electron_content_m=by_content,
            mean_by_position_pa=mean,
            by_orbit=self._by_orbit(path, by_position),
        )

    @bare_arguments
    def light_path(self, lander_pa_m: NDArray[np.float64]) -> tuple[LightPath, StationMotion, StationMotion]:
        """The solved light paths for a position, and both stations near their events.

        Where observations have a count interval the paths at its starts follow those at its ends.
        """
        self.at(lander_pa_m)  # places the motions at the events
        return self._solve(self._beside(lander_pa_m))[0], self._up, self._down

    def _ramp(self, path: LightPath) -> RampTerm:
        """What ramps of the transmitted frequency do to the paths' values."""
        n, paths = len(self._paths), self._paths
        term = RampTerm(np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n, dtype=np.int8))
        if not paths.ramped.any():
            return term
        # The transmitter's clock reads TT, from the epoch that the tag says, or the end of the count.
        one_way = self._sign == 0.0
        sent_s = np.where(one_way, path.bounce_s, path.transmit_s - self._equipment.transmit_s)
        geocentric_s = self._up.geocentric_tdb_minus_tt_at
        ahead_s = np.where(one_way, geocentric_s(sent_s), self._up.tdb_minus_tt_at(sent_s))
        sent_s = sent_s + geocentric_s(np.zeros(n)) - ahead_s
        counted = is_integrated(paths.kind)
        other = np.arange(n)
        other[self._integrated] = np.arange(len(self.observations), n)
        other[len(self.observations) :] = self._integrated
        reference_hz = np.where(one_way, 1e6 * C_M_S / paths.wavelength_um, paths.uplink_hz)
        sender = np.array([self._name(link.transmitter or link.target) for link in paths.links])[paths.link]
        term.status[paths.ramped] = Status.NO_RAMP
        for name in paths.ramps.stations:
            frequency = paths.ramps.of_station(name)
            rows = np.flatnonzero(paths.ramped & (sender == self._name(name)))
            origin = tai_to_tt(frequency.origin)
            tag_s = np.full(n, np.nan)
            tag_s[rows] = self._tt[rows].seconds_since(origin[np.zeros(len(rows), dtype=int)])
            time_s = tag_s + sent_s
            end_s = np.where(counted, time_s[other], tag_s)
            rows = rows[frequency.covers(time_s[rows], end_s[rows])]
            term.status[rows] = Status.OK
            f0_hz = reference_hz[rows]
            # One instant for both ends of a count: the reference frequency's cycles are counted from there on.
            since_s = np.where(counted, np.minimum(tag_s, tag_s[other]), tag_s)[rows]
            sent_hz, cycles = frequency.at(time_s[rows], since_s, f0_hz)
            term.scale[rows] = sent_hz / f0_hz
            term.by_tag_m_s[rows] = -C_M_S * (sent_hz / f0_hz - 1.0)
            ranges = ~counted[rows]
            if ranges.any():
                now_hz, until = frequency.at(tag_s[rows], since_s, f0_hz)
                cycles = cycles - np.where(ranges, until, 0.0)
                term.by_tag_m_s[rows] += np.where(ranges, C_M_S * (now_hz / f0_hz - 1.0), 0.0)
            term.excess_m[rows] = C_M_S / f0_hz * cycles
        return term

    def _name(self, transmitter: str) -> str:
        """The catalogue's name of a station; a target keeps its own."""
        catalogue = self.model.catalogue
        return catalogue.get(transmitter).name if transmitter in catalogue else transmitter

    def _beside(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position beside the trajectory; one that is adjustable goes where changes of its parameters take it."""
        if not isinstance(self.trajectory, AdjustableTrajectory):
            return x
        if not np.array_equal(x, self._orbit_x):
            self._orbit = self.trajectory.corrected(x) if np.any(x) else self.trajectory
            self._orbit_x = np.array(x)
            if hasattr(self, "_moon"):
                self._moon = with_craft(self._moon, self._orbit, self.model, self._reference)
        return np.zeros(3)

    def _by_orbit(self, path: LightPath, by_position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Partials by the parameters of an adjustable trajectory, shape (n, p)."""
        if not isinstance(self._orbit, AdjustableTrajectory):
            return np.zeros((len(self.observations), 0))
        moved = self._orbit.position_partials(self._reference.shifted(path.bounce_s))
        return self._observed(np.einsum("ni,nip->np", by_position, moved))

    def _by_stations(self, path: LightPath, partials: PathPartials) -> NDArray[np.float64]:
        """Partials by the ITRF coordinates of both stations, shape (n, 2, 3)."""
        first = -partials.by_up_delay[:, None] * path.up_unit
        second = partials.by_down_delay[:, None] * path.down_unit
        if self.model.has("tdb_tt"):
            # TDB - TT at a station has v_E . r / c^2, 1e-4 of a displacement; in two-way it cancels.
            by_clock = self._earth.velocity_m_s / C_M_S
            first, second = first + by_clock * (self._sign != 0.0)[:, None], second - by_clock
        ends = (self._up, first), (self._down, second)
        by_itrf = [rotated(np.swapaxes(station.rot_itrf_to_gcrs, -1, -2), by) for station, by in ends]
        return self._observed(np.stack(by_itrf, axis=1))

    def _by_electron_content(
        self, path: LightPath, partials: PathPartials, views: tuple[LineOfSight, LineOfSight]
    ) -> NDArray[np.float64]:
        """Partials by the vertical electron content above both stations, m/TECU, shape (n, 2)."""
        legs = zip(views, (partials.by_up_delay, partials.by_down_delay), self._drag(path), strict=True)
        columns = [
            np.where(by_delay == 0.0, 0.0, by_delay * drag * delay_by_content_m(view.leg))
            for view, by_delay, drag in legs
        ]
        return self._observed(np.stack(columns, axis=-1))

    def select(self, which: Any) -> ExactPredictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        n = len(self.observations)
        rows = np.arange(n)[which]
        second = np.full(n, -1)
        second[self._integrated] = n + np.arange(len(self._integrated))
        paths = np.concatenate([rows, second[rows][second[rows] >= 0]])
        part = copy.copy(self)
        part._take(self.observations.select(rows))
        for name in _PER_PATH:
            setattr(part, name, rows_of(getattr(self, name), paths))
        if isinstance(self.trajectory, AdjustableTrajectory) and len(rows):
            seconds = (self._reference.jd[paths] - self._reference.jd[0]) + self._reference.fraction[paths]
            ends = part._reference[[int(seconds.argmin()), int(seconds.argmax())]]
            first, last = ends[0].shifted(-_MARGIN_S), ends[1].shifted(_MARGIN_S)
            part.trajectory, part._orbit_x = self.trajectory.over(first, last), np.full(1, np.nan)
        return part

    def along(self, trajectory: AdjustableTrajectory) -> ExactPredictor:
        """As :meth:`Predictor.along`."""
        other = super().along(trajectory)
        other._orbit_x = np.full(1, np.nan)
        return other

    @staticmethod
    def concatenate(arcs: Sequence[ExactPredictor]) -> ExactPredictor:
        """Join prepared arcs of one model, in order; at least one."""
        whole = copy.copy(arcs[0])
        whole._take(Observations.concatenate([arc.observations for arc in arcs]))
        # The paths of each arc are its observations and then the second paths of what is counted; so are the whole's.
        second = np.concatenate([np.arange(len(arc._paths)) >= len(arc.observations) for arc in arcs])
        order = np.argsort(second, kind="stable")
        for name in _PER_PATH:
            setattr(whole, name, rows_of(joined([getattr(arc, name) for arc in arcs]), order))
        whole._orbit_x = np.full(1, np.nan)  # each may have left its trajectory elsewhere
        return whole

    @bare_arguments
    def with_model(self, model: PhysicalModel, lander_pa_m: NDArray[np.float64]) -> ExactPredictor:
        """The same observations prepared with another model, for values only."""
        return ExactPredictor(
            model,
            self.observations,
            lander_pa_m,
            self.trajectory,
            self.targets,
            clock_epoch=self._clock_epoch,
        )

    def _take(self, observations: Observations) -> None:
        super()._take(observations)
        self._integrated = np.flatnonzero(is_integrated(observations.kind))
        rows = np.concatenate([np.arange(len(observations)), self._integrated])
        self._path_rows = rows
        self._transmitter, self._receiver = self.transmitters[rows], self.receivers[rows]
        self._target = self.target[rows]

    def _observed(self, of_paths: NDArray[np.float64], *, mean: bool = False) -> NDArray[np.float64]:
        """From paths to observations: the path itself; of the two of a count interval the difference, or the mean."""
        n = len(self.observations)
        out = of_paths[:n].copy()
        late, early = out[self._integrated], of_paths[n:]
        out[self._integrated] = 0.5 * (late + early) if mean else late - early
        return out

    def _prepare(self, lander_pa_m: NDArray[np.float64]) -> None:
        """Place the straight motions at the events of the path to this position."""
        path = self._rough_path(lander_pa_m)
        n = len(self._paths)
        which = np.concatenate([self._transmitter, self._receiver])
        offset_s = np.concatenate([path.transmit_s, path.receive_s])
        row = np.tile(np.arange(n), 2)
        blocks = [slice(first, first + _BLOCK) for first in range(0, max(2 * n, 1), _BLOCK)]
        ends = joined([self._station(which[block], row[block], offset_s[block]) for block in blocks])
        self._up, self._down = rows_of(ends, slice(n)), rows_of(ends, slice(n, None))
        self._place_target(path.bounce_s, lander_pa_m)
        for name in ("_moon", "_clock"):
            setattr(self, name, rows_of(getattr(self, name), slice(None)))
        self.model.earth.warn_of_predictions(self._tt[: len(self.observations)], self.predicted_eop)

    def _rough_path(self, lander_pa_m: NDArray[np.float64]) -> LightPath:
        """The path to 0.1 microseconds, from motions that are straight from the reference epochs on."""
        zero = np.zeros(len(self._paths))
        up, down = (
            rough_station_motion(self.model, self._stations, which, self._tt, self._earth)
            for which in (self._transmitter, self._receiver)
        )
        self._place_target(zero, lander_pa_m)
        relay = self._relay(lander_pa_m)
        places_s = (topocentric_tdb_minus_tt(self._earth.velocity_m_s, end.position_m) for end in (up, down))
        return self._solver(up, relay, down, *places_s)(0.0, 0.0, tolerance_s=_ROUGHLY_S)

    def _place_target(self, offset_s: NDArray[np.float64], lander_pa_m: NDArray[np.float64]) -> None:
        """The motion of the Moon, or of the spacecraft, and the target's clock."""
        self._moon = lunar_motion(self.model, self._reference, self._earth, offset_s, self._orbit)
        keeps = (self._sign == 0.0) & self.model.has("target_proper_time")
        # Counts need no common zero, so that a trajectory may have gaps between the passes.
        counted = is_integrated(self._paths.kind) & (self._paths.count_s < SHORTEST_GAP_S)
        epoch = None if counted[keeps].all() else self._clock_epoch
        radius_m = length(np.atleast_2d(lander_pa_m))[self._target]
        tdb = self._reference.shifted(offset_s)
        self._clock = target_clock(self.model, tdb, keeps, radius_m, epoch, self._orbit)

    def _station_clocks(self) -> StationClocks:
        """Clocks of the stations that run free; a one-way path has none at its first end."""
        free = self.model.free_clocks if self.model.has("station_proper_time") else ()
        rates = np.array([station_rate(one) if one.name in free else 0.0 for one in self._stations])
        first, second = (rates[which] for which in (self._transmitter, self._receiver))
        since_s = np.zeros(len(self._paths))
        if rates.any() and self._clock_epoch is not None:
            since_s = self._reference.seconds_since(self._clock_epoch)
        return StationClocks(since_s, np.where(self._sign == 0.0, 0.0, first), second)

    def _ends(self) -> Iterator[LegEnd]:
        """Stations and signals at both ends of the paths."""
        for which, uplink in ((self._transmitter, self._sign > 0.0), (self._receiver, np.False_)):
            yield LegEnd(
                self._stations,
                which,
                self._tt,
                self._radio,
                is_integrated(self._paths.kind),
                _frequency_hz(self._paths, uplink),
                self._paths.wavelength_um,
                self._paths,
                which == self._receiver,
            )

    def _station(
        self, which: NDArray[np.int32], row: NDArray[np.intp], offset_s: NDArray[np.float64]
    ) -> StationMotion:
        reference, earth = self._reference[row], rows_of(self._earth, row)
        return station_motion(self.model, self._stations, which, reference, earth, offset_s)

    def _relay(self, lander_pa_m: NDArray[np.float64]) -> MovingPoint:
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

    def _solver(
        self,
        up: MovingPoint,
        relay: MovingPoint,
        down: MovingPoint,
        up_topocentric_s: NDArray[np.float64],
        down_topocentric_s: NDArray[np.float64],
    ) -> Callable[..., LightPath]:
        """:func:`solve_light_path` between motions, but for the delays."""
        # The reference epoch reads the tag as the geocentre's TT; the station's differs by up to 2 microseconds.
        zero = np.zeros(len(self._tag))
        tagged_s = np.choose(self._tag, (up_topocentric_s, down_topocentric_s, zero))
        # A one-way transmission, with which the path begins, is tagged by the target's clock.
        ahead_s, _, _ = self._clock.at(self._moon.origin, relay, zero)
        first_s, second_s = self._clocks.ahead(zero, zero)
        tagged_s = tagged_s - np.choose(self._tag, (first_s, second_s, ahead_s)) + self._equipment.after_tag_s
        return partial(
            solve_light_path,
            up,
            relay,
            down,
            self._tag,
            tagged_s,
            sign=self._sign,
            hold_s=self._equipment.hold_s,
            source=None if (self._target >= 0).all() else self._far,
        )

    def _solve(
        self, lander_pa_m: NDArray[np.float64]
    ) -> tuple[LightPath, MovingPoint, tuple[LineOfSight, LineOfSight]]:
        """The path, the motion of the point, and the view from both stations.

        The views are those along the path without delays, in which elevations are off by 1e-10 rad.
        """
        relay, up, down = self._relay(lander_pa_m), self._up, self._down
        solve = self._solver(up.point, relay, down.point, up.topocentric_s, down.topocentric_s)
        path = solve(0.0, 0.0, tolerance_s=_ROUGHLY_S)
        views = self._lines_of_sight(path, relay)
        delays_m = zip(self._gravity(path, relay), self._drag(path), views, strict=True)
        up_m, down_m = (gravity_m + drag * view.delay_m for gravity_m, drag, view in delays_m)
        return solve(up_m, down_m, near=path), relay, views

    def _drag(self, path: LightPath) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Media's delay of each leg in the barycentric frame, over that in the frame in which the media rest.

        While the signal is delayed the medium carries it along with the station, at up to 1e-4 of the speed of light.
        """
        up = self._sign * dot(path.up_unit, self._up.point.velocity_m_s) / C_M_S
        return 1.0 - up, 1.0 - dot(path.down_unit, self._down.point.velocity_m_s) / C_M_S

    def _gravity(
        self, path: LightPath, relay: MovingPoint
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gravitational delay of both legs, m.

        The Sun and the planets stand still in the barycentric frame to what matters; for the Earth and the Moon, which
        do not, the frame that moves with the Earth is the one in which they do.
        """
        up_m, down_m = np.zeros((2, len(self._paths)))
        if not self.model.has("shapiro"):
            return up_m, down_m
        gm = self.model.ephemeris.constants.gm_m3_s2
        lander_m = relay.at(path.bounce_s)
        lander_gcrs_m, _ = self._moon.geocentric(relay, path.bounce_s)
        far = np.flatnonzero(self._target < 0)
        solar_m = self._up.point.at(path.transmit_s), self._down.point.at(path.receive_s)
        terrestrial_m = self._up.gcrs_m, self._down.gcrs_m
        at_rest = (
            (lander_m, solar_m, self._moon.bodies_m),
            (lander_gcrs_m, terrestrial_m, {"earth": np.zeros(3), "moon": self._moon.moon_gcrs_m}),
        )
        for point_m, ends_m, bodies_m in at_rest:
            between_m = [length(point_m - end_m) for end_m in ends_m]
            for body, body_m in bodies_m.items():
                to_point_m = length(point_m - body_m)
                for total_m, end_m, leg_m in zip((up_m, down_m), ends_m, between_m, strict=True):
                    delay_m = gravitational_delay_m(length(end_m - body_m), to_point_m, leg_m, gm(body))
                    if len(far):
                        delay_m[far] = plane_wave_delay_m((end_m - body_m)[far], self._far[far], gm(body))
                    total_m += delay_m
        return up_m, down_m

    def _lines_of_sight(self, path: LightPath, relay: MovingPoint) -> tuple[LineOfSight, LineOfSight]:
        """The views from both stations."""
        lander_gcrs_m, velocity_m_s = self._moon.geocentric(relay, path.bounce_s)
        far = np.flatnonzero(self._target < 0)
        if len(far):
            # Aberration turns its direction into that of the frame that moves with the Earth.
            v, source = self._earth.velocity_m_s[far] / C_M_S, self._far[far]
            lander_gcrs_m[far] = _FAR_M * (source + v - source * dot(source, v)[:, None])
            velocity_m_s[far] = 0.0
        moon_gcrs_m = None if self.trajectory is None else self._moon.moon_gcrs_m
        media = self.model.media
        up, down = (
            line_of_sight(Leg(end, station, lander_gcrs_m, velocity_m_s), media, prepared, moon_gcrs_m)
            for end, station, prepared in zip(self._ends(), (self._up, self._down), self._media, strict=True)
        )
        return up, down


def _frequency_hz(paths: Observations, uplink: ArrayLike) -> NDArray[np.float64]:
    """Frequency of a leg: the recorded uplink's where it goes up and that was recorded, else the downlink's."""
    down_hz = C_M_S / (paths.wavelength_um * 1e-6)
    return np.where(uplink & ~np.isnan(paths.uplink_hz), paths.uplink_hz, down_hz)


def is_radio(
    wavelength_um: NDArray[np.float64], stations: Sequence[Station], receiver: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Whether signals are radio, shape (n,); without a recorded wavelength those to laser stations are light."""
    laser = np.array([station.kind == "llr" for station in stations], dtype=bool)[receiver]
    return np.where(np.isnan(wavelength_um), ~laser, wavelength_um >= _SHORTEST_RADIO_UM)


_PER_PATH = (
    "_paths",
    "_radio",
    "_tt",
    "_media",
    "_sign",
    "_tag",
    "_equipment",
    "_reference",
    "_earth",
    "_up",
    "_down",
    "_moon",
    "_far",
    "_clock",
    "_clocks",
)
"""What an arc holds for each light path."""
