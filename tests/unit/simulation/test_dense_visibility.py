from dataclasses import replace

import numpy as np
import pytest

from radioloc.earth.stations import StationCatalogue
from radioloc.simulation import dense_visibility
from radioloc.simulation.dense_visibility import seen, station_elevations_rad
from radioloc.simulation.visibility import Masks, directions_itrf, elevations
from radioloc.time import Epochs, utc_to_tt

STATIONS = ["KASHI", "NEUQUEN", "SESHAN25"]
INTERPOLATED_RAD = 1e-12
"""0.01 micrometres of a delay that a metre of zenith delay has at 10 degrees; rounding is 1e-15."""


def every_s(step_s, hours):
    return utc_to_tt(Epochs.from_jd(2459185.1, np.arange(0.0, hours * 3600.0, step_s) / 86400.0, "UTC"))


@pytest.mark.parametrize("mask_deg", [10.0, 40.0])
def test_what_is_seen_is_what_every_epoch_says(model, lander_pa_m, mask_deg):
    tt, masks = every_s(5.0, 30.0), Masks(mask_deg, by_station_deg={"NEUQUEN": 25.0})
    found = seen(model, lander_pa_m, STATIONS, tt, masks)
    np.testing.assert_array_equal(
        found, elevations(model, lander_pa_m, STATIONS, tt).margin_rad(masks) >= 0.0
    )
    assert (np.diff(found, axis=0).sum(axis=0) >= 2).all()


def test_a_culmination_of_seconds_above_the_mask_is_not_missed(model, lander_pa_m):
    tt = every_s(1.0, 26.0)
    highest_rad = elevations(model, lander_pa_m, ["KASHI"], tt).at_station_rad.max()
    masks = Masks(float(np.degrees(highest_rad)) - 1e-7)
    found = seen(model, lander_pa_m, ["KASHI"], tt, masks)
    assert 0 < found.sum() < 60


def test_the_zenith_has_no_edge(model, lander_pa_m):
    """A station that the Moon passes over at less than half a degree: elevations have a kink there, directions none."""
    tt = every_s(1.0, 24.0)
    itrf = directions_itrf(model, lander_pa_m, ["KASHI"], tt[[43200]])[0, 0]
    below = StationCatalogue.default().get("KASHI")
    below = replace(below, name="BELOW", aliases=(), itrf_m=6.37e6 * itrf)
    world = replace(model, catalogue=model.catalogue.with_station(below))
    which = np.zeros(len(tt), dtype=int)
    found = station_elevations_rad(world, lander_pa_m, ["BELOW"], which, tt)
    near = slice(42000, 44400)
    exact = elevations(world, lander_pa_m, ["BELOW"], tt[near]).at_station_rad[:, 0]
    assert exact.max() > np.radians(89.5)
    np.testing.assert_allclose(found[near], exact, rtol=0.0, atol=INTERPOLATED_RAD)


def test_nothing_changes_faster_than_the_bound(model, lander_pa_m):
    tt = every_s(600.0, 24.0 * 28.0)
    found = elevations(model, lander_pa_m, STATIONS, tt)
    for elevation_rad in (found.at_station_rad, found.at_target_rad):
        assert np.abs(np.diff(elevation_rad, axis=0)).max() / 600.0 < dense_visibility._FASTEST_RAD_S


def test_few_epochs_are_few_computations(model, lander_pa_m, monkeypatch):
    computed = []

    def counting(model, target_pa_m, stations, tt):
        computed.append(len(tt))
        return elevations(model, target_pa_m, stations, tt)

    monkeypatch.setattr(dense_visibility, "elevations", counting)
    tt = every_s(1.0, 24.0)
    assert seen(model, lander_pa_m, STATIONS, tt, Masks()).shape == (86400, 3)
    assert sum(computed) < 86400 // 20
    assert seen(model, lander_pa_m, STATIONS, tt[[5]], Masks()).shape == (1, 3)
    assert seen(model, lander_pa_m, STATIONS, tt[:0], Masks()).shape == (0, 3)


def test_elevations_between_nodes(model, lander_pa_m):
    """Irregular epochs in no order, with a gap, up to the first and last ones."""
    random = np.random.default_rng(5)
    seconds = np.concatenate(
        [[0.0, 7200.0], random.uniform(0.0, 7200.0, 2000), random.uniform(5e4, 5.2e4, 2000)]
    )
    tt = utc_to_tt(Epochs.from_jd(2459185.1, seconds / 86400.0, "UTC"))
    which = random.integers(0, len(STATIONS), len(tt))
    found = station_elevations_rad(model, lander_pa_m, STATIONS, which, tt)
    exact = elevations(model, lander_pa_m, STATIONS, tt).at_station_rad[np.arange(len(tt)), which]
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=INTERPOLATED_RAD)
    few = slice(0, 20)
    np.testing.assert_allclose(
        station_elevations_rad(model, lander_pa_m, STATIONS, which[few], tt[few]),
        exact[few],
        rtol=0.0,
        atol=1e-14,
    )
