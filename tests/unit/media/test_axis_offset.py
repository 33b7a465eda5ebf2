"""The offset of an antenna's axes: its geometry for each mount, and its derivatives."""

import dataclasses

import numpy as np
import pytest
from legs import end, state

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.earth.stations import StationCatalogue
from radioloc.media.axis_offset import AntennaAxisOffset
from radioloc.media.medium import Leg

OFFSET_M = 8.0
REFRACTION = 3.13e-4
"""Shortening of the offset by refraction, which the derivatives neglect."""
PLACE = state()
POLE = PLACE.pole_gcrs[0]
FIXED_AXES = {
    "azimuth_elevation": (0.0, 0.0, 1.0),
    "equatorial": POLE,
    "xy_north": (1.0, 0.0, 0.0),  # the pole is in the plane of x and z
    "xy_east": (0.0, -1.0, 0.0),
}
TARGET_M = 3.8e8 * np.array([0.48, 0.64, 0.6])


def delay(mount, target_m=TARGET_M, up=(0.0, 0.0, 1.0), velocity_m_s=(0.0, 0.0, 0.0)):
    station = dataclasses.replace(end(1).stations[0], mount=mount, axis_offset_m=OFFSET_M)
    leg = Leg(
        dataclasses.replace(end(1), stations=[station, end(1).stations[0]]),
        state(up),
        np.array([target_m]),
        np.array([velocity_m_s]),
    )
    return AntennaAxisOffset().delay(leg, None)


@pytest.mark.parametrize("mount", FIXED_AXES)
def test_delay_is_the_offset_across_the_fixed_axis(mount):
    expected_m = -OFFSET_M * np.linalg.norm(np.cross(TARGET_M / 3.8e8, FIXED_AXES[mount]))
    # Refraction at 37 degrees turns the direction by 4e-4 rad.
    assert delay(mount).delay_m[0] == pytest.approx(expected_m, abs=5e-4 * OFFSET_M)


@pytest.mark.parametrize("elevation_deg", [15.0, 40.0, 70.0])
def test_refraction_shortens_the_offset(elevation_deg):
    cosine, sine = np.cos(np.radians(elevation_deg)), np.sin(np.radians(elevation_deg))
    delay_m = delay("azimuth_elevation", 3.8e8 * np.array([cosine, 0.0, sine])).delay_m[0]
    # The cotangent is limited near the horizon.
    assert 1.0 + delay_m / (OFFSET_M * cosine) == pytest.approx(REFRACTION, abs=3e-6)


@pytest.mark.parametrize("mount", FIXED_AXES)
def test_derivatives(mount):
    step_m, velocity_m_s = 1e5, np.array([300.0, -500.0, 800.0])
    by_position = [
        (delay(mount, TARGET_M + step).delay_m[0] - delay(mount, TARGET_M - step).delay_m[0]) / (2.0 * step_m)
        for step in step_m * np.eye(3)
    ]
    result = delay(mount, velocity_m_s=velocity_m_s)
    atol = 4.0 * REFRACTION * OFFSET_M / 3.8e8
    np.testing.assert_allclose(result.by_position[0], by_position, rtol=0.0, atol=atol)
    assert np.abs(result.by_position).max() > 100.0 * atol

    def moved_m(seconds):
        """Return the delay after a rotation of the vertical about the pole."""
        turned = np.array([0.0, 0.0, 1.0]) + EARTH_ROTATION_RAD_S * seconds * np.cross(POLE, [0.0, 0.0, 1.0])
        return delay(mount, TARGET_M + seconds * velocity_m_s, turned / np.linalg.norm(turned)).delay_m[0]

    rate_m_s = (moved_m(10.0) - moved_m(-10.0)) / 20.0
    assert result.rate_m_s[0] == pytest.approx(
        rate_m_s, abs=4.0 * REFRACTION * OFFSET_M * EARTH_ROTATION_RAD_S
    )


def test_stations_without_an_offset_have_no_delay():
    leg = Leg(end(1), PLACE, np.array([TARGET_M]), np.zeros((1, 3)))
    assert AntennaAxisOffset().delay(leg, None) is None


def test_offsets_of_the_catalogue():
    """Values of antenna-info.txt of the IVS; beam waveguide and 70 m antennas of the DSN have zero by construction."""
    offsets_m = {s.name: s.axis_offset_m for s in StationCatalogue.default() if s.axis_offset_m}
    assert offsets_m == {
        **{"SESHAN25": 0.00017, "TIANMA65": 0.0071, "KUNMING": -0.0031, "URUMQI": -0.0024},
        **{"EFLSBERG": 0.0103, "MEDICINA": 1.8301, "METSAHOV": -0.0015, "NOTO": 1.8285, "ONSALA60": -0.006},
        **{"WETTZELL20": -0.0001, "YEBES40M": 1.9968, "ZELENCHK": -0.0115, "BADARY": 0.0025},
        **{"HARTRAO": 6.6945, "HART15M": 1.4901, "HOBART12": 0.0021, "HOBART26": 8.1905, "KATH12M": 0.0031},
        **{"YARRA12M": 0.001, "PARKES": 0.0006, "WARK12M": 0.001},
        **{"DSS-13": 0.0081, "DSS-15": -0.0026, "DSS-45": -0.0005, "DSS-65": -0.0053, "UCHINOURA34": -0.001},
    }
    mounts = {s.name: s.mount for s in StationCatalogue.default() if s.mount != "azimuth_elevation"}
    assert mounts == {"HARTRAO": "equatorial", "HOBART26": "xy_east"}
