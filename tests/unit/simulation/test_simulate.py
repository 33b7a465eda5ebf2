"""Simulated observations: sum of their parts, realizations, drawn errors, errors of input."""

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.simulation import (
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    baselines,
    two_way,
)

START, STOP = "2020-12-01T15:11", "2020-12-01T20:11"
SCHEDULE = Schedule(
    [
        Session("range", two_way("JIAMUSI", "KASHI"), START, STOP, 600.0, 3.0),
        Session("vlbi_delay", baselines("SESHAN25", "KUNMING"), START, STOP, 600.0, 0.5),
    ]
)
TRUTH = Truth(
    range_bias_m={"KASHI": 4.0}, station_delay_s={"KUNMING": 1e-9}, station_position_m={"KS": (1.0, 0.0, 0.0)}
)
NOISE = NoiseModel({"range": Noise(white_m=1.0, outlier_fraction=0.2, outlier_m=40.0)}, Noise(white_m=0.1))


def test_values_are_the_sum_of_the_recorded_parts(lander, lander_pa_m, model):
    simulated = Scenario(SCHEDULE, lander, TRUTH, NOISE, seed=4, name="ce5").world(model).draw()
    parts = simulated.error_free_m + simulated.noise_m + sum(simulated.added_m.values())
    np.testing.assert_allclose(simulated.observations.value_m, parts, rtol=0.0, atol=3e-7)
    assert set(simulated.added_m) == {"range_bias", "station_delay", "station_position"}
    assert (simulated.targets[0].position_pa_m == lander_pa_m).all()
    assert (simulated.truth, simulated.noise, simulated.seed) == (TRUTH, NOISE, 4)
    assert {link.target for link in simulated.observations.links} == {"ce5"}
    assert set(simulated.observations.sigma_m.tolist()) == {3.0, 0.5}
    assert 0 < simulated.is_outlier.sum() < len(simulated.observations)
    assert np.abs(simulated.noise_m[simulated.is_outlier]).min() > 15.0
    with pytest.raises(ValueError, match="read-only"):
        simulated.observations.value_m[0] = 1.0


def test_realizations_of_a_world_depend_on_the_seed_only(lander, model):
    world = Scenario(SCHEDULE, lander, TRUTH).world(model)
    first, repeated, different = (world.draw(NOISE, seed=seed) for seed in (4, 4, 5))
    direct = Scenario(SCHEDULE, lander, TRUTH, NOISE, seed=4).world(model).draw()
    assert (first.observations.value_m == repeated.observations.value_m).all()
    assert (first.observations.value_m == direct.observations.value_m).all()
    assert (first.observations.value_m != different.observations.value_m).all()
    assert (world.draw().noise_m == 0.0).all()


def test_errors_of_each_pass_are_drawn(lander, lander_pa_m, model):
    """Clock errors are constant in a pass, and different in the pass of the next day."""
    sessions = [
        Session(session.kind, session.pairs, START, "2020-12-02T20:11", 600.0, session.sigma_m)
        for session in SCHEDULE.sessions
    ]
    sigma = TruthSigma(position_enu_m=(0.0, 0.0, 5.0), clock_s={"SESHAN25": 1e-9}, clock_per="pass")
    world = Scenario(Schedule(sessions), lander, truth_sigma=sigma).world(model)
    simulated = world.draw(seed=4, draw_errors=True)
    assert set(simulated.drawn) == {"position.up", "clock.SESHAN25 1", "clock.SESHAN25 2"}
    up = lander_pa_m / np.linalg.norm(lander_pa_m)
    np.testing.assert_allclose(
        simulated.targets[0].position_pa_m,
        lander_pa_m + simulated.drawn["position.up"] * up,
        rtol=0.0,
        atol=1e-6,
    )
    rows = simulated.observations.types() == "vlbi_delay"
    clock_m = simulated.drawn_m[rows] - simulated.drawn["position.up"] * world.drawn.partials[0, rows]
    second = simulated.observations.epoch.mjd[rows] > simulated.observations.epoch.mjd.min() + 0.6
    for pass_number, in_pass in ((1, ~second), (2, second)):
        # The clock also shifts the time tag, by 1e-6 of the effect.
        expected_m = -C_M_S * simulated.drawn[f"clock.SESHAN25 {pass_number}"]
        np.testing.assert_allclose(clock_m[in_pass], expected_m, rtol=1e-5)
    assert "drawn clock.SESHAN25 1: " in simulated.summary()
    np.testing.assert_array_equal(world.draw(seed=4).observations.value_m, world.value_m)
    with pytest.raises(InputError, match="clock_per needs clock_s"):
        TruthSigma(clock_per="pass")
