"""Simulated tracking of a spacecraft: visibility, and agreement with the prediction of its model."""

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, epochs_tai
from spk_files import ORBITER, lander, low_lunar_orbit, tracking, write_states

import radioloc
from radioloc.ephemeris import Trajectory
from radioloc.measurements import ExactPredictor, FixedPoint
from radioloc.measurements.predictor import reasons
from radioloc.simulation import Masks, elevations, windows
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
        for target in (FixedPoint(APOLLO15_PA_M), Trajectory.open(path, ORBITER))
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
