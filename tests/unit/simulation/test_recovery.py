"""Fits of noise-free data recover the position to a millimetre from starts 20 km away."""

import numpy as np
import pytest
from quick import some

from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.simulation import Masks, Scenario, Schedule, Session, all_ranges, baselines, two_way

TOLERANCE_M = 1e-3
START_OFFSET_M = 20e3
START, STOP = "2020-12-01T15:11", "2020-12-03T15:10"
RANGERS, VLBI = ("JIAMUSI", "KASHI", "NEUQUEN"), ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
# At the limb the Earth may be below the horizon.
MASKS = Masks(10.0, target_deg=-90.0)
RADIO = {"uplink_hz": 7.2e9, "wavelength_um": 35394.6}
RANGE = Session("range", all_ranges(*RANGERS), START, STOP, 1200.0, 1e-3, one_uplink=True, **RADIO)
DELAY = Session("vlbi_delay", baselines(*VLBI), START, STOP, 1200.0, 1e-3, **RADIO)
# The libration angle is rounded to 2 micrometres on the surface. The change of a range over a quarter of an hour
# depends on the distance of the point by 0.2 mm per metre, which magnifies the rounding; over two hours 0.4 mm remain.
DOPPLER = Session(
    "doppler", all_ranges(*RANGERS), START, STOP, 600.0, 1e-3, one_uplink=True, count_s=7200.0, **RADIO
)
TWO_WAY_DOPPLER = Session("doppler", two_way("KASHI"), START, STOP, 1200.0, 1e-3, count_s=900.0, **RADIO)
DELAY_RATE = Session("vlbi_delay_rate", baselines(*VLBI), START, STOP, 1200.0, 1e-3, count_s=7200.0, **RADIO)
MIXES = {
    "range": [RANGE],
    "vlbi": [DELAY],
    "range and vlbi": [RANGE, DELAY],
    "doppler": [DOPPLER],
    "vlbi rates": [DELAY_RATE],
    "all": [RANGE, DELAY, TWO_WAY_DOPPLER, DELAY_RATE],
}


@pytest.fixture(scope="module")
def full_model():
    """Model with troposphere."""
    return PhysicalModel.build()


def sites():
    """Return twenty places on the near side and the limb, with the poles and the Chang'e-5 lander."""
    limb = [(90.0, 0.0), (-90.0, 0.0), (0.0, 90.0), (0.0, -90.0), (90.0, 60.0), (-88.0, -60.0), (85.0, 30.0)]
    near_side = [(0.0, 0.0), (60.0, 0.0), (-60.0, 0.0), (0.0, 60.0), (0.0, -60.0), (-51.9162, 43.0584)]
    spiral = [(-70.0 + 20.0 * k, 50.0 * np.sin(2.0 * k)) for k in range(7)]
    return [(float(lon), float(lat)) for lon, lat in (*near_side, *limb, *spiral)]


def recovered_error_m(sessions, longitude_deg, latitude_deg, model, seed):
    target = LunarPosition.from_selenographic(longitude_deg, latitude_deg, -2000.0)
    world = Scenario(Schedule(sessions, MASKS), target).world(model)
    observations = world.draw().observations
    direction = np.random.default_rng(seed).normal(size=3)
    start_m = world.targets[0].position_pa_m + START_OFFSET_M * direction / np.linalg.norm(direction)
    arc = ExactPredictor(model, observations, FixedPoint(start_m))

    def residuals(x):
        computed = arc.compute(FixedPoint(x))
        return observations.value_m - computed.value_m, computed.by_position_pa

    parameters = ParameterSet(
        [
            Parameter(f"position.{axis}", "m", "position", float(value))
            for axis, value in zip("xyz", start_m, strict=True)
        ]
    )
    fit = fit_least_squares(residuals, parameters, observations.sigma_m)
    assert fit.converged, fit.status
    return float(np.linalg.norm(fit.x - world.targets[0].position_pa_m))


QUICK_SITES = (0, 5, 11)  # middle of the near side, Chang'e-5 lander, limb in the south-west


@pytest.mark.parametrize(
    ("mix", "number"),
    some([(mix, k) for mix in MIXES for k in range(20)], zip(MIXES, 2 * QUICK_SITES, strict=True)),
)
def test_position_is_recovered(mix, number, full_model):
    longitude_deg, latitude_deg = sites()[number]
    assert recovered_error_m(MIXES[mix], longitude_deg, latitude_deg, full_model, seed=number) < TOLERANCE_M
