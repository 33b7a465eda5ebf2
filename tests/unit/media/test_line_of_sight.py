"""Sum of the media on a leg, its derivatives, and the status of obstructed legs."""

from dataclasses import replace

import numpy as np
import pytest
from legs import end, leg, state

from radioloc.earth.stations import StationCatalogue
from radioloc.media.axis_offset import AntennaAxisOffset
from radioloc.media.ionosphere import Ionosphere, UniformTec
from radioloc.media.medium import Leg, Status, behind_moon, line_of_sight
from radioloc.media.troposphere import Troposphere

MEDIA = (Troposphere(), Ionosphere(UniformTec(20.0)), AntennaAxisOffset())
STATION = replace(StationCatalogue.default()["KASHI"], axis_offset_m=6.7)
TARGET_M = np.array([[3.3e8, 2.6e8, 0.9e8]])  # 9 degrees high
BY_POSITION_TOLERANCE = 6e-12
"""Refraction, 3e-4 of the derivative by the axis offset, 2e-8, is neglected; the sum is 2e-7."""
RADIUS_M = 1737.4e3


def view(media=MEDIA, target_m=TARGET_M, velocity_m_s=(0.0, 0.0, 0.0)):
    legs = Leg(
        replace(end(1), stations=[STATION]), state((0.36, -0.48, 0.8)), target_m, np.array([velocity_m_s])
    )
    return line_of_sight(legs, media, {medium.name: medium.prepare(legs.end) for medium in media})


def test_delays_of_all_media_add_up():
    parts = [view((medium,)) for medium in MEDIA]
    total = view(velocity_m_s=(0.0, 0.0, 1000.0))
    assert all(abs(part.delay_m[0]) > 0.1 for part in parts)
    assert total.delay_m[0] == pytest.approx(sum(part.delay_m[0] for part in parts), abs=1e-12)
    assert total.status[0] == Status.OK


def test_derivative_by_position_is_that_of_the_delay():
    step_m = 3e4
    numeric = [
        (view(target_m=TARGET_M + step).delay_m[0] - view(target_m=TARGET_M - step).delay_m[0])
        / (2.0 * step_m)
        for step in step_m * np.eye(3)
    ]
    np.testing.assert_allclose(view().by_position[0], numeric, rtol=0, atol=BY_POSITION_TOLERANCE)
    axis_alone = view(MEDIA[2:]).by_position[0]
    assert np.abs(numeric).max() > 1e-7
    assert np.abs(axis_alone).max() > 100 * BY_POSITION_TOLERANCE


def test_rate_of_the_delay_of_a_rising_target():
    velocity_m_s = np.array([0.0, 0.0, 1000.0])
    air = MEDIA[:2]
    later, earlier = (view(air, TARGET_M + s * velocity_m_s).delay_m[0] for s in (1.0, -1.0))
    rate_m_s = view(air, velocity_m_s=velocity_m_s).rate_m_s[0]
    assert rate_m_s == pytest.approx(0.5 * (later - earlier), rel=1e-6)
    assert rate_m_s < -1e-5


def test_status_is_of_the_first_failed_medium_unless_the_target_is_hidden():
    low = leg([20.0, 2.0, -1.0], frequency_hz=np.nan)
    prepared = {medium.name: medium.prepare(low.end) for medium in MEDIA}
    status = line_of_sight(low, MEDIA, prepared).status.tolist()
    assert status == [Status.NO_FREQUENCY, Status.TOO_LOW, Status.BELOW_HORIZON]
    moon_m = 0.9 * low.target_gcrs_m  # between the stations and the target
    status = line_of_sight(low, MEDIA, prepared, moon_m).status.tolist()
    assert status == [Status.BEHIND_MOON, Status.BEHIND_MOON, Status.BELOW_HORIZON]


@pytest.mark.parametrize(
    ("height_m", "angle_deg", "hidden"),
    [
        (1e5, 108.0, False),  # 100 km up the horizon is 18.99 degrees beyond the limb
        (1e5, 109.5, True),
        (-9e3, 60.0, False),  # in a basin the sphere is reduced to the radius of the spacecraft
        (-9e3, 120.0, True),
        (0.0, 89.0, False),
        (0.0, 91.0, True),
        (-3e5, 0.0, True),  # below any terrain
    ],
)
def test_moon_hides_spacecraft_beyond_its_limb(height_m, angle_deg, hidden):
    moon_m, angle = np.array([[0.0, 3.8e8, 0.0]]), np.radians(angle_deg)
    point_m = moon_m + (RADIUS_M + height_m) * np.array([[np.sin(angle), -np.cos(angle), 0.0]])
    assert behind_moon(point_m, np.zeros((1, 3)), moon_m)[0] == hidden
