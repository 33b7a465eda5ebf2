"""Integrated orbit: states of a spacecraft, with partials with respect to the initial state and force parameters."""

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
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs, utc_strings
from radioloc.units import as_float_array
from radioloc.vectors import Floats

_TIME_TOLERANCE_S = 1e-9  # two floats of an epoch resolve 1e-11 s

MIN_RADIUS_M = MEAN_LUNAR_RADIUS_M + LUNAR_HEIGHT_LIMITS_M[0]
"""Distance of the lowest terrain from the Moon's centre, m."""

STATE = ("x", "y", "z", "vx", "vy", "vz")
"""First parameters of an orbit: its state at the epoch."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Integrated part of an orbit between discontinuities."""

    states: Floats  # at the steps, in either direction: TDB seconds from the epoch, state, partials
    dense: Floats  # series for interpolation

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time."""
        first_s, last_s = sorted((float(self.states[0, 0]), float(self.states[-1, 0])))
        return first_s, last_s


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceRest:
    """Rest on the ground after a touchdown, fixed to the Moon."""

    start_s: float  # TDB seconds from the epoch
    stop_s: float  # end of the time of interest
    libration: LunarOrientation

    def states_at(self, touchdown: Floats, epoch: Epochs, times_s: Floats) -> Floats:
        """Return positions and velocities at later times from the states of the touchdown, shapes (n, k, 6)."""
        tdb = epoch.shifted(np.append(self.start_s, times_s))
        angles_rad, rates_rad_s = self.libration.angles(tdb)
        rot, rate = rot_icrf_to_pa(angles_rad), rot_icrf_to_pa_rate(angles_rad, rates_rad_s)
        fixed = touchdown[..., :3] @ rot[0].T
        return np.concatenate([fixed @ rot[1:], fixed @ rate[1:]], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """Integrated orbit about the Moon, from :func:`propagate`."""

    name: str
    epoch: Epochs  #: single epoch, TDB
    forces: Forces
    parameters: tuple[str, ...]  #: of the partials, the state first; empty without partials
    legs: tuple[Leg, ...]  #: in the order of time
    surface_rest: SurfaceRest | None = None  #: after the last leg
    changes: Floats | None = None  #: of the parameters, applied to the states to first order

    @property
    def flight_s(self) -> tuple[float, float]:
        """First and last time of the flight, TDB seconds from the epoch."""
        return self.legs[0].span_s[0], self.legs[-1].span_s[1]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, TDB seconds from the epoch."""
        first_s, last_s = self.flight_s
        return first_s, last_s if self.surface_rest is None else max(last_s, self.surface_rest.stop_s)

    def __str__(self) -> str:
        return orbit_text(self.name, self.epoch, self.span_s)

    @accepts_quantities
    def states(self, tdb: EpochsLike) -> tuple[Floats, Floats]:
        """Return position, m, and velocity, m/s, relative to the Moon's centre, ICRF axes, at epochs of TDB, (n, 3).

        Raises
        ------
        CoverageError
            An epoch is outside of the span.
        """
        augmented = self._augmented_states(tdb)
        states = augmented[:, 0]
        if self.changes is not None:
            states = states + self.changes @ augmented[:, 1:]
        return states[:, :3], states[:, 3:]

    @accepts_quantities
    def geocentric(self, ephemeris: Ephemeris, tdb: EpochsLike) -> tuple[Floats, Floats]:
        """Return geometric geocentric position, m, and velocity, m/s, in barycentric coordinates, ICRF axes, (n, 3).

        An orbit can replace a :class:`radioloc.ephemeris.Trajectory`.
        """
        position_m, velocity_m_s = self.states(tdb)
        moon_m, moon_m_s = ephemeris.geocentric("moon", tdb)
        return position_m + moon_m, velocity_m_s + moon_m_s

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the span that the orbit covers, TDB seconds since J2000."""
        return [since_j2000_s(self.epoch, self.span_s)]

    @accepts_quantities
    def partials(self, tdb: EpochsLike) -> Floats:
        """Return partials of the state with respect to the `parameters` at TDB epochs, SI, (n, 6, n_parameters).

        Raises
        ------
        InputError
            The orbit was integrated without partials.
        CoverageError
            An epoch is outside of the span.
        """
        if not self.parameters:
            raise InputError(f"{self.name}: partials were not integrated; call propagate with parameters=()")
        return np.swapaxes(self._augmented_states(tdb)[:, 1:], 1, 2)

    def _augmented_states(self, tdb: Epochs) -> Floats:
        """Return state and partials, shape (n, 1 + n_parameters, 6)."""
        tdb.require("TDB")
        times_s = tdb.seconds_since(self.epoch)
        first_s, last_s = self.span_s
        if ((times_s < first_s - _TIME_TOLERANCE_S) | (times_s > last_s + _TIME_TOLERANCE_S)).any():
            raise CoverageError(
                self.name,
                _dates(self.epoch, (first_s, last_s)),
                _dates(self.epoch, (times_s.min(), times_s.max())),
                "propagate over a longer span, or exclude these epochs",
            )
        # The compiler takes a third of a second to import.
        from radioloc.dynamics._collocation_kernels import interpolate

        out = np.empty((len(times_s), 1 + len(self.parameters), 6))
        ends_s = np.array([leg.span_s[1] for leg in self.legs])
        # At a discontinuity the state is that before it.
        leg_index = np.minimum(np.searchsorted(ends_s, times_s), len(self.legs) - 1)
        for k, leg in enumerate(self.legs):
            rows = np.flatnonzero(leg_index == k)
            if len(rows):
                in_leg = interpolate(np.minimum(times_s[rows], ends_s[-1]), leg.states, leg.dense)
                out[rows] = in_leg.reshape(len(rows), -1, 6)
        landed = np.flatnonzero(times_s > ends_s[-1] + _TIME_TOLERANCE_S)
        if len(landed) and self.surface_rest is not None:
            out[landed] = self.surface_rest.states_at(out[landed], self.epoch, times_s[landed])
        return out


def since_j2000_s(epoch: Epochs, span_s: tuple[float, float]) -> tuple[float, float]:
    """Convert a span in seconds from an epoch to TDB seconds since J2000."""
    epoch_s = float(epoch.seconds_since(Epochs.from_tdb_seconds(0.0))[0])
    return epoch_s + span_s[0], epoch_s + span_s[1]


def orbit_text(name: str, epoch: Epochs, span_s: tuple[float, float]) -> str:
    """Return the name and span of an orbit, TDB seconds from the epoch, as text."""
    first, last = _dates(epoch, span_s)
    return f"{name}, integrated from {first} to {last} TDB"


def _dates(epoch: Epochs, times_s: tuple[float, float]) -> tuple[str, str]:
    first, last = utc_strings(epoch.shifted(np.array(times_s)), 3)
    return str(first), str(last)


def initial_state(position_m: ArrayLike, velocity_m_s: ArrayLike, at_rest: bool = False) -> Floats:
    """Return the initial state of an orbit, shape (6,), if it is possible; only `at_rest` it may lack a plane."""
    state = np.concatenate(
        [
            np.ravel(as_float_array(position_m, "m", "position_m")),
            np.ravel(as_float_array(velocity_m_s, "m / s", "velocity_m_s")),
        ]
    )
    if state.shape != (6,) or not np.isfinite(state).all():
        raise InputError("position_m, velocity_m_s: expected three finite numbers each")
    distance_m = float(np.linalg.norm(state[:3]))
    if distance_m < MIN_RADIUS_M:
        raise InputError(
            f"position_m: expected a distance from the Moon's centre above {MIN_RADIUS_M / 1e3:.0f} km, got "
            f"{distance_m / 1e3:.3f} km; check the unit (m) and the central body"
        )
    momentum = np.linalg.norm(np.cross(state[:3], state[3:]))
    if not at_rest and not momentum > 1e-9 * distance_m * np.linalg.norm(state[3:]):
        raise InputError("velocity_m_s: expected a velocity that is not parallel to position_m")
    return state
