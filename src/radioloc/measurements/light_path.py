"""Light path between two stations and a target, and its partial derivatives.

Three geometries have a common solution, with the sign of the first leg. A range goes up from the first station to the
target and down to the second, sign 1. In a differenced delay (VLBI) both legs go down from the target: the first leg is
reversed in time, sign -1, and the event at the first station, called transmission below, is an arrival. A one-way
signal begins with the bounce and has no first leg, sign 0.

A delay can have a source at infinity in place of the target. The length of each leg is then its difference from the
path to the origin, -K.x with the direction K of the source, and the bounce is the passage of the wavefront through the
origin.

Positions are BCRS vectors from an origin for each observation, the geocentre at its reference epoch, and times are TDB
seconds from that epoch. Barycentric positions of 1.5e11 m would have a rounding error of 0.03 mm; positions from this
origin are below 1e9 m, with rounding errors of 0.1 micrometre.

A transponder may hold the signal of a range (group delay). The *bounce* is the arrival of the signal at the target. The
departure is later by the hold, at the position of the target at that time.

The three participants are :class:`MovingPoint`, straight lines in time about an instant near their events. Over the
millisecond of their use the largest curvature (0.034 m/s^2 of a station) causes an error below 2e-8 m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S
from radioloc.errors import ConvergenceError
from radioloc.vectors import Floats, dot, length

TRANSMIT, RECEIVE, BOUNCE = 0, 1, 2
_MAX_ITERATIONS = 12
TOLERANCE_S = 1e-15
PLANETS_MM = {"venus": 0.1, "jupiter": 2.0, "saturn": 0.3}
"""Planets with a gravitational delay, beside Sun, Earth and Moon: largest one-way delay, mm."""


def stack_ends(of_paths: NDArray[Any]) -> NDArray[Any]:
    """Return values of n paths for both of their ends, shape (2 n, ...)."""
    return np.concatenate([of_paths, of_paths])


def split_ends(of_ends: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return values of the ends of paths, shape (2 n, ...), for all first ends and for all second ends."""
    n = len(of_ends) // 2
    return of_ends[:n], of_ends[n:]


@dataclass(frozen=True, slots=True)
class MovingPoint:
    """Point on a straight line near its event, BCRS axes from the geocentre at the reference epochs."""

    offset_s: Floats  # instant of the position, TDB from the reference epoch
    position_m: Floats  # shape (n, 3)
    velocity_m_s: Floats  # barycentric, shape (n, 3)

    def position_at(self, offset_s: Floats) -> Floats:
        """Return the position at another instant, shape (n, 3)."""
        return self.position_m + self.velocity_m_s * (offset_s - self.offset_s)[:, None]

    def split_ends(self) -> tuple[MovingPoint, MovingPoint]:
        """Return the motions of the first and of the second ends of paths."""
        columns = (split_ends(column) for column in (self.offset_s, self.position_m, self.velocity_m_s))
        first, second = zip(*columns, strict=True)
        return MovingPoint(*first), MovingPoint(*second)

    def is_within(self, limit_s: float, offset_s: Floats) -> bool:
        """Return whether all other instants are nearer than a limit."""
        return bool((np.abs(offset_s - self.offset_s) < limit_s).all())


@dataclass(frozen=True, slots=True)
class LightPath:
    """Solved path: instants in TDB seconds from the reference epochs, and durations as separate variables."""

    transmit_s: Floats
    bounce_s: Floats  # arrival at the target
    receive_s: Floats
    up_s: Floats
    down_s: Floats
    up_unit: Floats  # from the transmitter to the target, shape (n, 3)
    down_unit: Floats  # from the target to the receiver, shape (n, 3)

    @property
    def ends_s(self) -> Floats:
        """Instants at the stations: all transmissions, then all receptions, shape (2 n,)."""
        return np.concatenate([self.transmit_s, self.receive_s])


