"""Runs that end early by a closed output, an interrupt, a kill or a full disk, and their files."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from change5_case import PLAN
from paths import EXAMPLES
from quick import some

from radioloc import cli
from radioloc.report.files import INCOMPLETE
from radioloc.text_files import write_blocks, write_text

APOLLO = EXAMPLES / "apollo15" / "apollo15.toml"
RADIOLOC = [sys.executable, "-m", "radioloc"]

# Killed where the first figure is written, as by a system that is short of memory.
KILLED = """
import os, signal, sys
import radioloc.report.files
from radioloc.cli import main
radioloc.report.files.write_figure = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
main(["locate", *sys.argv[1:]])
"""


@pytest.fixture(autouse=True)
def _no_measured_coverage(monkeypatch):
    """Disable the measurement of coverage, which killed processes and full disks spoil."""
    monkeypatch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)


def run(*command, **options):
    return subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=120, **options)


def one_line(done, status, *parts):
    assert done.returncode == status, done.stderr
    assert done.stderr.startswith("radioloc: ")
    assert done.stderr.count("\n") == 1
    for part in parts:
        assert part in done.stderr


@pytest.mark.parametrize("arguments", some([["stations"], ["--help"], ["--version"]], [["stations"]]))
def test_a_reader_that_stops_reading(arguments):
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run([*RADIOLOC, *arguments], stdout=write, stderr=subprocess.PIPE, timeout=600)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.slow
@pytest.mark.parametrize("end", ["| true", ">&-"])
def test_the_exit_status_does_not_depend_on_who_reads(end, tmp_path):
    """A position that two points do not determine is an error with a closed output too."""
    lines = (APOLLO.parent / "apollo15_apollo_2006-2007.csv").read_text().splitlines(keepends=True)
    (tmp_path / "d.csv").write_text("".join(lines[:6]))
    study = "[target]\nlongitude_deg = 3.5\nlatitude_deg = 26.0\nheight_m = -1000.0\n"
    (tmp_path / "s.toml").write_text(f'{study}[observations]\nfiles = ["d.csv"]\n')
    command = " ".join([*RADIOLOC, "locate", str(tmp_path / "s.toml")])
    done = run("bash", "-c", f"{command} {end}; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stderr) == (3, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
def test_output_to_a_full_disk():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*RADIOLOC, "stations"], stdout=full, stderr=subprocess.PIPE, text=True)
    one_line(done, 1, "standard output: No space left on device")


def limited():
    """The limit of a file's size, which as a full disk lets a program write some of a file."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))


@pytest.mark.study
def test_a_file_that_the_disk_cannot_take(tmp_path):
    table = APOLLO.parent / "apollo15_apollo_2006-2007.csv"
    done = run(*RADIOLOC, "convert", table, tmp_path / "a.parquet", preexec_fn=limited)
    one_line(done, 1, "a.parquet: cannot be written", "make room on the disk")


@pytest.mark.slow
def test_a_folder_that_the_disk_cannot_take(tmp_path):
    # So that all is compiled, which writes files as well.
    assert cli.main(["locate", str(APOLLO), "--quiet"]) == 0
    done = run(*RADIOLOC, "locate", APOLLO, "--out", tmp_path, preexec_fn=limited)
    one_line(done, 1, str(tmp_path), "cannot be written", "make room on the disk")
    assert {path.name for path in tmp_path.iterdir()} == {INCOMPLETE}


