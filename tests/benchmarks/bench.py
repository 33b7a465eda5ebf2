"""Benchmarks of speed in one table: what a task takes, its goal, and how other programs compare in the same run.

    make bench BENCH_ARGS="GROUP ..."

Groups are the functions below; ``images`` draws its frames for minutes and runs only if it is named. Times are of
processor time, which a busy machine changes little. The exit status is 1 if a task takes more than three times its
goal, or another program is not slower by the stated factor.
"""

import json
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import numpy as np
import others
from change5_case import LANDER, RANGING, STUDY, VLBI
from harmonic_series import Series, solved
from low_orbit import forces, propagated
from measured_process import run
from tdm_messages import TWO_WAY, kvn, xml

import radioloc
from radioloc.earth.stations import StationCatalogue
from radioloc.io.tdm import TdmAgreement, read_tdm
from radioloc.measurements import ExactPredictor, FixedPoint, Link, PhysicalModel, prepare_predictor
from radioloc.measurements._kernels import _polynomial
from radioloc.measurements.registry import kind_of
from radioloc.simulation import Schedule, Session, all_ranges, baselines
from radioloc.time import Epochs, epochs_from_strings, tt_to_tdb, utc_to_tt

EXAMPLES = Path(__file__).parents[2] / "examples"
GENEROUS = 3.0  # times the goal before the exit status is 1: an old or busy machine is slower
START, STOP = "2020-12-01T15:11:00", "2020-12-03T15:10:00"
APOLLO_15 = radioloc.LunarPosition.from_selenographic(3.628, 26.133, -1500.0)


@dataclass(frozen=True)
class Row:
    """Row of the table; `is_factor` for a quantity that is to be larger than its goal."""

    task: str
    value: float
    unit: str
    goal: float
    is_factor: bool = False

    @property
    def ratio(self) -> float:
        """Value over goal, or goal over value of a factor; up to one if the goal is reached."""
        return self.goal / self.value if self.is_factor else self.value / self.goal

    @property
    def failed(self) -> bool:
        """True for values far from the goal."""
        return self.ratio > (1.0 if self.is_factor else GENEROUS)

    def __str__(self) -> str:
        goal = f"{'>' if self.is_factor else '<'} {self.goal:g}"
        return f"| {self.task:<58} | {self.value:>9.3g} {self.unit:<6} | {goal:>7} | {self.ratio:>6.2f} |"


HEADING = f"| {'task':<58} | {'value':>16} | {'goal':>7} | ratio |\n| {'-' * 58} | {'-' * 15}: | {'-' * 6}: | -----: |"


def cpu_s(function, runs: int = 3) -> float:
    """Return the least processor time of some runs, s."""
    taken_s = []
    for _ in range(runs):
        start = time.process_time()
        function()
        taken_s.append(time.process_time() - start)
    return min(taken_s)


def in_turns(*functions, turns: int = 5) -> list[float]:
    """Return the least processor times of functions that alternate, s."""
    return np.min([[cpu_s(function, 1) for function in functions] for _ in range(turns)], axis=0).tolist()


def predictions(folder: Path) -> Iterator[Row]:
    """Predict ranges and VLBI delays of 48 hours at 1 Hz with all partials, beside other programs."""
    model = PhysicalModel.build()
    sender, receiver = (model.catalogue.get(name).itrf_m for name in RANGING[1::-1])
    place_pa_m = LANDER.to_axes("PA", model.ephemeris.constants).xyz_m
    sessions = [
        Session("range", all_ranges(*RANGING), START, STOP, 1.0, sigma_m=1.0),
        Session("vlbi_delay", baselines(*VLBI), START, STOP, 1.0, sigma_m=0.3),
    ]
    planned = Schedule(sessions).plan(model, LANDER).observations
    numba.set_num_threads(1)
    own_s = {}
    for name, kind in (("three-way range", "range"), ("VLBI delay", "vlbi_delay")):
        observations = planned.select(planned.kind == kind_of(kind))
        arc = prepare_predictor(model, observations, FixedPoint(place_pa_m))
        order = np.lexsort((observations.epoch.fraction, observations.epoch.jd, observations.link))
        arcs, floor = (arc, arc.select(order)), floor_of(arc, place_pa_m)
        cases = [lambda arc=arc: in_blocks(arc, place_pa_m) for arc in arcs]
        in_turns(*cases, floor, turns=1)  # compiles
        by_time_s, by_link_s, floor_s = (s / len(observations) for s in in_turns(*cases, floor))
        own_s[name] = by_time_s
        yield Row(f"{name}, all terms and partials, one thread", 1e9 * by_time_s, "ns", 40.0)
        yield Row(f"{name} over bare polynomials", by_time_s / floor_s, "", 4.0)
        yield Row(f"{name} over bare polynomials, link by link", by_link_s / floor_s, "", 4.0)
    sample = planned.select(slice(0, 4096))
    exact = ExactPredictor(model, sample, FixedPoint(place_pa_m))
    yield Row("observation by the exact path, prepared", 1e6 * cpu_s(exact.compute) / len(sample), "us", 10.0)
    tdb = tt_to_tdb(utc_to_tt(epochs_from_strings(["2020-12-01T21:00:00"], "UTC")))
    tdb_s = float((tdb.jd[0] - 2451545.0 + tdb.fraction[0]) * 86400.0) + np.arange(720.0)
    for program, min_factor in (
        (others.SpiceLoop, 1000.0),
        (others.Skyfield, 300.0),
        (others.Astropy, 300.0),
        (others.OrekitLoop, 300.0),
    ):
        try:
            geometry = program(folder)
        except (ImportError, FileNotFoundError) as error:  # no Java, or not installed
            print(f"{program.__name__}: not compared ({error})", file=sys.stderr)
            continue
        evaluated = [lambda: geometry.three_way_m(sender, place_pa_m, receiver, tdb_s)]  # noqa: B023
        other_s = min(in_turns(*evaluated, turns=3)) / len(tdb_s)
        geometry.close()
        factor = other_s / own_s["three-way range"]
        yield Row(f"{program.__name__}, geometry only, over this range", factor, "times", min_factor, True)


