"""Without noise the position comes back to a millimetre, from 20 km off, wherever the lander and whatever the data."""

import numpy as np
import pytest

from radioloc.estimation import Parameter, ParameterSet, fit_least_squares
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.tracking_arc import TrackingArc
from radioloc.simulation import Masks, Schedule, Session, World, all_ranges, baselines, two_way

TOLERANCE_M = 1e-3
START_OFF_M = 20e3
START, STOP = "2020-12-01T15:11", "2020-12-03T15:10"
RANGERS, VLBI = ("JIAMUSI", "KASHI", "NEUQUEN"), ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
# At the limb the Earth may be below the horizon; the equations do not mind.
MASKS = Masks(10.0, target_deg=-90.0)
RADIO = {"uplink_hz": 7.2e9, "wavelength_um": 35394.6}
RANGE = Session("range", all_ranges(*RANGERS), START, STOP, 1200.0, 1e-3, one_uplink=True, **RADIO)
DELAY = Session("vlbi_delay", baselines(*VLBI), START, STOP, 1200.0, 1e-3, **RADIO)
# The libration angle is rounded to 2 micrometres on the surface. In a range that is nothing, but the growth of a range
# over a quarter of an hour feels the distance of the point by 0.2 mm for a metre. Two hours leave 0.4 mm.
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
def whole_model():
    """The troposphere too."""
    return PhysicalModel.build()


def sites():
    """Twenty places: near side and limb, poles among them, and the Chang'e-5 lander."""
    limb = [(90.0, 0.0), (-90.0, 0.0), (0.0, 90.0), (0.0, -90.0), (90.0, 60.0), (-88.0, -60.0), (85.0, 30.0)]
    near = [(0.0, 0.0), (60.0, 0.0), (-60.0, 0.0), (0.0, 60.0), (0.0, -60.0), (-51.9162, 43.0584)]
    spiral = [(-70.0 + 20.0 * k, 50.0 * np.sin(2.0 * k)) for k in range(7)]
    return [(float(lon), float(lat)) for lon, lat in (*near, *limb, *spiral)]


def recovered_error_m(sessions, longitude_deg, latitude_deg, model, seed):
    target = LunarPosition.from_selenographic(longitude_deg, latitude_deg, -2000.0)
    world = World.prepare(Schedule(sessions, MASKS), target, model=model)
    observations = world.draw().observations
    away = np.random.default_rng(seed).normal(size=3)
    start_m = world.target_pa_m + START_OFF_M * away / np.linalg.norm(away)
    arc = TrackingArc(model, observations, start_m)

    def residuals(x):
        computed = arc.compute(x)
        return observations.value_m - computed.value_m, computed.by_position_pa

    parameters = ParameterSet(
        [
            Parameter(f"position.{axis}", "m", "position", float(value))
            for axis, value in zip("xyz", start_m, strict=True)
        ]
    )
    fit = fit_least_squares(residuals, parameters, observations.sigma_m)
    assert fit.converged, fit.status
    return float(np.linalg.norm(fit.x - world.target_pa_m))


def test_there_are_twenty_different_sites():
    assert len(set(sites())) == 20


@pytest.mark.parametrize("mix", MIXES)
@pytest.mark.parametrize("site", [(0.0, 0.0), (-51.9162, 43.0584), (88.0, -60.0)])
def test_the_position_comes_back(mix, site, whole_model):
    assert recovered_error_m(MIXES[mix], *site, whole_model, seed=1) < TOLERANCE_M


@pytest.mark.slow
@pytest.mark.parametrize("mix", MIXES)
@pytest.mark.parametrize("number", range(20))
def test_the_position_comes_back_everywhere(mix, number, whole_model):
    longitude_deg, latitude_deg = sites()[number]
    assert recovered_error_m(MIXES[mix], longitude_deg, latitude_deg, whole_model, seed=number) < TOLERANCE_M
