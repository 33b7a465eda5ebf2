"""Predictions of ranges, VLBI delays and Doppler of an arc, with partials.

Targets are points fixed to the Moon, and spacecraft on trajectories (:class:`~radioloc.ephemeris.Trajectory`). Values
are metres by the stations' atomic clocks (rate of TT and UTC), at the stations' reference points or, with delays of
equipment (:mod:`~radioloc.measurements.equipment_delays`), at the clocks behind them.
"""

from __future__ import annotations

import numpy as np

from radioloc.constants import C_M_S
from radioloc.measurements.light_path import LightPath, path_length_partials, split_ends, stack_ends
from radioloc.measurements.predictor import Computed
from radioloc.measurements.prepared_paths import PreparedPaths, rows_of
from radioloc.measurements.ramps import RampTerm, ramp_term
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.station_motion import StationMotion
from radioloc.measurements.target_motion import MotionsLike, partials_of_points
from radioloc.media.ionosphere import delay_by_content_m
from radioloc.media.medium import first_failure
from radioloc.vectors import Floats, rotated


class ExactPredictor(PreparedPaths):
    """Predictor that computes each observation of an arc; combined types are excluded.

    Parameters and errors are those of :func:`prepare_predictor`. ``clock_epoch`` (TDB) is the epoch at which the clock
    of a one-way target reads TT; by default 0h UTC of the first day.
    """

    def predict(self, motions: MotionsLike | None = None) -> Computed:
        """Predict all observations for motions; raise a ConvergenceError if light times do not converge."""
        self._set_motions(motions)
        path, target, views, drag = self._solve()
        limit_s, ends = self.model.max_extrapolation_s, self._ends.point
        if not (ends.is_within(limit_s, path.ends_s) and self._moon.centre.is_within(limit_s, path.bounce_s)):
            self._place()
            path, target, views, drag = self._solve()
        ramp, one_way, tdb_tt = self._ramp(path), self._sign == 0.0, self.model.has("tdb_tt")
        up, down = self._ends.point.split_ends()
        partials = path_length_partials(path, up, target, down, self._tag, self._sign)
        partials = partials.scaled(ramp.scale)

        clock_s, clock_rate, clock_by_place = self._clock.reading_at(self._moon.origin, target, path.bounce_s)
        first_clock_s, second_clock_s = split_ends(
            self._station_clock_s + self._station_clock_rate * path.ends_s
        )
        clocks_s = second_clock_s - first_clock_s - clock_s
        flight_s = self._sign * path.up_s + (path.down_s + self._equipment.in_value_s) + clocks_s
        length_m = C_M_S * flight_s - ramp.excess_m
        if tdb_tt:
            first_s, second_s = split_ends(self._ends.tdb_minus_tt_at(path.ends_s))
            first_s = np.where(one_way, self._geocentric_tdb_minus_tt_s(path.bounce_s), first_s)
            length_m = length_m - C_M_S * (second_s - first_s)

        first_rate, second_rate = split_ends(self._station_clock_rate)
        by_time = partials.by_tag + C_M_S * (second_rate - first_rate - clock_rate)
        if tdb_tt:
            # 1e-5 m/s for two-way, but up to 0.1 m/s between two stations with different velocities.
            first_rate, second_rate = split_ends(self._ends.tdb_rate)
            geocentric_rate = split_ends(self._ends.geocentric_tdb_rate)[0]
            first_rate = np.where(one_way, geocentric_rate, first_rate)
            by_time = by_time - C_M_S * ramp.scale * (second_rate - first_rate)
        by_delay = np.concatenate([partials.by_up_delay, partials.by_down_delay])
        by_media = by_delay * drag
        by_time = by_time + ramp.by_tag_m_s + np.add(*split_ends(by_media * views.rate_m_s))
        by_position = partials.by_position - C_M_S * clock_by_place
        by_position = by_position + np.add(*split_ends(by_media[:, None] * views.by_position))
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
            by_station = self._station_partials(path, by_delay)
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
            by_motion=self._motion_partials(path, by_position, observed_by_position_pa),
        )

    def light_path(
        self, motions: MotionsLike | None = None
    ) -> tuple[LightPath, StationMotion, StationMotion]:
        """Return the solved light paths for motions, and the motions of both stations near their events.

        Paths at the starts of count intervals follow those at the ends.
        """
        self.predict(motions)  # prepares the motions at the events
        n = len(self._tag)
        ends = rows_of(self._ends, slice(n)), rows_of(self._ends, slice(n, None))
        return self._solve()[0], *ends

    def _ramp(self, path: LightPath) -> RampTerm:
        """Return the effect of ramps of the transmitted frequency on the values of the paths."""
        paths, n = self._paths, len(self.observations)
        if not paths.ramped.any():
            return RampTerm.zeros(len(paths))
        # Time of transmission by the transmitter's clock (TT) since the time tag, or the end of the count.
        one_way = self._sign == 0.0
        sent_s = np.where(one_way, path.bounce_s, path.transmit_s - self._equipment.transmit_s)
        at_station_s = split_ends(self._ends.tdb_minus_tt_at(stack_ends(sent_s)))[0]
        tdb_minus_tt_s = np.where(one_way, self._geocentric_tdb_minus_tt_s(sent_s), at_station_s)
        sent_s = sent_s + self._geocentric_tdb_minus_tt_s(0.0 * sent_s) - tdb_minus_tt_s
        partner = np.arange(len(paths))
        partner[self._integrated], partner[n:] = partner[n:], self._integrated
        reference_hz = np.where(one_way, 1e6 * C_M_S / paths.wavelength_um, paths.uplink_hz)
        sender = np.array([self._name(link.transmitter or link.target) for link in paths.links])[paths.link]
        sender = np.where(paths.ramped, sender, "")
        partner = np.where(is_integrated(paths.kind), partner, -1)
        return ramp_term(self._frequencies, sender, self._tt, sent_s, partner, reference_hz)

    def _geocentric_tdb_minus_tt_s(self, offset_s: Floats) -> Floats:
        """Return TDB - TT at the geocentre near the first events, s."""
        return split_ends(self._ends.geocentric_tdb_minus_tt_at(stack_ends(offset_s)))[0]

    def _motion_partials(self, path: LightPath, by_position: Floats, by_position_pa: Floats) -> Floats:
        """Return d(value)/d(motion parameter), (n, p); `by_position_pa` is d(value)/d(position), (n, 3)."""
        count = len(self.motions)
        if not self.trajectories:
            return partials_of_points(by_position_pa, self.target, count)
        bounce = self._reference.shifted(path.bounce_s)
        columns = []
        for k, motion in enumerate(self._restricted_motions):
            paths = slice(None) if count == 1 else np.flatnonzero(self._target == k)
            of_position = motion.position_partials(bounce[paths])
            if of_position is None:
                is_target = (self.target == k)[:, None]
                columns.append(by_position_pa if count == 1 else by_position_pa * is_target)
                continue
            partials = np.einsum("ni,nip->np", by_position[paths], of_position)
            if count > 1:
                of_all = np.zeros((len(by_position), partials.shape[1]))
                of_all[paths] = partials
                partials = of_all
            columns.append(self._observed(partials))
        return columns[0] if count == 1 else np.hstack(columns)

    def _station_partials(self, path: LightPath, by_delay: Floats) -> Floats:
        """Return partials with respect to the ITRF coordinates of both stations, shape (n, 2, 3)."""
        by_place = by_delay[:, None] * np.concatenate([-path.up_unit, path.down_unit])
        if self.model.has("tdb_tt"):
            # TDB - TT at a station contains v_E . r / c^2, 1e-4 of a displacement, which cancels in two-way values.
            clocks = np.concatenate([self._sign != 0.0, np.full(len(self._sign), -1.0)])
            by_place = by_place + stack_ends(self._earth.velocity_m_s / C_M_S) * clocks[:, None]
        by_itrf = rotated(np.swapaxes(self._ends.rot_itrf_to_gcrs, -1, -2), by_place)
        return self._observed(np.swapaxes(by_itrf.reshape(2, -1, 3), 0, 1))

    def _observed(self, of_paths: Floats, *, mean: bool = False) -> Floats:
        """Return values of observations from those of paths: of the path, or the difference or mean over a count."""
        n = len(self.observations)
        out = of_paths[:n].copy()
        late, early = out[self._integrated], of_paths[n:]
        out[self._integrated] = 0.5 * (late + early) if mean else late - early
        return out
