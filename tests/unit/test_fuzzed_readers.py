"""Whatever happens to a file, reading it gives a result or one of the library's errors, in bounded time and memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from quick import some

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize(("seed", "seconds"), some([(1, 1.0), (2, 60.0), (3, 60.0)], [(1, 1.0)]))
def test_damaged_files(seed, seconds, tmp_path):
    run = subprocess.run(
        [sys.executable, TESTS / "toys" / "fuzz_readers.py", tmp_path, str(seed), str(seconds)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS / "toys")])},
        capture_output=True,
        text=True,
        check=False,
    )
    last = run.stdout.splitlines()[-1:]
    assert run.returncode == 0, f"{last}: {run.stderr[-5000:]}"
    assert last[0].split()[1] == "done:"
