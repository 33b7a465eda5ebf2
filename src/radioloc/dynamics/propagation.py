"""Propagation of orbits about the Moon with their partials: Moon-centred, ICRF axes, TDB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from radioloc.dynamics._force_data import (
    ACTS,
    DONE,
    IN_MOON,
    NODES,
    STUCK,
    TOO_MANY,
    Collocation,
    ForceData,
    Tolerance,
)
from radioloc.dynamics.accelerations import force_data, parameter_columns
from radioloc.dynamics.forces import Forces, Impulse, require_one_epoch
from radioloc.dynamics.orbit import LOWEST_M, STATE, Leg, Orbit, Rest, initial_state
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import ConvergenceError, InputError
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats, rtn_axes

_FIRST_STEP_S = 10.0
_TOLERANCE_M = 1e-7  # Error of the position in one step
_MOST_STEPS = 2_000_000
_VELOCITY_PER_POSITION = 1e-3  # 1/s: about the mean motion of a low orbit


@accepts_quantities
def propagate(
    epoch: Epochs,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    forces: Forces,
    span_s: tuple[float, float],
    *,
    parameters: Sequence[str] | None = None,
    ephemeris: Ephemeris | None = None,
    tolerance_m: float = _TOLERANCE_M,
    touchdown: Epochs | None = None,
) -> Orbit:
    """Integrate the motion of a spacecraft about the Moon, forward and backward from an epoch.

    Parameters
    ----------
    epoch : Epochs
        TDB, one.
    position_m, velocity_m_s : array_like, shape (3,)
        State at the epoch relative to the Moon's centre, ICRF axes.
    forces : Forces
    span_s : tuple of float
        First and last time that is wanted, TDB seconds from the epoch; the epoch itself is always covered.
    parameters : sequence of str, optional
        Forces' parameters (:meth:`Forces.parameters`) whose partials are integrated beside those by the state; an empty
        one for the state alone, None (the default) for no partials.
    ephemeris : Ephemeris, optional
        Positions and masses of the bodies, and the ephemeris of the lunar orientation; DE421 by default.
    tolerance_m : float
        Error of the position in one step of the integration.
    touchdown : Epochs, optional
        From when on it rests on the Moon, where it then is, TDB, one; the epoch itself, or later.

    Raises
    ------
    InputError
        A state under the ground or one that comes down to it, without finite numbers or velocity; an unknown parameter
        or a body that the ephemeris does not hold; an impulse outside the span or at the epoch; no single epoch; a
        tolerance that is not above 0.
    CoverageError
        The ephemeris does not cover the span.
    ConvergenceError
        The integration needs too many steps.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, propagate
    >>> from radioloc.time import epochs_from_strings
    >>> epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> orbit = propagate(epoch, [575750.0, -463261.0, -1631634.0], [-567.855, 1434.222, -600.22], forces, (0, 7200))
    >>> position_m, velocity_m_s = orbit.states(epoch.shifted(3600.0))
    >>> bool(abs((position_m**2).sum() ** 0.5 - 1.79e6) < 1e4)
    True
    """
    ephemeris = ephemeris or Ephemeris.open()
    state = initial_state(position_m, velocity_m_s, at_rest=touchdown is not None)
    motion = Motion(epoch, state, forces, ephemeris, LunarOrientation.open(ephemeris.name), touchdown)
    return integrate_motion(motion, span_s, parameters, tolerance_m, has_all_impulses=True)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a spacecraft: its initial state, forces, and the ground or the touchdown that ends it."""

    epoch: Epochs
    state: Floats
    forces: Forces
    ephemeris: Ephemeris
    libration: LunarOrientation
    touchdown: Epochs | None = None
    name: str = "orbit"  # in messages
    lowest_m: float = LOWEST_M  # distance from the Moon's centre below which the orbit is refused


def integrate_motion(
    motion: Motion,
    span_s: tuple[float, float],
    parameters: Sequence[str] | None,
    tolerance_m: float = _TOLERANCE_M,
    *,
    has_all_impulses: bool = False,
) -> Orbit:
    """Integrate a motion as :func:`propagate` does; a part of an arc need not have all impulses in its span."""
    name, epoch, forces, touchdown = motion.name, motion.epoch, motion.forces, motion.touchdown
    require_one_epoch(name, epoch)
    if not tolerance_m > 0.0:
        raise InputError(f"tolerance_m = {tolerance_m!r} is not above 0")
    start_s, stop_s = min(0.0, float(span_s[0])), max(0.0, float(span_s[1]))
    rest = None
    if touchdown is not None:
        require_one_epoch(name, touchdown)
        rest = Rest(float(touchdown.seconds_since(epoch)[0]), stop_s, motion.libration)
        if rest.start_s < 0.0:
            raise InputError(
                f"the touchdown of {name} is before the epoch of its state; exchange or correct them"
            )
        # Some of the flight is always there, so that there is something to end.
        start_s, stop_s = min(start_s, -1.0), min(stop_s, rest.start_s)
    if not (np.isfinite(start_s) and np.isfinite(stop_s)) or start_s == stop_s:
        raise InputError(f"span_s = {span_s!r} has no length; give first and last seconds from the epoch")
    names = () if parameters is None else (*STATE, *parameters)
    for impulse in forces.impulses:
        impulse_s = float(impulse.epoch.seconds_since(epoch)[0])
        if impulse_s == 0.0 or (has_all_impulses and not start_s < impulse_s < stop_s):
            raise InputError(
                f"impulse {impulse.name} is at {utc_strings(impulse.epoch, 3)[0]} TDB, outside the span or at the "
                f"epoch of {name}; leave it out, or propagate over a longer span"
            )
    data = force_data(
        forces, motion.ephemeris, motion.libration, epoch, (start_s, stop_s), motion.state, names
    )
    before, after = (_legs(motion, names, data, end_s, tolerance_m) for end_s in (start_s, stop_s))
    return Orbit(name, epoch, forces, names, (*before[::-1], *after), rest)


