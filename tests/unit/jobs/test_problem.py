"""Partials against central differences, at the poles too, and who owns a bias."""

import numpy as np
import pytest
from arc_cases import observed_at
from quick import each_with_one

import radioloc
from radioloc import LunarPosition
from radioloc.jobs.problem import observation_model
from radioloc.jobs.study_targets import surface_points
from radioloc.measurements import FixedPoint
from radioloc.study import EstimateChoice

PLACES = {
    "apollo15": (3.6, 26.1, -1900.0),
    "north pole": (0.0, 90.0, 500.0),
    "south pole": (123.0, -90.0, -2000.0),
    "shackleton": (-130.0, -89.7, 1500.0),
    "limb": (89.0, 1.0, 0.0),
}
PARTIALS_M = 2e-6
"""Central differences over 100 m: rounding of 1e-7 m over 200 m, times the curvature of the path, per metre."""


def target(place, model):
    return LunarPosition.from_selenographic(*PLACES[place]).to_axes("PA", model.ephemeris.constants)


@pytest.mark.parametrize("form", ["geographic", "cartesian"])
@pytest.mark.parametrize("place", PLACES)
def test_partials_are_the_slopes(place, form, late15, model):
    start = target(place, model)
    sample = late15.select([0, 9, 27])
    arc = radioloc.measurements.ExactPredictor(model, sample, FixedPoint(start.xyz_m))
    choice = EstimateChoice(position=form, range_bias="all", time_bias="all")
    problem = observation_model(arc, surface_points({"": start}, model, choice), choice)
    steps = {"m": 100.0, "s": 1e-3}
    x = problem.parameters.prior_values + np.array([steps[p.unit] / 3.0 for p in problem.parameters])
    x[:2] += 30e3  # away from where the coordinates have their origin
    _, partials = problem.residuals(x)
    for k, parameter in enumerate(problem.parameters):
        step = np.zeros(len(x))
        step[k] = steps[parameter.unit]
        later, earlier = problem.residuals(x + step)[0], problem.residuals(x - step)[0]
        slope = (earlier - later) / (2.0 * step[k])
        assert slope == pytest.approx(
            partials[:, k], abs=PARTIALS_M * (1.0 if parameter.unit == "m" else 1e4)
        )
        position = (problem.position_pa_m(x + step) - problem.position_pa_m(x - step)) / (2.0 * step[k])
        assert position == pytest.approx(problem.position_partials(x)[:, k], abs=1e-8)


POLES = [(0.0, -90.0), (45.0, -89.9), (10.0, 88.5), (88.0, 0.0)]


@pytest.mark.parametrize(("place", "form"), each_with_one(POLES, POLES[::2], ["geographic", "cartesian"]))
def test_lander_near_a_pole_is_found_from_across_the_pole(place, form, apollo15, model):
    lon, lat = place
    truth = LunarPosition.from_selenographic(lon, lat, 1000.0).to_axes("PA", model.ephemeris.constants)
    sample = apollo15.select(slice(None, None, 3))
    predicted_m = (
        radioloc.measurements.ExactPredictor(model, sample, FixedPoint(truth.xyz_m)).compute().value_m
    )
    observations = observed_at(
        sample.epoch,
        sample.links,
        link=sample.link,
        tag=sample.tag,
        value_m=predicted_m,
        sigma_m=0.03,
        pressure_hpa=sample.pressure_hpa,
        temperature_k=sample.temperature_k,
        relative_humidity=sample.relative_humidity,
        wavelength_um=sample.wavelength_um,
    )
    target = LunarPosition.from_selenographic(
        lon + 160.0 * (abs(lat) > 80.0), np.sign(lat) * 88.9 if lat else 1.5, 0.0
    )
    study = radioloc.Study(target=target, estimate=EstimateChoice(position=form))
    solution = radioloc.locate(study, observations)
    assert solution.converged
    assert np.linalg.norm(solution.position_pa_m - truth.xyz_m) < 1e-3
