"""Some cells of the benchmark of faults, so that its worlds, faults and classes stay in use (`make faults`)."""

import pytest
from fault_worlds import REAL, world
from tracking_faults import FAULTS, NO_FAULT, OUTCOMES, run

BY_NAME = {fault.name: fault for fault in FAULTS}


def test_fit_without_fault_is_right_and_names_nothing():
    outcome = run(world("three-way"), NO_FAULT, 0)
    assert (outcome.outcome, outcome.exit, outcome.named) == ("right", 0, ())


@pytest.mark.study
@pytest.mark.parametrize("name", ["station 300 m long", "tags in TAI"])
def test_gross_fault_is_not_silent(name):
    outcome = run(world("three-way"), BY_NAME[name], 0)
    assert outcome.outcome in OUTCOMES
    assert outcome.outcome != "silent"


def test_values_in_single_precision_are_refused_by_name():
    outcome = run(world("dsn"), BY_NAME["single precision"], 0)
    assert (outcome.outcome, outcome.exit) == ("refused, culprit first", 2)


def test_benchmark_has_enough_faults_and_cells():
    assert len(FAULTS) == len(BY_NAME) >= 40
    assert sum(len(fault.worlds) for fault in FAULTS) >= 150


@pytest.mark.study
@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("dsn", "troposphere switched off"),
        ("dsn", "stations exchanged"),
        ("dsn", "sign reversed in a pass"),
        ("dsn", "wrong turnaround ratio"),
        ("three-way", "values in km"),
        ("vlbi", "all stations 30 m up"),
        ("vlbi", "link reversed"),
        *(
            pytest.param("grail", name, marks=pytest.mark.skipif(not REAL.is_dir(), reason="no files"))
            for name in ("tags in TDB", "half of the count interval", "gravity truncated")
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.*records are left out")
def test_culprit_is_the_first_of_the_findings(place, name):
    assert run(world(place), BY_NAME[name], 0).place == 0


def test_term_that_is_switched_off_is_named_in_the_notes():
    """Without the gravitational delay, ranges are 8 m short at all stations, which residuals do not show."""
    outcome = run(world("dsn"), BY_NAME["relativity switched off"], 0)
    assert outcome.outcome == "mentioned"
    assert "shapiro" in outcome.text
