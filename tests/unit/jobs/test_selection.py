"""What is kept, in which order, and how what is not kept is counted."""

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc import StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.jobs.selection import select_observations, with_target_names
from radioloc.measurements import Link, Ramps
from radioloc.measurements.registry import KINDS
from radioloc.study import ObservationChoice
from radioloc.time import epochs_from_strings

CATALOGUE = StationCatalogue.default()
LINKS = (
    Link("APOLLO", "apollo15", "APOLLO"),
    Link("GRASSE", "Apollo 15", "GRASSE"),
    Link("APOLLO", "apollo15", "GRASSE"),
    Link("APOLLO", "apollo11", "APOLLO"),
    Link("NEW", "apollo15", "NEW"),
)


def observations(link, dates):
    n = len(link)
    return observed_at(dates, LINKS, tag="transmit", link=link, value_m=7.7e8 + np.arange(n), sigma_m=0.01)


def some():
    days = ["2024-05-03", "2024-05-01", "2024-05-02", "2024-05-02T12:00:00", "2024-05-04", "2024-05-05"]
    return observations([0, 1, 2, 3, 4, 0], days)


def selected_rows(choice, observed=None, positions=()):
    chosen, left_out = select_observations(observed or some(), choice, CATALOGUE, positions)
    rows = (chosen.value_m - 7.7e8).astype(int).tolist()
    assert len(rows) + sum(left_out.values()) == len(observed or some())
    return rows, left_out


def test_target_by_any_of_its_names():
    assert selected_rows(ObservationChoice(targets="AP15")) == ([0, 1, 2, 4, 5], {"other target": 1})
    assert selected_rows(ObservationChoice(targets=["apollo-11", "Apollo 11"])) == ([3], {"other target": 5})


def test_targets_under_the_names_of_the_study():
    """A file calls it by a number, another one by a name; ramps are of stations and of targets."""
    links = (Link("DSS-24", "sc181", "DSS-24"), Link("", "sc181", "DSS-24"), Link("", "grail-b", "DSS-24"))
    of_beacon = Ramps.from_columns(
        ["DSS-24", "SC181"],
        *(epochs_from_strings([f"2012-04-0{day}"] * 2, "UTC") for day in (1, 2)),
        [2e9, 8e9],
        [0, 0],
    )
    observed = observed_at(
        ["2012-04-01"] * 3,
        links,
        link=[0, 1, 2],
        kind=[KINDS.index("range"), *[KINDS.index("one_way_doppler")] * 2],
        value_m=[7.7e8, 1.0, 2.0],
        count_s=1.0,
        ramps=of_beacon,
    )
    assert with_target_names(observed, {}) is observed
    named = with_target_names(observed, {"SC181": "grail-b"})
    assert named.paths().tolist() == ["DSS-24>grail-b>DSS-24", *["grail-b>DSS-24"] * 2]
    assert len(named.links) == 2
    assert named.ramps.stations == ("DSS-24", "grail-b")
    with pytest.raises(InputError, match=r"target_names:.*grail-b, sc181.*sc999"):
        with_target_names(observed, {"sc999": "x"})


def test_several_targets_need_a_choice():
    with pytest.raises(InputError, match=r"target.*apollo11, apollo15"):
        selected_rows(ObservationChoice())
    with pytest.raises(InputError, match="apollo11, apollo15"):
        selected_rows(ObservationChoice(targets=["apollo11", "apollo15"]))
    with pytest.raises(InputError, match=r"luna17.*apollo11, apollo15"):
        selected_rows(ObservationChoice(targets="lunokhod1"))


def test_targets_with_positions_are_kept():
    assert selected_rows(ObservationChoice(), positions=["apollo11", "AP15"]) == ([0, 1, 2, 3, 4, 5], {})
    assert selected_rows(ObservationChoice(), positions=["apollo11"]) == ([3], {"other target": 5})
    joint = {"positions": ["apollo11", "apollo15"]}
    assert selected_rows(ObservationChoice(targets="AP11"), **joint) == ([3], {"other target": 5})
    with pytest.raises(InputError, match=r"\[targets\]:.*luna17.*apollo11"):
        selected_rows(ObservationChoice(), positions=["luna17"])
    with pytest.raises(InputError, match=r"apollo15;.*: \[model\]"):
        selected_rows(ObservationChoice(targets="apollo15"), positions=["apollo11"])


def test_links_of_two_targets_need_both():
    links = [Link("JIAMUSI", "lander", "KASHI", True, "rover"), Link("JIAMUSI", "rover", "KASHI", True)]
    observed = observed_at(
        ["2024-05-03", "2024-05-04"],
        links,
        link=[0, 1],
        kind=[KINDS.index("differenced_delay"), KINDS.index("vlbi_delay")],
        value_m=[0.0, 1.0],
        sigma_m=0.01,
    )

    def values_m(positions):
        return select_observations(observed, ObservationChoice(), CATALOGUE, positions)[0].value_m.tolist()

    assert values_m(["lander", "rover"]) == [0.0, 1.0]
    assert values_m(["rover"]) == [1.0]


def test_stations_take_part_only_with_both_ends():
    fifteen = {"targets": "apollo15"}
    assert selected_rows(ObservationChoice(**fifteen, stations="7045"))[0] == [0, 5]
    assert selected_rows(ObservationChoice(**fifteen, stations=["GRASSE", "apollo"]))[0] == [0, 1, 2, 5]
    with pytest.raises(InputError, match=r"MATERA.*APOLLO, GRASSE, NEW"):
        selected_rows(ObservationChoice(**fifteen, stations="MATERA"))
    with pytest.raises(InputError, match=r"\[observations\].*DSN"):
        selected_rows(ObservationChoice(**fifteen, stations="DSN"))
    with pytest.raises(StationError, match=r"\[observations\] stations: station 'NOPE'"):
        selected_rows(ObservationChoice(**fifteen, stations="NOPE"))


def test_span_includes_its_ends():
    span = ObservationChoice(
        targets="apollo15",
        start=epochs_from_strings("2024-05-02", "UTC"),
        stop=epochs_from_strings("2024-05-04", "UTC"),
    )
    assert selected_rows(span) == ([0, 2, 4], {"other target": 1, "outside the time span": 2})


def test_hours_count_from_the_first_that_is_left():
    assert selected_rows(ObservationChoice(targets="apollo15", hours=48.0))[0] == [0, 1, 2]
    # Without GRASSE's the first is the one of 3 May.
    assert selected_rows(ObservationChoice(targets="apollo15", stations="APOLLO", hours=48.0))[0] == [0, 5]
    start = epochs_from_strings("2024-05-02T06:00:00", "UTC")
    assert selected_rows(ObservationChoice(targets="apollo15", start=start, hours=24.0))[0] == [0]


def test_hours_are_those_of_atoms_over_a_leap_second():
    observed = observations([0, 0, 0], ["2016-12-31T23:00:00", "2016-12-31T23:59:60", "2017-01-01T00:00:00"])
    assert selected_rows(ObservationChoice(hours=1.0), observed)[0] == [0, 1]
    assert selected_rows(ObservationChoice(hours=3601.0 / 3600.0), observed)[0] == [0, 1, 2]


@pytest.mark.parametrize("span", [{"start": "2030-01-01"}, {"stop": "1990-01-01"}])
def test_nothing_left_says_why(span):
    choice = ObservationChoice(
        targets="apollo15", **{key: epochs_from_strings(day, "UTC") for key, day in span.items()}
    )
    with pytest.raises(InputError, match=r"\(1.*5.*span\)"):
        selected_rows(choice)
