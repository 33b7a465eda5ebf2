"""Elevation of simple directions, and its derivatives."""

import numpy as np
import pytest
from legs import end, state

from radioloc.media.medium import Leg

DISTANCE_M = 3.8e8


def elevation_of(station, target_m, velocity_m_s=(0.0, 0.0, 0.0)):
    return Leg(end(1), station, target_m, np.array([velocity_m_s])).elevation


@pytest.mark.parametrize("degrees", [-90.0, -20.0, 0.0, 1e-7, 45.0, 89.9999999, 90.0])
def test_elevation_by_hand(degrees):
    angle = np.radians(degrees)
    elevation = elevation_of(state(), DISTANCE_M * np.array([[np.cos(angle), 0.0, np.sin(angle)]]))
    assert elevation.angle_rad[0] == pytest.approx(angle, rel=0, abs=3e-16)
    assert elevation.rate_rad_s.tolist() == [0.0]


@pytest.mark.parametrize(
    ("station", "velocity_m_s", "rate_rad_s"),
    [
        (state(), (5.0, 7.0, 1000.0), 1000.0 / DISTANCE_M),
        (state(velocity=(0.0, 0.0, 400.0)), (0.0, 0.0, 0.0), -400.0 / DISTANCE_M),
        (state(up_rate=(0.0, 7e-5, 0.0)), (0.0, 0.0, 0.0), 7e-5),
    ],
    ids=["target", "station", "vertical"],
)
def test_rate_has_three_parts(station, velocity_m_s, rate_rad_s):
    elevation = elevation_of(station, np.array([[0.0, DISTANCE_M, 0.0]]), velocity_m_s)
    assert elevation.rate_rad_s[0] == pytest.approx(rate_rad_s, rel=1e-12)


def test_derivative_by_position():
    station, step_m = state((0.36, -0.48, 0.8)), 100.0
    point = np.array([[2.2e8, -1.9e8, 2.4e8]])
    numeric = [
        (elevation_of(station, point + step).angle_rad[0] - elevation_of(station, point - step).angle_rad[0])
        / (2.0 * step_m)
        for step in step_m * np.eye(3)
    ]
    # Angles of 1 rad are rounded to 1e-16, so differences over 200 m to 1e-18 rad/m.
    np.testing.assert_allclose(elevation_of(station, point).by_position_rad_m[0], numeric, rtol=0, atol=3e-18)
