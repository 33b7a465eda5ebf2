"""Fits of noise-free data recover the position to a millimetre from starts 20 km away."""

import dataclasses

import numpy as np
import pytest
from quick import some

from radioloc.constants import C_M_S
from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.jobs.problem import observation_model
from radioloc.jobs.study_targets import surface_points
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import EquipmentDelays, ExactPredictor, FixedPoint, PhysicalModel, StationDelay
from radioloc.measurements.observations import RANGE as RANGES
from radioloc.simulation import Masks, Scenario, Schedule, Session, all_ranges, baselines, two_way
from radioloc.study.study import EstimateChoice
from radioloc.time import utc_to_tai

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
    start_m = world.target_pa_m + START_OFFSET_M * direction / np.linalg.norm(direction)
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
    return float(np.linalg.norm(fit.x - world.target_pa_m))


QUICK_SITES = (0, 5, 11)  # middle of the near side, Chang'e-5 lander, limb in the south-west


@pytest.mark.parametrize(
    ("mix", "number"),
    some([(mix, k) for mix in MIXES for k in range(20)], zip(MIXES, 2 * QUICK_SITES, strict=True)),
)
def test_position_is_recovered(mix, number, full_model):
    longitude_deg, latitude_deg = sites()[number]
    assert recovered_error_m(MIXES[mix], longitude_deg, latitude_deg, full_model, seed=number) < TOLERANCE_M


DELAYS = EquipmentDelays(1.2e-6, {name: StationDelay(3e-8, 2e-8) for name in (*RANGERS, *VLBI)})
HOLD_ERROR_S = 2e-8  # of the transponder delay in the model
WITH_RANGES = [mix for mix, sessions in MIXES.items() if RANGE in sessions]


def passes_of(arc):
    """Return the name of the range bias of each range, by passes separated by gaps of four hours."""
    since_s = utc_to_tai(arc.observations.epoch).seconds_since(utc_to_tai(arc.observations.epoch[:1]))
    names = np.full(len(since_s), "", dtype=object)
    ranges = arc.observations.kind == RANGES
    for station in set(arc.receivers[ranges].tolist()):
        rows = np.flatnonzero(ranges & (arc.receivers == station))
        number = 0
        last_s = -np.inf
        for row in rows[np.argsort(since_s[rows], kind="stable")]:
            number += bool(since_s[row] - last_s > 4 * 3600.0)
            last_s = since_s[row]
            names[row] = f"range_bias.{arc.stations[station]} {number}"
    return names


def recovered_with_equipment(sessions, longitude_deg, latitude_deg, model, seed):
    """Return errors of the position, of the biases of passes, and of the transponder delay as a distance, m.

    The mean of all biases is correlated with the transponder delay, so one pass is calibrated, to 0.1 mm. The delay is
    also correlated with the distance of the point; its a-priori sigma of 3 km makes its a-priori error of 6 m of path
    negligible.
    """
    model = dataclasses.replace(model, delays=DELAYS)
    real = dataclasses.replace(model, delays=dataclasses.replace(DELAYS, transponder_s=1.2e-6 + HOLD_ERROR_S))
    target = LunarPosition.from_selenographic(longitude_deg, latitude_deg, -2000.0)
    world = Scenario(Schedule(sessions, MASKS), target).world(real)
    observations = world.draw().observations
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    start_m = world.target_pa_m + START_OFFSET_M * direction / np.linalg.norm(direction)
    arc = ExactPredictor(model, observations, FixedPoint(start_m))
    passes = passes_of(arc)
    names = sorted(set(passes) - {""})
    bias_m = dict(zip(names, 10.0 * rng.normal(size=len(names)), strict=True)) | {"": 0.0}
    observed_m = observations.value_m + np.array([bias_m[name] for name in passes])

    choice = EstimateChoice(
        range_bias="all", range_bias_per="pass", transponder_delay=True, transponder_delay_sigma_s=1e-5
    )
    start = LunarPosition(model.libration.frame, start_m)
    problem = observation_model(arc, surface_points({"": start}, model, choice), choice)
    parameters = problem.parameters
    assert [p.name for p in parameters if p.kind == "range_bias"] == sorted(names)
    parameters = parameters.changed(names[0], prior_value=bias_m[names[0]], prior_sigma=1e-4)

    def residuals(x):
        residual_m, partials = problem.residuals(x)
        return residual_m + (observed_m - observations.value_m), partials

    fit = fit_least_squares(residuals, parameters, observations.sigma_m)
    assert fit.converged, fit.status
    estimates = dict(zip(parameters.names, fit.x, strict=True))
    return (
        float(np.linalg.norm(problem.position_pa_m(fit.x) - world.target_pa_m)),
        max(abs(estimates[name] - bias_m[name]) for name in names),
        0.5 * C_M_S * abs(estimates["transponder_delay"] - HOLD_ERROR_S),
    )


@pytest.mark.parametrize(
    ("mix", "number"),
    some([(mix, k) for mix in WITH_RANGES for k in range(20)], zip(WITH_RANGES, QUICK_SITES, strict=True)),
)
def test_biases_of_passes_and_transponder_delay_are_recovered(mix, number, full_model):
    longitude_deg, latitude_deg = sites()[number]
    errors_m = recovered_with_equipment(MIXES[mix], longitude_deg, latitude_deg, full_model, seed=number)
    assert max(errors_m) < TOLERANCE_M
