"""Exterior orientation: where the camera is and how it is turned, as functions of time.

Positions are in axes that turn with the Moon, m; a rotation takes a vector from the camera's axes to these. Times are
seconds from the image's reference epoch. Three forms have the same face: one pose, a table with interpolation,
and polynomials of position and attitude.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.imaging.cameras import as_points, as_rotation, as_vector
from radioloc.quantities import accepts_quantities, convert_fields
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


_EVEN = 1e-6  # times of an even table are off by less than this part of a step, or by the rounding of epochs
_ROUNDING_S = 2e-7
"""Epochs as seconds since J2000, from which times are differences, are rounded to 0.1 microseconds."""

_POSES_OF_FIT = 64


@dataclass(frozen=True, slots=True, eq=False)
class ConstantOrientation:
    """One pose, for any time.

    Parameters
    ----------
    position_m : array_like, shape (3,)
    rot_camera_to_moon : array_like, shape (3, 3)
    """

    position_m: Floats
    rot_camera_to_moon: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", as_vector(self.position_m, 3, "position_m"))
        rotation = as_rotation(self.rot_camera_to_moon, "rot_camera_to_moon")
        object.__setattr__(self, "rot_camera_to_moon", rotation)

    @property
    def span_s(self) -> tuple[float, float]:
        """All times."""
        return -np.inf, np.inf

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """The pose, as often as there are times."""
        n = len(time_s)
        return np.broadcast_to(self.position_m, (n, 3)), np.broadcast_to(self.rot_camera_to_moon, (n, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedOrientation:
    """Positions and rotations at some times, with interpolation between them.

    Parameters
    ----------
    position_times_s : array_like, shape (n,)
        Rising, two or more.
    positions_m : array_like, shape (n, 3)
    rotation_times_s : array_like, shape (m,)
    quaternions : array_like, shape (m, 4)
        From the camera's axes to the Moon's, scalar first.
    velocities_m_s : array_like, shape (n, 3), optional
        Relative to the turning axes.

    Notes
    -----
    Tables of even steps are interpolated as the Community Sensor Models of USGS do, by Lagrange polynomials through the
    eight nearest nodes, through six, four and two where fewer lie to a side (quaternions component by component, then
    normalized). Of uneven ones, positions are interpolated by cubic Hermite polynomials, for which they need
    velocities, and rotations along great circles (slerp). Nothing is extrapolated.
    """

    position_times_s: Floats
    positions_m: Floats
    rotation_times_s: Floats
    quaternions: Floats
    velocities_m_s: Floats | None = None
    _even: tuple[bool, bool] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        convert_fields(self)
        names = {"position_times_s": "positions_m", "rotation_times_s": "quaternions"}
        even = []
        for (times_name, values_name), components in zip(names.items(), (3, 4), strict=True):
            times = np.asarray(getattr(self, times_name), dtype=np.float64)
            values = as_points(getattr(self, values_name), components, values_name)
            steps = np.diff(times)
            if times.ndim != 1 or len(times) != len(values) or len(times) < 2 or not (steps > 0.0).all():
                raise InputError(
                    f"{times_name}: two or more rising times are needed, one for each of {values_name}"
                )
            off_s = np.abs(times - np.linspace(times[0], times[-1], len(times))).max()
            even.append(bool(off_s <= max(_EVEN * steps.mean(), _ROUNDING_S)))
            object.__setattr__(self, times_name, times)
            object.__setattr__(self, values_name, values)
        norms = np.linalg.norm(self.quaternions, axis=1)
        if (np.abs(norms - 1.0) > 1e-3).any():
            raise InputError("quaternions: one does not have the length 1")
        # The same rotation has two signs; neighbours get the same one, or interpolation would go the long way.
        turns = np.cumsum(np.sum(self.quaternions[1:] * self.quaternions[:-1], axis=1) < 0.0) % 2
        signs = np.concatenate([[1.0], 1.0 - 2.0 * turns])
        object.__setattr__(self, "quaternions", self.quaternions * (signs / norms)[:, None])
        if self.velocities_m_s is not None:
            velocities = as_points(self.velocities_m_s, 3, "velocities_m_s")
            if len(velocities) != len(self.positions_m):
                raise InputError("velocities_m_s: one is needed for each of positions_m")
            object.__setattr__(self, "velocities_m_s", velocities)
        elif not even[0]:
            raise InputError(
                "positions at uneven times are interpolated with velocities_m_s, which are missing"
            )
        object.__setattr__(self, "_even", tuple(even))

    @property
    def span_s(self) -> tuple[float, float]:
        """What both tables cover."""
        first = max(self.position_times_s[0], self.rotation_times_s[0])
        return float(first), float(min(self.position_times_s[-1], self.rotation_times_s[-1]))

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return positions, m, shape (n, 3), and rotations from the camera's axes, shape (n, 3, 3)."""
        time_s = _inside(np.asarray(time_s, dtype=np.float64), self.span_s)
        if self._even[0]:
            positions = _lagrange(self.position_times_s, self.positions_m, time_s)
        else:
            from scipy.interpolate import CubicHermiteSpline

            known = self.position_times_s, self.positions_m, self.velocities_m_s
            positions = np.asarray(CubicHermiteSpline(*known)(time_s))
        if self._even[1]:
            return positions, matrices_of(_lagrange(self.rotation_times_s, self.quaternions, time_s))
        return positions, slerp(self.rotation_times_s, matrices_of(self.quaternions), time_s)


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialOrientation:
    """Position and attitude as polynomials of time: equation 6 of Wang et al. (2021) with its three rotations.

    R = R_ol R_bo R_ib: from the camera to the spacecraft's body by a constant mounting R_ib, from the body to the orbit
    by the angles, R_bo = Rx(omega) Ry(phi) Rz(kappa) with each factor turning vectors, and from the orbit to the Moon
    by position and velocity: z up, y along z times the velocity relative to the Moon's axes, x completes them.

    Parameters
    ----------
    middle_s, half_span_s : float
        The polynomials' argument is (time - middle) / half span, from -1 to 1.
    position_coefficients_m : array_like, shape (degree + 1, 3)
        In rising powers.
    angle_coefficients_rad : array_like, shape (degree + 1, 3)
        Of omega, phi, kappa.
    rot_camera_to_body : array_like, shape (3, 3)
        The mounting.
    """

    middle_s: float
    half_span_s: float
    position_coefficients_m: Floats
    angle_coefficients_rad: Floats
    rot_camera_to_body: Floats

    @classmethod
    @accepts_quantities
    def fit(
        cls,
        orientation: Orientation,
        span_s: tuple[float, float],
        *,
        degree: int = 3,
        rot_camera_to_body: ArrayLike | None = None,
    ) -> PolynomialOrientation:
        """Polynomials that fit another orientation best, in least squares, at 64 times of a span.

        Without a mounting, that is taken for which the body has the orbit's axes in the middle of the span.

        Raises
        ------
        InputError
            The span is not inside the orientation's; the camera does not move sideways, so that there is no orbit's
            frame; the second angle is near 90 degrees: the mounting is to be given, or another.
        """
        middle, half = 0.5 * (span_s[0] + span_s[1]), 0.5 * (span_s[1] - span_s[0])
        if not half > 0.0:
            raise InputError(f"span_s = {span_s!r} is not a first and a later time")
        argument = np.cos(np.pi * (np.arange(_POSES_OF_FIT) + 0.5) / _POSES_OF_FIT)[::-1]
        positions, rotations = orientation.at(middle + half * argument)
        powers = np.polynomial.polynomial.polyvander(argument, degree)
        position_coefficients = np.asarray(np.linalg.lstsq(powers, positions, rcond=None)[0], np.float64)
        trial = cls(middle, half, position_coefficients, np.zeros((degree + 1, 3)), np.eye(3))
        to_orbit = np.swapaxes(trial._orbit_axes(argument), -1, -2) @ rotations
        if rot_camera_to_body is None:
            _, at_middle = orientation.at(np.array([middle]))
            mounting = trial._orbit_axes(np.zeros(1))[0].T @ at_middle[0]
        else:
            mounting = np.asarray(rot_camera_to_body, dtype=np.float64)
        angles = _rotations().from_matrix(to_orbit @ mounting.T).as_euler("XYZ")
        if np.abs(np.cos(angles[:, 1])).min() < 0.1:
            raise InputError(
                "the attitude's second angle is near 90 degrees; give another rot_camera_to_body"
            )
        unwrapped = np.unwrap(angles, axis=0)
        angle_coefficients = np.asarray(np.linalg.lstsq(powers, unwrapped, rcond=None)[0], np.float64)
        return cls(middle, half, position_coefficients, angle_coefficients, mounting)

    @property
    def span_s(self) -> tuple[float, float]:
        """Where the argument is from -1 to 1."""
        return self.middle_s - self.half_span_s, self.middle_s + self.half_span_s

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Positions, m, shape (n, 3), and rotations from the camera's axes, shape (n, 3, 3)."""
        time_s = _inside(np.asarray(time_s, dtype=np.float64), self.span_s)
        argument = (time_s - self.middle_s) / self.half_span_s
        attitude = rotation_of(_polynomials(self.angle_coefficients_rad, argument))
        rotations = self._orbit_axes(argument) @ attitude @ self.rot_camera_to_body
        return _polynomials(self.position_coefficients_m, argument), rotations

    def _orbit_axes(self, argument: Floats) -> Floats:
        """The orbit's axes as columns."""
        position = _polynomials(self.position_coefficients_m, argument)
        slopes = np.arange(1, len(self.position_coefficients_m))[:, None] * self.position_coefficients_m[1:]
        velocity = _polynomials(slopes, argument)
        up = position / np.linalg.norm(position, axis=1, keepdims=True)
        across = np.cross(up, velocity)
        size = np.linalg.norm(across, axis=1, keepdims=True)
        if (size <= 1e-6 * np.linalg.norm(velocity, axis=1, keepdims=True)).any():
            raise InputError(
                "the camera does not move sideways, so that its orbit gives no axes; use a table"
            )
        across = across / size
        return np.stack([np.cross(across, up), across, up], axis=-1)


