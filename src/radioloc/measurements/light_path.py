"""The light path between two stations and a point on the Moon, and how it moves with that point.

Three shapes share one solution, told apart by the sign of the first leg. A range goes up from the first station to
the point and down to the second, sign 1. A differenced delay (VLBI) comes down from the point to both: its first leg
runs the other way in time, sign -1, and the first station's event, called the transmission below, is an arrival. A
one-way signal has no first leg, sign 0: it begins with the bounce.

A source at infinity takes the point's place in a delay: of each leg then counts how much longer it is than that to the
origin, -K.x with the direction K of the source, and the bounce is when the wavefront would meet the origin.

All positions are BCRS vectors from one origin per observation, the geocentre at the observation's reference epoch,
and all times are TDB seconds from that epoch. Barycentric positions of 1.5e11 m would be rounded to 0.03 mm; from
this origin they stay below 1e9 m and are rounded to 0.1 micrometre.

The point may hold a range's signal before it sends it down (a transponder's group delay). The *bounce* is the arrival
of the signal at the point; the departure comes the hold later, from where the point then is.

Each of the three participants is a :class:`MovingPoint`, a straight line in time around an instant near its event.
Over the millisecond for which it is used, the fastest curvature (a station's 0.034 m/s^2) is below 2e-8 m.
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
_STRAIGHT_FOR_S = 1e-3
PLANETS_MM = {"venus": 0.1, "jupiter": 2.0, "saturn": 0.3}
"""Planets whose delay is modelled beside those of the Sun, the Earth and the Moon: largest size on one way, mm."""


def twice(of_paths: NDArray[Any]) -> NDArray[Any]:
    """What belongs to paths, for both of their ends."""
    return np.concatenate([of_paths, of_paths])


def halves(of_ends: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """What belongs to the ends of paths, of all first ones and of all second ones."""
    n = len(of_ends) // 2
    return of_ends[:n], of_ends[n:]


@dataclass(frozen=True, slots=True)
class MovingPoint:
    """A point that moves along a straight line near its event, BCRS axes from the geocentre at the reference epochs."""

    offset_s: Floats  # instant at which the position holds, TDB from the reference epoch
    position_m: Floats  # shape (n, 3)
    velocity_m_s: Floats  # barycentric, shape (n, 3)

    def at(self, offset_s: Floats) -> Floats:
        """Position at another instant, shape (n, 3)."""
        return self.position_m + self.velocity_m_s * (offset_s - self.offset_s)[:, None]

    def halves(self) -> tuple[MovingPoint, MovingPoint]:
        """The motions of the first and of the second ends of paths."""
        columns = (halves(column) for column in (self.offset_s, self.position_m, self.velocity_m_s))
        first, second = zip(*columns, strict=True)
        return MovingPoint(*first), MovingPoint(*second)

    def holds_at(self, offset_s: Floats) -> bool:
        """Whether other instants are near enough for a straight line."""
        return bool((np.abs(offset_s - self.offset_s) < _STRAIGHT_FOR_S).all())


@dataclass(frozen=True, slots=True)
class LightPath:
    """A solved path; the offsets are TDB seconds from the reference epochs, the durations their own variables."""

    transmit_s: Floats
    bounce_s: Floats  # arrival at the point
    receive_s: Floats
    up_s: Floats
    down_s: Floats
    up_unit: Floats  # from transmitter to the point, shape (n, 3)
    down_unit: Floats  # from the point to the receiver, shape (n, 3)

    @property
    def ends_s(self) -> Floats:
        """When signals are at the stations: all transmissions, then all receptions, shape (2 n,)."""
        return np.concatenate([self.transmit_s, self.receive_s])


@dataclass(frozen=True, slots=True)
class PathPartials:
    """Partials of c (sign up + hold + down), the path's length, with the tagged event held."""

    # A leg's unit vector times the derivative by its delay is the derivative by the position of its second participant,
    # and minus that by the first one's.

    by_position: Floats  # the point's, BCRS, m/m, shape (n, 3)
    by_tag: Floats  # the time tag, m/s
    by_up_delay: Floats  # the delay of a leg, m/m: the leg's sign to 1e-4
    by_down_delay: Floats
    by_hold: Floats  # the hold, m/s: the speed of light to 1e-5

    def scaled(self, factor: Floats) -> PathPartials:
        """Those of the length times a factor."""
        return PathPartials(*((getattr(self, field.name).T * factor).T for field in fields(self)))


@dataclass(frozen=True, slots=True)
class Signal:
    """Signals between two stations and a point, each with one tagged event."""

    transmitter: MovingPoint
    relay: MovingPoint
    receiver: MovingPoint
    tag: NDArray[np.int8]
    tag_offset_s: Floats  # of the tagged event, TDB from the reference epoch
    sign: ArrayLike = 1.0  # of the first leg
    hold_s: ArrayLike = 0.0
    source: Floats | None = None  # directions of sources at infinity, zeros of other points, shape (n, 3)


