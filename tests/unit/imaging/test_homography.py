"""Homographies: their derivatives, covariances and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2 as chi_squared

from radioloc.errors import InputError
from radioloc.imaging.homography import Homography, derivative, fit_homography, transformed

# From pixels of a frame 1000 pixels wide to metres, 3 km east of the origin, seen 20 degrees off the vertical.
MATRIX = np.array([[1.9, 0.3, 3000.0], [-0.25, -2.1, 800.0], [1.0e-4, -2.0e-4, 1.0]])
PIXELS = np.random.default_rng(5).uniform(0.0, 1000.0, (60, 2))
ROUNDING_M = 1e-6  # coordinates of some 5 km in double precision


def noisy(rng, sigma_px, sigma_m):
    ground = transformed(MATRIX, PIXELS)
    return PIXELS + rng.normal(0.0, sigma_px, PIXELS.shape), ground + rng.normal(0.0, sigma_m, ground.shape)


def test_equation_7_of_wang():
    """x = (aX + bY + c) / (gX + hY + 1), y likewise, by hand."""
    parameters = [0.5, 0.1, 3.0, -0.2, 0.4, 7.0, 1e-3, 2e-3]
    homography = Homography(np.append(parameters, 1.0).reshape(3, 3), np.zeros((8, 8)))
    # (0.5 * 10 + 0.1 * 20 + 3) / (0.01 + 0.04 + 1), (-0.2 * 10 + 0.4 * 20 + 7) / 1.05
    assert homography.apply([[10.0, 20.0]])[0] == pytest.approx([10.0 / 1.05, 13.0 / 1.05], abs=1e-12)


def test_exact_points_give_the_transformation():
    fit = fit_homography(*noisy(np.random.default_rng(0), 0.0, 0.0), 0.5, 1.0)
    assert fit.inliers.all()
    np.testing.assert_allclose(
        fit.homography.apply(PIXELS), transformed(MATRIX, PIXELS), rtol=0, atol=ROUNDING_M
    )


def test_four_points_are_met():
    start, end = noisy(np.random.default_rng(0), 2.0, 3.0)
    fit = fit_homography(start[:4], end[:4], 2.0, 3.0)
    np.testing.assert_allclose(fit.homography.apply(start[:4]), end[:4], rtol=0, atol=ROUNDING_M)


def test_derivatives_are_central_differences():
    step = 1e-3
    numeric = np.stack(
        [
            (transformed(MATRIX, PIXELS + d) - transformed(MATRIX, PIXELS - d)) / (2 * step)
            for d in step * np.eye(2)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(derivative(MATRIX, PIXELS), numeric, rtol=0, atol=1e-7)


def test_covariance_of_a_point_by_differences_of_the_parameters():
    fit = fit_homography(*noisy(np.random.default_rng(0), 0.5, 1.0), 0.5, 1.0)
    homography, at = fit.homography, np.array([[120.0, 900.0]])
    parameters = homography.matrix.ravel()[:8]
    by_parameter = []
    for k in range(8):
        step = 1e-3 * np.sqrt(homography.covariance[k, k])
        ends = []
        for sign in (1.0, -1.0):
            changed = parameters.copy()
            changed[k] += sign * step
            ends.append(transformed(np.append(changed, 1.0).reshape(3, 3), at)[0])
        by_parameter.append((ends[0] - ends[1]) / (2.0 * step))
    numeric = np.transpose(by_parameter) @ homography.covariance @ np.array(by_parameter)
    np.testing.assert_allclose(homography.covariance_of(at)[0], numeric, rtol=0, atol=1e-5 * numeric.max())


def test_inverse_has_the_same_uncertainty():
    """A point's covariance, sent there and back, is the same as that of the derivative of the way back."""
    homography = fit_homography(*noisy(np.random.default_rng(0), 0.5, 1.0), 0.5, 1.0).homography
    back, at = homography.inverse(), np.array([[300.0, 400.0]])
    ground = homography.apply(at)
    np.testing.assert_allclose(back.apply(ground), at, rtol=0, atol=1e-9)
    by_ground = derivative(back.matrix, ground)[0]
    expected = by_ground @ homography.covariance_of(at)[0] @ by_ground.T
    np.testing.assert_allclose(back.covariance_of(ground)[0], expected, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_px", "sigma_m"), [(0.5, 0.0), (0.0, 1.0), (0.5, 1.0)])
def test_ellipses_cover_95_percent(sigma_px, sigma_m):
    """Errors of either side or both; 400 seeded draws, three sigmas of the binomial are 3.3 %."""
    rng, at = np.random.default_rng(7), np.array([[900.0, 100.0]])
    truth = transformed(MATRIX, at)[0]
    distances, factors = [], []
    for _ in range(400):
        fit = fit_homography(*noisy(rng, sigma_px, sigma_m), sigma_px, sigma_m)
        error = fit.homography.apply(at)[0] - truth
        factor = max(1.0, fit.variance_factor)  # taken out: what is tested is the covariance of given sigmas
        distances.append(error @ np.linalg.solve(fit.homography.covariance_of(at)[0] / factor, error))
        factors.append(fit.variance_factor)
    assert np.mean(np.array(distances) < chi_squared.ppf(0.95, 2)) == pytest.approx(0.95, abs=0.033)
    assert np.mean(factors) == pytest.approx(1.0, abs=0.03)


def test_outliers_are_left_out():
    rng = np.random.default_rng(3)
    start, end = noisy(rng, 0.5, 1.0)
    wrong = rng.permutation(60)[:15]
    end[wrong] += rng.uniform(20.0, 300.0, (15, 2))
    fit = fit_homography(start, end, 0.5, 1.0, approximate=MATRIX)
    assert not fit.inliers[wrong].any()
    assert fit.inliers.sum() >= 44  # of 45 good ones, one in 1000 may be lost


def test_sigmas_that_are_too_small_make_larger_covariances():
    start, end = noisy(np.random.default_rng(3), 1.5, 3.0)
    fit = fit_homography(start, end, 0.5, 1.0)
    assert fit.variance_factor == pytest.approx(9.0, abs=3.0)  # 112 degrees of freedom: sigma 1.2
    right = fit_homography(start, end, 1.5, 3.0)
    ratio = np.diag(fit.homography.covariance) / np.diag(right.homography.covariance)
    np.testing.assert_allclose(
        ratio, max(1.0, right.variance_factor) ** -1 * fit.variance_factor / 9.0, atol=0.01
    )


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (PIXELS[:3], "give four pairs or more"),
        (np.column_stack([np.arange(9.0), 2.0 * np.arange(9.0)]), "lie on a line or at one place"),
        (np.full((9, 2), 3.0), "lie on a line or at one place"),
        (np.full((9, 2), np.nan), "not finite"),
    ],
)
def test_points_that_determine_nothing(start, message):
    with pytest.raises(InputError, match=message):
        fit_homography(start, start, 0.5, 0.5)
