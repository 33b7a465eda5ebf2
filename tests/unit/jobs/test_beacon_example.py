"""The example of amateurs' Doppler: its files are what its script makes; it tells tens of kilometres, and no height."""

import runpy
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc.constants import C_M_S

EXAMPLE = EXAMPLES / "beacon"
# Three decimals in the files.
ROUNDED_HZ = 2e-3
# Revised Earth orientation would turn the stations by some centimetres.
REVISED_HZ = 1e-3
# Sigmas in metres follow the nominal frequency, by 1.8e-4.
WEIGHTS_M = 1.0


@pytest.fixture(scope="module")
def script():
    return SimpleNamespace(**runpy.run_path(EXAMPLE / "simulate.py"))


@pytest.fixture(scope="module")
def solution():
    return radioloc.locate(EXAMPLE / "beacon.toml")


def test_the_files_are_what_the_script_makes(script, tmp_path):
    script.write(tmp_path)
    shutil.copy(EXAMPLE / "sites.txt", tmp_path)
    shutil.copy(EXAMPLE / "beacon.toml", tmp_path)
    output = radioloc.read_study(EXAMPLE / "beacon.toml").observations.frequencies
    for file in script.FILES.values():
        simulated, shipped = (
            radioloc.read_observations(folder / file, frequencies=output) for folder in (tmp_path, EXAMPLE)
        )
        assert np.array_equal(simulated.epoch.mjd, shipped.epoch.mjd)
        apart_hz = script.BEACON_HZ * np.abs(simulated.value_m - shipped.value_m) / (C_M_S * script.COUNT_S)
        assert apart_hz.max() < ROUNDED_HZ + REVISED_HZ


@pytest.mark.study
def test_tens_of_kilometres(solution):
    assert solution.converged
    assert solution.residuals.used.all()
    [station] = {path for path in solution.residuals.path.tolist() if path.endswith("9001")}
    assert station == "beacon>COSPAR 9001"
    result = solution.to_dict()
    assert result["reference"]["horizontal_m"] < 20e3
    assert 5e3 < result["sigma"]["east_m"] < 20e3
    assert 10e3 < result["sigma"]["north_m"] < 30e3


def test_the_frequency_of_the_beacon_and_the_noise_of_readings(solution, script):
    """One offset for each pass: that of the beacon, which wanders, less that of the receiver's standard."""
    result = [p for p in solution.to_dict()["parameters"] if p["name"].startswith("frequency_offset")]
    assert len(result) == 14
    offsets = np.array([p["value"] for p in result])
    expected = -script.BEACON_OFF_HZ / script.BEACON_HZ
    assert np.abs(offsets - expected).max() < 4.0 * script.RECEIVER
    residual_hz = script.BEACON_HZ * solution.residuals.residual_m / (C_M_S * script.COUNT_S)
    assert script.READING_HZ < np.std(residual_hz) < np.hypot(script.READING_HZ, script.WANDER_HZ)


def test_a_nominal_frequency_that_is_far_off_does_not_move_the_lander(solution):
    """The Doppler shift is that of the frequency that was sent, which the offset of each pass says."""
    study = radioloc.read_study(EXAMPLE / "beacon.toml")
    [sent] = study.observations.frequencies
    wrong = replace(sent, transmit_hz=sent.transmit_hz + 1.5e6)
    result = radioloc.locate(replace(study, observations=replace(study.observations, frequencies=[wrong])))
    assert result.converged
    assert np.linalg.norm(result.position_pa_m - solution.position_pa_m) < WEIGHTS_M
