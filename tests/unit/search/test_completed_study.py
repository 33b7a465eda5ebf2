"""Completed study files: results of the search, preserved comments, the command."""

import tomllib

import pytest

from radioloc.search.study_search import Change, completed_text

CHANGE = Change(
    ("forces",), {"degree": 60}, ("gravity",), {"impulses": [{"name": "b", "epoch": "2012-04-09"}]}
)
BURN = {"name": "a", "epoch": "2012-04-08"}


@pytest.mark.parametrize(
    ("text", "impulses"),
    [
        ("", []),
        ("[forces] # all\ngravity = 'x'\n[observations]\nfiles = []\n", []),
        ("forces = {gravity = 'x', tides = true}\n", []),
        ("[forces]\n[[forces.impulses]]\nname = 'a'\nepoch = '2012-04-08'\n[model]\n", [BURN]),
        ("[forces]\nimpulses = [{name = 'a', epoch = '2012-04-08'}] # one\n", [BURN]),
        ("forces.impulses = [{name = 'a', epoch = '2012-04-08'}]\n", [BURN]),
    ],
)
def test_tables_of_all_forms_are_edited(tmp_path, text, impulses):
    (tmp_path / "study.toml").write_text(text)
    completed = completed_text(tmp_path / "study.toml", [CHANGE])
    forces = tomllib.loads(completed)["forces"]
    assert forces["impulses"] == [*impulses, {"name": "b", "epoch": "2012-04-09"}]
    assert forces["degree"] == 60
    assert "gravity" not in forces
    assert all(comment in completed for comment in ("# all",) if comment in text)
