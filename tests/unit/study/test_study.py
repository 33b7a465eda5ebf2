"""The records of a study refuse what makes no sense, and take what is plainly meant."""

from dataclasses import replace
from pathlib import Path

import pytest

from radioloc.errors import InputError
from radioloc.study import EstimateChoice, ObservationChoice


def test_single_names_and_files_stand_for_lists_of_one():
    choice = ObservationChoice(files="a.csv", targets="apollo15", stations="7045")
    assert choice.files == (Path("a.csv"),)
    assert choice.targets == ("apollo15",)
    assert choice.stations == ("7045",)
    assert ObservationChoice(files=["a", Path("b")], targets=["x"]).files == (Path("a"), Path("b"))
    assert EstimateChoice(range_bias=["A", "B"]).parameters["range_bias"].names == ("A", "B")


def test_a_key_of_a_parameter_can_be_replaced():
    """`dataclasses.replace` changes one key, and what else was chosen stays."""
    choice = EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, range_bias_per="link", clock=["A"])
    looser = replace(choice, range_bias_sigma_m=20.0)
    assert looser == EstimateChoice(
        range_bias="all", range_bias_sigma_m=20.0, range_bias_per="link", clock=["A"]
    )
    free = replace(choice, range_bias_sigma_m=None)
    assert free == EstimateChoice(range_bias="all", range_bias_per="link", clock=["A"])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"hours": 0.0}, "hours: expected a number above zero"),
        ({"start": 2460432.5}, "start: expected one epoch"),
    ],
)
def test_choice_of_observations_is_checked(fields, message):
    with pytest.raises(InputError, match=message):
        ObservationChoice(**fields)
