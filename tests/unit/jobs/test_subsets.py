"""Positions without a station or a link, against fits of what is left."""

from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc import leave_one_out
from radioloc.errors import InputError
from radioloc.estimation.combination import PositionEstimate
from radioloc.jobs.arcs import _groups
from radioloc.jobs.preparation import prepared_arc
from radioloc.results.subsets import Omission

SAME_M = 1e-3
"""Fits end where steps are below a millionth of a sigma; the model's Chebyshev nodes differ."""


@pytest.fixture(scope="module")
def study():
    return radioloc.read_study(EXAMPLES / "apollo15" / "apollo15_2024.toml")


@pytest.fixture(scope="module")
def result(study):
    return leave_one_out(study)


@pytest.mark.study
def test_without_a_station_is_with_the_others(study, result):
    assert [row.name for row in result.omissions] == ["APOLLO", "GRASSE", "MATERA"]
    assert {row.kind for row in result.omissions} == {"station"}  # the only link of each is no other group
    complete = radioloc.locate(study)
    for row in result.omissions:
        remaining = tuple(name for name in ("APOLLO", "GRASSE", "MATERA") if name != row.name)
        single = radioloc.locate(replace(study, observations=replace(study.observations, stations=remaining)))
        shift_m = complete.rot_pa_to_enu @ (single.position_pa_m - complete.position_pa_m)
        # East and north of principal and mean-Earth axes differ by 0.0005 rad.
        np.testing.assert_allclose(row.shift_enu_m, shift_m, rtol=2e-3, atol=SAME_M)
        assert row.omitted == len(complete.residuals) - len(single.residuals)
        assert row.used == single.fit.total.used


def test_the_shift_has_the_variance_that_the_rest_has_more_than_all(study, result):
    row = result.omissions[0]
    assert row.name == "APOLLO"
    remaining = replace(study.observations, stations=("GRASSE", "MATERA"))
    fits = radioloc.locate(replace(study, observations=remaining)), result.solution
    part, complete = (PositionEstimate.from_solution(fit.to_dict()) for fit in fits)
    assert set(part.errors_enu_m) <= set(complete.errors_enu_m)
    # All considered errors are in the weights of both.
    variance_m2 = np.diag(part.total_enu_m2 - complete.total_enu_m2)
    np.testing.assert_allclose(np.square(row.sigma_enu_m), variance_m2, rtol=1e-3)
    assert 0.0 < row.sigmas < 4.0


def test_links_are_left_out_too_where_they_are_not_all_of_a_station():
    study = radioloc.read_study(EXAMPLES / "change5" / "change5.toml")
    study = replace(study, observations=replace(study.observations, hours=1.0))
    arc, _ = prepared_arc(study)
    groups = _groups(arc, study)
    paths = np.array([link.path for link in arc.observations.links])[arc.observations.link]
    for (kind, name), mask in groups.items():
        of_it = paths == name if kind == "link" else np.char.find(paths, name) >= 0
        assert (mask == of_it).all(), name
    assert {name for kind, name in groups if kind == "link"} <= set(paths)
    assert len({mask.tobytes() for mask in groups.values()}) == len(groups) > 6
    shown = [
        Omission("link", name, 1, 2, True).label
        for name in ("JIAMUSI>x>KASHI", "KASHI>x>KASHI", "URUMQI<x>KUNMING")
    ]
    assert shown == ["KASHI from JIAMUSI", "KASHI two-way", "URUMQI–KUNMING"]


def test_nothing_can_be_left_out_of_one_link():
    with pytest.raises(InputError, match="one station or link"):
        leave_one_out(EXAMPLES / "apollo15" / "apollo15.toml")
