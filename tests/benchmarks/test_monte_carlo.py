"""A thousand trials of the one-a-minute Chang'e-5 study, three arcs each, from a cold start, against whole fits."""

import os
import subprocess
import sys
import time
from pathlib import Path

from busy import skip_if_busy

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "change5" / "simulation.toml"
TRIALS = 1000
FULL = 6
LIMIT_S = 20.0
"""On two idle cores."""


def montecarlo_s(trials, *options):
    """Return the wall time of the command in a separate process, s."""
    command = [
        sys.executable,
        "-m",
        "radioloc",
        "montecarlo",
        str(EXAMPLE),
        "--trials",
        str(trials),
        "--quiet",
    ]
    start = time.perf_counter()
    subprocess.run([*command, *options], check=True, timeout=600)
    return time.perf_counter() - start


def test_a_thousand_trials(benchmark, tmp_path, capsys):
    workers = min(2, os.cpu_count() or 1)
    options = ("--workers", str(workers), "--out", str(tmp_path))
    taken_s = benchmark.pedantic(montecarlo_s, args=(TRIALS, *options), rounds=1)
    start_s = montecarlo_s(1, "--full")
    full_s = (montecarlo_s(1 + FULL, "--full") - start_s) / FULL
    with capsys.disabled():
        print(f"\n{TRIALS} trials of three arcs, {workers} processes: {taken_s:.1f} s from start to figures")
        print(
            f"  {TRIALS * full_s / taken_s:.0f} times faster than whole fits one after the other ({full_s:.2f} s each)"
        )
    benchmark.extra_info["times_faster_than_whole_fits"] = TRIALS * full_s / taken_s
    skip_if_busy(workers + 0.5, f"{taken_s:.1f} s cannot be compared with {LIMIT_S:g} s")
    assert taken_s < LIMIT_S
