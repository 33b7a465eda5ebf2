"""Completed study files: results of the search, preserved comments, the command."""

import json
import tomllib
from dataclasses import replace

import change5_case
import numpy as np
import pytest

import radioloc
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.io.formats import write_observations
from radioloc.measurements import PhysicalModel
from radioloc.search import search
from radioloc.search.completed_file import Change, completed_text

DISTANT_TARGET = """
# A-priori position from another site.
[target]
longitude_deg = 8.0  # of another site
latitude_deg = 43.0
height_m = 0.0
[observations]
files = ["tracking.csv"]
hours = 4.0
[model]
off = ["ionosphere"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("far")
    write_observations(folder / "tracking.csv", change5_case.observations(PhysicalModel.build(), 1200.0))
    (folder / "study.toml").write_text(DISTANT_TARGET)
    return folder


def test_command_writes_a_study_that_needs_no_search(folder, capsys):
    completed = folder / "completed.toml"
    assert main(["search", str(folder / "study.toml"), "--out", str(completed), "--json"]) == 0
    [position] = json.loads(capsys.readouterr().out)["apriori_positions"]
    assert "# A-priori position from another site." in completed.read_text()
    target = tomllib.loads(completed.read_text())["target"]
    assert target == {key: position[key] for key in ("frame", "longitude_deg", "latitude_deg", "height_m")}
    solution = radioloc.locate(completed)
    assert solution.converged
    assert np.linalg.norm(solution.position_pa_m - change5_case.LANDER.to_frame("PA_DE421").xyz_m) < 50.0
    assert not any("radioloc search" in note for note in solution.notes)
    assert main(["search", str(completed), "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_completed_study_needs_the_folder_of_its_file(folder, tmp_path):
    result = search(folder / "study.toml")
    with pytest.raises(InputError, match="in the folder of"):
        result.write(tmp_path / "completed.toml")
    with pytest.raises(InputError, match="from a file"):
        replace(result, study=replace(result.study, path=None)).write(folder / "completed.toml")


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
