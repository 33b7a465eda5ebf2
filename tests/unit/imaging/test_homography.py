"""Homographies: their derivatives, fits to tie points and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.imaging.homography import derivative, fit_homography, transformed

# From pixels of a frame 1000 pixels wide to metres, 3 km east of the origin, seen 20 degrees off the vertical.
MATRIX = np.array([[1.9, 0.3, 3000.0], [-0.25, -2.1, 800.0], [1.0e-4, -2.0e-4, 1.0]])
PIXELS = np.random.default_rng(5).uniform(0.0, 1000.0, (60, 2))
ROUNDING_M = 1e-6  # coordinates of some 5 km in double precision


def noisy(rng, sigma_px, sigma_m):
    ground = transformed(MATRIX, PIXELS)
    return PIXELS + rng.normal(0.0, sigma_px, PIXELS.shape), ground + rng.normal(0.0, sigma_m, ground.shape)


@pytest.mark.parametrize(("points", "sigma_px", "sigma_m"), [(60, 0.0, 0.0), (4, 2.0, 3.0)])
def test_exact_points_and_any_four_are_met(points, sigma_px, sigma_m):
    start, end = (side[:points] for side in noisy(np.random.default_rng(0), sigma_px, sigma_m))
    found = fit_homography(start, end, 2.0, 3.0)
    np.testing.assert_allclose(transformed(found, start), end, rtol=0, atol=ROUNDING_M)


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


def test_outliers_are_left_out():
    rng = np.random.default_rng(3)
    start, end = noisy(rng, 0.5, 1.0)
    wrong = rng.permutation(60)[:15]
    right = np.delete(np.arange(60), wrong)
    end[wrong] += rng.uniform(20.0, 300.0, (15, 2))
    found = fit_homography(start, end, 0.5, 1.0, approximate=MATRIX)
    alone = fit_homography(start[right], end[right], 0.5, 1.0)
    np.testing.assert_allclose(transformed(found, start), transformed(alone, start), rtol=0, atol=ROUNDING_M)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.column_stack([np.arange(9.0), 2.0 * np.arange(9.0)]), "lie on a line or at one place"),
        (np.full((9, 2), 3.0), "lie on a line or at one place"),
        (np.full((9, 2), np.nan), "not finite"),
    ],
)
def test_points_that_determine_nothing(start, message):
    with pytest.raises(InputError, match=message):
        fit_homography(start, start, 0.5, 0.5)
