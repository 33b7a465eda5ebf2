"""Inconsistent data are named with their time: cases in which residuals, sigmas and status do not show them."""

from dataclasses import replace

import numpy as np
import pytest
from change5_case import RANGING

import radioloc
from radioloc.constants import C_M_S
from radioloc.measurements.registry import TIME_TAGS
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.earth import STATION_POSITION
from radioloc.parameters.rows import ObservationRows
from radioloc.study.study import HeightPrior
from radioloc.time import Epochs


@pytest.fixture(scope="module")
def study():
    return radioloc.read_study("examples/change5/change5.toml")


EPOCHS = [pytest.param(1, marks=pytest.mark.slow, id="all epochs"), pytest.param(9, id="every ninth epoch")]


@pytest.fixture(scope="module")
def full_tracking(study):
    return radioloc.read_observations(study.observations.files)


@pytest.fixture(scope="module", params=EPOCHS)
def tracking(full_tracking, request):
    epochs = np.unique(full_tracking.epoch.mjd, return_inverse=True)[1]
    return full_tracking.select(np.flatnonzero(epochs % request.param == 0))


@pytest.fixture(scope="module")
def fitted(study, tracking):
    return radioloc.locate(study, tracking)


def strongest_test(study, observations, added_m):
    solution = radioloc.locate(study, replace(observations, value_m=observations.value_m + added_m))
    assert str(solution.consistency.findings[0]) in " ".join(str(solution).split())
    return solution, solution.consistency.findings[0]


@pytest.mark.study
def test_clock_of_a_vlbi_station(study, tracking):
    """5 ns from the middle on."""
    paths = np.array(tracking.paths())
    second = np.char.endswith(paths, ">SESHAN25") & (np.char.find(paths, "<") > 0)
    signs = 1.0 * second - np.char.startswith(paths, "SESHAN25<")
    mjd = tracking.epoch.mjd
    middle = 0.5 * (mjd.min() + mjd.max())
    solution, first = strongest_test(study, tracking, 5e-9 * C_M_S * signs * (mjd > middle))
    assert (first.kind, first.name) == ("jump", "SESHAN25 vlbi_delay")
    assert first.unit == "s"
    assert first.amounts[""] == pytest.approx(5e-9, abs=0.5e-9)  # of 0.4 m in a minute, lasting for hours
    assert first.first_utc.startswith("2020-12-02T15:1")
    assert solution.to_dict()["consistency"][0]["text"] == str(first)


@pytest.mark.slow
def test_ranging_station_off_its_place(study, full_tracking):
    """Kashi 50 m east; the editing leaves out nearly all of its two-way ranges, the others get noise of their own."""
    arc = radioloc.jobs.prepare_arc(study, full_tracking)
    at = arc.predict()
    rows = ObservationRows(arc, np.arange(len(full_tracking)), None, at, arc.motions)
    kashi = rows.ends == arc.stations.index("KASHI")
    east_m = 50.0 * (STATION_POSITION.partials(rows)[..., 0] * kashi).sum(axis=1)
    solution, first = strongest_test(study, full_tracking, east_m)
    assert (first.kind, first.name) == ("a priori", "station_position.KASHI")
    # Of the 50 m a quarter is left to the position, little more than its sigma
    assert np.linalg.norm(first.shift_enu_m) < 1.5 * np.linalg.norm(solution.sigma_enu_m())
    assert first.amounts == {"east": pytest.approx(50.0, abs=2.0)}
    # Without errors of its position: the station all the same, 50 m east of it pass as 0.1 s of its time tags.
    _, first = strongest_test(replace(study, consider={}, consider_defaults=False), full_tracking, east_m)
    assert "KASHI" in first.name