@dataclass(frozen=True, slots=True)
class PathPartials:
    """Partials of the path length c (sign up + hold + down) at a fixed tagged event."""

    # The unit vector of a leg times the partial by its delay is the partial by the position of its second participant,
    # and minus the partial by that of its first participant.

    by_position: Floats  # of the target, BCRS, m/m, shape (n, 3)
    by_tag: Floats  # time tag, m/s
    by_up_delay: Floats  # delay of a leg, m/m: the sign of the leg to 1e-4
    by_down_delay: Floats
    by_hold: Floats  # m/s: the speed of light to 1e-5

    def scaled(self, factor: Floats) -> PathPartials:
        """Return the partials times a factor."""
        return PathPartials(*((getattr(self, field.name).T * factor).T for field in fields(self)))


@dataclass(frozen=True, slots=True)
class Signal:
    """Signals between two stations and a target, each with a tagged event."""

    transmitter: MovingPoint
    target: MovingPoint
    receiver: MovingPoint
    tag: NDArray[np.int8]
    tag_offset_s: Floats  # of the tagged event, TDB from the reference epoch
    sign: ArrayLike = 1.0  # of the first leg
    hold_s: ArrayLike = 0.0
    source: Floats | None = None  # directions of sources at infinity, zeros for targets, shape (n, 3)


def solve_light_path(
    signal: Signal,
    up_delay_m: ArrayLike,
    down_delay_m: ArrayLike,
    start: LightPath | None = None,
    tolerance_s: float = TOLERANCE_S,
) -> LightPath:
    """Solve the light-time equations of both legs in the BCRS (Moyer 2003, section 8.3).

    Delays are additions to the straight length of each leg; the iteration begins with `start`.
    """
    transmitter, target, receiver = signal.transmitter, signal.target, signal.receiver
    tag, tag_offset_s, source = signal.tag, signal.tag_offset_s, signal.source
    # Each substitution reduces the error by v/c = 1e-4, so durations are accurate to 1e-4 of the tolerance.
    sent, received = tag == TRANSMIT, tag == RECEIVE
    up_delay_m, down_delay_m, sign, hold_s = map(
        np.asarray, (up_delay_m, down_delay_m, signal.sign, signal.hold_s)
    )
    if start is None:
        up_s = length(target.position_m - transmitter.position_m) / C_M_S
        down_s = length(receiver.position_m - target.position_m) / C_M_S
    else:
        up_s, down_s = start.up_s + up_delay_m / C_M_S, start.down_s + down_delay_m / C_M_S
    for _ in range(_MAX_ITERATIONS):
        signed_up_s = sign * up_s
        bounce_s = tag_offset_s + np.where(sent, signed_up_s, np.where(received, -down_s - hold_s, 0.0))
        departure_s = bounce_s + hold_s
        transmit_s = np.where(sent, tag_offset_s, bounce_s - signed_up_s)
        receive_s = np.where(received, tag_offset_s, departure_s + down_s)
        up_m = target.position_at(bounce_s) - transmitter.position_at(transmit_s)
        down_m = receiver.position_at(receive_s) - target.position_at(departure_s)
        up_length_m = length(up_m)
        down_length_m = length(down_m)
        if source is not None:
            at_infinity = np.asarray(source.any(axis=-1, keepdims=True))
            from_source_m = -dot(source, transmitter.position_at(transmit_s))
            up_length_m = np.where(at_infinity[:, 0], from_source_m, up_length_m)
            from_source_m = -dot(source, receiver.position_at(receive_s))
            down_length_m = np.where(at_infinity[:, 0], from_source_m, down_length_m)
        new_up_s = (up_length_m + up_delay_m) / C_M_S
        new_down_s = (down_length_m + down_delay_m) / C_M_S
        change_s = np.abs(new_up_s - up_s) + np.abs(new_down_s - down_s)
        up_s, down_s = new_up_s, new_down_s
        if bool(np.all(change_s < tolerance_s)):  # false for NaN
            up_unit, down_unit = up_m / up_length_m[:, None], down_m / down_length_m[:, None]
            if source is not None:
                up_unit = np.where(at_infinity, source, up_unit)
                down_unit = np.where(at_infinity, -source, down_unit)
            return LightPath(transmit_s, bounce_s, receive_s, up_s, down_s, up_unit, down_unit)
    count = int(np.sum(~(change_s < tolerance_s)))
    raise ConvergenceError(
        f"the light times of {count} of {len(change_s)} paths did not converge in {_MAX_ITERATIONS} iterations; check "
        "that the positions are finite and the target is near the Moon"
    )


