"""Proper time of clocks against TT: clocks of targets with one-way signals, and free-running clocks of stations.

A clock at rest on the Earth gains (W_0 - W) / c^2 on TT, with the potential W of gravity and rotation at the clock and
W_0 = c^2 L_G on the geoid (IERS Conventions 2010, section 10.1): 1.09e-13 per kilometre.

At the same TDB a clock at the target gains on a geocentric clock that keeps TT, in units of their seconds,

    d(tau - TT)/d(TDB) = L_G - [(v^2 - v_E^2) / 2 + w(x) - w_E(x_E)] / c^2

with the barycentric velocities v of target and Earth, the potential w of all bodies at the target and w_E of all but
the Earth at the geocentre (Moyer 2003, section 11.4; IERS Conventions 2010, section 10.1; Soffel et al. 2003). Terms of
the order c^-4 are below 1e-17. The rate is integrated along an origin, the spacecraft, or the Moon's centre with the
Moon's potential at the distance of the point, GM / r. A clock at r from the origin is behind it by v.r / c^2, by the
simultaneity of the barycentric frame. Neglected on the Moon are tides, its rotation and the degrees of its field: 1e-14
at most, nearly constant.

At a common epoch of the arc the origin's clock reads TT of the same instant in the geocentric frame, as if set from the
Earth. At the same TDB it is v_E.r / c^2 behind the geocentric clock, up to 130 microseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radioloc.constants import C_M_S, L_G
from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import Station
from radioloc.ephemeris.positions import clock_rate
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.measurements.light_path import MovingPoint
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Mask, dot

_STEP_S, _STEP_IN_ORBIT_S = 3600.0, 30.0
"""Steps in which a cubic spline of the rate has errors of 1e-18, on the Moon and in a low orbit of two hours."""
MIN_GAP_S = 3600.0  # a longer gap separates counts
# Normal gravity of GRS80 by Somigliana's formula (Moritz 2000, J. Geod. 74, 128).
_EQUATOR_M_S2, _K, _E2, _EQUATOR_M = 9.7803267715, 0.001931851353, 0.00669438002290, 6378137.0


def station_rate(station: Station) -> float:
    """Return the rate of a free clock against TT, s/s, by its ellipsoidal height (neglecting the geoid, 1.1e-14)."""
    place = geodetic_from_itrf(station.itrf_m)
    square = np.sin(place.latitude_rad) ** 2
    gravity_m_s2 = _EQUATOR_M_S2 * (1.0 + _K * square) / np.sqrt(1.0 - _E2 * square)
    return float(gravity_m_s2 * place.height_m * (1.0 - place.height_m / _EQUATOR_M) / C_M_S**2)


@dataclass(frozen=True, slots=True)
class TargetClock:
    """Offset of the target's clock from TT at the geocentre near each event; zeros for signals other than one-way."""

    offset_s: Floats  # at the origin, at the instant of its motion
    rate: Floats
    is_one_way: Mask

    def merged_with(self, clocks: Sequence[TargetClock]) -> TargetClock:
        """Return the clock merged with those of other targets, which have other events."""
        return TargetClock(
            sum((clock.offset_s for clock in clocks), self.offset_s),
            sum((clock.rate for clock in clocks), self.rate),
            np.any([clock.is_one_way for clock in (self, *clocks)], axis=0),
        )

    def reading_at(
        self, origin: MovingPoint, point: MovingPoint, instant_s: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the offset at a point and a near instant, s, with derivatives by time and by place (s/m)."""
        if not self.is_one_way.any():
            zeros = np.zeros(len(self.is_one_way))
            return zeros, zeros, np.zeros((len(self.is_one_way), 3))
        elapsed_s = instant_s - origin.offset_s
        from_origin_m, velocity_m_s = point.position_m - origin.position_m, origin.velocity_m_s
        offset_s = self.offset_s + self.rate * elapsed_s - dot(velocity_m_s, from_origin_m) / C_M_S**2
        rate = self.rate - dot(velocity_m_s, point.velocity_m_s - velocity_m_s) / C_M_S**2
        by_place = -velocity_m_s / C_M_S**2
        return offset_s * self.is_one_way, rate * self.is_one_way, by_place * self.is_one_way[:, None]


def clock_epoch(observations: Observations, trajectory: SpacecraftTrajectory | None = None) -> Epochs | None:
    """Return the TDB at which the target's clock reads TT: 0h UTC of the first day, or the start of its trajectory."""
    if not len(observations):
        return None
    first = observations.span()[:1]
    midnight, tag = (tt_to_tdb(utc_to_tt(utc)) for utc in (Epochs(first.jd, np.zeros(1), "UTC"), first))
    for start_s, end_s in [] if trajectory is None else trajectory.spans_s():
        start = Epochs.from_tdb_seconds(start_s).shifted(1e-6)
        if tag.seconds_since(start)[0] <= end_s - start_s:
            return start if start.seconds_since(midnight)[0] > 0.0 else midnight
    return midnight


def target_clock(
    model: PhysicalModel,
    tdb: Epochs,
    is_one_way: Mask,
    radius_m: Floats,
    epoch: Epochs | None,
    trajectory: SpacecraftTrajectory | None = None,
) -> TargetClock:
    """Return the target's clock at events (TDB) of one-way signals; it reads TT at `epoch` (TDB), if given."""
    # `radius_m` is the distance of points on the Moon from its centre, unused for a trajectory. Without an epoch the
    # clock reads TT at the start of the counts of each pass.
    offset_s, rate = np.zeros((2, len(tdb)))
    rows = np.flatnonzero(is_one_way)
    if len(rows):
        zero = tdb[rows[:1]] if epoch is None else epoch
        since_s = tdb[rows].seconds_since(zero)
        offset_s[rows], rate[rows] = _gain(model, zero, since_s, trajectory, continuous=epoch is not None)
        if trajectory is None:
            of_moon = model.ephemeris.constants.gm_moon_m3_s2 / radius_m[rows] / C_M_S**2
            offset_s[rows] -= of_moon * since_s
            rate[rows] -= of_moon
    return TargetClock(offset_s, rate, is_one_way)


def _gain(
    model: PhysicalModel,
    zero: Epochs,
    since_s: Floats,
    trajectory: SpacecraftTrajectory | None,
    *,
    continuous: bool,
) -> tuple[Floats, Floats]:
    """Return the gain of the origin's clock since `zero`, or since the last gap unless `continuous`, and its rate."""
    from scipy.interpolate import CubicSpline

    gain_s, rate = np.zeros((2, len(since_s)))
    order = np.argsort(since_s)
    gaps = np.flatnonzero(np.diff(since_s[order]) > MIN_GAP_S) + 1
    for rows in [order] if continuous else np.split(order, gaps):
        first_s, last_s = since_s[rows[0]], since_s[rows[-1]]
        if continuous:
            first_s, last_s = min(first_s, 0.0), max(last_s, 0.0)
        length_s = max(last_s - first_s, 1e-3)
        steps = int(np.ceil(length_s / (_STEP_S if trajectory is None else _STEP_IN_ORBIT_S)))
        knots_s = first_s + length_s * np.linspace(0.0, 1.0, max(steps, 3) + 1)
        tdb = zero[:1].shifted(knots_s)
        excluded = "moon" if trajectory is None else ""
        at_knots = CubicSpline(
            knots_s, L_G + clock_rate(model.ephemeris, tdb, *_state(model, tdb, trajectory), excluded)
        )
        integral = at_knots.antiderivative()
        gain_s[rows] = integral(since_s[rows]) - integral(0.0 if continuous else first_s)
        rate[rows] = at_knots(since_s[rows])
    if continuous:
        place_m, _ = _state(model, zero, trajectory)
        gain_s -= dot(model.ephemeris.earth(zero).velocity_m_s, place_m) / C_M_S**2
    return gain_s, rate


def _state(
    model: PhysicalModel, tdb: Epochs, trajectory: SpacecraftTrajectory | None
) -> tuple[Floats, Floats]:
    """Return geocentric position and velocity of the spacecraft, or of the Moon's centre."""
    if trajectory is None:
        return model.ephemeris.geocentric("moon", tdb)
    return trajectory.geocentric(model.ephemeris, tdb)
