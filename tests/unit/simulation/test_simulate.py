"""The record adds up, and what the model cannot do is not simulated."""

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    baselines,
    one_way,
    simulate,
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


def test_the_record_adds_up(lander, lander_pa_m, model):
    made = simulate(SCHEDULE, lander, TRUTH, NOISE, model=model, seed=4, name="ce5")
    parts = made.error_free_m + made.noise_m + sum(made.added_m.values())
    np.testing.assert_allclose(made.observations.value_m, parts, rtol=0.0, atol=3e-7)
    assert set(made.added_m) == {"range_bias", "station_delay", "station_position"}
    assert (made.target_pa_m == lander_pa_m).all()
    assert (made.truth, made.noise, made.seed) == (TRUTH, NOISE, 4)
    assert {link.target for link in made.observations.links} == {"ce5"}
    assert set(made.observations.sigma_m.tolist()) == {3.0, 0.5}
    assert 0 < made.is_outlier.sum() < len(made.observations)
    assert np.abs(made.noise_m[made.is_outlier]).min() > 15.0
    with pytest.raises(ValueError, match="read-only"):
        made.observations.value_m[0] = 1.0


def test_a_prepared_world_gives_the_same_for_a_seed_and_another_for_another(lander, model):
    world = Scenario(SCHEDULE, lander, TRUTH).world(model)
    one, two, other = (world.draw(NOISE, seed=seed) for seed in (4, 4, 5))
    direct = simulate(SCHEDULE, lander, TRUTH, NOISE, model=model, seed=4)
    assert (one.observations.value_m == two.observations.value_m).all()
    assert (one.observations.value_m == direct.observations.value_m).all()
    assert (one.observations.value_m != other.observations.value_m).all()
    assert (world.draw().noise_m == 0.0).all()


def test_errors_of_each_pass_are_drawn_if_asked_for(lander, lander_pa_m, model):
    """Two passes, of Kashi and of Seshan, a day apart: another clock error in each, the same within it."""
    later = [
        Session(session.kind, session.pairs, START, "2020-12-02T20:11", 600.0, session.sigma_m)
        for session in SCHEDULE.sessions
    ]
    sigma = TruthSigma(position_enu_m=(0.0, 0.0, 5.0), clock_s={"SESHAN25": 1e-9}, clock_per="pass")
    world = Scenario(Schedule(later), lander, truth_sigma=sigma).world(model)
    made = world.draw(seed=4, draw_errors=True)
    assert set(made.drawn) == {"position.up", "clock.SESHAN25 1", "clock.SESHAN25 2"}
    up = lander_pa_m / np.linalg.norm(lander_pa_m)
    np.testing.assert_allclose(
        made.target_pa_m, lander_pa_m + made.drawn["position.up"] * up, rtol=0.0, atol=1e-6
    )
    rows = made.observations.types() == "vlbi_delay"
    clock_m = made.drawn_m[rows] - made.drawn["position.up"] * world.drawn.partials[0, rows]
    second = made.observations.epoch.mjd[rows] > made.observations.epoch.mjd.min() + 0.6
    for pass_number, mine in ((1, ~second), (2, second)):
        # An earlier clock tags the delay, too: 1e-6 of it.
        expected_m = -C_M_S * made.drawn[f"clock.SESHAN25 {pass_number}"]
        np.testing.assert_allclose(clock_m[mine], expected_m, rtol=1e-5)
    assert "drawn clock: SESHAN25 1 " in made.summary()
    np.testing.assert_array_equal(world.draw(seed=4).observations.value_m, world.value_m)
    with pytest.raises(InputError, match="clock_per needs clock_s"):
        TruthSigma(clock_per="pass")


def test_what_the_model_does_not_hold_for_is_refused(lander, model):
    low = Schedule([Session("range", two_way("KASHI"), START, "2020-12-02T08:00", 600.0, 1.0)], Masks(-90.0))
    words = r"\d+ of 101 observations cannot be simulated; .* range of KASHI>lander>KASHI: below the horizon"
    with pytest.raises(InputError, match=words):
        simulate(low, lander, model=model)
    with pytest.raises(InputError, match="PA_DE421 or ME_DE421"):
        simulate(SCHEDULE, LunarPosition("ME_DE440", lander.xyz_m), model=model)


def test_one_way_and_differenced_measurements(lander, model):
    sessions = [
        Session("one_way_range", one_way("KASHI", "JIAMUSI"), START, STOP, 3600.0, 1.0),
        Session("differenced_range", baselines("JIAMUSI", "KASHI"), START, STOP, 3600.0, 1.0),
    ]
    noise = NoiseModel({"one_way_range": Noise(white_m=1.0)}, Noise(white_m=0.1))
    made = simulate(Schedule(sessions), lander, noise=noise, model=model, seed=2)
    rows = {path: made.observations.paths() == path for path in set(made.observations.paths().tolist())}
    assert set(rows) == {"lander>KASHI", "lander>JIAMUSI", "JIAMUSI<lander>KASHI"}
    second, first, difference = (
        made.error_free_m[rows[path]] for path in ("lander>KASHI", "lander>JIAMUSI", "JIAMUSI<lander>KASHI")
    )
    np.testing.assert_allclose(difference, second - first, rtol=0.0, atol=1e-6)
    assert not made.noise_m[rows["JIAMUSI<lander>KASHI"]].any()
    assert made.noise_m[rows["lander>KASHI"]].all()
    with pytest.raises(InputError, match="'differenced_delay' is of two targets"):
        Session("differenced_delay", baselines("JIAMUSI", "KASHI"), START, STOP, 3600.0, 1.0)
