"""Processes that are measured; times of a busy machine are no reason to fail."""

from __future__ import annotations

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


def run(folder, *command, **environment):
    """Wall time, s, CPU time, s, peak memory, MB, and the output of a process of Python."""
    started = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *command],
        cwd=folder,
        env=os.environ | {"PYTHONWARNINGS": "ignore"} | environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    output = process.stdout.read()
    process.stdout.close()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, output
    peak_kb = usage.ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    return time.perf_counter() - started, usage.ru_utime + usage.ru_stime, peak_kb / 1e3, output
