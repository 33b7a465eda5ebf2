"""Simulated tracking of a spacecraft: visibility, and agreement with the prediction of its model."""

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, epochs_tai
from spk_files import ORBITER, lander, low_lunar_orbit, tracking, write_states

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

# The horizon of a spacecraft is the sphere of 1737.4 km, 1.9 km above this lander; the light time of a lander is that
# of the centre of the Moon, 6 ms longer.
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


def test_observations_outside_the_windows_are_behind_the_moon(model, orbiter):
    intervals = windows(model, orbiter, ["KASHI"], *HOURS, Masks(station_deg=0.0))
    assert len(intervals) >= 5
    # A window is that of the downlink; a round trip begins 2.6 s earlier.
    for window in intervals[1:-1]:
        utc = radioloc.time.epochs_from_strings([window.start_utc, window.stop_utc], "UTC")
        tai = radioloc.time.utc_to_tai(utc)[[0, 0, 1, 1]].shifted([-4.0, 4.0, -4.0, 4.0])
        predictor = ExactPredictor(model, tracking("KASHI>x>KASHI", tai), orbiter)
        problem = reasons(predictor, predictor.compute())[1]
        behind = "behind the Moon as seen from KASHI"
        assert problem.tolist() == [behind, "", "", behind]


def test_simulated_values_without_noise_are_those_of_the_predictor(model, orbiter):
    schedule = Schedule(
        [
            Session("range", two_way("KASHI"), *HOURS, step_s=120.0, sigma_m=0.5),
            Session("doppler", two_way("KASHI"), *HOURS, step_s=300.0, sigma_m=0.01, count_s=60.0),
        ]
    )
    truth = Truth(range_bias_m={"KASHI": 3.0}, clock_s={"KASHI": 1e-6})
    noise = NoiseModel(link={"range": Noise(white_m=0.5), "doppler": Noise(white_m=0.01)})
    simulated = simulate(schedule, orbiter, truth, noise, model=model, seed=4, name="orbiter")
    predicted = ExactPredictor(model, simulated.observations, orbiter).compute()
    assert predicted.usable.all()
    difference_m = (
        simulated.observations.value_m
        - simulated.noise_m
        - sum(simulated.added_m.values())
        - predicted.value_m
    )
    assert np.abs(difference_m).max() < 1e-6
    # A clock error of a microsecond shifts the time tags.
    np.testing.assert_allclose(
        simulated.added_m["clock"], -1e-6 * predicted.by_time_m_s, rtol=1e-9, atol=1e-12
    )
    assert "true trajectory: body -85 of orbiter.bsp" in simulated.summary()
    assert set(simulated.added_m) == {"clock", "range_bias"}
