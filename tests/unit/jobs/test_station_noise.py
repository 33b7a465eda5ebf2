"""Which delays share an epoch, and what a study makes of the noise of their stations."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import radioloc
from radioloc import LunarPosition, Study
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.jobs.station_noise import SAME_EPOCH_S, same_epoch, stated_noise
from radioloc.measurements.registry import KINDS
from radioloc.noise import ALONE, SharedAtEpoch
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    all_ranges,
    baselines,
)
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.time import Epochs, epochs_from_strings, tai_to_utc, utc_to_tai

START = utc_to_tai(epochs_from_strings("2016-12-31T23:59:50", "UTC"))  # before a leap second
OWN_M, STATION_M, RANGE_M = 0.02, 0.3, 20.0
STATIONS = ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")


def tags(seconds):
    seconds = np.asarray(seconds, dtype=float)
    return tai_to_utc(Epochs.from_jd(START.jd[0], START.fraction[0] + seconds / 86400.0, "TAI"))


def test_tags_of_one_wavefront_share_an_epoch():
    rng = np.random.default_rng(0)
    number = np.repeat(np.arange(50), 6)
    at_station_s = rng.uniform(-0.0213, 0.0213, len(number))  # the Earth's radius
    order = rng.permutation(len(number))
    for step_s in (0.1, 1.0, 60.0):  # over the leap second too, and no edge of a clock's tick in the way
        solution = same_epoch(tags(number * step_s + at_station_s)[order])
        np.testing.assert_array_equal(solution, number[order])


def test_epochs_too_dense_to_tell_are_refused():
    assert same_epoch(tags(0.051 * np.arange(5))).tolist() == [0, 1, 2, 3, 4]
    assert same_epoch(tags([0.0, 0.025, 0.0499])).tolist() == [0, 0, 0]
    with pytest.raises(InputError, match=r"closer than 0\.1 s"):
        same_epoch(tags(0.6 * SAME_EPOCH_S * np.arange(3)))


def arc_of(ends, kinds, seconds, count_s=None):
    """Observations of 3 m by pairs of the first three stations."""
    transmitters, receivers = np.array(ends).T
    kind = np.array([KINDS.index(kind) for kind in kinds])
    columns = {"epoch": tags(seconds), "kind": kind, "sigma_m": np.full(len(kind), 3.0), "count_s": count_s}
    return SimpleNamespace(
        places=None,
        stations=STATIONS[:3],
        transmitters=transmitters,
        receivers=receivers,
        model=SimpleNamespace(catalogue=StationCatalogue.default()),
        observations=SimpleNamespace(**columns),
    )


def covariance_m2(arc, **choice):
    whitened = stated_noise(arc, ObservationChoice(**choice)).whitener().whitened
    weight = np.vstack(list(whitened(lambda rows: np.eye(len(arc.receivers))[rows])))
    return np.linalg.inv(weight.T @ weight)


def test_sigmas_of_vlbi_stations_by_name():
    arc = arc_of([(0, 1), (0, 2), (1, 2)], ["vlbi_delay"] * 3, [0.0, 0.01, 0.02])
    expected = 9.0 * np.eye(3) + np.array([[4, 0, -4], [0, 9, 9], [-4, 9, 13]])
    solution = covariance_m2(arc, vlbi_station_sigma_m={STATIONS[1]: 2.0, STATIONS[2]: 3.0})
    np.testing.assert_allclose(solution, expected, rtol=0.0, atol=1e-10)
    with pytest.raises(InputError, match=r"vlbi_station_sigma_m.*ATLANTIS"):
        covariance_m2(arc, vlbi_station_sigma_m={"ATLANTIS": 1.0})
    with pytest.raises(InputError, match=r"vlbi_station_sigma_m\.URUMQI"):
        ObservationChoice(vlbi_station_sigma_m={"URUMQI": -1.0})


def test_delay_rates_share_the_growth_of_their_stations_times():
    """Of one epoch and count interval; with delays of that epoch they share nothing."""
    kinds = ["vlbi_delay", *["vlbi_delay_rate"] * 4]
    ends = [(0, 1), (0, 1), (0, 2), (1, 2), (0, 1)]
    count_s = np.array([np.nan, 60.0, 60.0, 60.0, 10.0])
    arc = arc_of(ends, kinds, [0.0, 0.0, 0.01, 0.02, 0.0], count_s)
    expected = 9.0 * np.eye(5)
    expected[0, 0] += 2 * 25.0
    expected[1:4, 1:4] += 4.0 * np.array([[2, 1, -1], [1, 2, 1], [-1, 1, 2]])
    expected[4, 4] += 2 * 4.0
    solution = covariance_m2(arc, vlbi_station_sigma_m=5.0, vlbi_station_rate_sigma_m=2.0)
    np.testing.assert_allclose(solution, expected, rtol=0.0, atol=1e-10)
    separate = stated_noise(arc, ObservationChoice(vlbi_station_rate_sigma_m=2.0))
    assert separate.of_type(SharedAtEpoch)[0].group.tolist()[0] == ALONE


def test_delay_rates_know_the_rates_of_the_clocks_but_not_their_offsets(site):
    """Noise of the stations, stated as such, gives a chi-square of one."""
    span = ("2020-12-01T15:11", "2020-12-02T15:11", 1800.0)
    schedule = Schedule(
        [Session("vlbi_delay_rate", baselines(*STATIONS), *span, 1e-4, count_s=600.0)], Masks(10.0)
    )
    rates = {"KUNMING": 3e-13, "URUMQI": -2e-13}
    truth = Truth(clock_s={"KUNMING": 1e-6, "URUMQI": -2e-6}, clock_rate_s_s=rates)
    model = radioloc.measurements.PhysicalModel.build()
    noise = NoiseModel({"vlbi_delay_rate": Noise(white_m=1e-4)}, vlbi_station_rate=Noise(white_m=1e-3))
    scene = Scenario(schedule, site, truth).world(model).draw(noise, seed=3)
    study = Study(
        target=site,
        observations=ObservationChoice(vlbi_station_rate_sigma_m=1e-3),
        estimate=EstimateChoice(position="none", clock_rate="all"),
        consider_defaults=False,
    )
    solution = radioloc.locate(study, scene.observations)
    assert solution.converged
    assert solution.fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / solution.fit.dof))
    estimated = solution.biases("clock_rate")
    assert set(estimated) == set(STATIONS[1:])
    for station, (value, sigma) in estimated.items():
        assert sigma < 2e-15  # 1 mm in 600 s, 33 times
        assert abs(value - rates.get(station, 0.0)) < 4.5 * sigma
    with pytest.raises(InputError, match="nothing to estimate"):
        radioloc.locate(
            replace(study, estimate=EstimateChoice(position="none", clock="all")), scene.observations
        )


@pytest.fixture(scope="module")
def site():
    return LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)


@pytest.fixture(scope="module")
def scene(site):
    """Ranges and delays of a day; the errors of the delays are those of their stations."""
    span = ("2020-12-01T15:11", "2020-12-02T15:11", 1800.0)
    schedule = Schedule(
        [
            Session("range", all_ranges("JIAMUSI"), *span, RANGE_M),
            Session("vlbi_delay", baselines(*STATIONS), *span, OWN_M),
        ],
        Masks(10.0),
    )
    model = radioloc.measurements.PhysicalModel.build(off=["troposphere"])
    noise = NoiseModel(
        {"range": Noise(white_m=RANGE_M), "vlbi_delay": Noise(white_m=OWN_M)}, Noise(white_m=STATION_M)
    )
    return Scenario(schedule, site).world(model).draw(noise, seed=1)


def locate(site, scene, observations=None, **choice):
    study = Study(
        target=site,
        observations=ObservationChoice(**choice),
        estimate=EstimateChoice(),
        consider_defaults=False,
        model=ModelChoice(off=["troposphere"]),
    )
    return radioloc.locate(study, scene.observations if observations is None else observations)
