"""Simulated tracking of a spacecraft: when it is seen, and a world that its own model predicts."""

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, epochs_tai
from spk_files import ORBITER, circular, lander, low_lunar_orbit, tracking, write_states

import radioloc
from radioloc.ephemeris import Trajectory
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.predictor import reasons
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Schedule,
    Session,
    Truth,
    elevations,
    simulate,
    two_way,
    windows,
)
from radioloc.time import tai_to_tt

HOURS = ("2020-12-02T13:00:00", "2020-12-03T00:00:00")

# A lander of 1735.5 km stands 1.9 km below the sphere that is its limb as a spacecraft; its light time is that of the
# Moon's centre as a lander, 6 ms longer.
SAME_RAD = 1e-7


@pytest.fixture(scope="module")
def model():
    return radioloc.measurements.PhysicalModel.build().without("troposphere")


@pytest.fixture(scope="module")
def orbiter(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("orbiter") / "orbiter.bsp"
    return Trajectory.open(write_states(path, low_lunar_orbit(model.ephemeris)), ORBITER)


def test_a_lander_as_a_spacecraft_has_the_same_elevations(model, tmp_path):
    path = write_states(tmp_path / "lander.bsp", lander(model.libration, APOLLO15_PA_M), step_s=600.0)
    tt = tai_to_tt(epochs_tai(20, 30.0))
    fixed, moving = (
        elevations(model, target, ["KASHI", "JIAMUSI"], tt)
        for target in (APOLLO15_PA_M, Trajectory.open(path, ORBITER))
    )
    assert np.abs(fixed.at_station_rad - moving.at_station_rad).max() < SAME_RAD
    assert np.abs(fixed.at_target_rad - moving.at_target_rad).max() < SAME_RAD


def test_windows_end_where_the_moon_hides_it(model, orbiter):
    """Inside a window the arc has nothing against an observation, outside it says that the Moon is in the way."""
    found = windows(model, orbiter, ["KASHI"], *HOURS, Masks(station_deg=0.0))
    assert len(found) >= 5
    # The window is of one signal down; the round trip needs the same at its sending, 2.6 s before.
    for window in found[1:-1]:
        utc = radioloc.time.epochs_from_strings([window.start_utc, window.stop_utc], "UTC")
        tai = radioloc.time.utc_to_tai(utc)[[0, 0, 1, 1]].shifted([-4.0, 4.0, -4.0, 4.0])
        predictor = ExactPredictor(model, tracking("KASHI>x>KASHI", tai), orbiter)
        problem = reasons(predictor, predictor.compute())[1]
        behind = "behind the Moon as seen from KASHI"
        assert problem.tolist() == [behind, "", "", behind]


def test_the_earth_hides_a_spacecraft_but_a_moon_beyond_does_not(model, tmp_path):
    states = circular(1.0e8, model.ephemeris.constants.gm_earth_m3_s2, inclination_deg=20.0)
    path = write_states(tmp_path / "high.bsp", states, center=399, step_s=600.0)
    tt = tai_to_tt(epochs_tai(200, 30.0))
    assert (elevations(model, Trajectory.open(path, ORBITER), ["KASHI"], tt).at_target_rad > 0.1).all()


def test_a_simulated_world_is_what_the_arc_predicts(model, orbiter):
    schedule = Schedule(
        [
            Session("range", two_way("KASHI"), *HOURS, step_s=120.0, sigma_m=0.5),
            Session("doppler", two_way("KASHI"), *HOURS, step_s=300.0, sigma_m=0.01, count_s=60.0),
        ]
    )
    truth = Truth(range_bias_m={"KASHI": 3.0}, clock_s={"KASHI": 1e-6})
    noise = NoiseModel(link={"range": Noise(white_m=0.5), "doppler": Noise(white_m=0.01)})
    made = simulate(schedule, orbiter, truth, noise, model=model, seed=4, name="orbiter")
    again = ExactPredictor(model, made.observations, orbiter).compute()
    assert again.usable.all()
    left_m = made.observations.value_m - made.noise_m - sum(made.added_m.values()) - again.value_m
    assert np.abs(left_m).max() < 1e-6
    # The clock's microsecond moves the tags by 2 mm of the range rate.
    np.testing.assert_allclose(made.added_m["clock"], -1e-6 * again.by_time_m_s, rtol=1e-9, atol=1e-12)
    assert "true trajectory: body -85 of orbiter.bsp" in made.summary()
    assert set(made.added_m) == {"clock", "range_bias"}
