"""Scale and altitude of descent images: the printed numbers of the Chang'e-3 team."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.imaging import Camera
from radioloc.imaging.cameras import altitude_m, field_of_view_rad, ground_pixel_m

# Chang'e-3 descent images (2014), table 2: altitude, width on the ground, resolution, m; the camera of table 1.
ALTITUDE_M = np.array([785.5, 548.4, 370.5, 139.5, 91.9])
WIDTH_M = np.array([657.2, 458.8, 310.0, 116.7, 76.9])
SIZE_PX = 1024
PIXEL_UM = 6.7


def camera(focal_mm):
    return Camera.of_pinhole(focal_mm, PIXEL_UM, [511.5, 511.5])


def test_the_printed_widths_are_of_a_shorter_focal_length_than_is_printed():
    """All five widths are those of 8.2 mm; the 8.594 mm of table 1 would see 5 % less."""
    fitted_mm = float(np.mean(ALTITUDE_M / WIDTH_M)) * SIZE_PX * PIXEL_UM * 1e-3
    assert fitted_mm == pytest.approx(8.20, abs=0.005)  # a width is printed to 0.1 m of 77 to 657
    np.testing.assert_allclose(SIZE_PX * ground_pixel_m(camera(fitted_mm), ALTITUDE_M), WIDTH_M, atol=0.1)
    printed = SIZE_PX * ground_pixel_m(camera(8.594), ALTITUDE_M)
    np.testing.assert_allclose(printed / ALTITUDE_M, 0.798, atol=5e-4)
    np.testing.assert_allclose(WIDTH_M / ALTITUDE_M, 0.837, atol=5e-4)


def test_what_an_image_covers_at_4_m_is_less_than_the_legs_span():
    """The text: 3.35 m at 4 m, less than the 4.38 m between the feet; so the centre of the image is the lander."""
    assert SIZE_PX * ground_pixel_m(camera(8.2), 4.0) == pytest.approx(3.35, abs=0.005)


def test_altitude_and_scale_lead_to_each_other():
    heights = np.array([4.0, 91.9, 9000.0])
    np.testing.assert_allclose(
        altitude_m(camera(8.3), ground_pixel_m(camera(8.3), heights)), heights, rtol=1e-14
    )
    # A square pixel field twice as wide as it is far is seen at 90 degrees.
    assert field_of_view_rad(Camera.of_pinhole(10.0, 10.0, [0.0, 0.0]), 2000) == pytest.approx(np.pi / 2.0)


def test_what_is_no_altitude_is_refused():
    with pytest.raises(InputError, match=r"altitude_m = -1\.0 is not a positive"):
        ground_pixel_m(camera(8.3), -1.0)