@pytest.mark.study
def test_laser_points_of_later_nights():
    study = radioloc.read_study("examples/apollo15/apollo15.toml")
    points = radioloc.read_observations(study.observations.files)
    late = np.argsort(np.argsort(points.epoch.mjd)) >= len(points) // 2
    _, first = strongest_test(study, points, 30.0 * late)
    assert (first.kind, first.name) == ("jump", "range APOLLO>apollo15>APOLLO")
    assert first.amounts[""] == pytest.approx(30.0, abs=0.1)
    assert first.first_utc == "2006-12-01T00:58:25"


@pytest.mark.study
def test_nothing_is_said_of_data_that_fit(fitted):
    assert not fitted.consistency.findings
    groups = fitted.consistency.groups
    assert {"station", "link", "type", "pass"} == {item.kind for item in groups}
    assert {item.name for item in groups if item.kind == "station"} >= set(RANGING)


@pytest.mark.study
@pytest.mark.parametrize("path", ["SESHAN25<change5>MIYUN50", "SESHAN25<change5>URUMQI"])
def test_baseline_that_is_off(study, tracking, path):
    """Test one of six, off by 1 m, against the triangles that it closes."""
    _, first = strongest_test(study, tracking, 1.0 * (np.array(tracking.paths()) == path))
    assert (first.kind, first.name) == ("offset", f"vlbi_delay {path}")
    assert first.log10_p_value < -10.0
    # Clocks and weather of both stations are 0.1 m each.
    assert first.amounts[""] * C_M_S == pytest.approx(1.0, abs=0.25)


@pytest.mark.study
def test_ranges_of_a_station_with_noise_of_its_own(study, tracking, fitted):
    """Neuquen's ranges scatter by 20 m more; the others keep their weights."""
    paths = np.array(tracking.paths())
    noisy = np.char.endswith(paths, ">NEUQUEN") & (np.char.find(paths, "<") < 0)
    added_m = 20.0 * noisy * np.random.default_rng(4).normal(size=len(tracking))
    second = radioloc.locate(study, replace(tracking, value_m=tracking.value_m + added_m))
    assert "range of NEUQUEN" not in fitted.fit.excess_noise_m
    assert second.to_dict()["fit"]["excess_noise_m"]["range of NEUQUEN"] == pytest.approx(20.0, rel=0.1)
    assert second.fit.excess_noise_m["range"] == pytest.approx(fitted.fit.excess_noise_m["range"], abs=0.1)


def test_late_time_tags_are_named_and_estimating_them_brings_the_position_back():
    study = radioloc.read_study("examples/change5/short_arc.toml")
    study = replace(study, estimate=replace(study.estimate, height_prior=HeightPrior(-2550.4, 5.0)))
    ranges = radioloc.read_observations(study.observations.files)
    epoch = ranges.epoch
    delayed = replace(ranges, epoch=Epochs(epoch.jd, epoch.fraction + 0.1 / 86400.0, "UTC"))
    solution = radioloc.locate(study, delayed)
    first = solution.consistency.findings[0]
    assert (first.kind, first.name) == ("parameter", "time_bias.all")
    assert first.amounts[""] == pytest.approx(-0.1, abs=0.02)
    time_bias = ParameterChoice("all", sigma=1.0)
    estimate = replace(study.estimate, parameters={**study.estimate.parameters, "time_bias": time_bias})
    estimated = radioloc.locate(replace(study, estimate=estimate), delayed)
    assert not solution.converged
    assert solution.reference.north_m < -1000.0
    assert estimated.reference.combined_sigmas < 3.0


def test_wrong_height_prior_is_named_before_what_the_data_cannot_separate_from_it(study, tracking):
    prior = replace(study.estimate.height_prior, height_m=-2250.4)
    estimate = replace(study.estimate, height_prior=prior, ephemeris_sigma_m=(0.0, 0.0, 0.0))
    solution = radioloc.locate(replace(study, estimate=estimate), tracking)
    first = solution.consistency.findings[0]
    assert (first.kind, first.name) == ("a priori", "position.height")
    assert first.data_values[""] == pytest.approx(-2550.0, abs=40.0)
    assert {item.name for item in first.alternatives[-2:]} == {
        "moon_position.radial",
        "moon_position_variation.1",
    }


