import numpy as np
import pytest

from radioloc.simulation import visibility
from radioloc.simulation.visibility import Masks, Sight, elevations
from radioloc.time import Epochs, utc_to_tt

STATIONS = ["KASHI", "NEUQUEN", "SESHAN25"]


def every_s(step_s, hours):
    return utc_to_tt(Epochs.from_jd(2459185.1, np.arange(0.0, hours * 3600.0, step_s) / 86400.0, "UTC"))


@pytest.mark.parametrize("mask_deg", [10.0, 40.0])
def test_visibility_is_that_of_the_elevations_at_each_epoch(model, lander_pa_m, mask_deg):
    tt, masks = every_s(5.0, 30.0), Masks(mask_deg, by_station_deg={"NEUQUEN": 25.0})
    visible = Sight(model, STATIONS, tt).is_visible(lander_pa_m, masks)
    np.testing.assert_array_equal(
        visible, elevations(model, lander_pa_m, STATIONS, tt).margin_rad(masks) >= 0.0
    )
    assert (np.diff(visible, axis=0).sum(axis=0) >= 2).all()


@pytest.mark.study
def test_a_culmination_of_seconds_above_the_mask_is_not_missed(model, lander_pa_m):
    tt = every_s(1.0, 26.0)
    highest_rad = elevations(model, lander_pa_m, ["KASHI"], tt).at_station_rad.max()
    masks = Masks(float(np.degrees(highest_rad)) - 1e-7)
    assert 0 < Sight(model, ["KASHI"], tt).is_visible(lander_pa_m, masks).sum() < 60


def test_elevations_change_less_than_the_bound(model, lander_pa_m):
    tt = every_s(600.0, 24.0 * 28.0)
    angles = elevations(model, lander_pa_m, STATIONS, tt)
    for elevation_rad in (angles.at_station_rad, angles.at_target_rad):
        assert np.abs(np.diff(elevation_rad, axis=0)).max() / 600.0 < visibility._MAX_ELEVATION_RATE_RAD_S
