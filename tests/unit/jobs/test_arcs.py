"""Predictor-length studies: the table of the paper, each arc as if fitted alone, what is printed and written."""

import csv
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from change5_case import LANDER, NEAR, observations
from toy_moon import ToyMoon, toy_solution

import radioloc
from radioloc import LunarPosition, Study
from radioloc.errors import InputError
from radioloc.results.subsets import horizontal_sigmas
from radioloc.results.tables import difference
from radioloc.study import EstimateChoice, ObservationChoice, Reference
from radioloc.study.study import HeightPrior

pytestmark = pytest.mark.usefixtures("unsearched")
SAME_M = 1e-4
"""Rounding, and where the iteration stops: 1e-3 sigmas at most."""

# Wang et al. (2021), table 1: longitude W and latitude N; differences to the first in 1e-4 deg and in m. The paper
# gives metres to 0.1.
IMAGES = (
    Reference(LANDER, "Chang'e-2 DOM"),
    Reference(LunarPosition.from_selenographic(-51.9156, 43.0591, -2552.5), "LROC NAC DOM"),
    Reference(LunarPosition.from_selenographic(308.0839, 43.0576, -2570.0), "LROC NAC image"),
)
ESTIMATE = EstimateChoice(
    range_bias="all", range_bias_sigma_m=10.0, height_prior=HeightPrior(height_m=-2550.4, sigma_m=5.0)
)


@pytest.fixture(scope="module")
def tracked(model):
    """Every half hour for 48 hours."""
    return observations(model, 1800.0)


@pytest.fixture(scope="module")
def study():
    return Study(
        target=NEAR,
        estimate=ESTIMATE,
        reference=IMAGES[0],
        references=IMAGES[1:],
        name="landing site",
        consider_defaults=False,
    )


@pytest.fixture(scope="module")
def arc_study(study, tracked):
    return radioloc.arcs(study, (12, 24, 48), tracked)


def test_longitudes_meet_beyond_180_degrees():
    east_deg, _, east_m, *_ = difference((179.99, 0.0, 0.0), (-179.99, 0.0, 0.0))
    assert east_deg == pytest.approx(-0.02)
    assert east_m == pytest.approx(-np.radians(0.02) * 1737400.0)


@pytest.mark.parametrize("k", range(3))
def test_each_arc_is_what_it_would_be_alone(k, arc_study, study, tracked):
    arc = arc_study.arcs[k]
    choice = ObservationChoice(hours=arc.hours)
    separate_solution = radioloc.locate(replace(study, observations=choice), tracked)
    item = arc.solution
    assert len(item.residuals) == len(separate_solution.residuals)
    np.testing.assert_allclose(item.position_pa_m, separate_solution.position_pa_m, rtol=0.0, atol=SAME_M)
    np.testing.assert_allclose(item.covariance, separate_solution.covariance, rtol=1e-5, atol=0.0)
    assert item.parameters.names == separate_solution.parameters.names
    np.testing.assert_allclose(item.values, separate_solution.values, rtol=0.0, atol=SAME_M)
    assert item.provenance["not_selected"] == separate_solution.provenance["not_selected"]
    assert item.notes == separate_solution.notes
    assert item.name == f"landing site, {arc.hours:g} h"


def test_rows_hold_the_differences_of_the_solutions(arc_study):
    rows = {row.name: row for row in arc_study.rows}
    assert list(rows) == ["48 h", "24 h", "12 h", "Chang'e-2 DOM", "LROC NAC DOM", "LROC NAC image"]
    for arc in arc_study.arcs:
        row, comparison = rows[arc.name], arc.solution.reference
        # On the sphere of 1737.4 km, not 2.5 km below: 0.15 %, and a plane instead of a sphere.
        assert row.east_m == pytest.approx(comparison.east_m, rel=2e-3, abs=0.01)
        assert row.north_m == pytest.approx(comparison.north_m, rel=2e-3, abs=0.01)
        assert row.up_m == pytest.approx(comparison.up_m, abs=0.01)
        sigmas_m = arc.solution.sigma_enu_m()
        assert (row.sigma_east_m, row.sigma_north_m, row.sigma_up_m) == tuple(sigmas_m)
        assert row.used + row.rejected == len(arc.solution.residuals)
    longest, shorter = (np.array([rows[n].east_m, rows[n].north_m]) for n in ("48 h", "12 h"))
    assert rows["12 h"].from_longest_m == pytest.approx(np.linalg.norm(shorter - longest), rel=1e-4)
    assert rows["48 h"].from_longest_m is None
    assert rows["Chang'e-2 DOM"].east_m is None
    assert (-rows["LROC NAC DOM"].east_m, rows["LROC NAC DOM"].north_m) == pytest.approx(
        (-13.3, 21.2), abs=0.05
    )
    assert rows["LROC NAC image"].longitude_deg == pytest.approx(-51.9161)


