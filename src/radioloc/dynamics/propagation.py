"""Propagation of orbits about the Moon with their partials: Moon-centred, ICRF axes, TDB."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics._force_data import (
    ACTS,
    CENTRAL,
    COMPONENTS,
    DONE,
    EARTH,
    EXTRA,
    FIGURES,
    FIRST,
    GIVEN,
    HARMONICS,
    IN_MOON,
    MOONLIGHT,
    NORMAL,
    OF_RTN,
    PARTS,
    RELATIVITY,
    STAGES,
    STUCK,
    SUNLIGHT,
    TIDES,
    TOO_MANY,
    ForceData,
    Tableau,
    Tolerance,
)
from radioloc.dynamics.bodies import BODIES, body_table
from radioloc.dynamics.forces import Forces, Impulse
from radioloc.dynamics.gravity import acceleration_series, gradient_series, recursion, stacked
from radioloc.dynamics.orbit import STATE, Leg, Orbit, Rest
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import ConvergenceError, InputError
from radioloc.time import Epochs, utc_strings
from radioloc.units import as_float_array

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_LOWEST_M = MEAN_LUNAR_RADIUS_M - 10.0e3
"""Below any terrain: heights reach down to -9.2 km."""
_FIRST_STEP_S = 10.0
_MOST_STEPS = 2_000_000
_NEARLY_REST = 1e-30
"""In parts of the position: by this what rests on a pole has a plane."""
_VELOCITY_PER_POSITION = 1e-3  # 1/s: about the mean motion of a low orbit


@bare_arguments
def propagate(
    epoch: Epochs,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    forces: Forces,
    span_s: tuple[float, float],
    *,
    parameters: Sequence[str] | None = None,
    ephemeris: Ephemeris | None = None,
    libration: LunarOrientation | None = None,
    tolerance_m: float = 1e-7,
    name: str = "orbit",
    touchdown: Epochs | None = None,
    whole: bool = True,
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
        Positions and masses of the bodies; DE421 by default.
    libration : LunarOrientation, optional
        That of the ephemeris by default.
    tolerance_m : float
        Error of the position in one step of the integration.
    name : str
        How messages call the orbit.
    touchdown : Epochs, optional
        From when on it rests on the Moon, where it then is, TDB, one; the epoch itself, or later.
    whole : bool
        Whether the span has all impulses; that of a part of an arc need not.

    Raises
    ------
    InputError
        A state under the ground or one that comes down to it, without finite numbers or velocity; an unknown parameter
        or a body that the ephemeris does not hold; an impulse outside the span or at the epoch.
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
    libration = libration or LunarOrientation.open(ephemeris.name)
    epoch.require("TDB")
    state = initial_state(position_m, velocity_m_s, at_rest=touchdown is not None)
    start_s, stop_s = min(0.0, float(span_s[0])), max(0.0, float(span_s[1]))
    if touchdown is None:
        rest = None
    else:
        rest = Rest(float(touchdown.seconds_since(epoch)[0]), stop_s, libration)
        if rest.start_s < 0.0:
            raise InputError(
                f"the touchdown of {name} is before the epoch of its state; exchange or correct them"
            )
        # Some of the flight is always there, so that there is something to end.
        start_s, stop_s = min(start_s, -1.0), min(stop_s, rest.start_s)
    if not (np.isfinite(start_s) and np.isfinite(stop_s)) or start_s == stop_s:
        raise InputError(f"span_s = {span_s!r} has no length; give first and last seconds from the epoch")
    names = () if parameters is None else (*STATE, *parameters)
    data = force_data(forces, ephemeris, libration, epoch, (start_s, stop_s), state, names)
    columns = _columns(forces, names)
    sweep = _Sweep(name, epoch, forces, names, columns, data, (start_s, stop_s), tolerance_m, whole)
    legs = [*sweep.legs(state, start_s)[::-1], *sweep.legs(state, stop_s)]
    return Orbit(name, epoch, forces, names, tuple(legs), rest)


def force_data(
    forces: Forces,
    ephemeris: Ephemeris,
    libration: LunarOrientation,
    epoch: Epochs,
    span_s: tuple[float, float],
    state: Floats,
    names: Sequence[str] = (),
) -> ForceData:
    """What compiled accelerations depend on; given accelerations do not act until they are said to."""
    for body in forces.bodies:
        if body != "earth" and body not in ephemeris.bodies:
            raise InputError(f"{ephemeris.name} has no {body}; leave it out of the bodies of Forces")
    field = forces.gravity
    coefficients = field.c - 1j * field.s
    coefficients[0, 0] = 0.0  # the central term is by itself
    series = stacked(acceleration_series(coefficients))
    part = slice(min(forces.gradient_degree, field.degree) + 1)
    table, first_s, length_s = body_table(ephemeris, libration, field.frame, epoch, span_s)
    masses = [ephemeris.constants.gm_m3_s2(body) for body in ("moon", *BODIES)]
    if forces.gm_m3_s2 is not None:
        masses[0] = forces.gm_m3_s2
    on, scales = np.ones((2, len(PARTS)))
    scales[TIDES], scales[SUNLIGHT], scales[MOONLIGHT] = forces.k2, *[forces.radiation_m2_kg] * 2
    for k, body in enumerate(BODIES):
        on[EARTH + k] = body in forces.bodies
    on[HARMONICS] = field.degree > 0
    on[TIDES] = forces.k2 != 0.0 or "k2" in names
    on[FIGURES], on[RELATIVITY] = forces.figures, forces.relativity
    on[SUNLIGHT] = forces.radiation_m2_kg != 0.0 or "radiation" in names
    on[MOONLIGHT] = forces.moonlight and on[SUNLIGHT]
    given = np.zeros((len(forces.accelerations), FIRST + COMPONENTS))
    from radioloc.dynamics._force_kernels import axes  # the compiler takes a third of a second to import

    for row, one in zip(given, forces.accelerations, strict=True):
        row[OF_RTN] = one.axes == "RTN"
        row[NORMAL:FIRST] = one.normal or 0.0
        row[FIRST:] = [*one.constant_m_s2, *one.cosine_m_s2, *one.sine_m_s2]
    first, _, normal = axes(state[:3], state[3:] + _NEARLY_REST * np.roll(state[:3], 1))
    return ForceData(
        table,
        first_s,
        length_s,
        np.array(masses),
        field.radius_m,
        series,
        stacked(gradient_series(coefficients[part, part])),
        recursion(len(series) + 1),
        on > 0.0,
        scales,
        given,
        np.stack([first, np.cross(normal, first)]),
    )


def initial_state(position_m: ArrayLike, velocity_m_s: ArrayLike, at_rest: bool = False) -> Floats:
    """A state that an orbit can begin with, shape (6,); errors as those of :func:`propagate`.

    On the Moon's pole what is `at_rest` has no velocity.
    """
    state = np.concatenate(
        [
            np.ravel(as_float_array(position_m, "m", "position_m")),
            np.ravel(as_float_array(velocity_m_s, "m / s", "velocity_m_s")),
        ]
    )
    if state.shape != (6,) or not np.isfinite(state).all():
        raise InputError("position_m and velocity_m_s must be three finite numbers each")
    distance_m = float(np.linalg.norm(state[:3]))
    if distance_m < _LOWEST_M:
        raise InputError(
            f"position_m is {distance_m / 1e3:.3f} km from the Moon's centre, under its ground; is it in km, or "
            "relative to another body?"
        )
    momentum = np.linalg.norm(np.cross(state[:3], state[3:]))
    if not at_rest and not momentum > 1e-9 * distance_m * np.linalg.norm(state[3:]):
        raise InputError("velocity_m_s is zero or along position_m, so there is no plane of the orbit")
    return state


def _columns(forces: Forces, names: Sequence[str]) -> Integers:
    """Part and index of each parameter, for the right-hand side."""
    known = {"gm": (CENTRAL, 0), "k2": (TIDES, 0), "radiation": (SUNLIGHT, 0)}
    known |= dict.fromkeys(STATE, (-1, 0))
    for row, one in enumerate(forces.accelerations):
        own = [name for names in one.names() for name in names]
        known |= {name: (GIVEN, row * COMPONENTS + k) for k, name in enumerate(own)}
    for impulse in forces.impulses:
        known |= dict.fromkeys(impulse.names(), (-1, 0))
    for name in names:
        if name not in known:
            raise InputError(f"no force has the parameter {name!r}; there are {', '.join(known)}")
    return np.array([known[name] for name in names], dtype=np.int64).reshape(-1, 2)


class _Sweep:
    """Integration from the epoch to one end, leg by leg."""

    def __init__(
        self,
        name: str,
        epoch: Epochs,
        forces: Forces,
        names: tuple[str, ...],
        columns: Integers,
        data: ForceData,
        span_s: tuple[float, float],
        tolerance_m: float,
        whole: bool,
    ) -> None:
        self.name, self.epoch, self.forces, self.names = name, epoch, forces, names
        self.columns, self.data = columns, data
        self.tolerance = Tolerance(tolerance_m, tolerance_m * _VELOCITY_PER_POSITION, _LOWEST_M, _MOST_STEPS)
        self.tableau = _tableau()
        self.spans_s = [
            (
                -np.inf if one.start is None else float(one.start.seconds_since(epoch)[0]),
                np.inf if one.stop is None else float(one.stop.seconds_since(epoch)[0]),
            )
            for one in forces.accelerations
        ]
        self.impulses_s = [float(one.epoch.seconds_since(epoch)[0]) for one in forces.impulses]
        for one, impulse_s in zip(forces.impulses, self.impulses_s, strict=True):
            if impulse_s == 0.0 or (whole and not span_s[0] < impulse_s < span_s[1]):
                raise InputError(
                    f"impulse {one.name} is at {utc_strings(one.epoch, 3)[0]} TDB, outside the span or at the epoch of "
                    f"{name}; leave it out, or propagate over a longer span"
                )

    def legs(self, state: Floats, end_s: float) -> list[Leg]:
        """Legs in the order in which they are integrated."""
        sign = 1.0 if end_s > 0.0 else -1.0
        corners = {time for span in self.spans_s for time in span} | set(self.impulses_s) | {end_s}
        ends_s = sorted((t for t in corners if 0.0 < sign * t <= sign * end_s), key=abs)
        y = np.zeros((1 + len(self.names), 6))
        y[0] = state
        y[1:7] = np.eye(6)[: len(y) - 1]
        legs, time_s, step_s = [], 0.0, _FIRST_STEP_S
        from radioloc.dynamics._dop853_kernels import integrate

        for leg_end_s in ends_s:
            middle_s = 0.5 * (time_s + leg_end_s)
            given = self.data.given.copy()
            given[:, ACTS] = [start <= middle_s < stop for start, stop in self.spans_s]
            status, states, dense, step_s = integrate(
                time_s,
                leg_end_s,
                step_s,
                y.ravel(),
                self.columns,
                self.data._replace(given=given),
                self.tableau,
                self.tolerance,
            )
            self._require_done(status, float(states[-1, 0]))
            legs.append(Leg(states, dense))
            time_s, y = leg_end_s, states[-1, 1:].reshape(-1, 6).copy()
            for impulse, impulse_s in zip(self.forces.impulses, self.impulses_s, strict=True):
                if impulse_s == time_s:
                    self._jump(y, impulse, sign)
        return legs

    def _jump(self, y: Floats, impulse: Impulse, sign: float) -> None:
        """Carry state and partials over an impulse, forward or backward."""
        delta = np.array(impulse.delta_v_m_s)

        from radioloc.dynamics._force_kernels import axes

        def turned(state: Floats) -> Floats:
            return axes(state[:3], state[3:]).T if impulse.axes == "RTN" else np.eye(3)

        before = y[0].copy()
        if (
            sign < 0.0
        ):  # its axes are those of the state before it: a contraction by the impulse over the velocity
            for _ in range(50):
                before[3:] = y[0, 3:] - turned(before) @ delta
        across = np.eye(6)
        steps = np.repeat([1e-5 * np.linalg.norm(before[:3]), 1e-5 * np.linalg.norm(before[3:])], 3)
        for k, step in enumerate(np.diag(steps)):
            across[3:, k] += (turned(before + step) - turned(before - step)) @ delta / (2.0 * steps[k])
        own = np.zeros((len(self.names), 6))
        for k, name in enumerate(impulse.names()):
            if name in self.names:
                own[self.names.index(name), 3:] = turned(before)[:, k]
        if sign > 0.0:
            y[0, 3:] += turned(before) @ delta
            y[1:] = y[1:] @ across.T + own
        else:
            y[0] = before
            y[1:] = np.linalg.solve(across, (y[1:] - own).T).T

    def _require_done(self, status: int, time_s: float) -> None:
        if status == DONE:
            return
        date = f"{utc_strings(self.epoch.shifted(time_s), 3)[0]} TDB"
        if status in (STUCK, TOO_MANY):
            raise ConvergenceError(
                f"{self.name} cannot be integrated beyond {date}; is its state in m and m/s?"
            )
        where = "Moon" if status == IN_MOON else "Earth"
        raise InputError(
            f"{self.name} comes down to the ground of the {where} at {date}; correct its state or manoeuvres, or end "
            "it before"
        )


def _tableau() -> Tableau:
    from scipy.integrate import DOP853

    size = STAGES + 1 + EXTRA
    a, c = np.zeros((size, size)), np.zeros(size)
    a[:STAGES, :STAGES], c[:STAGES] = DOP853.A, DOP853.C
    a[STAGES + 1 :], c[STAGES + 1 :] = DOP853.A_EXTRA, DOP853.C_EXTRA
    return Tableau(a, DOP853.B.copy(), c, DOP853.E3.copy(), DOP853.E5.copy(), DOP853.D.copy())
