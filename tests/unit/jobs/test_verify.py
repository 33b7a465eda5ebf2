"""Solutions made again: the same, different, or not to be made any more, as the command tells it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from quick import undrawn

import radioloc
from radioloc import verify
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.report.files import INCOMPLETE

pytestmark = pytest.mark.usefixtures("unsearched")
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "apollo15"
DATA = "apollo15_apollo_2006-2007.csv"
STUDY = """
[target]
longitude_deg = 3.6
latitude_deg = 26.1
height_m = -1900.0
[observations]
files = ["apollo15*.csv"]
[estimate]
range_bias = "all"
range_bias_sigma_m = 0.1
"""


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """A study with its data, and its solution."""
    folder = tmp_path_factory.mktemp("made")
    shutil.copy(EXAMPLE / DATA, folder)
    (folder / "s.toml").write_text(STUDY)
    with undrawn():
        assert main(["locate", str(folder / "s.toml"), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder


@pytest.fixture
def copy(example, tmp_path):
    """The same in another folder, whose solution names the study there."""
    shutil.copytree(example, tmp_path / "copy")
    folder = tmp_path / "copy"
    change(folder, lambda content: content["provenance"]["study"].update(file=str(folder / "s.toml")))
    return folder


def change(folder, edit):
    file = folder / "out" / "solution.json"
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


@pytest.mark.study
def test_the_same(example, capsys):
    assert main(["verify", str(example / "out" / "solution.json")]) == 0
    output = capsys.readouterr()
    assert "SAME in all of " in output.out
    assert output.err == ""


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_residuals_and_arcs_are_verified_as_such(copy, capsys):
    study = str(copy / "s.toml")
    assert main(["residuals", study, "--out", str(copy / "out"), "--quiet"]) == 0
    assert verify(copy / "out" / "solution.json").same
    assert main(["arcs", study, "--hours", "4000", "8000", "--out", str(copy / "arcs"), "--quiet"]) == 0
    for hours in (4000, 8000):
        file = copy / "arcs" / f"{hours}h" / "solution.json"
        fit = json.loads(file.read_text())["fit"]
        assert fit["used"] + fit["rejected"] < 153
        assert verify(file).same
    (copy / "arcs" / INCOMPLETE).touch()
    with pytest.raises(InputError, match="not written completely"):
        verify(file)


@pytest.mark.parametrize(
    ("edit", "names"),
    [
        (lambda c: c["position"]["pa"].update(y_m=c["position"]["pa"]["y_m"] + 1e-3), ["position.pa.y_m"]),
        (lambda c: c["covariance"]["enu_m2"][0].__setitem__(0, 1.0), ["covariance.enu_m2.0.0"]),
        (lambda c: c["budget"][0].update(total_m=99.0), ["budget.0.total_m"]),
        (lambda c: c["parameters"].pop(), ["parameters.range_bias.APOLLO"]),
        (lambda c: c["parameters"][3].update(value=0.2), ["parameters.range_bias.APOLLO.value"]),
        (lambda c: c["position"]["pa"].update(y_m=c["position"]["pa"]["y_m"] + 2e-5), []),
    ],
)
def test_what_differs_is_named(edit, names, copy, monkeypatch, repeat):
    change(copy, edit)
    solution = verify(copy / "out" / "solution.json")
    assert [item.name for item in solution.differences] == names
    assert solution.same == (not names)


@pytest.fixture(scope="module")
def repeat(example):
    """The fit once for all cases: what is compared is changed in the file only."""
    solution = radioloc.locate(radioloc.read_study(example / "s.toml"))
    patch = pytest.MonkeyPatch()
    patch.setattr("radioloc.jobs.verification.locate", lambda study: solution)
    yield
    patch.undo()


def altered(file, content=None):
    return lambda folder: (folder / file).write_text(
        (folder / file).read_text() + "\n" if content is None else content
    )


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (altered(DATA), f"cannot be repeated from .*s.toml: {DATA} has another content"),
        (lambda folder: shutil.copy(folder / DATA, folder / "apollo15_2.csv"), "apollo15_2.csv is new"),
        (altered("s.toml"), "s.toml has changed"),
        (lambda folder: change(folder, lambda c: c["provenance"].pop("study")), "expected a solution of a study file"),
        (altered("out/INCOMPLETE", "x"), "not written completely"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_again_says_why(edit, words, copy, capsys):
    edit(copy)
    file = copy / "out" / "solution.json"
    with pytest.raises(InputError, match=words):
        verify(file)
    assert main(["verify", str(file)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_study_that_has_moved(copy, repeat):
    moved = (copy / "s.toml").rename(copy / "t.toml")
    assert verify(copy / "out" / "solution.json", moved).same


@pytest.mark.study
@pytest.mark.usefixtures("undrawn")
def test_what_was_changed_in_python_is_not_taken_for_the_file(copy):
    study = radioloc.read_study(copy / "s.toml")
    second = replace(study, estimate=replace(study.estimate, rejection_sigma=4.0))
    radioloc.write_report(copy / "out", radioloc.locate(second))
    with pytest.raises(InputError, match=r"its settings differ \(estimate\)"):
        verify(copy / "out" / "solution.json")
    changes = radioloc.read_observations(copy / DATA).select(range(100))
    solution = radioloc.compute_residuals(study, replace(changes, files=("other.csv",)))
    assert solution.provenance["study"] is None
