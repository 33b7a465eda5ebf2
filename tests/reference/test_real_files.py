"""Real lunar ranging files, and the tables made of them that ship with the examples."""

import re
from pathlib import Path

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.io.formats import read_observations
from radioloc.measurements.observations import Observations

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
DATA = ROOT / "tests" / "data" / "llr"
MINI = "apollo_2006-04_2007-06.mini.np"

# Normal points per target, counted in the published files by record (grep -c ^11, column 38).
EARLY = {"apollo11": 23, "apollo14": 19, "apollo15": 153, "luna21": 5}
LATE = {"apollo11": 2, "apollo14": 2, "apollo15": 28, "luna17": 1, "luna21": 1}
SHIPPED_EARLY = [
    EXAMPLES / "apollo15" / "apollo15_apollo_2006-2007.csv",
    *sorted((EXAMPLES / "reflectors/2006-2007").glob("*.csv")),
]
SHIPPED_LATE = sorted((EXAMPLES / "reflectors/2024").glob("*.csv"))


def count_by_target(observations):
    targets = np.array([link.target for link in observations.links])[observations.link]
    return {
        str(name): int(count) for name, count in zip(*np.unique(targets, return_counts=True), strict=True)
    }


def by_epoch_and_value(observations):
    order = np.lexsort((observations.value_m, observations.epoch.fraction, observations.epoch.jd))
    return observations.select(order)


def assert_same(first: Observations, second: Observations):
    first, second = by_epoch_and_value(first), by_epoch_and_value(second)
    assert first.paths().tolist() == second.paths().tolist()
    assert (first.epoch.jd == second.epoch.jd).all()
    assert (first.epoch.fraction == second.epoch.fraction).all()
    for name in ("value_m", "tag", "pressure_hpa", "temperature_k", "relative_humidity", "wavelength_um"):
        assert (getattr(first, name) == getattr(second, name)).all(), name
    # A sigma in seconds times the speed of light may differ by its last bit.
    assert second.sigma_m == pytest.approx(first.sigma_m, rel=1e-15)


def test_shipped_tables_hold_all_points():
    early, late = read_observations(SHIPPED_EARLY), read_observations(SHIPPED_LATE)
    assert count_by_target(early) == EARLY
    assert count_by_target(late) == LATE
    assert len(early) == 200
    stations = {link.transmitter for link in late.links}
    assert stations == {"APOLLO", "GRASSE", "MATERA"}


def test_shipped_values_against_the_published_lines():
    """Three points read off the published files by eye: MINI lines 1 and 200, CRD record 11 of Matera."""
    early, late = read_observations(SHIPPED_EARLY[0]), read_observations(SHIPPED_LATE)
    assert early.value_m[0] == C_M_S * 2.6494326499837
    assert early.value_m[-1] == C_M_S * 2.5497445319558
    assert early.sigma_m[-1] == pytest.approx(C_M_S * 33.0e-12, rel=1e-14)
    matera = late.select(np.array([link.receiver == "MATERA" for link in late.links])[late.link])
    assert matera.value_m[0] == C_M_S * 2.6562889470543
    assert matera.sigma_m[0] == pytest.approx(C_M_S * 421.9e-12 / np.sqrt(48), rel=1e-14)
    assert matera.pressure_hpa[0] == 958.30


def test_shipped_tables_equal_the_published_files():
    assert_same(read_observations(DATA / MINI), read_observations(SHIPPED_EARLY))
    assert_same(read_observations(sorted(DATA.glob("*.np2"))), read_observations(SHIPPED_LATE))


def test_every_published_point_is_read_and_none_twice():
    files = sorted(DATA.iterdir())
    read = read_observations(files)
    lines = {str(file): file.read_text().split("\n") for file in files}
    marks = {str(file): "51" if file.name == MINI else "11" for file in files}
    expected = {(f, n) for f, text in lines.items() for n, line in enumerate(text, 1) if line[:2] == marks[f]}
    assert {(read.files[f], int(n)) for f, n in zip(read.file, read.line, strict=True)} == expected
    assert len(read) == len(expected) == 234


def test_uncertainty_is_what_the_station_itself_states():
    """APOLLO states each whole uncertainty in a comment, round trip in ps, by its own analysis.

    The bin's RMS over the root of the number of ranges must have its size: one way, or without the root, it
    would be off by 2 or more for most points.
    """
    ratios = []
    for file in sorted(DATA.glob("*.np2")):
        read = read_observations(file)
        lines = file.read_text().split("\n")
        stated = {
            n: float(match[1])
            for n, line in enumerate(lines, 1)
            if (match := re.search(r"normal point uncertainty of ([\d.]+) \[ps\]", line))
        }
        for row in range(len(read)):
            if read.links[read.link[row]].receiver == "APOLLO":
                ps = stated[min(n for n in stated if n > read.line[row])]
                ratios.append(read.sigma_m[row] / C_M_S * 1e12 / ps)
    assert len(ratios) == 14
    assert np.median(ratios) == pytest.approx(0.94, abs=0.01)
    assert min(ratios) > 0.6
    assert max(ratios) < 1.6


def test_mini_uncertainty_is_that_of_the_round_trip():
    """Per photon it must be the two-way spread that the same telescope gives in CRD, 140 to 430 ps."""
    read = read_observations(DATA / MINI)
    photons = np.array([int(line[43:46]) for line in (DATA / MINI).read_text().split("\n") if line])
    enough_photons = (photons > 20) & (photons < 999)
    per_photon_ps = read.sigma_m / C_M_S * 1e12 * np.sqrt(np.maximum(photons, 0))
    assert 140.0 < np.median(per_photon_ps[enough_photons]) < 430.0