def _legs(
    motion: Motion, names: tuple[str, ...], data: ForceData, end_s: float, tolerance_m: float
) -> list[Leg]:
    """Integrate from the epoch to one end; legs are in the order of integration."""
    epoch, forces = motion.epoch, motion.forces
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._collocation_kernels import integrate

    def seconds(moment: Epochs | None, always_s: float) -> float:
        return always_s if moment is None else float(moment.seconds_since(epoch)[0])

    spans_s = [(seconds(one.start, -np.inf), seconds(one.stop, np.inf)) for one in forces.accelerations]
    impulses_s = [seconds(one.epoch, 0.0) for one in forces.impulses]
    columns, method = parameter_columns(forces, names), _collocation()
    tolerance = Tolerance(tolerance_m, tolerance_m * _VELOCITY_PER_POSITION, motion.lowest_m, _MOST_STEPS)
    sign = 1.0 if end_s > 0.0 else -1.0
    corners = {time for span in spans_s for time in span} | {*impulses_s, end_s}
    ends_s = sorted((t for t in corners if 0.0 < sign * t <= sign * end_s), key=abs)
    y = np.zeros((1 + len(names), 6))
    y[0] = motion.state
    y[1:7] = np.eye(6)[: len(y) - 1]
    legs, time_s, step_s = [], 0.0, _FIRST_STEP_S
    for leg_end_s in ends_s:
        middle_s = 0.5 * (time_s + leg_end_s)
        given = data.given.copy()
        given[:, ACTS] = [start <= middle_s < stop for start, stop in spans_s]
        status, states, dense, step_s = integrate(
            time_s, leg_end_s, step_s, y.ravel(), columns, data._replace(given=given), method, tolerance
        )
        if status != DONE:
            _refuse(motion.name, status, epoch.shifted(float(states[-1, 0])))
        legs.append(Leg(states, dense))
        time_s, y = leg_end_s, states[-1, 1:].reshape(-1, 6).copy()
        for impulse, impulse_s in zip(forces.impulses, impulses_s, strict=True):
            if impulse_s == time_s:
                _jump(y, impulse, names, sign)
    return legs


def _jump(y: Floats, impulse: Impulse, names: tuple[str, ...], sign: float) -> None:
    """Carry state and partials over an impulse, forward or backward."""
    delta = np.array(impulse.delta_v_m_s)

    def turned(state: Floats) -> Floats:
        return rtn_axes(state[:3], state[3:]).T if impulse.axes == "RTN" else np.eye(3)

    before = y[0].copy()
    if sign < 0.0:
        axes = _axes_before(y[0], impulse) if impulse.axes == "RTN" else np.eye(3)
        before[3:] -= delta @ axes
    across = np.eye(6)
    steps = np.repeat([1e-5 * np.linalg.norm(before[:3]), 1e-5 * np.linalg.norm(before[3:])], 3)
    for k, step in enumerate(np.diag(steps)):
        across[3:, k] += (turned(before + step) - turned(before - step)) @ delta / (2.0 * steps[k])
    own = np.zeros((len(names), 6))
    for k, name in enumerate(impulse.names()):
        if name in names:
            own[names.index(name), 3:] = turned(before)[:, k]
    if sign > 0.0:
        y[0, 3:] += turned(before) @ delta
        y[1:] = y[1:] @ across.T + own
    else:
        y[0] = before
        y[1:] = np.linalg.solve(across, (y[1:] - own).T).T


def _axes_before(after: Floats, impulse: Impulse) -> Floats:
    """Radial, transverse and normal axes as rows, before an impulse, from the state after it."""
    # Two states become that after it; this is the one whose motion the impulse does not turn back.
    axes = rtn_axes(after[:3], after[3:])
    _, along, across = impulse.delta_v_m_s
    speed = axes[1] @ after[3:]
    # Its part across turned the plane about the radial axis; the rest of the speed along is what was there before.
    rest = speed**2 - across**2
    if rest <= 0.0 or np.sqrt(rest) <= along:
        raise InputError(
            f"no velocity before impulse {impulse.name} in radial, transverse and normal axes becomes that after it; "
            "correct the impulse or the state, or give the state at an epoch before it"
        )
    cosine, sine = np.sqrt(rest) / speed, across / speed
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]]) @ axes


def _refuse(name: str, status: int, tdb: Epochs) -> NoReturn:
    """Say why an orbit ends before its end."""
    if status in (STUCK, TOO_MANY):
        date = utc_strings(tdb, 3)[0]
        raise ConvergenceError(f"{name} cannot be integrated beyond {date} TDB; is its state in m and m/s?")
    refuse_ground(name, "Moon" if status == IN_MOON else "Earth", tdb)


def refuse_ground(name: str, body: str, tdb: Epochs) -> NoReturn:
    """Raise an InputError with the epoch at which an orbit meets the ground of a body."""
    raise InputError(
        f"{name} comes down to the ground of the {body} at {utc_strings(tdb, 3)[0]} TDB; correct its state or "
        "manoeuvres, or end it before"
    )


def _collocation() -> Collocation:
    nodes, _ = legendre.leggauss(NODES)
    to_series = np.asarray(np.linalg.inv(legendre.legvander(nodes, NODES - 1)), dtype=np.float64)
    ends = np.append(nodes, 1.0)
    once, twice = (
        legendre.legval(ends, legendre.legint(np.eye(NODES), times, lbnd=-1.0)).T @ to_series
        for times in (1, 2)
    )
    return Collocation(ends, to_series, once, twice)