def in_blocks(arc, place_pa_m, block: int = 65536) -> None:
    """Compute values and partials of all observations in blocks of rows, as in a fit."""
    prediction = arc.predict(FixedPoint(place_pa_m))
    for first in range(0, len(arc.observations), block):
        prediction.rows(slice(first, first + block))


def floor_of(arc, place_pa_m):
    """Return the evaluation of the same polynomials alone, of one segment at sorted times in the nearest cache."""
    coefficients = arc.predict(FixedPoint(place_pa_m))._coefficients[:1]
    x = np.linspace(-1.0, 1.0, 1024)
    return lambda: polynomials(coefficients, x, len(arc.observations))


@numba.njit
def polynomials(coefficients, x, n):
    out, total = np.empty(x.shape[0]), 0.0
    for _ in range(0, n, x.shape[0]):
        for q in range(coefficients.shape[1]):
            _polynomial(coefficients[0, q], x, out)
            total += out[0]
    return total


def far_apart(folder: Path) -> Iterator[Row]:
    """Prepare and predict observations at random epochs of fifty years, such as laser points."""
    model, random = PhysicalModel.build(), np.random.default_rng(1)
    place_pa_m = APOLLO_15.to_axes("PA", model.ephemeris.constants).xyz_m
    lasers, antennas = ("APOLLO", "GRASSE", "MATERA", "MLRS2", "WETTZELL"), ("KASHI", "NEUQUEN")
    for kind, count, paths, columns, goal_us in (
        ("range", 10_000, [f"{a}>x>{a}" for a in lasers], {"value_m": 7.6e8, "wavelength_um": 0.532}, 50.0),
        (
            "doppler",
            5_000,
            [f"{a}>x>{b}" for a in antennas for b in antennas],
            {"value_m": 1.0, "wavelength_um": 35_700.0, "count_s": 60.0},
            100.0,
        ),
    ):
        observations = radioloc.Observations.from_columns(
            epoch=Epochs.from_jd(2441700.5 + np.sort(random.uniform(0.0, 18_900.0, count)), 0.0, "UTC"),
            links=[Link.from_path(path) for path in paths],
            link=random.integers(0, len(paths), count),
            kind=kind_of(kind),
            sigma_m=0.02,
            pressure_hpa=900.0,
            temperature_k=285.0,
            relative_humidity=0.5,
            **columns,
        )
        taken_s = cpu_s(lambda: ExactPredictor(model, observations, FixedPoint(place_pa_m)).compute())  # noqa: B023
        yield Row(f"{kind} at random epochs of fifty years", 1e6 * taken_s / count, "us", goal_us)


def fits(folder: Path) -> Iterator[Row]:
    """Fit harmonics with outliers and additive noise, with all of the solution."""
    for count, goal_s in ((100_000, 1.0), (1_000_000, 10.0)):
        series = Series(count, p=9, excess_m=0.02, blunders=0.01)
        yield Row(
            f"fit of {count:,} observations, 9 parameters", cpu_s(partial(solved, series), 1), "s", goal_s
        )


def orbits(folder: Path) -> Iterator[Row]:
    """Integrate a low orbit with its partials."""
    for hours, goal_s in ((4.0, 1.0), (24.0, 5.0)):
        field, options = forces(150, radiation_m2_kg=0.02), {"parameters": ("radiation",)}
        propagated(field, (0.0, 60.0), **options)  # compiles
        taken_s = cpu_s(lambda: propagated(field, (0.0, 3600.0 * hours), **options))  # noqa: B023
        yield Row(f"{hours:g} h of a low orbit to degree 150 with partials", taken_s, "s", goal_s)


