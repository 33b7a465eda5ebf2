"""An arc of tracking: predictions of ranges, VLBI delays and Doppler, with partials.

Targets are points fixed to the Moon, and spacecraft on trajectories (:class:`~radioloc.ephemeris.Trajectory`).
Values are in metres and by the stations' atomic clocks (TT rate, as UTC has), at the stations' reference points or,
with delays of equipment (:mod:`~radioloc.measurements.equipment_delays`), at the clocks behind them.
"""

from __future__ import annotations

import numpy as np

from radioloc.constants import C_M_S
from radioloc.measurements.light_path import LightPath, halves, path_length_partials, twice
from radioloc.measurements.predictor import Computed
from radioloc.measurements.prepared_paths import PreparedPaths, rows_of
from radioloc.measurements.ramps import RampTerm, ramp_term
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.station_motion import StationMotion
from radioloc.measurements.target_motion import GivenMotions, partials_of_points
from radioloc.media.ionosphere import delay_by_content_m
from radioloc.media.status import first_failure
from radioloc.vectors import Floats, rotated


class ExactPredictor(PreparedPaths):
    """The observations of one arc, none of them combined, each computed by itself.

    Parameters and errors are those of :func:`prepare_predictor`. ``clock_epoch`` (TDB) is when the clock of a target
    that transmits by its own reads TT; as a rule at 0h UTC of the first day.
    """

    def at(self, motions: GivenMotions | None = None) -> Computed:
        """Predict all observations for motions; a ConvergenceError where the light times do not settle."""
        self._aim(motions)
        path, relay, views, drag = self._solve()
        if not (self._ends.point.holds_at(path.ends_s) and self._moon.centre.holds_at(path.bounce_s)):
            self._place()
            path, relay, views, drag = self._solve()
        ramp, one_way, tdb_tt = self._ramp(path), self._sign == 0.0, self.model.has("tdb_tt")
        up, down = self._ends.point.halves()
        partials = path_length_partials(path, up, relay, down, self._tag, self._sign)
        partials = partials.scaled(ramp.scale)

        ahead_s, ahead_rate, ahead_by_place = self._clock.at(self._moon.origin, relay, path.bounce_s)
        first_ahead_s, second_ahead_s = halves(self._gained_s + self._gained_rate * path.ends_s)
        gained_s = second_ahead_s - first_ahead_s - ahead_s
        flight_s = self._sign * path.up_s + (path.down_s + self._equipment.in_value_s) + gained_s
        length_m = C_M_S * flight_s - ramp.excess_m
        if tdb_tt:
            first_s, second_s = halves(self._ends.tdb_minus_tt_at(path.ends_s))
            first_s = np.where(one_way, self._geocentric_tdb_minus_tt_s(path.bounce_s), first_s)
            length_m = length_m - C_M_S * (second_s - first_s)

        first_rate, second_rate = halves(self._gained_rate)
        by_time = partials.by_tag + C_M_S * (second_rate - first_rate - ahead_rate)
        if tdb_tt:
            # 1e-5 m/s in two-way, but up to 0.1 m/s between two stations, whose velocities differ.
            first_rate, second_rate = halves(self._ends.tdb_rate)
            geocentric_rate = halves(self._ends.geocentric_tdb_rate)[0]
            first_rate = np.where(one_way, geocentric_rate, first_rate)
            by_time = by_time - C_M_S * ramp.scale * (second_rate - first_rate)
        by_delay = np.concatenate([partials.by_up_delay, partials.by_down_delay])
        by_media = by_delay * drag
        by_time = by_time + ramp.by_tag_m_s + np.add(*halves(by_media * views.rate_m_s))
        by_position = partials.by_position - C_M_S * ahead_by_place
        by_position = by_position + np.add(*halves(by_media[:, None] * views.by_position))
        by_position = by_position * (self._target >= 0)[:, None]
        by_position_pa = rotated(np.swapaxes(self._moon.rot_pa_to_icrf, -1, -2), by_position)

        n = len(self.observations)
        elevation_rad = views.leg.elevation.angle_rad.reshape(2, -1).T.copy()
        elevation_rad[one_way, 0] = elevation_rad[one_way, 1]
        status = views.status.reshape(2, -1).T.copy()
        status[:, 0] = first_failure(np.where(one_way, 0, status[:, 0]), ramp.status)
        if len(self._integrated):
            late, early = elevation_rad[self._integrated], elevation_rad[n:]
            elevation_rad[self._integrated] = np.where((late >= 0.0) & (early < 0.0), early, late)
            status[self._integrated] = first_failure(status[self._integrated], status[n:])
        by_station, by_content, mean = np.zeros((n, 0, 3)), np.zeros((n, 0)), np.zeros((n, 0))
        if self.more_partials:
            by_station = self._by_stations(path, by_delay)
            by_content_m = np.where(by_delay == 0.0, 0.0, by_media * delay_by_content_m(views.leg))
            by_content = self._observed(by_content_m.reshape(2, -1).T)
            mean = self._observed(by_position_pa, mean=True)
        observed_by_position_pa = self._observed(by_position_pa)
        return Computed(
            value_m=self._observed(length_m),
            by_position_pa=observed_by_position_pa,
            by_time_m_s=self._observed(by_time),
            by_transponder_delay_m_s=self._observed(np.where(self._sign > 0.0, partials.by_hold, 0.0)),
            by_zenith_wet=self._observed((by_media * views.by_zenith_wet).reshape(2, -1).T),
            elevation_rad=elevation_rad[:n],
            status=status[:n],
            by_station_itrf=by_station,
            by_electron_content_m=by_content,
            mean_by_position_pa=mean,
            by_motion=self._by_motion(path, by_position, observed_by_position_pa),
        )

    def light_path(
        self, motions: GivenMotions | None = None
    ) -> tuple[LightPath, StationMotion, StationMotion]:
        """The solved light paths for motions, and both stations near their events.

        Where observations have a count interval the paths at its starts follow those at its ends.
        """
        self.at(motions)  # places the motions at the events
        n = len(self._tag)
        ends = rows_of(self._ends, slice(n)), rows_of(self._ends, slice(n, None))
        return self._solve()[0], *ends

    def _ramp(self, path: LightPath) -> RampTerm:
        """What ramps of the transmitted frequency do to the paths' values."""
        paths, n = self._paths, len(self.observations)
        if not paths.ramped.any():
            return RampTerm.none(len(paths))
        # The transmitter's clock reads TT, from the epoch that the tag says, or the end of the count.
        one_way = self._sign == 0.0
        sent_s = np.where(one_way, path.bounce_s, path.transmit_s - self._equipment.transmit_s)
        at_station_s = halves(self._ends.tdb_minus_tt_at(twice(sent_s)))[0]
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
        return halves(self._ends.geocentric_tdb_minus_tt_at(twice(offset_s)))[0]

    def _by_motion(self, path: LightPath, by_position: Floats, by_position_pa: Floats) -> Floats:
        """Partials by the parameters of the motions, (n, p); `by_position_pa` is that of observations, (n, 3)."""
        count = len(self.motions)
        if not self.trajectories:
            return partials_of_points(by_position_pa, self.target, count)
        met = self._reference.shifted(path.bounce_s)
        columns = []
        for k, motion in enumerate(self._aimed):
            paths = slice(None) if count == 1 else np.flatnonzero(self._target == k)
            moved = motion.position_partials(met[paths])
            if moved is None:
                own = by_position_pa if count == 1 else by_position_pa * (self.target == k)[:, None]
                columns.append(own)
                continue
            partials = np.einsum("ni,nip->np", by_position[paths], moved)
            if count > 1:
                of_all = np.zeros((len(by_position), partials.shape[1]))
                of_all[paths] = partials
                partials = of_all
            columns.append(self._observed(partials))
        return columns[0] if count == 1 else np.hstack(columns)

    def _by_stations(self, path: LightPath, by_delay: Floats) -> Floats:
        """Partials by the ITRF coordinates of both stations, shape (n, 2, 3)."""
        by_place = by_delay[:, None] * np.concatenate([-path.up_unit, path.down_unit])
        if self.model.has("tdb_tt"):
            # TDB - TT at a station has v_E . r / c^2, 1e-4 of a displacement; in two-way it cancels.
            clocks = np.concatenate([self._sign != 0.0, np.full(len(self._sign), -1.0)])
            by_place = by_place + twice(self._earth.velocity_m_s / C_M_S) * clocks[:, None]
        by_itrf = rotated(np.swapaxes(self._ends.rot_itrf_to_gcrs, -1, -2), by_place)
        return self._observed(np.swapaxes(by_itrf.reshape(2, -1, 3), 0, 1))

    def _observed(self, of_paths: Floats, *, mean: bool = False) -> Floats:
        """From paths to observations: the path itself; of the two of a count interval the difference, or the mean."""
        n = len(self.observations)
        out = of_paths[:n].copy()
        late, early = out[self._integrated], of_paths[n:]
        out[self._integrated] = 0.5 * (late + early) if mean else late - early
        return out
