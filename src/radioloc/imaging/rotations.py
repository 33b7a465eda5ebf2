"""Rotations as angles, matrices and quaternions (scalar first), and between two of them along the great circle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def rotation_of(angles_rad: Floats) -> Floats:
    """Rx(omega) Ry(phi) Rz(kappa), each turning vectors, shape (n, 3, 3), of angles, shape (n, 3)."""
    (so, sp, sk), (co, cp, ck) = np.sin(angles_rad).T, np.cos(angles_rad).T
    rows = [
        [cp * ck, -cp * sk, sp],
        [co * sk + so * sp * ck, co * ck - so * sp * sk, -so * cp],
        [so * sk - co * sp * ck, so * ck + co * sp * sk, co * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def angles_of(rotations: Floats) -> Floats:
    """The angles of :func:`rotation_of`, rad, shape (n, 3)."""
    omega = np.arctan2(-rotations[:, 1, 2], rotations[:, 2, 2])
    kappa = np.arctan2(-rotations[:, 0, 1], rotations[:, 0, 0])
    return np.stack([omega, np.arcsin(np.clip(rotations[:, 0, 2], -1.0, 1.0)), kappa], axis=-1)


def matrices_of(quaternions: Floats) -> Floats:
    """Rotation matrices, shape (n, 3, 3), of quaternions of any length, scalar first, shape (n, 4)."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions_of(rotations: Floats) -> Floats:
    """Quaternions, scalar first, shape (n, 4), of rotation matrices."""
    from scipy.spatial.transform import Rotation

    return np.asarray(np.roll(Rotation.from_matrix(rotations).as_quat(), 1, axis=-1))


def of_one_sign(quaternions: Floats) -> Floats:
    """The same rotation has two signs; neighbours get the same one, or interpolation would go the long way."""
    turns = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    return quaternions * np.concatenate([[1.0], np.where(np.cumsum(turns) % 2, -1.0, 1.0)])[:, None]


def slerp(times_s: Floats, quaternions: Floats, time_s: Floats) -> Floats:
    """Quaternions of neighbours have the same sign; by the half-angle's tangent, exact also for small angles."""
    index = intervals(times_s, time_s)
    t = (time_s - times_s[index]) / (times_s[index + 1] - times_s[index])
    a, b = quaternions[index], quaternions[index + 1]
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a, axis=1), np.linalg.norm(b + a, axis=1))
    small = angle < 1e-9
    sine = np.where(small, 1.0, np.sin(angle))
    before = np.where(small, 1.0 - t, np.sin((1.0 - t) * angle) / sine)
    after = np.where(small, t, np.sin(t * angle) / sine)
    return np.asarray(before[:, None] * a + after[:, None] * b)


def intervals(times_s: Floats, time_s: Floats) -> NDArray[np.intp]:
    """The interval of rising times in which each time is."""
    return np.clip(np.searchsorted(times_s, time_s, side="right") - 1, 0, len(times_s) - 2)
