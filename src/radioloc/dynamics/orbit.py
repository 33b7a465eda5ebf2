"""An integrated orbit: where a spacecraft is, and how that depends on where it began and on what acted on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.dynamics.forces import Forces
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import CoverageError, InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, utc_strings
from radioloc.units import as_float_array
from radioloc.vectors import Floats

_ROUNDING_S = 1e-9  # two floats of an epoch resolve 1e-11 s

LOWEST_M = MEAN_LUNAR_RADIUS_M + LUNAR_HEIGHT_LIMITS_M[0]
"""Distance of the lowest terrain from the Moon's centre, m."""

STATE = ("x", "y", "z", "vx", "vy", "vz")
"""The first parameters of an orbit: its state at the epoch."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Part of an orbit without a jump, as it was integrated."""

    states: Floats  # by step, in either direction: TDB seconds from the epoch, state, partials
    dense: Floats

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time."""
        first_s, last_s = sorted((float(self.states[0, 0]), float(self.states[-1, 0])))
        return first_s, last_s


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """The end of an orbit on the ground, which turns with the Moon from there on."""

    start_s: float  # TDB seconds from the epoch
    stop_s: float  # until which it is wanted
    libration: LunarOrientation

    def carried(self, states: Floats, epoch: Epochs, times_s: Floats) -> Floats:
        """Positions at the touchdown, shape (n, k, 6), as positions and velocities at later times."""
        when = epoch.shifted(np.append(self.start_s, times_s))
        angles_rad, rates_rad_s = self.libration.angles(when)
        rot, rate = rot_icrf_to_pa(angles_rad), rot_icrf_to_pa_rate(angles_rad, rates_rad_s)
        fixed = states[..., :3] @ rot[0].T
        return np.concatenate([fixed @ rot[1:], fixed @ rate[1:]], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """An integrated orbit about the Moon; made by :func:`propagate`."""

    name: str
    epoch: Epochs  # TDB, one
    forces: Forces
    parameters: tuple[str, ...]  # of the partials, those of the state first; none without partials
    legs: tuple[Leg, ...]  # in the order of time
    rest: Rest | None = None  # after the last leg
    changes: Floats | None = None  # of the parameters, by which the states are others, to first order

    @property
    def flight_s(self) -> tuple[float, float]:
        """First and last time of what was integrated, TDB seconds from the epoch."""
        return self.legs[0].span_s[0], self.legs[-1].span_s[1]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, TDB seconds from the epoch."""
        first_s, last_s = self.flight_s
        return first_s, last_s if self.rest is None else max(last_s, self.rest.stop_s)

    def __str__(self) -> str:
        return integrated_over(self.name, self.epoch, self.span_s)

    @accepts_quantities
    def states(self, tdb: Epochs) -> tuple[Floats, Floats]:
        """Position, m, and velocity, m/s, relative to the Moon's centre, ICRF axes, at epochs of TDB, shapes (n, 3).

        Raises
        ------
        CoverageError
            An epoch lies outside what was integrated.
        """
        found = self._at(tdb)
        states = found[:, 0] if self.changes is None else found[:, 0] + self.changes @ found[:, 1:]
        return states[:, :3], states[:, 3:]

    @accepts_quantities
    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """Geocentric position and velocity, geometric (no light time), in barycentric coordinates, ICRF axes.

        As :meth:`radioloc.ephemeris.Trajectory.geocentric`, in whose place an orbit can stand.
        """
        position_m, velocity_m_s = self.states(tdb)
        moon_m, moon_m_s = ephemeris.geocentric("moon", tdb)
        return position_m + moon_m, velocity_m_s + moon_m_s

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the one span that the orbit covers, TDB seconds since J2000."""
        return [since_j2000_s(self.epoch, self.span_s)]

    @accepts_quantities
    def partials(self, tdb: Epochs) -> Floats:
        """Return partials of position and velocity by the `parameters` at epochs of TDB, SI, (n, 6, n_parameters).

        Raises
        ------
        InputError
            The orbit was integrated without partials.
        CoverageError
            An epoch lies outside what was integrated.
        """
        if not self.parameters:
            raise InputError(f"{self.name} has no partials; give propagate the names of parameters")
        return np.swapaxes(self._at(tdb)[:, 1:], 1, 2)

    def _at(self, tdb: Epochs) -> Floats:
        """State and partials, shape (n, 1 + n_parameters, 6)."""
        tdb.require("TDB")
        times_s = tdb.seconds_since(self.epoch)
        first_s, last_s = self.span_s
        if ((times_s < first_s - _ROUNDING_S) | (times_s > last_s + _ROUNDING_S)).any():
            raise CoverageError(
                self.name,
                _dates(self.epoch, (first_s, last_s)),
                _dates(self.epoch, (times_s.min(), times_s.max())),
                "propagate over a longer span, or leave these epochs out",
            )
        # The compiler takes a third of a second to import.
        from radioloc.dynamics._collocation_kernels import interpolate

        found = np.empty((len(times_s), 1 + len(self.parameters), 6))
        ends_s = np.array([leg.span_s[1] for leg in self.legs])
        # At a jump the state is that before it.
        which = np.minimum(np.searchsorted(ends_s, times_s), len(self.legs) - 1)
        for k, leg in enumerate(self.legs):
            rows = np.flatnonzero(which == k)
            if len(rows):
                in_leg = interpolate(np.minimum(times_s[rows], ends_s[-1]), leg.states, leg.dense)
                found[rows] = in_leg.reshape(len(rows), -1, 6)
        landed = np.flatnonzero(times_s > ends_s[-1] + _ROUNDING_S)
        if len(landed) and self.rest is not None:
            found[landed] = self.rest.carried(found[landed], self.epoch, times_s[landed])
        return found


def since_j2000_s(epoch: Epochs, span_s: tuple[float, float]) -> tuple[float, float]:
    """Convert a span in seconds from an epoch to TDB seconds since J2000."""
    epoch_s = float(epoch.seconds_since(Epochs.from_tdb_seconds(0.0))[0])
    return epoch_s + span_s[0], epoch_s + span_s[1]


def integrated_over(name: str, epoch: Epochs, span_s: tuple[float, float]) -> str:
    """Describe an orbit by its name and its span, TDB seconds from the epoch."""
    first, last = _dates(epoch, span_s)
    return f"{name}, integrated from {first} to {last} TDB"


def _dates(epoch: Epochs, times_s: tuple[float, float]) -> tuple[str, str]:
    first, last = utc_strings(epoch.shifted(np.array(times_s)), 3)
    return str(first), str(last)


def initial_state(position_m: ArrayLike, velocity_m_s: ArrayLike, at_rest: bool = False) -> Floats:
    """State at the start of an orbit, shape (6,), refused if impossible; `at_rest` on a pole it has no velocity."""
    state = np.concatenate(
        [
            np.ravel(as_float_array(position_m, "m", "position_m")),
            np.ravel(as_float_array(velocity_m_s, "m / s", "velocity_m_s")),
        ]
    )
    if state.shape != (6,) or not np.isfinite(state).all():
        raise InputError("position_m and velocity_m_s must be three finite numbers each")
    distance_m = float(np.linalg.norm(state[:3]))
    if distance_m < LOWEST_M:
        raise InputError(
            f"position_m is {distance_m / 1e3:.3f} km from the Moon's centre, under its ground; is it in km, or "
            "relative to another body?"
        )
    momentum = np.linalg.norm(np.cross(state[:3], state[3:]))
    if not at_rest and not momentum > 1e-9 * distance_m * np.linalg.norm(state[3:]):
        raise InputError("velocity_m_s is zero or along position_m, so there is no plane of the orbit")
    return state
