import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.lunar import cartesian_to_selenographic, east_north_up, selenographic_to_cartesian

ROUNDOFF_M = 2e-9  # some units in the last place of 1.7e6 m
LONGITUDE = st.floats(-np.pi, np.pi)
LATITUDE = st.floats(-np.pi / 2, np.pi / 2)
HEIGHT = st.floats(-1e4, 1e5)


@given(LONGITUDE, LATITUDE, HEIGHT)
def test_round_trip(longitude, latitude, height):
    point_m = selenographic_to_cartesian(longitude, latitude, height)
    restored = selenographic_to_cartesian(*cartesian_to_selenographic(point_m))
    np.testing.assert_allclose(restored, point_m, rtol=0, atol=ROUNDOFF_M)
    lon, lat, h = cartesian_to_selenographic(point_m)
    assert h == pytest.approx(height, abs=ROUNDOFF_M)
    assert (lat - latitude) * MEAN_LUNAR_RADIUS_M == pytest.approx(0.0, abs=ROUNDOFF_M)
    assert np.sin(lon - longitude) * np.cos(latitude) * MEAN_LUNAR_RADIUS_M == pytest.approx(
        0.0, abs=ROUNDOFF_M
    )


def test_known_points():
    half = np.pi / 2
    points = selenographic_to_cartesian(
        [0.0, half, 0.0, np.pi], [0.0, 0.0, half, 0.0], [0.0, 100.0, -50.0, 0.0]
    )
    r = MEAN_LUNAR_RADIUS_M
    np.testing.assert_allclose(
        points, [[r, 0, 0], [0, r + 100, 0], [0, 0, r - 50], [-r, 0, 0]], rtol=0, atol=ROUNDOFF_M
    )


def test_east_north_up_against_differences():
    rng = np.random.default_rng(3)
    lon, lat, h = rng.uniform(-3, 3, 40), rng.uniform(-1.5, 1.5, 40), rng.uniform(-9e3, 1e4, 40)
    radius_m = h + MEAN_LUNAR_RADIUS_M
    scale = np.stack([radius_m * np.cos(lat), radius_m, np.ones(40)], axis=-1)
    partials = np.swapaxes(scale[..., np.newaxis] * east_north_up(lon, lat), -1, -2)
    step_rad, step_m = 1e-6, 1.0
    steps = np.diag([step_rad, step_rad, step_m])
    for column, (d_lon, d_lat, d_h) in enumerate(steps):
        ahead = selenographic_to_cartesian(lon + d_lon, lat + d_lat, h + d_h)
        behind = selenographic_to_cartesian(lon - d_lon, lat - d_lat, h - d_h)
        slope = (ahead - behind) / (2 * steps[column, column])
        # Round-off of the point over the step; the third derivative adds 3e-7 m/rad.
        atol = (ROUNDOFF_M / steps[column, column]) + 1e-6
        np.testing.assert_allclose(partials[:, :, column], slope, rtol=0, atol=atol)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 1.6, 0.0), "beyond a pole.*degrees"),
        ((np.nan, 0.0, 0.0), "a longitude is not"),
        ((0.0, 0.0, np.nan), "a height is not"),
        ((0.0, 0.0, -1737400.0), "below the Moon's centre"),
    ],
)
def test_refused_coordinates(values, message):
    with pytest.raises(InputError, match=message):
        selenographic_to_cartesian(*values)


@pytest.mark.parametrize(
    ("point", "message"),
    [((0.0, 0.0, 0.0), "centre"), ((np.nan, 0.0, 1.0), "finite"), ((1.0, 2.0), "x, y, z"), (5.0, "x, y, z")],
)
def test_refused_points(point, message):
    with pytest.raises(InputError, match=message):
        cartesian_to_selenographic(point)
