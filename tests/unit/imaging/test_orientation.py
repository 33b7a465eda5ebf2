"""Exterior orientation in time: interpolation rules and errors of input."""

import numpy as np
import pytest
from paths import ISDS

from radioloc.errors import InputError
from radioloc.imaging import TabulatedOrientation, read_isd
from radioloc.imaging.orientation import (
    matrices_from_quaternions,
    quaternions_from_matrices,
    rotation_matrices,
)

ROUNDING = 1e-12  # of interpolation, relative to the largest value
# Roughness of the positions of real kernels, every few milliseconds: Kaguya's have steps of 0.7 mm.
KERNEL_M = {"lro_nac.json.gz": 1e-5, "kaguya_tc.json.gz": 1e-3}


def about_z(angle_rad):
    half = 0.5 * np.asarray(angle_rad)
    return np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)


def table(times_s, positions_m, velocities_m_s=None, rate_rad_s=0.01):
    return TabulatedOrientation(times_s, positions_m, times_s, about_z(rate_rad_s * times_s), velocities_m_s)


def test_lagrange_polynomials_have_the_order_that_the_nodes_allow():
    """Eight nodes reproduce polynomials of degree 7; near the ends, degree 5, 3 and 1."""
    times = np.arange(16.0)
    epoch_s = np.array([0.3, 1.3, 2.3, 3.3, 7.5, 11.7, 12.7, 13.7, 14.7])
    exact_to = np.array([1, 3, 5, 7, 7, 7, 5, 3, 1])
    for degree in range(1, 8):
        values = np.outer(((times - 8.0) / 8.0) ** degree, [1.0, 2.0, 3.0])
        positions, _ = table(times, values).poses(epoch_s)
        error = np.abs(positions[:, 2] / 3.0 - ((epoch_s - 8.0) / 8.0) ** degree)
        assert (error[exact_to >= degree] < ROUNDING).all()
        assert (error[exact_to < degree] > 1e-7).all()


def test_uneven_tables_are_interpolated_with_velocities_and_along_great_circles():
    times = np.array([0.0, 1.0, 1.5, 4.0])
    epoch_s = np.array([0.0, 0.4, 1.2, 3.9, 4.0])
    cubic, slope = np.outer(times**3, [1.0, -1.0, 0.5]), np.outer(3 * times**2, [1.0, -1.0, 0.5])
    positions, rotations = table(times, cubic, slope, rate_rad_s=0.5).poses(epoch_s)
    assert np.abs(positions - np.outer(epoch_s**3, [1.0, -1.0, 0.5])).max() < 64 * ROUNDING
    assert np.abs(rotations - matrices_from_quaternions(about_z(0.5 * epoch_s))).max() < ROUNDING
    with pytest.raises(InputError, match="velocities_m_s is missing"):
        table(times, cubic)


def test_sign_of_quaternion_does_not_matter():
    times = np.arange(12.0)
    quaternions = about_z(0.1 * times)
    signs = np.where(np.arange(12) % 3 == 0, -1.0, 1.0)[:, None]
    epoch_s = np.linspace(0.0, 11.0, 50)
    positions = np.zeros((12, 3))
    rotations = TabulatedOrientation(times, positions, times, quaternions).poses(epoch_s)[1]
    rotations_of_signed = TabulatedOrientation(times, positions, times, quaternions * signs).poses(epoch_s)[1]
    assert np.abs(rotations - rotations_of_signed).max() < ROUNDING


@pytest.mark.parametrize("name", ["lro_nac.json.gz", "kaguya_tc.json.gz"])
def test_lagrange_and_great_circles_agree_on_real_tables(name):
    """Both reproduce every second node from the others, except for jitter of the attitude."""
    orientation = read_isd(ISDS / name).model.orientation
    times = orientation.position_times_s
    half = slice(0, None, 2)
    even = TabulatedOrientation(
        times[half], orientation.positions_m[half], times[half], orientation.quaternions[half]
    )
    nodes = np.delete(np.arange(0, len(times), 2), 5)
    uneven = TabulatedOrientation(
        times[nodes],
        orientation.positions_m[nodes],
        times[nodes],
        orientation.quaternions[nodes],
        orientation.velocities_m_s[nodes],
    )
    epoch_s = times[31:-31:2]
    for positions, rotations in (even.poses(epoch_s), uneven.poses(epoch_s)):
        assert np.abs(positions - orientation.poses(epoch_s)[0]).max() < KERNEL_M[name]
        assert np.abs(rotations - orientation.poses(epoch_s)[1]).max() < 2e-7


def test_rotations_of_angles():
    rotations = rotation_matrices(np.random.default_rng(6).uniform(-1.4, 1.4, size=(50, 3)))
    assert np.abs(matrices_from_quaternions(quaternions_from_matrices(rotations)) - rotations).max() < 1e-14
    # each factor turns vectors: omega takes y to z, phi takes z to x, kappa takes x to y
    quarter = np.pi / 2 * np.eye(3)
    turned = rotation_matrices(quarter)
    assert turned[0] @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert turned[1] @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert turned[2] @ [1, 0, 0] == pytest.approx([0, 1, 0])
