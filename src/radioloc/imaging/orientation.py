"""Exterior orientation: position and attitude of a camera as functions of time.

Positions are in axes that turn with the Moon, m; a rotation takes a vector from the camera's axes to these. Times are
seconds from the image's reference epoch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from radioloc.errors import InputError
from radioloc.imaging.cameras import as_points, as_vector
from radioloc.quantities import convert_fields
from radioloc.units import set_fields
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# Largest deviation of the times of an even table from even steps, as a ratio to the step.
_EVEN_STEP_TOLERANCE = 1e-6
# Rounding of epochs as seconds since J2000, from which times are differences.
_EPOCH_ROUNDING_S = 2e-7


@dataclass(frozen=True, slots=True, eq=False)
class ConstantOrientation:
    """Pose of a camera that is constant in time."""

    position_m: Floats  #: (3,)
    rot_camera_to_moon: Floats  #: (3, 3)

    def __post_init__(self) -> None:
        set_fields(self, position_m=as_vector(self.position_m, 3, "position_m"))
        rotation = np.array(self.rot_camera_to_moon, dtype=np.float64)
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6):
            raise InputError("rot_camera_to_moon: expected a rotation matrix, shape (3, 3)")
        set_fields(self, rot_camera_to_moon=rotation)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time: infinite."""
        return -np.inf, np.inf

    def poses(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return the pose, repeated for each time."""
        n = len(time_s)
        return np.broadcast_to(self.position_m, (n, 3)), np.broadcast_to(self.rot_camera_to_moon, (n, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedOrientation:
    """Table of positions and rotations with interpolation.

    Notes
    -----
    Tables of even steps are interpolated as the Community Sensor Models of USGS do, by Lagrange polynomials through the
    eight nearest nodes, through six, four and two where fewer lie to a side (quaternions component by component, then
    normalized). Of uneven ones, positions are interpolated by cubic Hermite polynomials, for which they need
    velocities, and rotations along great circles (slerp). Nothing is extrapolated.
    """

    position_times_s: Floats  #: (n,), rising, two or more
    positions_m: Floats  #: (n, 3)
    rotation_times_s: Floats  #: (m,)
    quaternions: Floats  #: (m, 4), from the camera's axes to the Moon's, scalar first
    velocities_m_s: Floats | None = None  #: (n, 3), relative to the turning axes
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
                    f"{times_name}: expected two or more rising times, one for each of {values_name}"
                )
            deviation_s = np.abs(times - np.linspace(times[0], times[-1], len(times))).max()
            even.append(bool(deviation_s <= max(_EVEN_STEP_TOLERANCE * steps.mean(), _EPOCH_ROUNDING_S)))
            set_fields(self, **{times_name: times})
            set_fields(self, **{values_name: values})
        norms = np.linalg.norm(self.quaternions, axis=1)
        if (np.abs(norms - 1.0) > 1e-3).any():
            raise InputError("quaternions: expected unit length")
        # A rotation has two quaternions of opposite sign; neighbours need the same sign for interpolation.
        turns = np.cumsum(np.sum(self.quaternions[1:] * self.quaternions[:-1], axis=1) < 0.0) % 2
        signs = np.concatenate([[1.0], 1.0 - 2.0 * turns])
        set_fields(self, quaternions=self.quaternions * (signs / norms)[:, None])
        if self.velocities_m_s is not None:
            velocities = as_points(self.velocities_m_s, 3, "velocities_m_s")
            if len(velocities) != len(self.positions_m):
                raise InputError("velocities_m_s: expected one for each of positions_m")
            set_fields(self, velocities_m_s=velocities)
        elif not even[0]:
            raise InputError("velocities_m_s is missing: positions at uneven times are interpolated with it")
        set_fields(self, _even=tuple(even))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time that both tables cover."""
        first = max(self.position_times_s[0], self.rotation_times_s[0])
        return float(first), float(min(self.position_times_s[-1], self.rotation_times_s[-1]))

    def poses(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return positions, m, shape (n, 3), and rotations from the camera's axes, shape (n, 3, 3)."""
        time_s = _clipped(np.asarray(time_s, dtype=np.float64), self.span_s)
        if self._even[0]:
            positions = _lagrange(self.position_times_s, self.positions_m, time_s)
        else:
            from scipy.interpolate import CubicHermiteSpline

            nodes = self.position_times_s, self.positions_m, self.velocities_m_s
            positions = np.asarray(CubicHermiteSpline(*nodes)(time_s))
        if self._even[1]:
            return positions, matrices_from_quaternions(
                _lagrange(self.rotation_times_s, self.quaternions, time_s)
            )
        return positions, slerp(self.rotation_times_s, matrices_from_quaternions(self.quaternions), time_s)


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedOrientation:
    """Orientation with corrections of position and attitude, constant and changing evenly over a span of time.

    Parameters
    ----------
    orientation : ConstantOrientation, TabulatedOrientation or CorrectedOrientation
    position_m : array_like, shape (2, 3)
        Offset in the middle of the span, and change from there to its end.
    angles_rad : array_like, shape (2, 3)
        The same for small angles about the camera's axes.
    times_s : tuple of float
        Middle and half of the span.
    """

    orientation: Orientation
    position_m: Floats
    angles_rad: Floats
    times_s: tuple[float, float]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time that the orientation covers."""
        return self.orientation.span_s

    def poses(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return positions, m, shape (n, 3), and rotations from the camera's axes, shape (n, 3, 3)."""
        positions, rotations = self.orientation.poses(time_s)
        part = ((np.asarray(time_s) - self.times_s[0]) / self.times_s[1])[:, None]
        turns = _rotations().from_rotvec(self.angles_rad[0] + part * self.angles_rad[1]).as_matrix()
        return positions + self.position_m[0] + part * self.position_m[1], rotations @ turns


Orientation = ConstantOrientation | TabulatedOrientation | CorrectedOrientation


def rotation_matrices(angles_rad: Floats) -> Floats:
    """Return Rx(omega) Ry(phi) Rz(kappa), each turning vectors, shape (n, 3, 3), of angles, shape (n, 3)."""
    return np.asarray(_rotations().from_euler("XYZ", angles_rad).as_matrix())


def matrices_from_quaternions(quaternions: Floats) -> Floats:
    """Return rotation matrices, shape (n, 3, 3), of quaternions of any length, scalar first, shape (n, 4)."""
    return np.asarray(_rotations().from_quat(np.roll(quaternions, -1, axis=-1)).as_matrix())


def quaternions_from_matrices(rotations: Floats) -> Floats:
    """Return quaternions, scalar first, shape (n, 4), of rotation matrices."""
    return np.asarray(np.roll(_rotations().from_matrix(rotations).as_quat(), 1, axis=-1))


def slerp(times_s: Floats, rotations: Floats, time_s: Floats) -> Floats:
    """Return rotations at times along great circles between nodes, and up to 1 s beyond them, as axes turn evenly."""
    if len(times_s) == 1:
        return np.broadcast_to(rotations[0], (len(time_s), 3, 3))
    _clipped(time_s, (times_s[0] - 1.0, times_s[-1] + 1.0))
    nodes = _rotations().from_matrix(rotations)
    turns = (nodes[:-1].inv() * nodes[1:]).as_rotvec()
    index = np.clip(np.searchsorted(times_s, time_s, side="right") - 1, 0, len(times_s) - 2)
    part = (time_s - times_s[index]) / (times_s[index + 1] - times_s[index])
    return np.asarray((nodes[index] * _rotations().from_rotvec(part[:, None] * turns[index])).as_matrix())


def _rotations() -> type[Rotation]:
    """Import scipy's class of rotations on first use."""
    from scipy.spatial.transform import Rotation

    return Rotation


def _clipped(time_s: Floats, span_s: tuple[float, float]) -> Floats:
    """Return times; those outside the span by rounding are moved to its ends."""
    first, last = span_s
    tolerance_s = 5 * _EPOCH_ROUNDING_S
    invalid = (time_s < first - tolerance_s) | (time_s > last + tolerance_s) | ~np.isfinite(time_s)
    if invalid.any():
        raise InputError(
            f"expected times from {first:.6f} to {last:.6f} s from the reference epoch, which the camera's orientation "
            f"covers, got {time_s[invalid][0]:.6f} s; take other lines, or a table that covers the image"
        )
    return np.clip(time_s, first, last)


def _lagrange(times_s: Floats, values: Floats, time_s: Floats) -> Floats:
    """Interpolate with the exact node times: rounding them to even steps would move an orbiter by 0.05 mm."""
    from radioloc.imaging._kernels import lagrange

    return np.asarray(lagrange(*map(np.ascontiguousarray, (times_s, values, time_s))))
