"""Elevation of simple directions and its derivatives, and media whose delay is a function of it."""

import numpy as np
import pytest
from legs import end, leg, state
from paths import EXAMPLES

import radioloc
from radioloc.errors import InputError, PluginWarning
from radioloc.measurements import PhysicalModel, prepare_predictor
from radioloc.media import ElevationDelay, Status
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


ELEVATION_DEG = np.array([2.9, 3.0, 10.0, 45.0, 89.99])


def test_delay_and_derivative_of_the_cosecant_law():
    legs = leg(ELEVATION_DEG)
    delay = ElevationDelay("cosecant", lambda elevation_rad: 2.4 / np.sin(elevation_rad)).delay(legs, None)
    sine, cosine = np.sin(legs.elevation.angle_rad), np.cos(legs.elevation.angle_rad)
    is_low = legs.elevation.angle_rad < np.deg2rad(3.0)
    np.testing.assert_array_equal(delay.status, np.where(is_low, Status.OUTSIDE_MODEL, Status.OK))
    assert is_low[0]
    assert not is_low[2:].any()
    np.testing.assert_allclose(delay.delay_m, np.where(is_low, 0.0, 2.4 / sine), rtol=0, atol=1e-12)
    expected_m_rad = -2.4 * cosine / sine**2
    np.testing.assert_allclose(delay.by_elevation_m_rad[2:], expected_m_rad[2:], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "function", [lambda elevation_rad: 2.4, lambda elevation_rad: np.nan * elevation_rad]
)
def test_function_without_a_finite_delay_for_each_leg_is_refused(function):
    with pytest.raises(InputError, match="medium constant"):
        ElevationDelay("constant", function).delay(leg(ELEVATION_DEG), None)


@pytest.mark.parametrize(("zenith_m", "count"), [(2.4, 1), (0.1, 0)])
def test_second_troposphere_is_warned_of_once(zenith_m, count, restored_registries, recwarn):
    radioloc.register(ElevationDelay("second", lambda elevation_rad: zenith_m / np.sin(elevation_rad)))
    ranges = radioloc.read_observations(EXAMPLES / "change5" / "short_arc.csv")
    place = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    model = PhysicalModel.build()
    for terms in (model, model.without("second"), model.without("troposphere")):
        prepare_predictor(terms, ranges, place)
    assert [warning.category for warning in recwarn] == [PluginWarning] * count


def test_second_troposphere_is_a_note_of_the_result(restored_registries):
    radioloc.register(ElevationDelay("second", lambda elevation_rad: 2.4 / np.sin(elevation_rad)))
    with pytest.warns(PluginWarning):
        solution = radioloc.locate(EXAMPLES / "change5" / "short_arc.toml")
    assert any('off = ["troposphere"] or ["second"]' in note for note in solution.notes)
