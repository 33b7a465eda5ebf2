"""Observations far apart: the full model, one point after the other; real laser points beside a spiceypy loop.

Points of lunar laser ranging are minutes to days apart, so none is interpolated: each is computed by itself.
``radioloc`` gives all terms and all partials, the loop bare geometry. So few points as the examples have, five
reflectors apart, cost what it takes to call array functions a few hundred times; "again" is once more, as in every step
of a fit. Run with ``make bench``.
"""

import time
import warnings
from pathlib import Path

import numpy as np
import others
import pytest

import radioloc
from radioloc.measurements.registry import kind_of
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt

# Other packages leave the kernel's file to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDERS = ("apollo15", "reflectors/2006-2007", "reflectors/2024")
REFLECTORS = {  # east, north, deg, to a hundred metres: where the light times end does not matter here
    "apollo11": (23.473, 0.673),
    "apollo14": (-17.478, -3.644),
    "apollo15": (3.628, 26.133),
    "luna17": (-35.008, 38.315),
    "luna21": (30.922, 25.832),
}
MOST_S = {"range": 4.0, "doppler": 3.0}
"""Processor time for so many observations of fifty years; a quiet core takes a third of it."""


@pytest.fixture(scope="module")
def model():
    return radioloc.measurements.PhysicalModel.build()


@pytest.fixture(scope="module")
def points(model):
    """Observations of each reflector, and where it is."""
    files = sorted(file for folder in FOLDERS for file in (EXAMPLES / folder).glob("*.csv"))
    read = radioloc.read_observations(files, catalogue=model.catalogue)
    targets = np.array([link.target for link in read.links])[read.link]
    found = []
    for name, (longitude_deg, latitude_deg) in REFLECTORS.items():
        place = radioloc.LunarPosition.from_selenographic(longitude_deg, latitude_deg, -1500.0)
        mine = read.select(targets == name)
        assert len(mine)
        found.append((mine, place.to_axes("PA", model.ephemeris.constants).xyz_m))
    return found


def best_s(function, rounds=5):
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def test_ratios(benchmark, model, points, tmp_path, capsys):
    def prepared():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", radioloc.errors.RadiolocWarning)
            return [
                (radioloc.measurements.ExactPredictor(model, mine, place), place) for mine, place in points
            ]

    arcs = prepared()

    def computed():
        return [arc.compute(place) for arc, place in arcs]

    n = sum(len(mine) for mine, _ in points)
    benchmark.pedantic(computed, rounds=10, warmup_rounds=1)
    compute_s = benchmark.stats.stats.min / n
    prepare_s = best_s(prepared, 3) / n

    loop = others.SpiceLoop(tmp_path)
    asked = []
    for mine, place in points:
        tdb = tt_to_tdb(utc_to_tt(mine.epoch))
        seconds = (tdb.jd - 2451545.0) * 86400.0 + tdb.fraction * 86400.0 + 2.6
        for link in np.unique(mine.link):
            ends = (mine.links[link].transmitter, mine.links[link].receiver)
            sender, receiver = (model.catalogue.get(name).itrf_m for name in ends)
            asked.append((sender, place, receiver, seconds[mine.link == link]))
    spice_s = best_s(lambda: [loop.three_way_m(*each) for each in asked], 3) / n
    loop.close()

    ratios = {"again": spice_s / compute_s, "with preparation": spice_s / (prepare_s + compute_s)}
    with capsys.disabled():
        print(
            f"\n{n} laser points: {1e6 * compute_s:.1f} us each with all terms and partials, prepared once in "
            f"{1e6 * prepare_s:.0f} us; spiceypy loop of bare geometry {1e6 * spice_s:.0f} us: "
            f"{ratios['again']:.0f} times faster again, {ratios['with preparation']:.1f} times with preparation"
        )
    benchmark.extra_info.update(ratios)
    assert ratios["again"] > 3.0


@pytest.mark.parametrize(
    ("kind", "count", "paths"),
    [
        ("range", 30_000, "{0}>x>{0}"),
        ("doppler", 10_000, "{0}>x>{1}"),
    ],
)
def test_fifty_years(benchmark, model, kind, count, paths, capsys):
    """Random epochs from 1973 to 2024: prepared, and values with all partials."""
    random = np.random.default_rng(1)
    stations = {"range": ("APOLLO", "GRASSE", "MATERA", "MLRS2", "WETTZELL"), "doppler": ("KASHI", "NEUQUEN")}
    links = [paths.format(a, b) for a in stations[kind] for b in stations[kind]]
    of_kind = {
        "range": {"value_m": 7.6e8, "wavelength_um": 0.532},
        "doppler": {"value_m": 1.0, "wavelength_um": 35_700.0, "count_s": 60.0},
    }
    observations = radioloc.Observations.from_columns(
        epoch=Epochs.from_jd(2441700.5 + np.sort(random.uniform(0.0, 18_900.0, count)), 0.0, "UTC"),
        links=[radioloc.measurements.Link.from_path(path) for path in links],
        link=random.integers(0, len(links), count),
        kind=kind_of(kind),
        sigma_m=0.02,
        pressure_hpa=900.0,
        temperature_k=285.0,
        relative_humidity=0.5,
        **of_kind[kind],
    )
    place = radioloc.LunarPosition.from_selenographic(*REFLECTORS["apollo15"], -1500.0)
    place_pa_m = place.to_axes("PA", model.ephemeris.constants).xyz_m
    taken_s = []

    def prepared_and_computed():
        start = time.process_time()
        found = radioloc.measurements.ExactPredictor(model, observations, place_pa_m).compute(place_pa_m)
        taken_s.append(time.process_time() - start)
        return found

    found = benchmark.pedantic(prepared_and_computed, rounds=3, warmup_rounds=1)
    assert np.isfinite(found.value_m).all()
    least_s = min(taken_s)
    with capsys.disabled():
        print(f"\n{count} of {kind} over fifty years: {least_s:.2f} s, {1e6 * least_s / count:.0f} us each")
    assert least_s < MOST_S[kind]
