"""Brightness of ground under the Sun by hand."""

import numpy as np
import pytest

from radioloc.imaging.shading import lunar_lambert, sun_direction


def test_lunar_lambert_law_by_hand():
    """Level ground, camera above, the Sun 30 degrees from the zenith: L = 1 - 0.57 + 0.2178 - 0.03942."""
    weight = 1.0 - 0.019 * 30.0 + 2.42e-4 * 900.0 - 1.46e-6 * 27000.0
    cosine = np.cos(np.radians(30.0))
    expected = 2.0 * weight * cosine / (1.0 + cosine) + (1.0 - weight) * cosine
    assert lunar_lambert(cosine, 1.0, np.radians(30.0)) == pytest.approx(expected, rel=1e-14)


def test_direction_of_the_sun_by_its_angles():
    np.testing.assert_allclose(sun_direction(90.0, 30.0), [np.cos(np.pi / 6), 0.0, 0.5], atol=1e-15)
    np.testing.assert_allclose(sun_direction(0.0, 90.0), [0.0, 0.0, 1.0], atol=1e-15)
