"""Targets of different kinds in one fit, each against its truth and against a fit of its own."""

from dataclasses import replace

import numpy as np
import pytest
import several_targets
from several_targets import LANDER, ROVER, STATE

import radioloc
from radioloc.measurements import PhysicalModel
from radioloc.results.comparison import state_pair

TURNED = STATE[[1, 0, 2, 4, 3, 5]]
ALL = ("lander", "rover", "craft", "other", "known", "descent")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return several_targets.scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def joint(scene):
    return radioloc.locate(scene.study(*ALL), scene.observations)


def test_two_spacecraft_have_states_and_forces_of_their_own(scene):
    solution = radioloc.locate(scene.study("craft", "other"), scene.observations)
    assert solution.converged, solution.message
    for name, state in (("craft", STATE), ("other", TURNED)):
        columns = [k for k, item in enumerate(solution.parameters) if item.name.startswith(f"state.{name}.")]
        error = solution.values[columns] - state
        covariance = solution.parameter_covariance()[np.ix_(columns, columns)]
        assert error @ np.linalg.solve(covariance, error) < 22.5  # 0.1 % of six


def test_six_targets_without_common_errors_are_as_each_by_itself(scene, joint):
    assert joint.converged, joint.message
    for names in (("lander",), ("craft",), ("descent",)):
        single = radioloc.locate(scene.study(*names), scene.observations)
        [name] = names
        for item, value, sigma in zip(single.parameters, single.values, single.sigmas(), strict=True):
            kind, _, suffix = item.name.partition(".")
            k = joint.parameters.index(f"{kind}.{name}.{suffix}")
            assert abs(joint.values[k] - value) < 0.01 * sigma, item.name
            # One noise level is estimated for all targets.
            assert joint.sigmas()[k] == pytest.approx(sigma, rel=0.2), item.name


def test_places_of_points_and_of_a_descent_are_found_together(joint):
    model = PhysicalModel.build()
    true = {"lander": LANDER, "rover": ROVER, "descent": several_targets.PLACE}
    assert [target.name for target in joint.targets] == [*true]
    for name, place in true.items():
        solution = joint.of_target(name)
        error_m = solution.position_pa_m - place.to_axes("PA", model.ephemeris.constants).xyz_m
        covariance = solution.position_covariance("pa")
        assert error_m @ np.linalg.solve(covariance, error_m) < 16.3, name  # 0.1 % of three


@pytest.fixture(scope="module")
def arcs(scene):
    return radioloc.arcs(scene.study(*ALL), (0.3, 0.5), scene.observations)


@pytest.mark.study
def test_state_of_a_part_differs_from_that_of_all_by_what_it_should(arcs):
    rows = {row.target: row for row in arcs.states if row.from_longest_sigmas is not None}
    assert [*rows] == ["craft", "other", "descent"]
    for name, row in rows.items():
        assert row.from_longest_sigmas < 4.74, name  # 99.9 % of six
    assert rows["craft"].sigma_along_m > arcs.states[0].sigma_along_m
    assert arcs.converged


@pytest.mark.study
def test_arcs_of_targets_of_every_kind_have_positions_states_and_files(arcs, tmp_path):
    assert {name for row in arcs.rows for name in [row.name.partition(",")[0]]} == {
        "lander",
        "rover",
        "descent",
    }
    card = str(arcs)
    assert "craft" in card
    assert "other" in card
    radioloc.write_report(tmp_path, arcs)
    states = (tmp_path / "states.csv").read_text().splitlines()
    assert states[0].startswith("target,name,sigma_radial_m")
    assert len(states) == 1 + 2 * 3


@pytest.mark.study
def test_states_from_ranges_and_from_doppler_agree(scene, tmp_path):
    study = scene.study("craft")
    solutions = [
        radioloc.locate(
            replace(study, name=kind, observations=replace(study.observations, types=(kind,))),
            scene.observations,
        )
        for kind in ("range", "doppler")
    ]
    compared = radioloc.compare(solutions)
    [pair] = compared.pairs
    assert pair.chi2 < 22.5  # 0.1 % of six
    assert compared.is_usable
    for solution in solutions:
        radioloc.write_report(tmp_path / solution.name, solution)
    files = [tmp_path / solution.name / "solution.json" for solution in solutions]
    assert radioloc.compare(files).to_dict() == compared.to_dict()
    shifted = solutions[0].to_dict()
    shifted["state"]["position_m"][0] += 1e3
    displaced = state_pair(("a", "b"), (shifted["state"], solutions[1].to_dict()["state"]), share_data=False)
    assert displaced.chance < 1e-3
