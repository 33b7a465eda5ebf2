"""Whatever happens to a file, reading it gives a result or one of the library's errors, in bounded time and memory."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_readers import ALL

TESTS = Path(__file__).parents[1]
SLOW = ("solution_export", "solution_map", "solution_page", "solution_verify", "resume", "cube", "map")
"""Targets that draw, fit, or have large files."""


def fuzz(*arguments):
    return subprocess.run(
        [sys.executable, TESTS / "support" / "fuzz_readers.py", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS / "support")])},
        capture_output=True,
        text=True,
        check=False,
    )


def test_damaged_files(tmp_path):
    names = [name for name in ALL if name not in SLOW]
    run = fuzz("--target", ",".join(names), tmp_path, 1, 1.0)
    failed = [line for line in run.stdout.splitlines() if line.startswith("FAILED")]
    assert run.returncode == 0, f"{run.stdout[-500:]}: {run.stderr[-3000:]}"
    assert not failed
    assert run.stdout.count(" done\n") == len(names)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_damaged_files_of_all_targets_each_in_a_process(seed, tmp_path):
    run = fuzz(tmp_path, seed, 120.0)
    assert run.returncode == 0, f"{run.stdout[-5000:]}: {run.stderr[-5000:]}"
    assert re.search(r"all +\d+ files +\d+ refused +0 failures", run.stdout)