def messages(folder: Path) -> Iterator[Row]:
    """Read Tracking Data Messages of 200,000 records."""
    minutes, seconds = np.divmod(np.arange(200_000), 60)
    hours, minutes = np.divmod(minutes, 60)
    days, hours = np.divmod(hours, 24)
    records = [
        f"RANGE = 2021-03-{day + 1:02d}T{hour:02d}:{minute:02d}:{second:02d}.000 {768800.1 + 1e-3 * k:.9f}"
        for k, (day, hour, minute, second) in enumerate(zip(days, hours, minutes, seconds, strict=True))
    ]
    settings = {"catalogue": StationCatalogue.default()}
    for name, text in (("kvn", lambda segment: "\n".join(kvn(segment))), ("xml", xml)):
        path = folder / f"records.{name}"
        path.write_text(text((TWO_WAY, records)))
        taken_s = cpu_s(lambda: read_tdm(path, TdmAgreement(sigma_m={"range": 1.0}), **settings))  # noqa: B023
        yield Row(f"million records of a TDM, {name}", 5.0 * taken_s, "s", 5.0)


def commands(folder: Path) -> Iterator[Row]:
    """Run commands in processes of their own: the first ever, a small study, and two days at 1 Hz."""
    apollo = ("-m", "radioloc", "locate", str(EXAMPLES / "apollo15" / "apollo15.toml"), "--quiet")
    _, taken_s, _, _ = run(folder, *apollo, NUMBA_CACHE_DIR=str(folder / "cache"))
    yield Row("first locate, with compilation", taken_s, "s", 5.0)
    yield Row("locate of the Apollo 15 example", min(run(folder, *apollo)[1] for _ in range(3)), "s", 1.2)
    plan = (EXAMPLES / "change5" / "simulation.toml").read_text()
    (folder / "plan.toml").write_text(plan.replace("step_s = 60.0", "step_s = 1.0"))
    (folder / "change5.toml").write_text(STUDY)
    _, taken_s, _, _ = run(
        folder, "-m", "radioloc", "simulate", "plan.toml", "--out", "change5.csv", "--quiet"
    )
    yield Row("simulate two days at 1 Hz", taken_s, "s", 10.0)
    locate = ("-m", "radioloc", "locate", "change5.toml", "--quiet")
    _, taken_s, peak_mb, _ = run(folder, *locate)
    yield Row("locate by 660,000 observations", taken_s, "s", 5.0)
    yield Row("locate by 660,000 observations, memory", peak_mb, "MB", 500.0)
    _, taken_s, peak_mb, _ = run(folder, *locate, "--out", "out")
    yield Row("locate by 660,000 observations, all files", taken_s, "s", 9.0)
    yield Row("locate by 660,000 observations, all files, memory", peak_mb, "MB", 500.0)


def planning(folder: Path) -> Iterator[Row]:
    """Run trials and a map of landing sites in one process."""
    plan = str(EXAMPLES / "change5" / "simulation.toml")
    start_s, total_s = (
        run(folder, "-m", "radioloc", "montecarlo", plan, "--workers", "1", "--quiet", "--trials", count)[1]
        for count in ("25", "225")
    )
    yield Row("Monte Carlo trial of three arcs", 5.0 * (total_s - start_s), "ms", 50.0)
    options = ("--grid", "3", "--workers", "1", "--quiet", "--out", "map")
    arc = str(EXAMPLES / "change5" / "short_arc.toml")
    _, taken_s, _, _ = run(folder, "-m", "radioloc", "covariance", arc, *options)
    yield Row("landing site of an accuracy map", 1e3 * taken_s / 3600.0, "ms", 12.0)


def images(folder: Path) -> Iterator[Row]:
    """Locate a lander by 240 frames of 2352 x 1728 pixels on a map of 10,000 x 10,000."""
    import descent_frames

    drawn = Path(tempfile.gettempdir()) / "radioloc_240_images"
    if not (drawn / "study.toml").exists():
        descent_frames.draw(drawn)
    _, taken_s, peak_mb, _ = run(drawn, "-m", "radioloc", "images", "study.toml", "--out", "out")
    yield Row("locate by 240 frames", taken_s, "s", 300.0)
    yield Row("locate by 240 frames, memory", peak_mb, "MB", 1200.0)
    content = json.loads((drawn / "out" / "solution.json").read_text())
    yield Row("errors of the located lander", descent_frames.error_sigmas(content), "sigmas", 3.0)


GROUPS = {
    function.__name__: function
    for function in (predictions, far_apart, fits, orbits, messages, commands, planning, images)
}


def main() -> int:
    """Print the table of the named groups."""
    names = sys.argv[1:] or [name for name in GROUPS if name != "images"]
    if unknown := set(names) - {*GROUPS}:
        sys.exit(f"expected groups of {', '.join(GROUPS)}, got {', '.join(sorted(unknown))}")
    print(HEADING)
    failed = False
    for name in names:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other programs
            for row in GROUPS[name](Path(folder)):
                print(row, flush=True)
                failed |= row.failed
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