DSN = """
[target]
longitude_deg = -51.8
latitude_deg = 43.0
height_m = -2500.0
[model]
off = ["ionosphere"]
[simulation.position]
longitude_deg = -51.9162
latitude_deg = 43.0584
height_m = -2550.4
[simulation.sessions.ranging]
kind = "range"
stations = ["DSS-14", "DSS-43", "DSS-63"]
one_uplink = true
start = "2020-12-01T15:00:00"
stop = "2020-12-03T15:00:00"
step_s = 600.0
sigma_m = 1.0
uplink_hz = 7.2e9
wavelength_um = 35394.6
[simulation.noise.range]
white_m = 0.8
"""


@pytest.mark.parametrize("bias_m", [30.0, 80.0, 1000.0])
def test_a_station_whose_ranges_are_too_long_is_named_however_large_its_bias(tmp_path, bias_m):
    """Three stations; robust editing rejects the ranges of the other two from 80 m on."""
    (tmp_path / "dsn.toml").write_text(DSN)
    study = radioloc.read_study(tmp_path / "dsn.toml")
    ranges = radioloc.simulate(study).observations
    received = np.array([path.endswith(">DSS-14") for path in ranges.paths()])
    solution = radioloc.locate(study, replace(ranges, value_m=ranges.value_m + bias_m * received))
    [first] = solution.consistency.findings
    assert first.name == "range_bias.DSS-14"
    assert first.amounts[""] == pytest.approx(bias_m, abs=1.0)


def corrupted(ranges, name):
    """Return ranges with a mistake of users, and the sentence that names it."""
    epoch, at = ranges.epoch, np.array([path.endswith(">DSS-14") for path in ranges.paths()])
    match name:
        case "TAI" | "GPS time":
            ahead_s = 37.0 if name == "TAI" else 18.0
            later = Epochs(epoch.jd, epoch.fraction + ahead_s / 86400.0, "UTC")
            sentence = f"the time tags of all stations are {name}, not UTC ({ahead_s:g} s ahead)"
            return replace(ranges, epoch=later), sentence
        case "local":
            later = Epochs(epoch.jd, epoch.fraction + 8.0 / 24.0, "UTC")
            return replace(ranges, epoch=later), "the time tags of all stations are in local time, UTC+8 h"
        case "late":
            later = Epochs(epoch.jd, epoch.fraction + at / 86400.0, "UTC")
            return replace(ranges, epoch=later), "the time tags of DSS-14 are 1 s late"
        case "reception":
            transmitted = replace(ranges, tag=np.full_like(ranges.tag, TIME_TAGS.index("transmit")))
            return transmitted, "the time tags of all stations are times of reception"
        case "half":
            half = replace(ranges, value_m=np.where(at, 0.5, 1.0) * ranges.value_m)
            return half, "the range values of DSS-14 are half of the right ones"
        case "exchanged":
            names = {"DSS-14": "DSS-43", "DSS-43": "DSS-14", "DSS-63": "DSS-63"}
            links = tuple(
                replace(x, transmitter=names[x.transmitter], receiver=names[x.receiver]) for x in ranges.links
            )
            return replace(ranges, links=tuple(links)), "the stations DSS-14 and DSS-43 are exchanged"


@pytest.mark.study
@pytest.mark.parametrize(
    "name",
    [
        "half",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("TAI", "GPS time", "local", "late", "reception", "exchanged")
        ),
    ],
)
def test_mistakes_of_users_are_named(tmp_path, name):
    (tmp_path / "dsn.toml").write_text(DSN)
    study = radioloc.read_study(tmp_path / "dsn.toml")
    ranges, sentence = corrupted(radioloc.simulate(study).observations, name)
    solution = radioloc.locate(study, ranges)
    assert not solution.converged
    first = solution.consistency.findings[0]
    assert (first.kind, first.name) == ("mistake", sentence)
    assert first.next_chi2_ratio > 4.0