def path_length_partials(
    path: LightPath,
    transmitter: MovingPoint,
    target: MovingPoint,
    receiver: MovingPoint,
    tag: NDArray[np.int8],
    sign: ArrayLike = 1.0,
) -> PathPartials:
    """Return partials of the path length from the linearized light-time equations of both legs."""
    # c d(up) = n . (dx + v_L dt2 - v_A dt1) + d(up delay), c d(down) = m . (v_B dt3 - dx - v_L dt2') + d(down delay),
    # with the tagged event fixed (or moved); dt2' is that of the departure.
    n, m, sign = path.up_unit, path.down_unit, np.asarray(sign)
    c_up_a = C_M_S - sign * dot(n, transmitter.velocity_m_s)
    c_up_l = C_M_S - sign * dot(n, target.velocity_m_s)
    c_down_l = C_M_S - dot(m, target.velocity_m_s)
    c_down_b = C_M_S - dot(m, receiver.velocity_m_s)
    closing_up = dot(n, target.velocity_m_s - transmitter.velocity_m_s)
    closing_down = dot(m, receiver.velocity_m_s - target.velocity_m_s)
    sent, received = tag == TRANSMIT, tag == RECEIVE

    # First the leg next to the tag; the other leg begins at a bounce that moves with it.
    up_to_down = np.where(sent, closing_down / c_down_b, 0.0)
    down_to_up = np.where(received, -closing_up / c_up_a, 0.0)
    by_up = sign * C_M_S / np.where(sent, c_up_l, c_up_a) * (1.0 + up_to_down)
    by_down = C_M_S / np.where(received, c_down_l, c_down_b) * (1.0 + sign * down_to_up)
    return PathPartials(
        by_position=by_up[:, None] * n - by_down[:, None] * m,
        by_tag=by_up * closing_up + by_down * closing_down,
        by_up_delay=by_up,
        by_down_delay=by_down,
        by_hold=C_M_S + np.where(received, -by_up * closing_up, by_down * closing_down),
    )


def delay_by_bodies_m(
    bodies_m: Mapping[str, Floats],
    point_m: Floats,
    ends_m: Floats,
    gm_m3_s2: Callable[[str], float],
    source: Floats | None = None,
) -> Floats:
    """Return the gravitational delay of legs by bodies at rest, m, (2 n,), from points (n, 3) to stations (2 n, 3)."""
    total_m = np.zeros(len(ends_m))
    leg_m = length(stack_ends(point_m) - ends_m)
    for body, body_m in bodies_m.items():
        to_end_m, to_point_m = ends_m - stack_ends(body_m), stack_ends(length(point_m - body_m))
        delay_m = gravitational_delay_m(length(to_end_m), to_point_m, leg_m, gm_m3_s2(body))
        if source is not None:
            rows = np.flatnonzero(stack_ends(np.asarray(source.any(axis=-1))))
            delay_m[rows] = plane_wave_delay_m(to_end_m[rows], source[rows % len(source)], gm_m3_s2(body))
        total_m += delay_m
    return total_m


def plane_wave_delay_m(from_body_m: Floats, source: Floats, gm_m3_s2: float) -> Floats:
    """Return the delay from a source at infinity up to a constant, m; IERS Conventions (2010), eq. 11.1 and 11.2."""
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return -k_m * np.log((length(from_body_m) + dot(source, from_body_m)) / 1e11)


def gravitational_delay_m(r1_m: Floats, r2_m: Floats, r12_m: Floats, gm_m3_s2: float) -> Floats:
    """Return the delay (gamma = 1) between points at distances r1, r2 from a body, m; Moyer (2003), eq. 8-55."""
    # The term k = 2 GM/c^2 beside the distances is the bending of the ray, which IERS Conventions (2010), eq. 11.17,
    # omit. With s = r1 + r2 the logarithm of (s + r12 + k) / (s - r12 + k) as log1p is accurate for short paths.
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return k_m * np.log1p(2.0 * r12_m / (r1_m + r2_m - r12_m + k_m))
