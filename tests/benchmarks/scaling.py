"""Time and memory of preparing and fitting a thousand to ten million observations, and a figure of them.

``make scaling``; or ``python tests/benchmarks/scaling.py FIGURE.png [MOST]``. The tracking is that of Chang'e-5 at 1 Hz
on nine links, longer and longer: ten million observations are a month. Each number of observations has a process of
its own, which reads them, pickled, from a file made before; what it needs beyond them is its peak.
"""

import json
import pickle
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import fields
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "support")]

COUNTS = (1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
RATE_HZ = 3.0
"""Smallest number of observations per second of any day of the month."""


def make(path: Path, count: int) -> None:
    """Simulate a number of observations and store their columns."""
    from change5_case import LANDER, NOISE, RANGING, START, VLBI

    import radioloc
    from radioloc.simulation import Scenario, Schedule, Session, all_ranges, baselines
    from radioloc.time import epochs_from_strings, tai_to_utc, utc_strings, utc_to_tai

    model = radioloc.measurements.PhysicalModel.build(off=["ionosphere"])
    start = utc_to_tai(epochs_from_strings([START], "UTC"))
    stop = str(utc_strings(tai_to_utc(start.shifted(count / RATE_HZ + 120.0)), decimals=0)[0])
    sessions = [
        Session("range", all_ranges(*RANGING), START, stop, 1.0, sigma_m=1.0, one_uplink=True),
        Session("vlbi_delay", baselines(*VLBI), START, stop, 1.0, sigma_m=0.3),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", radioloc.errors.RadiolocWarning)
        simulated = Scenario(Schedule(sessions), LANDER, noise=NOISE, seed=1).world(model).draw().observations
    if len(simulated) < count:
        raise ValueError(f"{len(simulated)} observations to {stop}, too few for {count}")
    path.write_bytes(pickle.dumps(simulated.select(slice(0, count))))


def fit(path: Path) -> None:
    """Prepare and fit the observations of a file; print times and memory."""
    from change5_case import STUDY

    import radioloc
    from radioloc.jobs.locate import fit_arc
    from radioloc.jobs.preparation import prepared_arc

    with path.open("rb") as file:
        observations = pickle.load(file)
    epoch, columns = observations.epoch, (getattr(observations, f.name) for f in fields(observations))
    held = sum(getattr(column, "nbytes", 0) for column in (epoch.jd, epoch.fraction, *columns))
    study_file = path.with_suffix(".toml")
    study_file.write_text(STUDY)
    study_file.with_name("change5.csv").touch()
    study = radioloc.read_study(study_file)
    before_kb = _peak_kb()
    times = [(time.perf_counter(), time.process_time())]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", radioloc.errors.RadiolocWarning)
        arc, left_out = prepared_arc(study, observations)
        times.append((time.perf_counter(), time.process_time()))
        solution = fit_arc(study, arc, left_out)
        times.append((time.perf_counter(), time.process_time()))
    peak_kb = _peak_kb()
    wall_s, processor_s = (np.diff([at[k] for at in times]) for k in (0, 1))
    figures = {"observations": len(observations), "held_mb": held / 1e6, "before_mb": before_kb / 1e3}
    figures |= {"prepare_s": wall_s[0], "fit_s": wall_s[1], "peak_mb": peak_kb / 1e3}
    figures |= {"prepare_cpu_s": processor_s[0], "fit_cpu_s": processor_s[1], "converged": solution.converged}
    print(json.dumps(figures))


def _peak_kb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024 if sys.platform == "darwin" else peak


def measure(max_count: int) -> list[dict[str, float]]:
    """Return figures for each number of observations, the best of three runs for short ones."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        for count in [count for count in COUNTS if count <= max_count]:
            path = Path(folder) / f"{count}.pickle"
            _run("make", path, count)
            runs = [json.loads(_run("fit", path)) for _ in range(3 if count < 1_000_000 else 1)]
            figures.append(min(runs, key=cpu_s))
            path.unlink()
            print(row(figures[-1]), flush=True)
    return figures


def _run(*arguments: object) -> str:
    command = [sys.executable, __file__, *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def cpu_s(run: dict[str, float]) -> float:
    """Return the processor time of preparing and fitting, s."""
    return run["prepare_cpu_s"] + run["fit_cpu_s"]


HEADER = """| observations | prepare, s | fit, s | CPU, s | data, MB | peak, MB | peak beyond the data, bytes each |
| ---: | ---: | ---: | ---: | ---: | ---: | ---: |"""


def row(run: dict[str, float]) -> str:
    """Return a row of the table."""
    beyond = (run["peak_mb"] - run["before_mb"]) * 1e6 / run["observations"]
    cells = (
        f"{run['observations']:,}".replace(",", " "),
        *(f"{run[key]:.2f}" for key in ("prepare_s", "fit_s")),
        f"{cpu_s(run):.2f}",
        *(f"{run[key]:.0f}" for key in ("held_mb", "peak_mb")),
        f"{beyond:.0f}",
    )
    return f"| {' | '.join(cells)} |"


def draw(figures: list[dict[str, float]], path: Path) -> None:
    """Draw time and memory over the number of observations, with linear references."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    n = np.array([run["observations"] for run in figures])
    time_s = np.array([cpu_s(run) for run in figures])
    peak_mb = np.array([run["peak_mb"] for run in figures])
    figure, (times, memory) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    times.loglog(n, time_s, "o-", color="tab:blue", label="prepare and fit")
    times.loglog(n, [run["prepare_cpu_s"] for run in figures], "s:", color="tab:orange", label="prepare")
    times.loglog(n, time_s[-1] * n / n[-1], "k--", lw=1.0, label="in proportion")
    times.set(
        xlabel="observations", ylabel="processor time, s", title="Time", ylim=(time_s.min() / 30.0, None)
    )
    memory.loglog(n, peak_mb, "o-", color="tab:blue", label="peak of the process")
    memory.loglog(n, [run["held_mb"] for run in figures], "s:", color="tab:orange", label="the observations")
    memory.loglog(n, peak_mb[-1] * n / n[-1], "k--", lw=1.0, label="in proportion")
    memory.set(xlabel="observations", ylabel="memory, MB", title="Memory", ylim=(10.0, None))
    for axes in (times, memory):
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Run the measurement or the figure of the arguments."""
    match sys.argv[1:]:
        case ["make", path, count]:
            make(Path(path), int(count))
        case ["fit", path]:
            fit(Path(path))
        case [figure, *counts]:
            print(HEADER)
            draw(measure(int(counts[0]) if counts else COUNTS[-1]), Path(figure))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
