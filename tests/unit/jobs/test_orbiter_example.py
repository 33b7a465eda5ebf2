"""The example with a low lunar orbiter: its files are what its script makes, its study finds what was put in."""

import runpy
from types import SimpleNamespace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc

EXAMPLE = EXAMPLES / "orbiter"

# Sines of one machine and another.
ROUNDED_KM = 1e-9
# Revised Earth orientation would move the stations by some centimetres.
REVISED_M = 0.1


@pytest.fixture(scope="module")
def script():
    return SimpleNamespace(**runpy.run_path(EXAMPLE / "simulate.py"))


def test_the_files_are_what_the_script_makes(script, tmp_path):
    script.main(tmp_path)
    simulated, shipped = (
        radioloc.read_observations(folder / "tracking.csv") for folder in (tmp_path, EXAMPLE)
    )
    assert np.array_equal(simulated.epoch.mjd, shipped.epoch.mjd)
    assert np.abs(simulated.value_m - shipped.value_m).max() < REVISED_M
    source = radioloc.ephemeris.Trajectory.open(EXAMPLE / "orbiter.bsp", script.BODY)
    et_s = np.arange(script.FIRST_S, script.LAST_S, 7.0 * script.STEP_S)
    states = source.states(et_s, source.segment_indices(et_s))
    assert np.abs(states - script.states_km(et_s)).max() < ROUNDED_KM


def test_the_bias_is_found(script):
    solution = radioloc.locate(radioloc.read_study(EXAMPLE / "orbiter.toml"))
    value_m, sigma_m = solution.biases()["JIAMUSI"]
    assert solution.converged
    assert abs(value_m - script.BIAS_M) < 3.0 * sigma_m
    assert sigma_m < 0.1
    assert solution.residuals.used.sum() == 140