Orientation = ConstantOrientation | TabulatedOrientation | PolynomialOrientation


def rotation_of(angles_rad: Floats) -> Floats:
    """Rx(omega) Ry(phi) Rz(kappa), each turning vectors, shape (n, 3, 3), of angles, shape (n, 3)."""
    return np.asarray(_rotations().from_euler("XYZ", angles_rad).as_matrix())


def matrices_of(quaternions: Floats) -> Floats:
    """Rotation matrices, shape (n, 3, 3), of quaternions of any length, scalar first, shape (n, 4)."""
    return np.asarray(_rotations().from_quat(np.roll(quaternions, -1, axis=-1)).as_matrix())


def quaternions_of(rotations: Floats) -> Floats:
    """Quaternions, scalar first, shape (n, 4), of rotation matrices."""
    return np.asarray(np.roll(_rotations().from_matrix(rotations).as_quat(), 1, axis=-1))


def slerp(times_s: Floats, rotations: Floats, time_s: Floats) -> Floats:
    """Return rotations at times along great circles between nodes, and up to 1 s beyond them, as axes turn evenly."""
    if len(times_s) == 1:
        return np.broadcast_to(rotations[0], (len(time_s), 3, 3))
    _inside(time_s, (times_s[0] - 1.0, times_s[-1] + 1.0))
    nodes = _rotations().from_matrix(rotations)
    turns = (nodes[:-1].inv() * nodes[1:]).as_rotvec()
    index = np.clip(np.searchsorted(times_s, time_s, side="right") - 1, 0, len(times_s) - 2)
    part = (time_s - times_s[index]) / (times_s[index + 1] - times_s[index])
    return np.asarray((nodes[index] * _rotations().from_rotvec(part[:, None] * turns[index])).as_matrix())


