"""Targets of different kinds in one fit, each against its truth and against a fit of its own."""

import numpy as np
import pytest
import several_targets
from several_targets import LANDER, ROVER, STATE

import radioloc
from radioloc.measurements import PhysicalModel

TURNED = STATE[[1, 0, 2, 4, 3, 5]]
ALL = ("lander", "rover", "craft", "other", "known", "descent")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return several_targets.scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def together(scene):
    return radioloc.locate(scene.study(*ALL), scene.observations)


def test_two_spacecraft_have_states_and_forces_of_their_own(scene):
    solution = radioloc.locate(scene.study("craft", "other"), scene.observations)
    assert solution.converged, solution.message
    for name, state in (("craft", STATE), ("other", TURNED)):
        columns = [k for k, item in enumerate(solution.parameters) if item.name.startswith(f"state.{name}.")]
        error = solution.values[columns] - state
        covariance = solution.parameter_covariance()[np.ix_(columns, columns)]
        assert error @ np.linalg.solve(covariance, error) < 22.5  # 0.1 % of six


def test_six_targets_without_common_errors_are_as_each_by_itself(scene, together):
    assert together.converged, together.message
    for names in (("lander",), ("craft",), ("descent",)):
        alone = radioloc.locate(scene.study(*names), scene.observations)
        [name] = names
        for item, value, sigma in zip(alone.parameters, alone.values, alone.sigmas(), strict=True):
            kind, _, rest = item.name.partition(".")
            k = together.parameters.index(f"{kind}.{name}.{rest}")
            assert abs(together.values[k] - value) < 0.01 * sigma, item.name
            # One noise level is estimated for all targets together.
            assert together.sigmas()[k] == pytest.approx(sigma, rel=0.2), item.name


def test_places_of_points_and_of_a_descent_are_found_together(together):
    model = PhysicalModel.build()
    true = {"lander": LANDER, "rover": ROVER, "descent": several_targets.PLACE}
    assert [target.name for target in together.targets] == [*true]
    for name, place in true.items():
        solution = together.of_target(name)
        error_m = solution.position_pa_m - place.to_axes("PA", model.ephemeris.constants).xyz_m
        covariance = solution.position_covariance("pa")
        assert error_m @ np.linalg.solve(covariance, error_m) < 16.3, name  # 0.1 % of three
