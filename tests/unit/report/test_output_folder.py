"""Output folders: one result, one writer, the user's permissions, nothing left behind."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc import compare
from radioloc.errors import InputError
from radioloc.report import write_report
from radioloc.report.files import INCOMPLETE
from radioloc.results.subsets import Arc, ArcStudy
from radioloc.text_files import TEMPORARY_FILES, locked, write_text

pytestmark = pytest.mark.usefixtures("undrawn")
LOCKED = "import sys, time; from pathlib import Path; from radioloc.text_files import locked\n"
LOCKED += "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"


@pytest.fixture(scope="module")
def solution():
    model = ToyMoon(90, 72.0)
    paths = [f"{name}>lander>{name}" for name in model.station]
    toy = toy_solution(model, path=paths, reference_pa_m=LANDER_M, reference_name="truth")
    elevation_deg = np.full(len(toy.residuals), 45.0)
    return replace(toy, residuals=replace(toy.residuals, elevation_deg=elevation_deg))


def names(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_results_that_share_names_replace_each_other_whole_and_others_stay(solution, tmp_path):
    (tmp_path / "notes.txt").write_text("of the user")
    write_report(tmp_path, ArcStudy("toy", (Arc(72.0, 72.0, solution),)))
    assert "72h/solution.json" in names(tmp_path)
    write_report(tmp_path, solution)
    earlier_names = names(tmp_path)
    assert {"arcs.json", "solution.json", "residuals.csv", "notes.txt"} <= earlier_names
    write_report(tmp_path, compare([tmp_path / "solution.json"]))
    assert "arcs.json" not in names(tmp_path)
    assert not {name for name in names(tmp_path) if name.startswith(("72h/", "figure2."))}
    assert {"comparison.json", "solution.json", "notes.txt"} <= names(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="needs locks of POSIX")
def test_a_second_writer_is_refused_and_a_killed_one_leaves_nothing(solution, tmp_path):
    (tmp_path / INCOMPLETE).write_text("")
    (tmp_path / ".radioloc-0123456789abcdef.part").write_text("left by a run that was killed")
    writer = subprocess.Popen([sys.executable, "-c", LOCKED, tmp_path / INCOMPLETE], stdout=subprocess.PIPE)
    try:
        assert writer.stdout.readline() == b"locked\n"
        with pytest.raises(InputError, match="another run"):
            write_report(tmp_path, solution)
        assert "solution.json" not in names(tmp_path)
    finally:
        writer.kill()
        writer.communicate()
    write_report(tmp_path, solution)
    assert "solution.json" in names(tmp_path)
    assert not list(tmp_path.glob(TEMPORARY_FILES))
    assert INCOMPLETE not in names(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="needs permissions of POSIX")
@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_files_have_the_permissions_of_the_umask(umask, tmp_path):
    earlier_umask = os.umask(umask)
    try:
        write_text(tmp_path / "a.txt", "a\n")
        with locked(tmp_path / "a.txt"):
            pass
    finally:
        os.umask(earlier_umask)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o666 & ~umask
    assert names(tmp_path) == {"a.txt"}
