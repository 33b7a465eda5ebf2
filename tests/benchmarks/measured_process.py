"""Time and memory of a process of Python."""

import os
import subprocess
import sys
import time

# A process inherits the peak memory of its parent; a small process between them resets it.
_BETWEEN = """
import resource, subprocess, sys
code = subprocess.call(sys.argv[1:])
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"\\n{usage.ru_utime + usage.ru_stime} {usage.ru_maxrss}")
sys.exit(code)
"""


def run(folder, *command, **environment):
    """Return wall time, s, CPU time, s, peak memory, MB, and output of a process of Python."""
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", _BETWEEN, sys.executable, *command],
        cwd=folder,
        # Byte code is kept, as by users: without it each command compiles the whole source.
        env=os.environ | {"PYTHONWARNINGS": "ignore", "PYTHONDONTWRITEBYTECODE": ""} | environment,
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
