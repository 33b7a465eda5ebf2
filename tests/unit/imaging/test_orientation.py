"""Exterior orientation in time: interpolation rules, polynomials, and what is refused."""

import numpy as np
import pytest
from paths import ISDS

from radioloc.errors import InputError
from radioloc.imaging import ConstantOrientation, PolynomialOrientation, TabulatedOrientation, read_isd
from radioloc.imaging.orientation import matrices_of, quaternions_of, rotation_of

ROUNDING = 1e-12
"""Of interpolation, relative to the largest value."""

KERNEL_M = {"lro_nac.json.gz": 1e-5, "kaguya_tc.json.gz": 1e-3, "lro_nac_polar.json.gz": 1e-4}
"""Roughness of the positions that real kernels give every few milliseconds: Kaguya's have steps of 0.7 mm."""


def about_z(angle_rad):
    half = 0.5 * np.asarray(angle_rad)
    return np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)


def table(times_s, positions_m, velocities_m_s=None, rate_rad_s=0.01):
    return TabulatedOrientation(times_s, positions_m, times_s, about_z(rate_rad_s * times_s), velocities_m_s)


def test_lagrange_polynomials_have_the_order_that_the_nodes_allow():
    """Through eight nodes polynomials of degree 7 are exact, near the ends those of degree 5, 3 and 1."""
    times = np.arange(16.0)
    at = np.array([0.3, 1.3, 2.3, 3.3, 7.5, 11.7, 12.7, 13.7, 14.7])
    exact_to = np.array([1, 3, 5, 7, 7, 7, 5, 3, 1])
    for degree in range(1, 8):
        values = np.outer(((times - 8.0) / 8.0) ** degree, [1.0, 2.0, 3.0])
        found, _ = table(times, values).at(at)
        error = np.abs(found[:, 2] / 3.0 - ((at - 8.0) / 8.0) ** degree)
        assert (error[exact_to >= degree] < ROUNDING).all()
        assert (error[exact_to < degree] > 1e-7).all()


def test_uneven_tables_are_interpolated_with_velocities_and_along_great_circles():
    times = np.array([0.0, 1.0, 1.5, 4.0])
    at = np.array([0.0, 0.4, 1.2, 3.9, 4.0])
    cubic, slope = np.outer(times**3, [1.0, -1.0, 0.5]), np.outer(3 * times**2, [1.0, -1.0, 0.5])
    positions, rotations = table(times, cubic, slope, rate_rad_s=0.5).at(at)
    assert np.abs(positions - np.outer(at**3, [1.0, -1.0, 0.5])).max() < 64 * ROUNDING
    assert np.abs(rotations - matrices_of(about_z(0.5 * at))).max() < ROUNDING
    with pytest.raises(InputError, match="interpolated with velocities_m_s, which are missing"):
        table(times, cubic)


def test_the_sign_of_a_quaternion_has_no_meaning():
    times = np.arange(12.0)
    quaternions = about_z(0.1 * times)
    signs = np.where(np.arange(12) % 3 == 0, -1.0, 1.0)[:, None]
    at = np.linspace(0.0, 11.0, 50)
    positions = np.zeros((12, 3))
    one = TabulatedOrientation(times, positions, times, quaternions).at(at)[1]
    other = TabulatedOrientation(times, positions, times, quaternions * signs).at(at)[1]
    assert np.abs(one - other).max() < ROUNDING


@pytest.mark.parametrize("name", ["lro_nac.json.gz", "kaguya_tc.json.gz"])
def test_lagrange_and_great_circles_agree_on_real_tables(name):
    """Left out every second node, both come back to them, but for jitter of the attitude."""
    known = read_isd(ISDS / name).model.orientation
    times = known.position_times_s
    half = slice(0, None, 2)
    even = TabulatedOrientation(times[half], known.positions_m[half], times[half], known.quaternions[half])
    kept = np.delete(np.arange(0, len(times), 2), 5)
    uneven = TabulatedOrientation(
        times[kept], known.positions_m[kept], times[kept], known.quaternions[kept], known.velocities_m_s[kept]
    )
    at = times[31:-31:2]
    for positions, rotations in (even.at(at), uneven.at(at)):
        assert np.abs(positions - known.at(at)[0]).max() < KERNEL_M[name]
        assert np.abs(rotations - known.at(at)[1]).max() < 2e-7


