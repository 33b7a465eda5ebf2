"""Combinations of targets and jobs, as docs/architecture.md lists them: each works, or its message says why not."""

from dataclasses import replace

import numpy as np
import pytest
import several_targets
from paths import ROOT

import radioloc
from radioloc.errors import InputError
from radioloc.parameters.choice import ParameterChoice
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, two_way
from radioloc.study.map_positions import PlaceOnMap
from radioloc.study.orbit_choice import OrbitChoice, ProcessNoise

TARGETS = {
    "surface point": ("lander",),
    "several points": ("lander", "rover"),
    "known trajectory": ("known",),
    "orbit": ("craft",),
    "descent": ("descent",),
    "point and orbit": ("lander", "craft"),
}
START, STOP = "2020-12-01T14:48:00", "2020-12-01T15:10:00"
HOURS = (0.3, 0.5)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return several_targets.scene(tmp_path_factory.mktemp("scene"))


def estimating(scene, names, **fields):
    """Return a study in which something is estimated: of a known trajectory the biases of ranges."""
    estimate = scene.study(*names).estimate
    if names == ("known",):
        estimate = replace(estimate, parameters={"range_bias": ParameterChoice("all")})
    return scene.study(*names, estimate=estimate, **fields)


def simulated(scene, names):
    """Return a study of simulated ranges and Doppler of all targets."""
    sessions = [
        Session(kind, two_way(*several_targets.STATIONS), START, STOP, 120.0, sigma_m, count_s=count_s)
        for kind, sigma_m, count_s in (("range", 1.0, np.nan), ("doppler", 0.01, 60.0))
    ]
    noise = NoiseModel({"range": Noise(white_m=1.0), "doppler": Noise(white_m=0.01)})
    truths = {name: scene.true[name] for name in names}
    return scene.study(*names, simulation=Scenario(Schedule(sessions), truths, noise=noise))


def locate(scene, names):
    solution = radioloc.locate(estimating(scene, names), scene.observations)
    assert solution.converged, solution.message


def residuals(scene, names):
    solution = radioloc.compute_residuals(scene.study(*names), scene.observations)
    assert np.isfinite(solution.residuals.residual_m).all()


def covariance(scene, names):
    planned = radioloc.covariance(scene.study(*names), HOURS, scene.observations)
    assert len((planned, *planned.others)) == len(names)
    assert planned.determined


def montecarlo(scene, names):
    trials = radioloc.monte_carlo(simulated(scene, names), trials=4, hours=0.4)
    assert trials.converged
    assert len((trials, *trials.others)) == len(names)


def arcs(scene, names):
    study = radioloc.arcs(scene.study(*names), HOURS, scene.observations)
    assert study.converged
    assert len(study.rows) + len(study.states) >= len(HOURS) * len(names)


def leave_one_out(scene, names):
    study = radioloc.leave_one_out(scene.study(*names), scene.observations)
    assert len(study.omissions) >= 3 * len(names)
    assert all(row.sigmas is not None for row in study.omissions if row.kind == "station")


def simulate(scene, names):
    simulated_data = radioloc.simulate(simulated(scene, names))
    assert {target for link in simulated_data.observations.links for target in link.targets} == {*names}
    assert np.isfinite(simulated_data.observations.value_m).all()


def compare(scene, names):
    first = radioloc.locate(estimating(scene, names, name="first"), scene.observations)
    second = radioloc.locate(estimating(scene, names, name="second"), scene.observations)
    compared = radioloc.compare([first, second], target=names[0] if first.targets else None)
    assert compared.is_usable


def on_map(names, name, **fields):
    """Return the true place of a target as a position on a map."""
    place = {"descent": several_targets.PLACE, "rover": several_targets.ROVER}.get(
        name, several_targets.LANDER
    )
    longitude_deg, latitude_deg, height_m = place.selenographic
    fields = {"sigma_m": (5.0, 5.0), "map_sigma_m": (5.0, 5.0)} | fields
    return PlaceOnMap(
        longitude_deg=longitude_deg,
        latitude_deg=latitude_deg,
        height_m=height_m,
        map="map",
        target=name if len(names) > 1 else None,
        **fields,
    )


def images(scene, names):
    study = scene.study(*names)
    choice = replace(study.observations, map_positions=(on_map(names, names[0]),), hours=0.3)
    solution = radioloc.locate(replace(study, observations=choice), scene.observations)
    assert solution.converged, solution.message
    assert (
        solution.sigma_enu_m()[0] < 7.1
    )  # that of map and image; tracking of 0.3 h alone has 8 m, of a descent 400 m


def with_process_noise(scene, names):
    noise = ProcessNoise(1e-6, 1e-6, 1e-6, interval_s=300.0)
    estimate = scene.study(*names).estimate
    orbit = replace(estimate.orbit or OrbitChoice(), process_noise=noise)
    return scene.study(*names, estimate=replace(estimate, orbit=orbit))


def process_noise(scene, names):
    solution = radioloc.locate(with_process_noise(scene, names), scene.observations)
    assert solution.converged, solution.message
    assert solution.state.process is not None
    assert solution.fit.total.rejected == 0


