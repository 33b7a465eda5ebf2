"""Homographies: their derivatives, fits to tie points and what is refused."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.imaging.homography import derivative, fit_homography, transformed

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


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.column_stack([np.arange(9.0), 2.0 * np.arange(9.0)]), "lie on a line"),
        (np.full((9, 2), 3.0), "lie on a line"),
        (np.full((9, 2), np.nan), "expected finite coordinates"),
    ],
)
def test_degenerate_points_are_refused(start, message):
    with pytest.raises(InputError, match=message):
        fit_homography(start, start, 0.5, 0.5)