def test_rotations_of_angles():
    rotations = rotation_of(np.random.default_rng(6).uniform(-1.4, 1.4, size=(50, 3)))
    assert np.abs(matrices_of(quaternions_of(rotations)) - rotations).max() < 1e-14
    # each factor turns vectors: omega takes y to z, phi takes z to x, kappa takes x to y
    quarter = np.pi / 2 * np.eye(3)
    turned = rotation_of(quarter)
    assert turned[0] @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert turned[1] @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert turned[2] @ [1, 0, 0] == pytest.approx([0, 1, 0])


def orbit(times_s, height_m=1.0e5, gm_m3_s2=4.9028e12):
    """A circular orbit over the poles with a slow roll, in axes at rest."""
    radius = 1.7374e6 + height_m
    angle = np.sqrt(gm_m3_s2 / radius**3) * times_s
    up = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    along = np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    axes = np.stack([along, np.cross(up, along), up], axis=-1)
    roll = rotation_of(np.stack([1e-3 + 1e-5 * times_s, 2e-6 * times_s, 0.02 + 0 * times_s], axis=-1))
    mounting = rotation_of(np.array([[np.pi, 0.0, 0.3]]))[0]  # looks down
    rates = np.sqrt(gm_m3_s2 / radius) * along
    return radius * up, rates, axes @ roll @ mounting, mounting


def test_polynomials_have_the_three_rotations_of_equation_6():
    """Angles of body to orbit come out as they went in, and the pose to what a cubic leaves of a circle."""
    times = np.linspace(-50.0, 50.0, 401)
    positions, rates, rotations, mounting = orbit(times)
    known = TabulatedOrientation(times, positions, times, quaternions_of(rotations), rates)
    fitted = PolynomialOrientation.fit(known, (-50.0, 50.0), rot_camera_to_body=mounting)
    expected = np.array([[1e-3, 0.0, 0.02], [50e-5, 50 * 2e-6, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    # the cubic's velocity is wrong by up to 1e-6 of the orbit's
    assert np.abs(fitted.angle_coefficients_rad - expected).max() < 2e-6
    at = np.linspace(-50.0, 50.0, 333)
    positions, _, rotations, _ = orbit(at)
    found = fitted.at(at)
    # r n^4 t^4 / 192 at t = 50 s, the error of the best cubic to a circle
    assert 0.02 < np.abs(found[0] - positions).max() < 0.06
    assert np.abs(found[1] - rotations).max() < 2e-6
    # shorter, it is better by the fourth power
    short = PolynomialOrientation.fit(known, (-5.0, 5.0))
    middle = np.abs(at) < 5.0
    assert np.abs(short.at(at[middle])[0] - positions[middle]).max() < 1e-5


@pytest.mark.parametrize(("name", "span_s", "angle_rad"), [
    ("lro_nac.json.gz", (-0.2, 0.2), 1e-6),  # jitter of a quarter of a microradian
    ("kaguya_tc.json.gz", (-1.2, 1.2), 5e-6),
    ("lro_nac_polar.json.gz", (-5.0, 5.0), 3e-6),
])  # fmt: skip
def test_cubic_polynomials_of_real_orbits(name, span_s, angle_rad):
    known = read_isd(ISDS / name).model.orientation
    fitted = PolynomialOrientation.fit(known, span_s)
    at = np.linspace(*span_s, 200)
    (positions, rotations), (fit_positions, fit_rotations) = known.at(at), fitted.at(at)
    assert np.abs(fit_positions - positions).max() < KERNEL_M[name]
    turn = np.swapaxes(rotations, 1, 2) @ fit_rotations
    assert np.abs(turn - np.eye(3)).max() < angle_rad


def test_a_camera_that_only_falls_has_no_orbit():
    times = np.arange(10.0)
    falling = np.outer(1.75e6 - 10.0 * times, [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match="does not move sideways"):
        PolynomialOrientation.fit(table(times, falling), (0.0, 9.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ConstantOrientation([0.0, 1.0], np.eye(3)), "position_m"),
        (lambda: ConstantOrientation([0.0, 1.0, 2.0], 2 * np.eye(3)), "not a rotation matrix"),
        (lambda: table(np.array([0.0, 1.0, 1.0]), np.zeros((3, 3))), "two or more rising times"),
        (lambda: table(np.array([0.0]), np.zeros((1, 3))), "two or more rising times"),
        (lambda: table(np.arange(3.0), np.zeros((4, 3))), "one for each of positions_m"),
        (lambda: table(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3))), "one is needed for each of positions_m"),
        (lambda: TabulatedOrientation(np.arange(2.0), np.zeros((2, 3)), np.arange(2.0), np.ones((2, 4))),
         "does not have the length 1"),
        (lambda: PolynomialOrientation.fit(table(np.arange(5.0), np.zeros((5, 3))), (3.0, 3.0)), "a first and a later"),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()
