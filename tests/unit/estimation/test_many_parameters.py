"""Sparse normal equations of many parameters."""

from dataclasses import replace

import change5_case as case
import numpy as np
import pytest

import radioloc
from radioloc.estimation import robust


@pytest.mark.study
def test_sparse_normal_equations_give_the_same_estimate_and_tests(monkeypatch):
    planned = case.sessions(1800.0, "2020-12-02T03:10:00")
    study = case.study_of(planned, consider_defaults=True)
    observations = radioloc.simulate(study).observations
    is_late = np.arange(len(observations)) > len(observations) // 2
    jump_m = np.where(is_late & (observations.link == observations.link[0]), 40.0, 0.0)
    observations = replace(observations, value_m=observations.value_m + jump_m)
    dense = radioloc.locate(study, observations)
    monkeypatch.setattr(robust, "MAX_DENSE_PARAMETERS", 0)
    sparse = radioloc.locate(study, observations)
    # Starts differ by rounding, and ranges are rounded to 0.1 um.
    assert np.abs(sparse.values - dense.values).max() < 1e-5
    tests = zip(sparse.consistency.groups, dense.consistency.groups, strict=True)
    assert all(a.chi2 == pytest.approx(b.chi2, rel=1e-5) for a, b in tests)
    assert [item.name for item in sparse.consistency.findings] == [
        item.name for item in dense.consistency.findings
    ]
    assert sparse.consistency.findings
    pairs = zip(sparse.consistency.reliability, dense.consistency.reliability, strict=True)
    assert all(a.minimal == pytest.approx(b.minimal, rel=1e-6) for a, b in pairs)
