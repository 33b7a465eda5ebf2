"""Names and numbers of a spacecraft in study, tracking and calibrations: the same, noted, or refused."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from arc_cases import observed_at
from paths import EXAMPLES

import radioloc
from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.media import read_csp
from radioloc.study.identity import spacecraft_doubts
from radioloc.study.study import ModelChoice, Study

PLACE = radioloc.LunarPosition.from_selenographic(3.5, 26.0, -1000.0)
ION = (
    "ADJUST(DOPRNG) BY CONST(2.0) MODEL(CHPART) FROM(20/12/02,00:00) TO(20/12/02,24:00) DSN(C10) SCID({}).\n"
)


def doubts(tracked, calibrations=None, choice=None, **study):
    observations = observed_at(
        ["2020-12-02T01:00:00"],
        Link("DSS-24", tracked, "DSS-24"),
        tag="transmit",
        value_m=[7.7e8],
        sigma_m=[1.0],
    )
    study = Study(PLACE, **study)
    if choice:
        study = replace(study, observations=replace(study.observations, **choice))
    return spacecraft_doubts(
        study, observations, SimpleNamespace(sources={}, media_calibrations=calibrations)
    )


@pytest.mark.parametrize(
    ("tracked", "name"),
    [
        ("change5", "Chang'e-5 lander"),
        ("CHANGE 5", "change-5"),
        ("apollo15", "Apollo 15 reflector"),
        ("luna17", "Lunokhod 1"),
        ("lander", "Beresheet"),
        ("sc177", "SC 177"),
        ("sc177", None),
    ],
)
def test_the_same_target_or_none_named_is_no_doubt(tracked, name):
    assert doubts(tracked, target_name=name) == []


@pytest.mark.parametrize(
    ("tracked", "name"), [("GRAIL-A", "GRAIL-B"), ("sc181", "GRAIL-A"), ("apollo15", "a site")]
)
def test_tracking_of_a_target_of_another_name_is_noted_until_the_study_names_it(tracked, name):
    [note] = doubts(tracked, target_name=name)
    assert tracked.lower() in note.lower()
    assert name in note
    assert doubts(tracked, target_name=name, choice={"targets": (tracked,)}) == []


@pytest.mark.parametrize(("tracked", "name"), [("apollo11", "Apollo 15"), ("sc177", "sc181")])
def test_tracking_of_another_known_target_is_refused(tracked, name):
    with pytest.raises(InputError, match=f"the observations are of {tracked}, but .* name is '{name}'"):
        doubts(tracked, target_name=name)


def test_the_naif_code_of_a_study_is_compared_with_the_number_of_the_tracking():
    study = radioloc.read_study(EXAMPLES / "orbiter" / "orbiter.toml")
    tracked = radioloc.read_observations(EXAMPLES / "dsn" / "lander.odf")
    model = SimpleNamespace(sources={}, media_calibrations=None)
    orbiter_study = replace(study, target=replace(study.target, body=-85), target_name=None)
    [note] = spacecraft_doubts(orbiter_study, tracked, model)
    assert "sc999" in note
    assert "-85" in note
    assert spacecraft_doubts(replace(study, target_name="LRO"), tracked, model) == []  # body is -999


def test_calibrations_of_another_spacecraft_need_its_number(tmp_path):
    (tmp_path / "cards.ion").write_text(ION.format(181))
    cards = read_csp(tmp_path / "cards.ion")
    assert doubts("sc181", cards) == doubts("GRAIL-B", cards) == []
    with pytest.raises(InputError, match=r"181.*sc177"):
        doubts("sc177", cards)
    [note] = doubts("sc177", cards, model=ModelChoice(csp=(tmp_path / "cards.ion",), csp_scid=181))
    assert "csp_scid" in note
