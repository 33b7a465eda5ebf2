"""Scale and altitude of descent images: the printed numbers of the Chang'e-3 team."""

import numpy as np
import pytest

from radioloc.imaging import Camera
from radioloc.imaging.cameras import altitude_m

# Chang'e-3 descent images (2014), table 2: altitude, width on the ground, m; the camera of table 1.
ALTITUDE_M = np.array([785.5, 548.4, 370.5, 139.5, 91.9])
WIDTH_M = np.array([657.2, 458.8, 310.0, 116.7, 76.9])
SIZE_PX = 1024
PIXEL_UM = 6.7


def camera(focal_mm):
    return Camera.of_pinhole(focal_mm, PIXEL_UM, [511.5, 511.5])


def test_printed_widths_imply_a_focal_length_of_8_2_mm():
    """Five widths, and 3.35 m at 4 m in the text; 8.594 mm (table 1) gives 5 % less."""
    fitted_mm = float(np.mean(ALTITUDE_M / WIDTH_M)) * SIZE_PX * PIXEL_UM * 1e-3
    assert fitted_mm == pytest.approx(8.20, abs=0.005)  # a width is printed to 0.1 m of 77 to 657
    fitted_m = altitude_m(camera(fitted_mm), WIDTH_M / SIZE_PX)
    assert (np.abs(fitted_m - ALTITUDE_M) < 0.1 * ALTITUDE_M / WIDTH_M).all()
    np.testing.assert_allclose(WIDTH_M / altitude_m(camera(8.594), WIDTH_M / SIZE_PX), 0.798, atol=5e-4)
    np.testing.assert_allclose(WIDTH_M / ALTITUDE_M, 0.837, atol=5e-4)
    assert altitude_m(camera(8.2), 3.35 / SIZE_PX) == pytest.approx(4.0, abs=0.006)
