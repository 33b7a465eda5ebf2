"""Clocks that keep proper time against TT: of a target that transmits by its own, of stations that nothing steers.

A clock at rest on the Earth gains (W_0 - W) / c^2 on TT, with the potential W of gravity and rotation where it is and
W_0 = c^2 L_G that on the geoid (IERS Conventions 2010, section 10.1): 1.09e-13 a kilometre.

At the same TDB a clock at the target gains on one at the geocentre that keeps TT, in units of their seconds,

    d(tau - TT)/d(TDB) = L_G - [(v^2 - v_E^2) / 2 + w(x) - w_E(x_E)] / c^2

with the barycentric velocities v of target and Earth, the potential w of all bodies at the target and w_E of all but
the Earth at the geocentre (Moyer 2003, section 11.4; IERS Conventions 2010, section 10.1; Soffel et al. 2003). Terms of
the order c^-4 are below 1e-17. The rate is integrated along an origin, the spacecraft, or the Moon's centre with the
Moon's potential at the distance of the point, GM / r. What is at r from the origin is behind it by v.r / c^2, as
simultaneity is that of the barycentric frame. Left out on the Moon are tides, its rotation and the degrees of its
field: 1e-14 at most, all but constant.

At an epoch that is chosen once for an arc the origin's clock reads TT of the same instant in the geocentric frame, as
if it had been set from the Earth; at the same TDB that is v_E.r / c^2 behind the geocentre's, up to 130 microseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, L_G
from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import Station
from radioloc.ephemeris.positions import clock_rate
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.measurements.light_path import MovingPoint
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, dot

_STEP_S, _STEP_IN_ORBIT_S = 3600.0, 30.0
"""A cubic spline between rates so far apart is good to 1e-18, in a low orbit of two hours to 1e-18 as well."""
MIN_GAP_S = 3600.0  # after a longer gap counts begin anew
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
    """What the target's clock is ahead of TT at the geocentre, near one event each; of what is not one-way zeros."""

    ahead_s: Floats  # at the origin, at the instant of its motion
    rate: Floats
    kept: NDArray[np.bool_]  # whether it reads anything

    def together(self, others: Sequence[TargetClock]) -> TargetClock:
        """Return the clock with those of other targets, each of its own events."""
        clocks = (self, *others)
        return TargetClock(
            sum((clock.ahead_s for clock in others), self.ahead_s),
            sum((clock.rate for clock in others), self.rate),
            np.any([clock.kept for clock in clocks], axis=0),
        )

    def at(self, origin: MovingPoint, point: MovingPoint, offset_s: Floats) -> tuple[Floats, Floats, Floats]:
        """How far it is ahead at a point and an instant nearby, s, with derivatives by time and by place (s/m)."""
        if not self.kept.any():
            nothing = np.zeros(len(self.kept))
            return nothing, nothing, np.zeros((len(self.kept), 3))
        later_s = offset_s - origin.offset_s
        from_origin_m, velocity_m_s = point.position_m - origin.position_m, origin.velocity_m_s
        ahead_s = self.ahead_s + self.rate * later_s - dot(velocity_m_s, from_origin_m) / C_M_S**2
        rate = self.rate - dot(velocity_m_s, point.velocity_m_s - velocity_m_s) / C_M_S**2
        by_place = -velocity_m_s / C_M_S**2
        return ahead_s * self.kept, rate * self.kept, by_place * self.kept[:, None]


def clock_epoch(observations: Observations, trajectory: AnyTrajectory | None = None) -> Epochs | None:
    """Return the TDB at which the target's clock reads TT: 0h UTC of the first day, or when its trajectory begins."""
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
    kept: NDArray[np.bool_],
    radius_m: Floats,
    epoch: Epochs | None,
    trajectory: AnyTrajectory | None = None,
) -> TargetClock:
    """Return the target's clock at events (TDB) where it is `kept`; it reads TT at one `epoch` (TDB), if given."""
    # `radius_m` is the distance of points on the Moon from its centre; a trajectory needs none. Without an epoch it
    # agrees when the counts of a pass begin.
    ahead_s, rate = np.zeros((2, len(tdb)))
    rows = np.flatnonzero(kept)
    if len(rows):
        zero = tdb[rows[:1]] if epoch is None else epoch
        since_s = tdb[rows].seconds_since(zero)
        ahead_s[rows], rate[rows] = _gained(model, zero, since_s, trajectory, whole=epoch is not None)
        if trajectory is None:
            of_moon = model.ephemeris.constants.gm_moon_m3_s2 / radius_m[rows] / C_M_S**2
            ahead_s[rows] -= of_moon * since_s
            rate[rows] -= of_moon
    return TargetClock(ahead_s, rate, kept)


def _gained(
    model: PhysicalModel,
    zero: Epochs,
    since_s: Floats,
    trajectory: AnyTrajectory | None,
    *,
    whole: bool,
) -> tuple[Floats, Floats]:
    """What the origin's clock has gained since `zero` and its rate; but for the `whole` arc, since a gap ended."""
    from scipy.interpolate import CubicSpline

    gained_s, rate = np.zeros((2, len(since_s)))
    order = np.argsort(since_s)
    gaps = np.flatnonzero(np.diff(since_s[order]) > MIN_GAP_S) + 1
    for rows in [order] if whole else np.split(order, gaps):
        first_s, last_s = since_s[rows[0]], since_s[rows[-1]]
        if whole:
            first_s, last_s = min(first_s, 0.0), max(last_s, 0.0)
        length_s = max(last_s - first_s, 1e-3)
        steps = int(np.ceil(length_s / (_STEP_S if trajectory is None else _STEP_IN_ORBIT_S)))
        knots_s = first_s + length_s * np.linspace(0.0, 1.0, max(steps, 3) + 1)
        tdb = zero[:1].shifted(knots_s)
        left_out = "moon" if trajectory is None else ""
        at_knots = CubicSpline(
            knots_s, L_G + clock_rate(model.ephemeris, tdb, *_state(model, tdb, trajectory), left_out)
        )
        grown = at_knots.antiderivative()
        gained_s[rows] = grown(since_s[rows]) - grown(0.0 if whole else first_s)
        rate[rows] = at_knots(since_s[rows])
    if whole:
        place_m, _ = _state(model, zero, trajectory)
        gained_s -= dot(model.ephemeris.earth(zero).velocity_m_s, place_m) / C_M_S**2
    return gained_s, rate


def _state(model: PhysicalModel, tdb: Epochs, trajectory: AnyTrajectory | None) -> tuple[Floats, Floats]:
    """Geocentric position and velocity of the spacecraft, or of the Moon's centre."""
    if trajectory is None:
        return model.ephemeris.geocentric("moon", tdb)
    return trajectory.geocentric(model.ephemeris, tdb)
