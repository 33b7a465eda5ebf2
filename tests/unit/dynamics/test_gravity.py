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


@pytest.mark.parametrize(("point_m", "words"), [((0.0, 0.0, 0.0), "finite coordinates"), (5.0, "shape")])
def test_points_without_a_value(point_m, words):
    with pytest.raises(InputError, match=words):
        FIELD.acceleration(point_m)
