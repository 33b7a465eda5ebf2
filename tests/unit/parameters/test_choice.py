"""Parameters that a study chooses: a-priori values, held members, scopes."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import START_TAI_JD, observed_at

import radioloc
from radioloc import LunarPosition, Study
from radioloc.constants import C_M_S
from radioloc.errors import InputError, StationError
from radioloc.jobs.problem import observation_model
from radioloc.jobs.study_targets import surface_points
from radioloc.measurements.link import Link
from radioloc.measurements.observations import DOPPLER, RANGE, VLBI_DELAY
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.time import Epochs

TARGET = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
# Two days of each station, from 15 h on, where it sees the Moon.
HOURS = {"KASHI": (15.5, 18.0, 20.5, 40.0, 42.4), "JIAMUSI": (12.0, 15.0, 17.5, 36.0, 39.5)}
# What the fit leaves of data without noise.
SAME_M = 1e-4


def table(kind=RANGE, path=None, **columns):
    rows = [(station, hour) for station, hours in HOURS.items() for hour in hours]
    tai = Epochs.from_jd(START_TAI_JD, np.array([hour / 24.0 for _, hour in rows]), "TAI")
    links = [Link.from_path(path or f"{station}>lander>{station}") for station in HOURS]
    if path:
        return observed_at(tai, links[:1], kind=kind, **columns)
    link = [list(HOURS).index(station) for station, _ in rows]
    return observed_at(tai, links, link=link, kind=kind, value_m=7.7e8, **columns)


def study(**estimate):
    # Below the horizon an observation is left out; these paths are for what parameters do.
    return Study(
        TARGET,
        ObservationChoice(),
        EstimateChoice(**({"position": "none"} | estimate)),
        ModelChoice(off=["troposphere"]),
        name="owners",
        consider_defaults=False,
    )


@pytest.fixture(scope="module")
def ranges():
    """Ranges without error, and the station of each."""
    observations = table()
    arc = radioloc.jobs.prepare_arc(study(), observations)
    stations = np.array([arc.stations[i] for i in arc.receivers])
    return replace(observations, value_m=arc.compute().value_m), stations


@pytest.fixture(scope="module")
def biased(ranges):
    """The same with 12 m on KASHI and 5 m on JIAMUSI."""
    observations, stations = ranges
    return replace(observations, value_m=observations.value_m + np.where(stations == "KASHI", 12.0, 5.0))


def test_every_path_sees_the_moon(ranges):
    assert radioloc.compute_residuals(study(), ranges[0]).residuals.used.all()


def test_a_priori_values_start_and_constrain_the_fit(biased):
    solution = radioloc.locate(
        study(
            range_bias="all",
            range_bias_m={"KASHI": 11.0, "Jiamusi": 5.0},
            range_bias_sigma_m={"KASHI": 0.5, "JIAMUSI": 1e-3},
        ),
        biased,
    )
    rows = {row["name"]: row for row in solution.to_dict()["parameters"]}
    assert rows["range_bias.KASHI"]["prior_value"] == 11.0
    assert (rows["range_bias.KASHI"]["prior_sigma"], rows["range_bias.JIAMUSI"]["prior_sigma"]) == (0.5, 1e-3)
    # Five ranges of 1 m beside a value of 0.5 m: weights 5 and 4.
    assert rows["range_bias.KASHI"]["value"] == pytest.approx((5 * 12.0 + 4 * 11.0) / 9.0, abs=SAME_M)
    assert rows["range_bias.KASHI"]["sigma"] == pytest.approx(1.0 / 3.0, rel=1e-6)
    assert solution.biases()["JIAMUSI"] == pytest.approx((5.0, 1e-3), abs=SAME_M)


def test_unlisted_station_with_a_value_is_held_at_it(biased):
    solution = radioloc.locate(study(range_bias=["JIAMUSI"], range_bias_m={"KASHI": 12.0}), biased)
    assert solution.to_dict()["biases"]["KASHI"] == {"value_m": 12.0, "sigma_m": 0.0}
    assert {row["name"]: row["fixed"] for row in solution.to_dict()["parameters"]} == {
        **{f"position.{axis}": True for axis in "xyz"},
        "range_bias.JIAMUSI": False,
        "range_bias.KASHI": True,
    }
    assert np.abs(solution.residuals.residual_m).max() < SAME_M
    assert "fixed       range bias of KASHI 12 m" in str(solution)


@pytest.mark.parametrize(
    ("estimate", "error", "message"),
    [
        ({"range_bias_m": {"ATLANTIS": 1.0}}, StationError, r"\[estimate\] range_bias_m: .*ATLANTIS"),
        ({"range_bias_sigma_m": {"JIAMUSI": 1.0}}, InputError, "JIAMUSI gets no range_bias; list it"),
        ({"range_bias_m": {"KASHI": 1.0, "kashi": 2.0}}, InputError, "KASHI twice, once as kashi"),
        ({"clock_s": 1e-6}, InputError, "clock_s: expected observations .* none; leave it out"),
    ],
)
def test_unusable_members_are_refused(ranges, estimate, error, message):
    with pytest.raises(error, match=message):
        radioloc.locate(study(range_bias=["KASHI"], **estimate), ranges[0])


@pytest.mark.parametrize(
    ("estimate", "message"),
    [
        ({"range_bias_m": {"KASHI": np.nan}}, "range_bias_m of KASHI: expected a finite number"),
        ({"range_bias_sigma_m": {"KASHI": 0.0}}, "range_bias_sigma_m of KASHI: expected a number above zero"),
        ({"range_bias_per": "day"}, 'per: expected "station" or "pass" or "link" or "link and pass"'),
        ({"range_bias": "KASHI"}, 'range_bias: expected a list of names, "all" or "none", got \'KASHI\''),
        ({"ut1": ["KASHI"]}, "ut1 has no members with names; use true or false"),
        ({"range_bias_m": 10**400}, "range_bias_m: expected a finite number"),
        ({"transponder_delay_sigma_s": 1e-8}, "transponder_delay_sigma_s needs transponder_delay"),
    ],
)
def test_unusable_choices_are_refused(estimate, message):
    with pytest.raises(InputError, match=message):
        EstimateChoice(**estimate)


def test_range_biases_of_passes(ranges):
    observations, stations = ranges
    hours = np.array([hour for station in HOURS for hour in HOURS[station]])
    bias_m = np.where(stations == "KASHI", 10.0, 20.0) + (hours > 24.0)
    solution = radioloc.locate(
        study(range_bias="all", range_bias_per="pass"),
        replace(observations, value_m=observations.value_m + bias_m),
    )
    biases = solution.to_dict()["biases"]
    assert {name: round(bias["value_m"], 3) for name, bias in biases.items()} == {
        "KASHI 1": 10.0,
        "KASHI 2": 11.0,
        "JIAMUSI 1": 20.0,
        "JIAMUSI 2": 21.0,
    }
    # Tags are TAI - 37 s.
    assert biases["KASHI 2"]["first_utc"].startswith("2020-12-03T15:59:23")
    assert biases["KASHI 2"]["last_utc"].startswith("2020-12-03T18:23:23")


def test_all_observations_of_a_station_define_its_passes(ranges):
    """Five hours without ranges, with Doppler in the middle."""
    hours = [hour for station in HOURS for hour in HOURS[station]]
    observations = table(np.where(np.array(hours) == 18.0, DOPPLER, RANGE), count_s=60.0)
    arc = radioloc.jobs.prepare_arc(study(), observations)
    choice = study(range_bias=["KASHI"], range_bias_per="pass").estimate
    pa_m = arc.motions[0].position_pa_m
    problem = observation_model(
        arc, surface_points({"": LunarPosition("PA_DE421", pa_m)}, arc.model, choice), choice
    )
    assert [p.name for p in problem.parameters][3:] == ["range_bias.KASHI 1", "range_bias.KASHI 2"]
    assert problem.residuals(problem.parameters.prior_values)[1][:5, 3:].tolist() == [
        [1.0, 0.0],
        [0.0, 0.0],
        [1.0, 0.0],
        [0.0, 1.0],
        [0.0, 1.0],
    ]


def test_each_session_has_its_own_moon_position(ranges):
    """Two nights, of both stations together; a Moon that is 1 m farther makes the round trip 2 m longer."""
    observations, _ = ranges
    hours = np.array([hour for station in HOURS for hour in HOURS[station]])
    farther_m = np.where(hours < 24.0, 1.0, 3.0)
    solution = radioloc.locate(
        study(moon_position_variation=True, moon_position_variation_sigma_m=[1e3, 1e-6, 1e-6]),
        replace(observations, value_m=observations.value_m + 2.0 * farther_m),
    )
    radial = {
        name: solution.values[k] for k, name in enumerate(solution.parameters.names) if "radial" in name
    }
    assert list(radial) == ["moon_position_variation.1.radial", "moon_position_variation.2.radial"]
    # The path to the station is as far from that to the geocentre as 1 degree, 0.00015 in its cosine.
    assert list(radial.values()) == pytest.approx([1.0, 3.0], abs=1e-3)


def test_transponder_delay_is_one_parameter_of_all_ranges(ranges):
    observations, _ = ranges
    late = replace(observations, value_m=observations.value_m + C_M_S * 2e-8)
    solution = radioloc.locate(study(transponder_delay=True, transponder_delay_sigma_s=1e-6), late)
    row = solution.to_dict()["parameters"][3]
    assert row["name"] == "transponder_delay"
    assert row["value"] == pytest.approx(2e-8, abs=1e-3 / C_M_S)
    assert row["sigma"] == pytest.approx(1.0 / C_M_S / np.sqrt(10.0), rel=1e-3)
    assert "transponder delay" in str(solution)
    delays = table(VLBI_DELAY, "KASHI<lander>JIAMUSI", value_m=0.0)
    with pytest.raises(InputError, match="transponder_delay: expected observations"):
        radioloc.locate(study(transponder_delay=True), delays)


def test_range_biases_of_links(ranges):
    observations, stations = ranges
    biased = replace(observations, value_m=observations.value_m + np.where(stations == "KASHI", 10.0, 20.0))
    by_link = radioloc.locate(study(range_bias="all", range_bias_per="link"), biased)
    names = {
        f"{station}>lander>{station}": metres for station, metres in (("KASHI", 10.0), ("JIAMUSI", 20.0))
    }
    assert {name: round(value, 3) for name, (value, _) in by_link.biases().items()} == names
    by_link_and_pass = radioloc.locate(
        study(range_bias=["KASHI > lander > KASHI"], range_bias_per="link and pass", range_bias_sigma_m=50.0),
        biased,
    )
    assert list(by_link_and_pass.biases()) == ["KASHI>lander>KASHI 1", "KASHI>lander>KASHI 2"]
    with pytest.raises(InputError, match=r"\(KASHI>l.*\), got URUMQI>lander>KASHI"):
        radioloc.locate(study(range_bias=["URUMQI>lander>KASHI"], range_bias_per="link"), biased)


def test_frequency_offsets_of_links_and_passes():
    """Two stations' Doppler of two days, the reference 1e-12 high, on one link on the second day 3e-12."""
    offsets = {("KASHI", 0): 1e-12, ("KASHI", 1): 3e-12, ("JIAMUSI", 0): 1e-12, ("JIAMUSI", 1): 1e-12}
    observations = table(DOPPLER, count_s=60.0)
    arc = radioloc.jobs.prepare_arc(study(), observations)
    hours = np.array([hour for station in HOURS for hour in HOURS[station]])
    offset = np.array(
        [offsets[arc.stations[s], int(h > 24.0)] for s, h in zip(arc.receivers, hours, strict=True)]
    )
    value_m = arc.compute().value_m + C_M_S * 60.0 * offset
    data = replace(observations, value_m=value_m, sigma_m=np.full(len(observations), 1e-3))
    solution = radioloc.locate(
        study(frequency_offset="all", frequency_offset_per="link and pass", frequency_offset_sigma=1e-10),
        data,
    )
    rows = {row["name"]: row["value"] for row in solution.to_dict()["parameters"]}
    for (station, day), expected in offsets.items():
        name = f"frequency_offset.{station}>lander>{station} {day + 1}"
        assert rows[name] == pytest.approx(expected, abs=1e-16)


def test_clocks_have_one_reference_in_each_network():
    """Two ranging stations and three of VLBI, which do not observe together."""
    tai = Epochs.from_jd(START_TAI_JD, np.repeat(np.array([15.5, 16.0, 17.0]) / 24.0, 3), "TAI")
    links = [Link.from_path(p) for p in ("KASHI>x>JIAMUSI", "SESHAN25<x>URUMQI", "SESHAN25<x>KUNMING")]
    link = np.tile(np.arange(3), 3)
    data = observed_at(
        tai,
        links,
        link=link,
        kind=np.where(link == 0, RANGE, VLBI_DELAY),
        value_m=np.where(link == 0, 7.7e8, 0.0),
    )
    arc = radioloc.jobs.prepare_arc(study(), data)
    start = LunarPosition("PA_DE421", arc.motions[0].position_pa_m)
    choice = study(clock="all").estimate
    model = observation_model(arc, surface_points({"": start}, arc.model, choice), choice)
    assert [p.name for p in model.parameters][3:] == ["clock.JIAMUSI", "clock.URUMQI", "clock.KUNMING"]