def solve_light_path(
    signal: Signal,
    up_delay_m: ArrayLike,
    down_delay_m: ArrayLike,
    near: LightPath | None = None,
    tolerance_s: float = TOLERANCE_S,
) -> LightPath:
    """Solve the light-time equations of both legs in the BCRS (Moyer 2003, section 8.3).

    Delays are beyond the straight length of each leg; the iteration begins with `near`.
    """
    transmitter, relay, receiver = signal.transmitter, signal.relay, signal.receiver
    tag, tag_offset_s, source = signal.tag, signal.tag_offset_s, signal.source
    # Repeated substitution contracts by v/c = 1e-4 a step, so durations are good to a ten-thousandth of the tolerance.
    sent, received = tag == TRANSMIT, tag == RECEIVE
    up_delay_m, down_delay_m, sign, hold_s = map(
        np.asarray, (up_delay_m, down_delay_m, signal.sign, signal.hold_s)
    )
    if near is None:
        up_s = length(relay.position_m - transmitter.position_m) / C_M_S
        down_s = length(receiver.position_m - relay.position_m) / C_M_S
    else:
        up_s, down_s = near.up_s + up_delay_m / C_M_S, near.down_s + down_delay_m / C_M_S
    for _ in range(_MAX_ITERATIONS):
        ahead_s = sign * up_s
        bounce_s = tag_offset_s + np.where(sent, ahead_s, np.where(received, -down_s - hold_s, 0.0))
        leave_s = bounce_s + hold_s
        transmit_s = np.where(sent, tag_offset_s, bounce_s - ahead_s)
        receive_s = np.where(received, tag_offset_s, leave_s + down_s)
        up_m = relay.at(bounce_s) - transmitter.at(transmit_s)
        down_m = receiver.at(receive_s) - relay.at(leave_s)
        up_length_m = length(up_m)
        down_length_m = length(down_m)
        if source is not None:
            far = np.asarray(source.any(axis=-1, keepdims=True))
            up_length_m = np.where(far[:, 0], -dot(source, transmitter.at(transmit_s)), up_length_m)
            down_length_m = np.where(far[:, 0], -dot(source, receiver.at(receive_s)), down_length_m)
        new_up_s = (up_length_m + up_delay_m) / C_M_S
        new_down_s = (down_length_m + down_delay_m) / C_M_S
        moved_s = np.abs(new_up_s - up_s) + np.abs(new_down_s - down_s)
        up_s, down_s = new_up_s, new_down_s
        # Written so that a NaN does not pass for converged.
        if bool(np.all(moved_s < tolerance_s)):
            up_unit, down_unit = up_m / up_length_m[:, None], down_m / down_length_m[:, None]
            if source is not None:
                up_unit = np.where(far, source, up_unit)
                down_unit = np.where(far, -source, down_unit)
            return LightPath(transmit_s, bounce_s, receive_s, up_s, down_s, up_unit, down_unit)
    open_paths = int(np.sum(~(moved_s < tolerance_s)))
    raise ConvergenceError(
        f"the light time of {open_paths} of {len(moved_s)} paths did not settle within {_MAX_ITERATIONS} iterations; "
        "are the positions finite, and the point near the Moon?"
    )


def path_length_partials(
    path: LightPath,
    transmitter: MovingPoint,
    relay: MovingPoint,
    receiver: MovingPoint,
    tag: NDArray[np.int8],
    sign: ArrayLike = 1.0,
) -> PathPartials:
    """Compute partials of the path's length from the linearized light-time equations of both legs."""
    # c d(up) = n . (dx + v_L dt2 - v_A dt1) + d(up delay), c d(down) = m . (v_B dt3 - dx - v_L dt2') + d(down delay),
    # with the tagged event held (or moved) and the others following; dt2' is the departure's.
    n, m, sign = path.up_unit, path.down_unit, np.asarray(sign)
    c_up_a = C_M_S - sign * dot(n, transmitter.velocity_m_s)
    c_up_l = C_M_S - sign * dot(n, relay.velocity_m_s)
    c_down_l = C_M_S - dot(m, relay.velocity_m_s)
    c_down_b = C_M_S - dot(m, receiver.velocity_m_s)
    closing_up = dot(n, relay.velocity_m_s - transmitter.velocity_m_s)
    closing_down = dot(m, receiver.velocity_m_s - relay.velocity_m_s)
    sent, received = tag == TRANSMIT, tag == RECEIVE

    # The leg next to the tag first; the other leg sees the bounce move with it.
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
    """Compute the gravitational delay of legs by bodies at rest, m, from points (n, 3) to stations (2 n, 3)."""
    total_m = np.zeros(len(ends_m))
    leg_m = length(twice(point_m) - ends_m)
    for body, body_m in bodies_m.items():
        to_end_m, to_point_m = ends_m - twice(body_m), twice(length(point_m - body_m))
        delay_m = gravitational_delay_m(length(to_end_m), to_point_m, leg_m, gm_m3_s2(body))
        if source is not None:
            far = np.flatnonzero(twice(np.asarray(source.any(axis=-1))))
            there = source[far % len(source)]
            delay_m[far] = plane_wave_delay_m(to_end_m[far], there, gm_m3_s2(body))
        total_m += delay_m
    return total_m


def plane_wave_delay_m(from_body_m: Floats, source: Floats, gm_m3_s2: float) -> Floats:
    """Compute the delay from a source at infinity but for a constant, m; IERS Conventions (2010), eq. 11.1 and 11.2."""
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return -k_m * np.log((length(from_body_m) + dot(source, from_body_m)) / 1e11)


def gravitational_delay_m(r1_m: Floats, r2_m: Floats, r12_m: Floats, gm_m3_s2: float) -> Floats:
    """Compute the delay (gamma = 1) by one body at r1 and r2 from points r12 apart, m; Moyer (2003), eq. 8-55."""
    # The term k = 2 GM/c^2 beside the distances is the bending of the ray; IERS Conventions (2010), eq. 11.17, lack it.
    # With s = r1 + r2 the logarithm of (s + r12 + k) / (s - r12 + k) as log1p, so that a short path loses no digits.
    k_m = 2.0 * gm_m3_s2 / C_M_S**2
    return k_m * np.log1p(2.0 * r12_m / (r1_m + r2_m - r12_m + k_m))
