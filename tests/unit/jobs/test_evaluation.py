"""[model] evaluation: what a study finds does not depend on it."""

from dataclasses import replace

import numpy as np
import pytest
from change5_case import NEAR, observations

import radioloc
from radioloc.measurements.registry import kind_of
from radioloc.study.study import EstimateChoice, ModelChoice, Study

# Some micrometres of single ranges, in a position that eight hours of tracking give to metres.
SAME_M = 1e-4


@pytest.mark.slow
def test_exact_and_interpolated_find_the_same():
    model = radioloc.measurements.PhysicalModel.build()
    table = observations(model, 60.0, stop="2020-12-01T23:00:00")
    study = Study(target=NEAR, estimate=EstimateChoice(position="geographic"))
    solution = {}
    for evaluation in ("exact", "interpolated"):
        choice = replace(study.model, evaluation=evaluation)
        solution[evaluation] = radioloc.locate(replace(study, model=choice), table)
        assert solution[evaluation].provenance["evaluation"]["kind"] == evaluation
    exact, interpolated = solution["exact"], solution["interpolated"]
    assert np.abs(exact.position_pa_m - interpolated.position_pa_m).max() < SAME_M
    record = interpolated.provenance["evaluation"]
    assert record["interpolated"] > 0.5 * len(table)
    assert record["range_m"] < 1e-5
    assert record["delay_s"] < 1e-14


def test_combinations_of_interpolated_observations_are_called_so():
    model = radioloc.measurements.PhysicalModel.build()
    table = observations(model, 60.0, stop="2020-12-01T18:00:00")
    delays = table.select(table.kind == kind_of("vlbi_delay"))
    differences = replace(delays, kind=np.full(len(delays), kind_of("differenced_range"), dtype=np.int8))
    study = Study(target=NEAR, model=ModelChoice(evaluation="interpolated"))
    assert radioloc.compute_residuals(study, differences).provenance["evaluation"]["kind"] == "interpolated"