def _rotations() -> type[Rotation]:
    """Of scipy, imported when it is needed."""
    from scipy.spatial.transform import Rotation

    return Rotation


def _polynomials(coefficients: Floats, argument: Floats) -> Floats:
    return np.asarray(np.polynomial.polynomial.polyval(argument, coefficients).T, dtype=np.float64)


def _inside(time_s: Floats, span_s: tuple[float, float]) -> Floats:
    """Times, of which those that rounding has put outside are moved to the end of the span."""
    first, last = span_s
    outside = (time_s < first - 5 * _ROUNDING_S) | (time_s > last + 5 * _ROUNDING_S) | ~np.isfinite(time_s)
    if outside.any():
        raise InputError(
            f"the camera's orientation is known from {first:.6f} to {last:.6f} s from the reference epoch, not at "
            f"{time_s[outside][0]:.6f} s; take pixels of lines inside, or a table that covers the image"
        )
    return np.clip(time_s, first, last)


def _lagrange(times_s: Floats, values: Floats, time_s: Floats) -> Floats:
    """With the nodes' own times: rounding them to even ones would move an orbiter by 0.05 mm."""
    from radioloc.imaging._kernels import lagrange

    return np.asarray(lagrange(*map(np.ascontiguousarray, (times_s, values, time_s))))
