"""Predictions for a spacecraft as the target."""

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15, APOLLO15_PA_M, epochs_tai
from spk_files import ORBITER, START_S, circular, lander, low_lunar_orbit, tracking, write_states

from radioloc.constants import C_M_S
from radioloc.ephemeris import Trajectory
from radioloc.errors import CoverageError, InputError
from radioloc.measurements import (
    EquipmentDelays,
    ExactPredictor,
    PhysicalModel,
    TrajectoryMotion,
    prepare_predictor,
)
from radioloc.measurements.predictor import reasons

# States in km are rounded to 4e-10 m, and what SPICE's epoch loses is made up for; a round trip of 8e8 m is rounded to
# 1.2e-7 m, some times over.
SAME_M = 2e-6

# Central differences over 100 m of round trips rounded to 1.2e-7 m (2e-9), and what the analytic partials leave out:
# how the gravitational delay changes along with the place, by 1e-7 at most beside the Moon.
PARTIAL = 2e-7

# As for a lander: by the time tag the analytic partials leave out how the delays change, 4e-5 m/s.
BY_TIME_M_S = 2e-4


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build().without("troposphere")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("spk")


@pytest.fixture(scope="module")
def orbiter(model, folder):
    return Trajectory.open(write_states(folder / "orbiter.bsp", low_lunar_orbit(model.ephemeris)), ORBITER)


@pytest.mark.parametrize(
    ("path", "tag", "kind"),
    [
        ("KASHI>x>KASHI", "transmit", "range"),
        ("KASHI>x>JIAMUSI", "receive", "range"),
        ("KASHI>x>JIAMUSI", "bounce", "range"),
        ("KASHI<x>JIAMUSI", "receive", "vlbi_delay"),
        ("KASHI>x>JIAMUSI", "receive", "doppler"),
    ],
)
def test_lander_written_as_a_trajectory_gives_the_same_ranges(model, tmp_path, path, tag, kind):
    table = tracking(path, epochs_tai(20, 30.0), tag, kind)
    surface = model.without("lunar_tide", "lunar_scale", "lunar_lorentz")
    fixed = ExactPredictor(surface, table, APOLLO15).compute()
    file = write_states(tmp_path / "lander.bsp", lander(model.libration, APOLLO15_PA_M), step_s=600.0)
    # All terms are on here: those of a lander have no part in a trajectory.
    moving = ExactPredictor(model, table, Trajectory.open(file, ORBITER)).compute()
    assert np.abs(moving.value_m - fixed.value_m).max() < SAME_M
    assert np.abs(moving.by_position_pa - fixed.by_position_pa).max() < 1e-12
    assert np.abs(moving.by_time_m_s - fixed.by_time_m_s).max() < 1e-7
    assert np.abs(moving.elevation_rad - fixed.elevation_rad).max() < 1e-12
    assert (moving.status == fixed.status).all()


def test_partials_by_an_offset_from_the_trajectory(model, orbiter):
    arc = ExactPredictor(model, tracking("KASHI>x>JIAMUSI", epochs_tai(60, 30.0)), orbiter)
    partials = arc.compute().by_position_pa
    for axis, step_m in enumerate(100.0 * np.eye(3)):
        late_m, early_m = (
            arc.compute(TrajectoryMotion(orbiter, sign * step_m)).value_m for sign in (1.0, -1.0)
        )
        difference = (late_m - early_m) / 200.0
        assert np.abs(difference - partials[:, axis]).max() < PARTIAL


def test_partial_by_the_time_tag_is_the_range_rate(model, orbiter):
    tai, step_s = epochs_tai(60, 30.0), 0.05
    early, middle, late = (
        ExactPredictor(model, tracking("KASHI>x>KASHI", tai.shifted(s)), orbiter).compute()
        for s in (-step_s, 0.0, step_s)
    )
    assert np.abs(middle.by_time_m_s).max() > 2000.0
    rate_m_s = (late.value_m - early.value_m) / (2.0 * step_s)
    assert np.abs(rate_m_s - middle.by_time_m_s).max() < BY_TIME_M_S


def test_reasons_name_the_moon_and_the_horizon(model, orbiter):
    table = tracking("KASHI>x>JIAMUSI", epochs_tai(300, 20.0))
    predictor = ExactPredictor(model, table, orbiter)
    problem = reasons(predictor, predictor.compute())[1]
    hidden = np.char.startswith(problem, "behind the Moon as seen from KASHI")
    below_horizon = np.char.startswith(problem, "below the horizon")
    assert (hidden | below_horizon | (problem == "")).all()
    # With the Earth in the plane of an orbit at 100 km, 71 of 180 degrees are behind the Moon; the time above the
    # horizon begins and ends with a hidden part.
    assert 0.3 < hidden.sum() / (~below_horizon).sum() < 0.5


def test_epochs_outside_the_trajectory_name_file_and_span(model, folder, orbiter):
    late = tracking("KASHI>x>KASHI", epochs_tai(3, 60.0))
    with pytest.raises(CoverageError, match=r"orbiter\.bsp \(.*-85\).*2020-12-02.*2020-12-03T12"):
        ExactPredictor(model, late, orbiter)
    spans = ((START_S, START_S + 3600.0), (START_S + 7200.0, START_S + 36000.0))
    file = write_states(folder / "gap.bsp", low_lunar_orbit(model.ephemeris), spans_s=spans)
    in_gap = tracking("KASHI>x>KASHI", epochs_tai(2, 1.0).shifted(1800.0))
    with pytest.raises(CoverageError, match=r"\(2020-12-02.*2020-12-02T01:00:00, 2020-12-02T02:00"):
        ExactPredictor(model, in_gap, Trajectory.open(file, ORBITER))


def test_predictions_of_a_trajectory_are_never_interpolated(model, orbiter):
    table = tracking("KASHI>x>KASHI", epochs_tai(3, 30.0))
    with pytest.raises(InputError, match="for a spacecraft"):
        prepare_predictor(model, table, orbiter, "interpolated")


def test_distances_beyond_the_light_path(model, folder):
    states = circular(3.0e10, model.ephemeris.constants.gm_earth_m3_s2)
    file = write_states(folder / "far.bsp", states, center=399, step_s=3600.0)
    table = tracking("KASHI>x>KASHI", epochs_tai(2, 1.0))
    with pytest.raises(InputError, match=r"got 30\.0 million km"):
        ExactPredictor(model, table, Trajectory.open(file, ORBITER))


def test_orbiter_moves_during_the_transponder_delay(model, orbiter):
    """The partial by the transponder delay includes the motion of the orbiter, 1.6 m in a delay of 1 ms."""
    table = tracking("KASHI>x>JIAMUSI", epochs_tai(60, 30.0))
    hold_s = 1e-3
    # The partial leaves out the change of TDB - TT during the delay, 4e-10 of 300 km.
    model = model.without("tdb_tt")
    plain = ExactPredictor(model, table, orbiter).compute()
    delayed_model = dataclasses.replace(model, delays=EquipmentDelays(transponder_s=hold_s))
    delayed = ExactPredictor(delayed_model, table, orbiter).compute()
    added_m = delayed.value_m - plain.value_m
    assert np.abs(added_m - C_M_S * hold_s).max() > 1.0
    # Second order: the acceleration of both ends over 1 ms, 1e-6 m each, and the change of media and gravity.
    assert np.abs(added_m - plain.by_transponder_delay_m_s * hold_s).max() < 1e-5
