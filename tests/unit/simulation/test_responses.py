"""First-order responses against worlds computed with the departure, and noise drawn for many seeds at once."""

import numpy as np
import pytest

from radioloc.lunar.position import LunarPosition
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.simulation import (
    Departure,
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    all_ranges,
    baselines,
    departed,
    two_way,
)
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.responses import responses

START, STOP = "2020-12-01T15:11", "2020-12-03T15:10"
FREQUENCIES = {"wavelength_um": 35394.6, "uplink_hz": 7.2e9}
SCENARIO = Scenario(
    Schedule(
        [
            Session("range", all_ranges("JIAMUSI", "KASHI"), START, STOP, 7200.0, 1.0, **FREQUENCIES),
            Session("vlbi_delay", baselines("SESHAN25", "URUMQI"), START, STOP, 7200.0, 0.5, **FREQUENCIES),
            Session("doppler", two_way("NEUQUEN"), START, STOP, 7200.0, 0.01, count_s=60.0, **FREQUENCIES),
        ],
        Masks(station_deg=10.0),
    ),
    LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4),
)
STATIONS = ("JIAMUSI", "NEUQUEN", "URUMQI")
SIZES = {
    **{Departure("position_enu_m", axis=k): 10.0 for k in range(3)},
    **{Departure("moon_m", axis=k): 1.0 for k in range(3)},
    **{Departure("libration_rad", axis=k): 1e-7 for k in range(3)},
    **{Departure("pole_rad", axis=k): 1e-8 for k in range(2)},
    Departure("ut1_s"): 1e-4,
    **{Departure("station_enu_m", name, k): 0.3 for name in STATIONS for k in range(3)},
    **{Departure("clock_s", name): 1e-6 for name in STATIONS},
    **{Departure("clock_rate", name): 1e-12 for name in STATIONS},
    **{Departure("zenith_delay_m", name): 0.1 for name in STATIONS},
    **{Departure("tec_tecu", name): 5.0 for name in STATIONS},
    Departure("range_bias_m", "KASHI"): 5.0,
}


@pytest.fixture(scope="module")
def case(model):
    world = SCENARIO.world(model)
    arc = ExactPredictor(model, world.plan.observations, world.target_pa_m)
    computed = arc.compute(world.target_pa_m)
    found = responses(
        model,
        world.plan.observations,
        world.target_pa_m,
        computed,
        list(SIZES),
        truth=Truth(),
        clock_epoch_utc=START,
    )
    return world, dict(zip(SIZES, found, strict=True))


def value_m(world):
    return world.error_free_m + sum(world.added_m.values())


@pytest.mark.parametrize("departure", SIZES, ids=str)
def test_responses_are_what_worlds_do(departure, case, model):
    world, found = case
    size = SIZES[departure]
    truth = departed(SCENARIO.truth, {departure: size}, START)
    plain = Scenario(SCENARIO.schedule, SCENARIO.position, truth)
    position_only = {departure: size} if departure.quantity == "position_enu_m" else {}
    changed_m = value_m(plain.world(model, position_only, world.plan)) - value_m(world)
    predicted_m = size * found[departure]
    largest_m = max(np.abs(changed_m).max(), 1e-9)
    # 3e-3 of the largest: both ends turn while the signal is under way; 3e-6 m: rounding of ranges and epochs.
    np.testing.assert_allclose(predicted_m, changed_m, rtol=0.0, atol=3e-3 * largest_m + 3e-6)
    assert largest_m > 1e-6


def test_noise_of_a_seed_is_the_same_in_any_company(case):
    world, _ = case
    noise = NoiseModel(
        {"range": Noise(1.0, 2.0, 9000.0, 0.01, 0.1, 50.0), "doppler": Noise(white_m=0.01)},
        vlbi_station=Noise(white_m=0.1, coloured_m=0.2, correlation_s=3600.0),
    )
    draws = NoiseDraws.of(noise, world.plan)
    many_m, wild = draws.draw([3, 8, 2**100])
    for seed, noise_m, is_outlier in zip([3, 8, 2**100], many_m, wild, strict=True):
        alone_m, alone = noise.draw(world.plan, seed)
        assert (alone_m == noise_m).all()
        assert (alone == is_outlier).all()
    assert not (many_m[0] == many_m[1]).any()
