"""Propagation of orbits about the Moon with their partials: Moon-centred, ICRF axes, TDB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from radioloc.dynamics._force_data import (
    DONE,
    IN_MOON,
    IS_ACTIVE,
    NODES,
    STUCK,
    TOO_MANY,
    Collocation,
    ForceData,
    Tolerance,
)
from radioloc.dynamics.accelerations import force_data, parameter_columns
from radioloc.dynamics.forces import Forces, Impulse, single_tdb_epoch
from radioloc.dynamics.orbit import MIN_RADIUS_M, STATE, Leg, Orbit, SurfaceRest, initial_state
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import ConvergenceError, InputError
from radioloc.quantities import EpochsLike, FloatLike, accepts_quantities
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats, rtn_axes

_FIRST_STEP_S = 10.0
_TOLERANCE_M = 1e-7  # error of the position in a step
_MAX_STEPS = 2_000_000
_MEAN_MOTION_S = 1e-3  # of a low orbit, 1/s: ratio of the tolerances of velocity and position


@accepts_quantities
def propagate(
    epoch: EpochsLike,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    forces: Forces,
    span_s: tuple[FloatLike, FloatLike],
    *,
    parameters: Sequence[str] | None = None,
    ephemeris: Ephemeris | None = None,
    tolerance_m: FloatLike = _TOLERANCE_M,
    touchdown: EpochsLike | None = None,
) -> Orbit:
    """Integrate the motion of a spacecraft about the Moon, forward and backward from an epoch.

    Parameters
    ----------
    epoch : Epochs or Time
        Single epoch of any scale.
    position_m, velocity_m_s : array_like or Quantity, shape (3,)
        State at the epoch relative to the Moon's centre, ICRF axes.
    forces : Forces
    span_s : tuple of float or Quantity
        First and last time of interest, TDB seconds from the epoch; the orbit also covers the epoch.
    parameters : sequence of str, optional
        Parameters of the forces (:meth:`Forces.parameters`) with partials, beside the state. Empty: partials with
        respect to the state only. None (the default): no partials.
    ephemeris : Ephemeris, optional
        Positions and masses of the bodies, and the ephemeris of the lunar orientation; DE421 by default.
    tolerance_m : float
        Error of the position in a step of the integration, m.
    touchdown : Epochs or Time, optional
        Epoch of the landing, not before `epoch`; the spacecraft then rests on the Moon at its position.

    Raises
    ------
    InputError
        The state is not finite or below the ground, or the orbit meets the ground; a parameter is unknown, the
        ephemeris lacks a body, an impulse is outside of the span or at the epoch, or the tolerance is not positive.
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
    libration = LunarOrientation.open(ephemeris.name)
    landing = None if touchdown is None else single_tdb_epoch("touchdown", touchdown)
    motion = Motion(single_tdb_epoch("epoch", epoch), state, forces, ephemeris, libration, landing)
    return integrate_motion(motion, span_s, parameters, tolerance_m, has_all_impulses=True)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a spacecraft: initial state, forces, ground and touchdown."""

    epoch: Epochs
    state: Floats
    forces: Forces
    ephemeris: Ephemeris
    libration: LunarOrientation
    touchdown: Epochs | None = None
    name: str = "orbit"  # in messages
    min_radius_m: float = MIN_RADIUS_M  # smallest permitted distance from the Moon's centre


def integrate_motion(
    motion: Motion,
    span_s: tuple[float, float],
    parameters: Sequence[str] | None,
    tolerance_m: float = _TOLERANCE_M,
    *,
    has_all_impulses: bool = False,
) -> Orbit:
    """Integrate a motion as :func:`propagate` does; without `has_all_impulses` some may be outside of the span."""
    name, epoch, forces, touchdown = motion.name, motion.epoch, motion.forces, motion.touchdown
    if not tolerance_m > 0.0:
        raise InputError(f"tolerance_m: expected a number above 0, got {tolerance_m!r}")
    start_s, stop_s = min(0.0, float(span_s[0])), max(0.0, float(span_s[1]))
    surface_rest = None
    if touchdown is not None:
        surface_rest = SurfaceRest(float(touchdown.seconds_since(epoch)[0]), stop_s, motion.libration)
        if surface_rest.start_s < 0.0:
            raise InputError(f"touchdown of {name}: expected an epoch not before that of the state")
        # At least a second of flight.
        start_s, stop_s = min(start_s, -1.0), min(stop_s, surface_rest.start_s)
    if not (np.isfinite(start_s) and np.isfinite(stop_s)) or start_s == stop_s:
        raise InputError(
            f"span_s: expected different finite first and last seconds from the epoch, got {span_s!r}"
        )
    names = () if parameters is None else (*STATE, *parameters)
    for impulse in forces.impulses:
        impulse_s = float(impulse.epoch.seconds_since(epoch)[0])
        if impulse_s == 0.0 or (has_all_impulses and not start_s < impulse_s < stop_s):
            raise InputError(
                f"impulse {impulse.name}: expected an epoch in the span of {name}, other than its epoch, got "
                f"{utc_strings(impulse.epoch, 3)[0]} TDB; remove it, or propagate over a longer span"
            )
    data = force_data(
        forces, motion.ephemeris, motion.libration, epoch, (start_s, stop_s), motion.state, names
    )
    earlier, later = (_legs(motion, names, data, end_s, tolerance_m) for end_s in (start_s, stop_s))
    return Orbit(name, epoch, forces, names, (*earlier[::-1], *later), surface_rest)


def _legs(
    motion: Motion, names: tuple[str, ...], data: ForceData, end_s: float, tolerance_m: float
) -> list[Leg]:
    """Integrate from the epoch to an end; legs are in the order of integration."""
    epoch, forces = motion.epoch, motion.forces
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._collocation_kernels import integrate

    def seconds(tdb: Epochs | None, default_s: float) -> float:
        return default_s if tdb is None else float(tdb.seconds_since(epoch)[0])

    spans_s = [(seconds(item.start, -np.inf), seconds(item.stop, np.inf)) for item in forces.accelerations]
    impulses_s = [seconds(item.epoch, 0.0) for item in forces.impulses]
    columns, method = parameter_columns(forces, names), _collocation()
    tolerance = Tolerance(tolerance_m, tolerance_m * _MEAN_MOTION_S, motion.min_radius_m, _MAX_STEPS)
    sign = 1.0 if end_s > 0.0 else -1.0
    corners = {time for span in spans_s for time in span} | {*impulses_s, end_s}
    ends_s = sorted((t for t in corners if 0.0 < sign * t <= sign * end_s), key=abs)
    y = np.zeros((1 + len(names), 6))
    y[0] = motion.state
    y[1:7] = np.eye(6)[: len(y) - 1]
    legs, time_s, step_s = [], 0.0, _FIRST_STEP_S
    for leg_end_s in ends_s:
        middle_s = 0.5 * (time_s + leg_end_s)
        empirical = data.empirical.copy()
        empirical[:, IS_ACTIVE] = [start <= middle_s < stop for start, stop in spans_s]
        status, states, dense, step_s = integrate(
            time_s,
            leg_end_s,
            step_s,
            y.ravel(),
            columns,
            data._replace(empirical=empirical),
            method,
            tolerance,
        )
        if status != DONE:
            _raise_failure(motion.name, status, epoch.shifted(float(states[-1, 0])))
        legs.append(Leg(states, dense))
        time_s, y = leg_end_s, states[-1, 1:].reshape(-1, 6).copy()
        for impulse, impulse_s in zip(forces.impulses, impulses_s, strict=True):
            if impulse_s == time_s:
                _apply_impulse(y, impulse, names, sign)
    return legs


def _apply_impulse(y: Floats, impulse: Impulse, names: tuple[str, ...], sign: float) -> None:
    delta = np.array(impulse.delta_v_m_s)

    def rotation(state: Floats) -> Floats:
        return rtn_axes(state[:3], state[3:]).T if impulse.axes == "RTN" else np.eye(3)

    state = y[0].copy()
    if sign < 0.0:
        axes = _axes_before_impulse(y[0], impulse) if impulse.axes == "RTN" else np.eye(3)
        state[3:] -= delta @ axes
    transition = np.eye(6)
    steps = np.repeat([1e-5 * np.linalg.norm(state[:3]), 1e-5 * np.linalg.norm(state[3:])], 3)
    for k, step in enumerate(np.diag(steps)):
        transition[3:, k] += (rotation(state + step) - rotation(state - step)) @ delta / (2.0 * steps[k])
    by_impulse = np.zeros((len(names), 6))
    for k, name in enumerate(impulse.names()):
        if name in names:
            by_impulse[names.index(name), 3:] = rotation(state)[:, k]
    if sign > 0.0:
        y[0, 3:] += rotation(state) @ delta
        y[1:] = y[1:] @ transition.T + by_impulse
    else:
        y[0] = state
        y[1:] = np.linalg.solve(transition, (y[1:] - by_impulse).T).T


def _axes_before_impulse(state: Floats, impulse: Impulse) -> Floats:
    """Return radial, transverse and normal axes before an impulse as rows, from the state after it."""
    # Two solutions exist; the impulse does not reverse the motion in this one.
    axes = rtn_axes(state[:3], state[3:])
    _, transverse, normal = impulse.delta_v_m_s
    speed = axes[1] @ state[3:]
    # The normal component turned the plane about the radial axis.
    square = speed**2 - normal**2
    if square <= 0.0 or np.sqrt(square) <= transverse:
        raise InputError(
            f"impulse {impulse.name}: the velocity after it excludes its RTN components; correct impulse or state, or "
            "state the orbit at an epoch before the impulse"
        )
    cosine, sine = np.sqrt(square) / speed, normal / speed
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]]) @ axes


def _raise_failure(name: str, status: int, tdb: Epochs) -> NoReturn:
    """Raise the error of an integration that ended early."""
    if status in (STUCK, TOO_MANY):
        date = utc_strings(tdb, 3)[0]
        raise ConvergenceError(
            f"{name}: integration failed at {date} TDB; check the units of its state (m, m/s)"
        )
    raise_ground_error(name, "Moon" if status == IN_MOON else "Earth", tdb)


def raise_ground_error(name: str, body: str, tdb: Epochs) -> NoReturn:
    """Raise an InputError with the epoch at which an orbit meets the ground of a body."""
    raise InputError(
        f"{name} meets the ground of the {body} at {utc_strings(tdb, 3)[0]} TDB; correct its state or manoeuvres, or "
        "shorten its span"
    )


def _collocation() -> Collocation:
    nodes, _ = legendre.leggauss(NODES)
    to_series = np.asarray(np.linalg.inv(legendre.legvander(nodes, NODES - 1)), dtype=np.float64)
    ends = np.append(nodes, 1.0)
    to_speeds, to_places = (
        legendre.legval(ends, legendre.legint(np.eye(NODES), order, lbnd=-1.0)).T @ to_series
        for order in (1, 2)
    )
    return Collocation(ends, to_series, to_speeds, to_places)
