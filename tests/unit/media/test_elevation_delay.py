"""Delay as a function of the elevation alone."""

import numpy as np
import pytest
from legs import leg
from paths import EXAMPLES

import radioloc
from radioloc.errors import InputError, PluginWarning
from radioloc.measurements import PhysicalModel, prepare_predictor
from radioloc.media import ElevationDelay, Status

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