def test_content_is_on_the_disk_before_it_replaces_other(tmp_path, monkeypatch):
    file = tmp_path / "a.txt"
    write_text(file, "old")
    lines = []

    def fsync(handle):
        lines.append((os.fstat(handle).st_size, file.read_text()))

    monkeypatch.setattr(os, "fsync", fsync)
    write_blocks(file, [b"new ", b"content"])
    assert lines == [(11, "old")]
    assert file.read_text() == "new content"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_folder_that_was_not_finished_says_so(tmp_path, capsys):
    """New numbers beside the figures of an earlier run are not taken for one result."""
    assert cli.main(["locate", str(APOLLO), "--out", str(tmp_path), "--quiet", "--terms"]) == 0
    complete = {path.name for path in tmp_path.iterdir()}
    assert INCOMPLETE not in complete
    target = "[target]\nlongitude_deg = 3.6\nlatitude_deg = 26.1\nheight_m = -1900.0\n"
    files = f'files = ["{APOLLO.parent / "apollo15_apollo_2006-2007.csv"}"]'
    study = tmp_path / "other.toml"
    study.write_text(f"{target}[observations]\n{files}\nstop = 2006-12-31\n")
    killed = run(sys.executable, "-c", KILLED, study, "--out", tmp_path)
    assert killed.returncode == -signal.SIGKILL
    assert json.loads((tmp_path / "solution.json").read_text())["name"] == "other"
    assert {path.name for path in tmp_path.iterdir()} == complete | {INCOMPLETE, "other.toml"}
    assert cli.main(["residuals", str(study), "--out", str(tmp_path), "--quiet"]) == 0
    listed = {path.name for path in tmp_path.iterdir()}
    figures = {f"{name}.{end}" for name in ("residuals",) for end in ("png", "svg")}
    assert listed == {"other.toml", "solution.json", "residuals.csv"} | figures


def started(tmp_path, *options, command=()):
    """A Monte Carlo study under way, a session of its own with its workers."""
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    trials = ["--trials", 100_000, "--hours", 6]
    command = (
        [*command, plan, tmp_path]
        if command
        else [*RADIOLOC, "montecarlo", plan, *trials, "--out", tmp_path, *options]
    )
    process = subprocess.Popen(
        [*map(str, command)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    for _ in range(1200):
        if any((tmp_path / "parts").glob("*.npz")) or process.poll() is not None:
            break
        time.sleep(0.1)
    return process


def has_ended(session):
    """Return whether all processes of a session end within a minute."""
    for _ in range(600):
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    os.killpg(session, signal.SIGKILL)
    return False


@pytest.mark.slow
@pytest.mark.parametrize("workers", some([1, 2], [1]))
def test_an_interrupted_monte_carlo_study_says_how_to_go_on(workers, tmp_path):
    process = started(tmp_path, "--workers", workers)
    os.killpg(process.pid, signal.SIGINT)
    _, output = process.communicate(timeout=600)
    assert process.returncode == 130, output
    advice = f"{tmp_path} keeps what is computed so far, and the same command with --resume goes on"
    assert output == f"radioloc: interrupted; {advice}\n"
    assert has_ended(process.pid)
    count = 25 * len(list((tmp_path / "parts").iterdir()))
    arguments = [
        "montecarlo",
        str(tmp_path / "plan.toml"),
        "--trials",
        str(count),
        "--hours",
        "6",
        "--out",
        str(tmp_path),
    ]
    assert cli.main([*arguments, "--resume", "--quiet"]) == 0


SCRIPT = """
import sys
import radioloc
if __name__ == "__main__":
    radioloc.monte_carlo(sys.argv[1], 100_000, 6.0, workers=2, out=sys.argv[2])
"""


@pytest.mark.slow
def test_an_interrupted_script_has_one_exception_and_leaves_no_workers(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    process = started(tmp_path, command=[sys.executable, tmp_path / "script.py"])
    os.killpg(process.pid, signal.SIGINT)
    _, output = process.communicate(timeout=600)
    assert output.count("Traceback") == output.count("KeyboardInterrupt") == 1
    assert has_ended(process.pid)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_workers_end_with_their_parent(tmp_path):
    process = started(tmp_path, "--workers", 2)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=600)
    assert has_ended(process.pid)


def test_an_interrupt_anywhere_else_is_one_line(monkeypatch, capsys):
    def interrupted(study):
        raise KeyboardInterrupt

    monkeypatch.setattr("radioloc.read_study", interrupted)
    assert cli.main(["locate", str(APOLLO)]) == 130
    assert capsys.readouterr().err == "radioloc: interrupted\n"
