"""Spherical harmonics against a sum in 40 digits, a point mass off the centre and differences."""

import mpmath
import numpy as np
import pytest

from radioloc.dynamics import GravityField
from radioloc.errors import InputError

FIELD = GravityField.open("GRGM660PRIM")
DIGITS = 40
ROUNDING = 2e-15  # relative, of the acceleration in doubles; 6e-16 observed


def exact_potential(field, point_m):
    """Return the sum of the definition in `DIGITS` digits from unnormalized Legendre functions."""
    x, y, z = point_m
    r = mpmath.sqrt(x * x + y * y + z * z)
    t, cosine, longitude = z / r, mpmath.sqrt(x * x + y * y) / r, mpmath.atan2(y, x)
    total, sectoral = mpmath.mpf(0), mpmath.mpf(1)
    for m in range(field.degree + 1):
        if m:
            sectoral *= (2 * m - 1) * cosine
        preceding, legendre = mpmath.mpf(0), sectoral
        cos_m, sin_m = mpmath.cos(m * longitude), mpmath.sin(m * longitude)
        ratio = 1 / mpmath.factorial(2 * m)  # (n - m)! / (n + m)!
        for n in range(m, field.degree + 1):
            if n > m:
                legendre, preceding = (
                    ((2 * n - 1) * t * legendre - (n + m - 1) * preceding) / (n - m),
                    legendre,
                )
                ratio *= mpmath.mpf(n - m) / (n + m)
            norm = mpmath.sqrt((2 - (m == 0)) * (2 * n + 1) * ratio)
            factor = mpmath.mpf(field.c[n, m]) * cos_m + mpmath.mpf(field.s[n, m]) * sin_m
            total += (field.radius_m / r) ** n * norm * legendre * factor
    return field.gm_m3_s2 / r * total


def exact_acceleration(field, point_m):
    """Return central differences of the sum over 1 nm, with a relative error of 1e-31 and rounding of 1e-24."""
    h = mpmath.mpf("1e-9")
    out = []
    for axis in range(3):
        ends = [[mpmath.mpf(c) + sign * h * (k == axis) for k, c in enumerate(point_m)] for sign in (1, -1)]
        out.append((exact_potential(field, ends[0]) - exact_potential(field, ends[1])) / (2 * h))
    return np.array(out, dtype=float)


@pytest.mark.parametrize(
    ("degree", "point_m"),
    [
        (12, (1.1e6, -0.9e6, 1.2e6)),
        (12, (0.0, 0.0, 1.79e6)),
        (12, (0.0, 0.0, -1.79e6)),
        (12, (1e-3, -2e-3, 1.79e6)),
        (12, (0.0, -3.0e8, 1.0e7)),
        *(
            pytest.param(150, point_m, marks=pytest.mark.slow)
            for point_m in (
                (1.1e6, -0.9e6, 1.1e6),
                (0.0, 0.0, 1.79e6),
                (1e-3, 0.0, -1.75e6),
                (1.74e6, 1e5, 0.0),
            )
        ),
    ],
)
def test_acceleration_against_40_digits(degree, point_m):
    field = FIELD.to_degree(degree)
    with mpmath.workdps(DIGITS):
        exact_m_s2 = exact_acceleration(field, point_m)
    error_m_s2 = field.acceleration(point_m) - exact_m_s2
    assert np.linalg.norm(error_m_s2) < ROUNDING * np.linalg.norm(exact_m_s2)


def test_potential_against_40_digits():
    point_m = (1.0e6, 1.1e6, -1.0e6)
    field = FIELD.to_degree(30)
    with mpmath.workdps(DIGITS):
        exact = float(exact_potential(field, point_m))
    assert field.potential(point_m) == pytest.approx(exact, rel=ROUNDING)


