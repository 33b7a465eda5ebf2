"""Every kind of parameter, estimated and considered, in every scope that it can have."""

from dataclasses import replace

import change5_case
import numpy as np
import pytest
from arc_cases import observed_at
from quick import some

import radioloc
from radioloc import Observations
from radioloc.measurements import MEASUREMENTS
from radioloc.parameters.choice import parameter_choices
from radioloc.parameters.registry import PARAMETERS
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice

pytestmark = pytest.mark.usefixtures("unsearched")
PATHS = {
    "range": ("KASHI>lander>KASHI", "JIAMUSI>lander>KASHI", "JIAMUSI>lander>JIAMUSI"),
    "vlbi_delay": ("SESHAN25<lander>KUNMING", "SESHAN25<lander>URUMQI"),
    "doppler": ("JIAMUSI>lander>KASHI",),
    "vlbi_delay_rate": ("SESHAN25<lander>KUNMING",),
    "one_way_range": ("lander>KUNMING",),
    "one_way_doppler": ("lander>KUNMING",),
}
BY_KIND = [[(name, scope.value) for scope in kind.scopes] for name, kind in PARAMETERS.items()]
LEFT_M = 1e-2
"""Of what a parameter adds, some 10 m, an a-priori sigma of ten times as much takes 1e-4."""


@pytest.fixture(scope="module")
def tracking():
    """Two passes of all types, some of which any parameter acts on; values mean nothing yet."""
    days = [
        f"2020-12-0{day}T{hour:02d}:{minute:02d}:00"
        for day in (1, 2)
        for hour in (16, 18, 20)
        for minute in (0, 30)
    ]
    parts = [
        observed_at(
            days,
            path,
            kind=kind,
            sigma_m=0.1,
            count_s=60.0 if MEASUREMENTS[kind].integrated else np.nan,
            uplink_hz=7.2e9,
            wavelength_um=35394.6,
        )
        for kind, paths in PATHS.items()
        for path in paths
    ]
    return Observations.concatenate(parts)


def study(consider=None, **keys):
    return radioloc.Study(
        change5_case.LANDER,
        ObservationChoice(),
        EstimateChoice(**keys),
        ModelChoice(off=["ionosphere"]),
        consider=consider or {},
    )


def with_values(tracking, chosen):
    """The values that the model computes with the a-priori values of a study."""
    solution = radioloc.compute_residuals(chosen, tracking)
    return replace(
        tracking, value_m=np.array(tracking.value_m - solution.residuals.residual_m[: len(tracking)])
    )


@pytest.fixture(scope="module")
def measured(tracking):
    """Error-free values."""
    return with_values(tracking, study(position="none"))


def cases(first, every=1):
    """Each kind, or every second one, in one of its scopes, in turn; the others are slow."""
    quick = [in_scopes[(first + k) % len(in_scopes)] for k, in_scopes in enumerate(BY_KIND) if k % every == 0]
    return some([case for in_scopes in BY_KIND for case in in_scopes], quick)


@pytest.mark.parametrize(("name", "scope"), cases(0))
def test_estimated_in_every_scope(tracking, name, scope):
    kind = PARAMETERS[name]
    per = {kind.keys["per"]: scope} if scope != kind.scopes[0].value else {}
    biased = with_values(tracking, study(position="none", **{kind.value_key: 10.0 * kind.scale}))
    names = "all" if kind.scopes[0].named else True
    if kind.relative and scope in ("station", "pass"):  # "all" leaves one out, which one-way ranges show
        names = ["JIAMUSI", "KASHI", "SESHAN25", "KUNMING", "URUMQI"]
    sigma = {kind.sigma_key: 1000.0 * kind.scale}
    solution = radioloc.locate(study(position="none", **{name: names}, **sigma, **per), biased)
    assert solution.converged
    assert len(solution.parameters.of_kind(name)) >= len(kind.components)
    assert np.abs(solution.residuals.residual_m).max() < LEFT_M


@pytest.mark.parametrize(("name", "scope"), cases(1, every=2))
def test_considered_in_every_scope(measured, name, scope):
    kind = PARAMETERS[name]
    per = {kind.keys["per"]: scope} if scope != kind.scopes[0].value else {}
    names = "all" if kind.scopes[0].named else True
    keys = {name: names, kind.sigma_key: kind.scale} | per
    solution = radioloc.locate(study(parameter_choices(keys)), measured)
    assert solution.consider.parameters
    records = [
        record
        for record in solution.consider.to_list(solution.enu_partials)
        if record["name"].startswith(name)
    ]
    assert records
    assert max(np.abs(record["position_enu_m"]).max() for record in records) > 1e-6
