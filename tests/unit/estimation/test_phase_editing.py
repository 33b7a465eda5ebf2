"""Cycle slips and counts that were not locked to the uplink: found, left out, and called by their name."""

from dataclasses import replace

import numpy as np
import pytest
from change5_case import LANDER, NEAR

import radioloc
from radioloc import Study
from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.phase_editing import PhaseCounts, phase_faults
from radioloc.estimation.series import SeriesOrder
from radioloc.measurements import PhysicalModel
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, Truth, two_way
from radioloc.study import EstimateChoice

CYCLE_M = 299792458.0 / 2.27e9  # S band
NOISE_M = 0.001
N = 300


def faults(error_m, *, stated_m=NOISE_M, count_s=1.0, cycle_m=CYCLE_M, time_s=None):
    """Reasons for counts of one link that have noise of 1 mm, errors, and an offset that is estimated."""
    observed_m = 5.0 + NOISE_M * np.random.default_rng(1).normal(size=N) + error_m
    design = np.ones((N, 1))
    parameters = ParameterSet([Parameter("offset", "m", "bias")])
    edited = fit_with_editing(lambda x: (observed_m - design @ x, design), parameters, stated_m)
    time_s = count_s * np.arange(N) if time_s is None else time_s
    order = SeriesOrder.from_labels(
        Labels.from_texts(["doppler"] * N), Labels.from_texts(["A>x>A"] * N), time_s
    )
    result = phase_faults(edited, order, PhaseCounts(np.full(N, count_s), np.full(N, 1e6 * cycle_m)))
    return edited, result


def errors(**at):
    error_m = np.zeros(N)
    for row, size in at.items():
        error_m[int(row[1:])] = size
    return error_m


@pytest.mark.parametrize("count_s", [1.0, 60.0])
def test_whole_cycles_in_one_count_are_a_slip_however_long_it_is(count_s):
    edited, result = faults(errors(r50=3 * CYCLE_M, r51=-CYCLE_M, r200=-CYCLE_M), count_s=count_s)
    assert result == {50: "cycle slip of 3 cycles", 51: "cycle slip of 1 cycle", 200: "cycle slip of 1 cycle"}
    assert not edited.fit.used[[50, 51, 200]].any()


def test_an_outlier_that_is_no_whole_number_of_cycles_is_none():
    edited, result = faults(errors(r50=2.4 * CYCLE_M))
    assert not result
    assert not edited.fit.used[50]
    assert edited.status[50].startswith("outlier")


def test_a_slip_is_told_by_the_scatter_of_its_pass_where_the_stated_sigma_hides_it():
    edited, result = faults(errors(r50=CYCLE_M), stated_m=0.05)
    assert edited.fit.used[50]
    assert result == {50: "cycle slip of 1 cycle"}


def test_nothing_is_called_a_slip_where_noise_is_no_small_part_of_a_cycle():
    assert not faults(errors(r50=0.05), cycle_m=0.01)[1]


def test_seconds_before_the_lock_are_off_in_frequency():
    error_m = errors()
    error_m[:40] = -8.8e3 * CYCLE_M
    edited, result = faults(error_m)
    assert result == dict.fromkeys(range(40), "not locked to the uplink: 8.8 kHz off")
    assert not edited.fit.used[:40].any()


def test_another_transmitter_for_a_while_is_not_this_uplink():
    error_m = errors()
    error_m[100:140] = np.linspace(110.0, 130.0, 40) * CYCLE_M * 10.0
    _, result = faults(error_m, count_s=10.0)
    assert result == dict.fromkeys(range(100, 140), "not locked to this uplink for a while: 120 Hz off")


def test_errors_near_the_horizon_are_outliers_of_another_kind():
    error_m = errors()
    error_m[:5] = 12.0 * NOISE_M
    edited, result = faults(error_m)
    assert not result
    assert not edited.fit.used[:5].any()


def test_after_a_silence_the_lock_is_a_new_one():
    error_m = errors(r100=200.5 * CYCLE_M)
    time_s = np.arange(float(N)) + 1000.0 * (np.arange(N) >= 100)
    _, result = faults(error_m, time_s=time_s)
    assert result == {100: "not locked to the uplink: 200 Hz off"}


def test_without_a_wavelength_it_is_a_rate():
    error_m = errors()
    error_m[-5:] = 3.0
    _, result = faults(error_m, cycle_m=np.nan)
    assert result == dict.fromkeys(range(N - 5, N), "not locked to the uplink: 3 m/s off")


@pytest.fixture(scope="module")
def tracking():
    """Three passes of S band, 3000 counts of 1 s, and ranges."""
    radio = {"count_s": 1.0, "wavelength_um": 1e6 * CYCLE_M, "uplink_hz": 2.1e9}
    day = "2020-12-01T"
    sessions = [
        Session("doppler", two_way("KUNMING"), f"{day}{h}:00:00", f"{day}{h}:16:39", 1.0, NOISE_M, **radio)
        for h in (15, 19, 23)
    ]
    ranges = Session("range", two_way("KUNMING", "SESHAN25"), f"{day}15:00:00", f"{day}23:30:00", 600.0, 1.0)
    noise = NoiseModel({"doppler": Noise(white_m=NOISE_M), "range": Noise(white_m=1.0)})
    scenario = Scenario(Schedule([*sessions, ranges]), LANDER, Truth(), noise, seed=1)
    world = scenario.world(PhysicalModel.build())
    return world.draw().observations, world.targets[0].position_pa_m


@pytest.mark.study
def test_forty_counts_before_the_lock_and_slips_leave_the_position_as_it_is(tracking):
    observations, truth_pa_m = tracking
    counts = np.flatnonzero(observations.types() == "doppler")
    value_m = observations.value_m.copy()
    value_m[counts[1000:1040]] -= 8.8e3 * CYCLE_M
    value_m[counts[300]] += 3.0 * CYCLE_M
    study = Study(target=NEAR, estimate=EstimateChoice())
    solution = radioloc.locate(study, replace(observations, value_m=value_m))
    assert solution.converged
    status = solution.residuals.status
    assert set(status[counts[1000:1040]]) == {"not locked to the uplink: 8.8 kHz off"}
    assert status[counts[300]] == "cycle slip of 3 cycles"
    assert int((~solution.residuals.used).sum()) == 41
    left_out = "2020-12-01T19:00:00 and 39 more KUNMING doppler: not locked to the uplink: 8.8 kHz off"
    assert left_out in " ".join(str(solution).split())
    error_m = solution.position_pa_m - truth_pa_m
    covariance_m2 = solution.position_covariance("pa")
    assert np.sqrt(error_m @ np.linalg.solve(covariance_m2, error_m)) < 3.37  # 99 %