def test_point_mass_off_the_centre():
    """Coefficients are the harmonics at its place over 2 n + 1; the truncation at degree 20 is 0.05^21."""
    degree, place_m = 20, np.array([30.0e3, -50.0e3, 60.0e3])
    distance_m = np.linalg.norm(place_m)
    latitude, longitude = np.arcsin(place_m[2] / distance_m), np.arctan2(place_m[1], place_m[0])
    c, s = np.zeros((2, degree + 1, degree + 1))
    for n in range(degree + 1):
        for m in range(n + 1):
            # mpmath's harmonics have the Condon-Shortley phase and the mean square 1 / 4 pi.
            y = complex(mpmath.spherharm(n, m, np.pi / 2 - latitude, longitude)) * (-1) ** m
            y *= np.sqrt(4 * np.pi * (1 + (m > 0))) * (distance_m / FIELD.radius_m) ** n / (2 * n + 1)
            c[n, m], s[n, m] = y.real, y.imag
    field = GravityField("mass", FIELD.gm_m3_s2, FIELD.radius_m, "PA_DE421", "unknown", c, s, 0 * c, 0 * s)
    points_m = np.array([[1.9e6, 0.0, 0.0], [0.0, 0.0, 1.8e6], [-1.2e6, 0.9e6, -1.0e6], [0.0, 1e-3, -1.8e6]])
    from_mass_m = points_m - place_m
    r_m = np.linalg.norm(from_mass_m, axis=-1)[:, None]
    np.testing.assert_allclose(field.potential(points_m), FIELD.gm_m3_s2 / r_m[:, 0], rtol=1e-14)
    acceleration = -FIELD.gm_m3_s2 * from_mass_m / r_m**3
    np.testing.assert_allclose(field.acceleration(points_m), acceleration, rtol=0, atol=1e-14)
    unit = from_mass_m / r_m
    gradient = 3.0 * unit[:, :, None] * unit[:, None, :] - np.eye(3)
    gradient *= (FIELD.gm_m3_s2 / r_m**3)[:, :, None]
    np.testing.assert_allclose(field.gradient(points_m), gradient, rtol=0, atol=1e-20)


@pytest.mark.parametrize("point_m", [(1.0e6, 1.2e6, -0.9e6), (0.0, 0.0, 1.8e6), (0.0, 0.0, -1.8e6)])
def test_gradient_of_the_acceleration(point_m):
    step_m = 10.0
    ends = np.array(point_m) + step_m * np.stack([np.eye(3), -np.eye(3)])
    plus, minus = FIELD.acceleration(ends)
    gradient = FIELD.gradient(point_m)
    # Fourth derivatives of degree 150 cause relative errors of 1e-7 in differences over 10 m.
    np.testing.assert_allclose(gradient, ((plus - minus) / (2 * step_m)).T, rtol=0, atol=1e-13)
    assert np.trace(gradient) == 0.0


def test_packaged_field():
    assert FIELD.degree == 150
    assert FIELD.gm_m3_s2 == 4902.799806931690e9
    assert FIELD.radius_m == 1738.0e3
    # J2 and C22 of the Moon of Lemoine et al. (2013) and Konopliv et al. (2013).
    assert -FIELD.c[2, 0] * np.sqrt(5.0) == pytest.approx(203.2e-6, abs=0.1e-6)
    assert FIELD.c[2, 2] * np.sqrt(5.0 / 12.0) == pytest.approx(22.38e-6, abs=0.01e-6)
    assert 0.0 < FIELD.sigma_c[150, 150] < 1e-10


@pytest.mark.parametrize("degree", [151, -1, 2.5, True])
def test_degree_outside_of_the_field(degree):
    with pytest.raises(InputError, match="expected 0 to 150"):
        GravityField.open("GRGM660PRIM", degree=degree)


@pytest.mark.parametrize(
    ("point_m", "words"),
    [
        ((0.0, 0.0, 0.0), "finite coordinates"),
        (5.0, "shape"),
    ],
)
def test_points_without_a_value(point_m, words):
    with pytest.raises(InputError, match=words):
        FIELD.acceleration(point_m)
