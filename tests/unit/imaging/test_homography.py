"""Derivatives of homographies."""

import numpy as np

from radioloc.imaging.homography import derivative, transformed

# From pixels of a frame 1000 pixels wide to metres, 3 km east of the origin, seen 20 degrees off the vertical.
MATRIX = np.array([[1.9, 0.3, 3000.0], [-0.25, -2.1, 800.0], [1.0e-4, -2.0e-4, 1.0]])
PIXELS = np.random.default_rng(5).uniform(0.0, 1000.0, (60, 2))


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
