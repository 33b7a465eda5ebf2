"""Data that fit raise no sentence: draws of the example, whose errors beyond noise are estimated or considered."""

import pytest

import radioloc
from radioloc.jobs.locate import fit_arc
from radioloc.jobs.preparation import build_model, prepared_arc
from radioloc.jobs.simulate import build_scenario
from radioloc.simulation import World

pytestmark = pytest.mark.slow

DRAWS = 100


def test_at_most_one_of_a_hundred():
    study = radioloc.read_study("examples/change5/simulation.toml")
    world: World = build_scenario(study).world(build_model(study))
    arc, left_out = prepared_arc(study, world.plan.observations)
    messages = []
    for seed in range(DRAWS):
        drawn = world.draw(seed=seed, draw_errors=True).observations
        solution = fit_arc(study, arc.with_values(drawn.value_m), left_out)
        assert solution.converged
        messages += [str(item) for item in solution.consistency.findings[:1]]
    assert len(messages) <= 1, messages
