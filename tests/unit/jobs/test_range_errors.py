"""Considered delays of ranges: what they do to the sigma and to the card, and their draws in simulated worlds."""

import re
from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc.parameters.considered import considered_choices
from radioloc.simulation import TruthSigma
from radioloc.study import EstimateChoice, HeightPrior

NO_DELAYS = considered_choices(
    {"station_position_sigma_m": 0.1, "range_bias": "none", "transponder_delay": "none"}
)


@pytest.fixture(scope="module")
def study():
    """Return an hour of ranges with biases of 4.2 and -3.1 m that are not estimated."""
    study = radioloc.read_study(EXAMPLES / "change5" / "short_arc.toml")
    return replace(study, estimate=EstimateChoice(height_prior=HeightPrior(-2550.4, 5.0)))


@pytest.fixture(scope="module")
def ranges(study):
    return radioloc.read_observations(study.observations.files)


@pytest.fixture(scope="module")
def solution(study, ranges):
    return radioloc.locate(study, ranges)


def test_considered_biases_cover_ranges_whose_biases_are_not_estimated(study, ranges, solution):
    assert solution.reference.combined_sigmas < 2.8
    assert radioloc.locate(replace(study, consider=NO_DELAYS), ranges).reference.combined_sigmas > 2.8


def test_card_states_the_shift_by_a_metre_of_common_bias(study, ranges, solution):
    biased = radioloc.locate(study, replace(ranges, value_m=ranges.value_m + 1.0))
    shift_m = np.linalg.norm(biased.position_pa_m - solution.position_pa_m)
    pattern = r"1 m of range bias common to all stations moves the position by\s+([\d.]+)\s+m"
    [stated] = re.findall(pattern, str(solution))
    assert float(stated) == pytest.approx(shift_m, rel=0.02)


def test_shift_by_a_common_bias_is_left_out_where_biases_are_estimated(study, ranges):
    estimated = replace(study.estimate, parameters=EstimateChoice(range_bias="all").parameters)
    assert "common to all stations" not in str(radioloc.locate(replace(study, estimate=estimated), ranges))


def test_notes_state_the_sigma_of_rounded_coordinates(study, ranges, solution):
    assert any("rounded" in note and "0.100 m a coordinate" in note for note in solution.notes)
    by_default = radioloc.locate(replace(study, consider={}), ranges)
    assert any("rounded" in note and "100 m a coordinate: give" in note for note in by_default.notes)


def test_simulation_draws_the_errors_that_the_fit_considers(study):
    drawn = radioloc.simulate(study, draw_errors=True).drawn
    assert "transponder_delay" in drawn
    assert not any(name.startswith("range_bias") for name in drawn)  # which the scenario states
    assert any(name.startswith("station_position.KASHI") for name in drawn)
    stated = replace(study.simulation, truth_sigma=TruthSigma(considered=False))
    assert not radioloc.simulate(replace(study, simulation=stated), draw_errors=True).drawn