JOBS = {
    "locate": locate,
    "residuals": residuals,
    "covariance": covariance,
    "montecarlo": montecarlo,
    "arcs": arcs,
    "leave-one-out": leave_one_out,
    "simulate": simulate,
    "compare": compare,
    "images with tracking": images,
    "process noise": process_noise,
}

FLIES = "belongs to a position on the Moon"
NO_FORCES = 'belongs to a target with dynamics = "moon"'
REFUSALS = {
    ("covariance", "known trajectory"): "needs the position estimated",
    ("montecarlo", "known trajectory"): "needs the position estimated",
    ("arcs", "known trajectory"): "the motion of each target is known",
    ("leave-one-out", "known trajectory"): "needs the position estimated",
    ("compare", "known trajectory"): "on a trajectory",
    ("images with tracking", "known trajectory"): FLIES,
    ("images with tracking", "orbit"): FLIES,
    ("process noise", "surface point"): NO_FORCES,
    ("process noise", "several points"): NO_FORCES,
    ("process noise", "known trajectory"): NO_FORCES,
    ("process noise", "descent"): "does not land",
}
"""Words of the message."""
COMBINATIONS = [(job, target) for job in JOBS for target in TARGETS]


def test_page_lists_all_combinations():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = page.partition("## Targets and jobs\n")[2].partition("\n## ")[0]
    head, _, *rows = (
        [cell.strip(" `") for cell in line.split("|")[1:-1]]
        for line in section.splitlines()
        if line[:1] == "|"
    )
    cells = {(job, target): cell for job, *row in rows for target, cell in zip(head[1:], row, strict=True)}
    assert cells.keys() == set(COMBINATIONS)
    assert {key for key, cell in cells.items() if cell != "works"} == set(REFUSALS)
    assert all(f"- **{cell}**: " in section for cell in cells.values() if cell != "works")


@pytest.mark.study
@pytest.mark.parametrize(("job", "target"), [key for key in COMBINATIONS if key not in REFUSALS])
def test_combination_works(scene, job, target):
    JOBS[job](scene, TARGETS[target])


@pytest.mark.parametrize(("job", "target"), REFUSALS)
def test_combination_is_refused(scene, job, target):
    with pytest.raises(InputError, match=REFUSALS[job, target]):
        JOBS[job](scene, TARGETS[target])


@pytest.mark.study
def test_a_lander_on_the_map_determines_its_tie_for_a_descent(scene):
    """Of the tie of 20 m, which is all of a descent's a-priori sigma, 3 to 5 m remain."""
    names, accurate = ("lander", "craft", "descent"), {"sigma_m": (1.0, 1.0), "sigma_up_m": 1.0}
    places = tuple(on_map(names, name, map_sigma_m=(20.0, 20.0), **accurate) for name in names[::2])
    study = scene.study(*names)
    choice = replace(study.observations, map_positions=places, hours=0.3)
    solution = radioloc.locate(replace(study, observations=choice), scene.observations)
    assert solution.converged, solution.message
    lander, descent = (
        np.sqrt(np.diag(solution.of_target(name).position_covariance("enu"))) for name in names[::2]
    )
    np.testing.assert_allclose(descent[:2], np.hypot(lander[:2], 1.0), rtol=0.1)


@pytest.mark.study
@pytest.mark.parametrize("names", [("craft", "other"), ("lander", "craft", "other"), ("craft", "descent")])
def test_each_orbit_has_process_noise_of_its_own(scene, names):
    study = with_process_noise(scene, names)
    joint = radioloc.locate(study, scene.observations)
    assert joint.converged, joint.message
    planned = radioloc.covariance(study, 0.5, scene.observations)
    plans = dict(zip(names, (planned, *planned.others), strict=True))
    for name in {*names} & {"craft", "other"}:
        # No observation and no parameter is of both: each is as in a fit of its own, a plan as the fit.
        separate = radioloc.locate(with_process_noise(scene, (name,)), scene.observations).state
        np.testing.assert_allclose(joint.states[name].covariance, separate.covariance, rtol=1e-3)
        times = separate.orbit.times(5)
        for state in (joint.states[name], plans[name].longest.state):
            np.testing.assert_allclose(state.sigma_rtn_m(times), separate.sigma_rtn_m(times), rtol=2e-3)
    if "descent" in names:
        assert joint.states["descent"].process is None


@pytest.mark.study
@pytest.mark.parametrize("names", [("lander", "rover"), ("descent",), ("lander", "craft", "descent")])
def test_trials_draw_positions_on_a_map_with_their_shared_error(scene, names):
    study, accurate = simulated(scene, names), {"sigma_m": (1.0, 1.0), "sigma_up_m": 1.0}
    places = tuple(
        on_map(names, name, map_sigma_m=(20.0, 20.0), **accurate) for name in names if name != "craft"
    )
    choice = replace(study.observations, map_positions=places, hours=0.3)
    trials = radioloc.monte_carlo(replace(study, observations=choice), trials=60, hours=0.3, workers=1)
    for target in (trials, *trials.others):
        nees = target.to_dict()["arcs"][0]["nees"]
        assert nees["low"] < nees["mean"] < nees["high"]