def test_without_references_the_longest_arc_is_the_benchmark(study, tracked):
    arc_study = radioloc.arcs(replace(study, reference=None, references=()), [6.0, 12.0], tracked)
    longest, shorter = arc_study.rows
    assert longest.east_m is None
    assert shorter.from_longest_m == pytest.approx(np.hypot(shorter.east_m, shorter.north_m))
    assert arc_study.to_dict()["benchmark"] == "the arc of 12 h"


def test_hours_count_from_the_start_of_the_study(study, tracked):
    start = radioloc.time.epochs_from_strings("2020-12-01T21:11:00", "UTC")
    choice = ObservationChoice(start=start, hours=1.0)
    arc_study = radioloc.arcs(replace(study, observations=choice), [6.0, 12.0], tracked)
    assert [arc.span_h for arc in arc_study.arcs] == pytest.approx([12.0, 6.0], abs=1e-6)
    # What lies before the start is never there; the later hours are counted once.
    for arc in arc_study.arcs:
        left_out = arc.solution.provenance["not_selected"]["outside the time span"]
        assert left_out + len(arc.solution.residuals) == len(tracked)


@pytest.mark.parametrize(
    ("hours", "words"), [([], "no arc to fit"), ([-3.0], "hours: expected a number above zero")]
)
def test_lengths_that_are_none(study, tracked, hours, words):
    with pytest.raises(InputError, match=words):
        radioloc.arcs(study, hours, tracked)


def test_an_arc_without_observations(study, tracked):
    choice = ObservationChoice(start=radioloc.time.epochs_from_strings("2020-12-01T09:11:00", "UTC"))
    with pytest.raises(InputError, match=r"3.*6\.00"):
        radioloc.arcs(replace(study, observations=choice), [3.0, 12.0], tracked)


def test_departure_is_that_of_two_independent_halves():
    """By hand: the mean of four values of variance 1 differs from that of the first two by variance 1/2 - 1/4."""
    complete, part = toy_pair(0.25), toy_pair(0.5)
    apart_m = np.array([0.6, 0.0, 0.0])
    sigmas = horizontal_sigmas(
        replace(part, position_pa_m=part.position_pa_m + part.rot_pa_to_enu.T @ apart_m), complete
    )
    assert sigmas == pytest.approx(0.6 / 0.5, rel=1e-9)
    assert horizontal_sigmas(complete, part) is None
    assert horizontal_sigmas(replace(part, covariance=np.diag([np.inf] * 3)), complete) is None


def toy_pair(variance_m2):
    solution = toy_solution(ToyMoon(30, 24.0, biases=False))
    return replace(solution, covariance=variance_m2 * np.eye(3))


@pytest.mark.usefixtures("undrawn")
def test_what_is_written(arc_study, tmp_path):
    folder = tmp_path
    radioloc.write_report(folder, arc_study)
    assert json.loads((folder / "arcs.json").read_text()) == json.loads(json.dumps(arc_study.to_dict()))
    with (folder / "table1.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == [row.name for row in arc_study.rows]
    for row, record in zip(arc_study.rows, rows, strict=True):
        for key, value in asdict(row).items():
            is_text = isinstance(value, str) or value is None
            assert (record[key] if is_text else json.loads(record[key])) == (
                value or "" if is_text else value
            ), key
    value_m, sigma_m = arc_study.longest.biases()["KASHI"]
    assert float(rows[0]["range_bias.KASHI"]) == value_m
    assert float(rows[0]["range_bias.KASHI.sigma"]) == sigma_m
    assert rows[4]["range_bias.KASHI"] == ""
    lines = (folder / "12h" / "residuals.csv").read_text().splitlines()
    assert len(lines) == 1 + len(arc_study.arcs[2].solution.residuals)
