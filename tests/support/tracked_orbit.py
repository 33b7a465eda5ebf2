"""Doppler of a low polar lunar orbit by two stations."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at
from low_orbit import EPOCH
from paths import LARGE_DATA

from radioloc.measurements import ExactPredictor
from radioloc.measurements.observations import DOPPLER
from radioloc.study.orbiter import Orbiter

STATE = np.array([575739.0, -463249.0, -1631639.0, -567.864, 1434.223, -600.209])
REAL = LARGE_DATA / "odf"
GRAIL = """
[target]
name = "GRAIL-B"
dynamics = "moon"
epoch = "2012-04-09T04:30:00"
{orbit}
[forces]
radiation_m2_kg = 0.018
[observations]
files = ["{files}/*.odf"]
types = ["doppler"]
doppler_average_s = 10
hours = {hours}
[consider]
defaults = false
"""
OFF = (300.0, -200.0, 100.0, 0.3, -0.2, 0.1)
"""Errors of a-priori states."""
FIRST_PASS_S = np.arange(1200.0, 5000.0, 60.0)
PASSES_S = np.concatenate([FIRST_PASS_S, np.arange(7200.0, 12000.0, 60.0)])


def craft(state, forces, gravity_errors=0, **fields):
    return Orbiter(
        EPOCH, tuple(state[:3]), tuple(state[3:]), forces, "craft", gravity_errors=gravity_errors, **fields
    )


def tracked(model, forces, sigma_m, seconds=PASSES_S, state=STATE, seed=20120409, handover_s=6000.0):
    """Return counts of 60 s with noise, whether each is usable, and the orbit."""
    tdb = EPOCH.shifted(seconds)
    empty = observed_at(
        tdb,
        ["DSS-24>craft>DSS-24", "DSS-65>craft>DSS-65"],
        link=(seconds < handover_s).astype(int),
        kind=DOPPLER,
        sigma_m=sigma_m,
        count_s=60.0,
        wavelength_um=3.6e4,
    )
    orbit = craft(state, forces).orbit(model, empty, ())
    computed = ExactPredictor(model, empty, orbit).compute()
    noise_m = sigma_m * np.random.default_rng(seed).normal(size=len(seconds))
    return replace(empty, value_m=computed.value_m + noise_m), computed.usable, orbit


def grail_study(folder, orbit, hours):
    """Write a study of the real Doppler of GRAIL-B, with keys of its orbit."""
    if not REAL.is_dir():
        pytest.skip(f"the real orbit data files are not here ({REAL})")
    (folder / "grail.toml").write_text(GRAIL.format(orbit=orbit, files=REAL, hours=hours))
    return folder / "grail.toml"


def one_way_rms_mm_s(solution):
    used = solution.residuals.used
    return 0.5 * float(np.sqrt(np.mean(solution.residuals.residual_mm_s[used] ** 2)))
