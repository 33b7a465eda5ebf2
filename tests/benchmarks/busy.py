"""Processes that are measured; times of a busy machine are no reason to fail."""

import os
import subprocess
import sys
import time

import pytest


def skip_if_busy(most_load: float, what: str) -> None:
    """Skip the test if the load of the last minute is larger; `what` says which figures then say nothing."""
    load = os.getloadavg()[0]
    if load > most_load:
        pytest.skip(f"the machine is busy (load {load:.1f}): {what}")


# A process is told the peak of the one that starts it as its own, and the tests are large: a small one is between.
_BETWEEN = """
import resource, subprocess, sys
code = subprocess.call(sys.argv[1:])
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"\\n{usage.ru_utime + usage.ru_stime} {usage.ru_maxrss}")
sys.exit(code)
"""


def run(folder, *command, **environment):
    """Wall time, s, CPU time, s, peak memory, MB, and the output of a process of Python."""
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", _BETWEEN, sys.executable, *command],
        cwd=folder,
        env=os.environ | {"PYTHONWARNINGS": "ignore"} | environment,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    wall_s = time.perf_counter() - started
    assert done.returncode == 0, done.stdout
    output, _, measured = done.stdout.rstrip("\n").rpartition("\n")
    cpu_s, peak = measured.split()
    peak_kb = float(peak) / (1024 if sys.platform == "darwin" else 1)
    return wall_s, float(cpu_s), peak_kb / 1e3, output
