"""Transmitters of what listeners received of a lander, found among candidates by the residuals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from change5_case import LANDER, NEAR

import radioloc
from radioloc import Observations, Study
from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io.formats import write_observations
from radioloc.jobs.preparation import prepared_arc
from radioloc.measurements import Link, PhysicalModel
from radioloc.search import search
from radioloc.search.transmitters import _jumps, _passes
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, Truth
from radioloc.study import EstimateChoice, ObservationChoice

CANDIDATES = ("NEUQUEN", "JIAMUSI", "KASHI")
DOWN_HZ = 8.471e9
CYCLE_M = C_M_S / DOWN_HZ
NOISE_HZ, COUNT_S = 0.5, 10.0
SIGMA_M = NOISE_HZ * CYCLE_M * COUNT_S
TRUE = {"WETTZELL": "NEUQUEN", "KUNMING": "JIAMUSI", "URUMQI": "KASHI"}
"""Who sent to whom: listeners in Germany and China."""
HOURS = {
    "WETTZELL": ("2020-12-02T02:00:00", "2020-12-02T05:00:00"),
    "KUNMING": ("2020-12-01T15:00:00", "2020-12-01T18:00:00"),
    "URUMQI": ("2020-12-02T16:00:00", "2020-12-02T19:00:00"),
}


@pytest.fixture(scope="module")
def received():
    """Doppler at X band of three passes, each with an offset of the listener's oscillator, sent by whom is not said."""
    return unsaid(heard([(sender, listener, *HOURS[listener]) for listener, sender in TRUE.items()]))


def heard(passes):
    """What listeners receive of some stations from one hour to another."""
    sessions = [
        Session("doppler", ((sender, listener),), *hours, 240.0, SIGMA_M, count_s=COUNT_S,
                uplink_hz=DOWN_HZ * 749 / 880, wavelength_um=1e6 * CYCLE_M)
        for sender, listener, *hours in passes
    ]  # fmt: skip
    offsets = {
        f"{sender}>lander>{listener}": y
        for (sender, listener, *_), y in zip(passes, (3e-9, -8e-10, 2e-10), strict=False)
    }
    noise = NoiseModel({"doppler": Noise(white_m=SIGMA_M)})
    scenario = Scenario(Schedule(sessions), LANDER, Truth(frequency_offset_value=offsets), noise, seed=2)
    return scenario.world(PhysicalModel.build()).draw().observations


def unsaid(observations):
    links = tuple(replace(link, transmitter="KASHI") for link in observations.links)
    return Observations.concatenate([replace(observations, links=links)])  # each link once


def study(estimate=None, **observations):
    chosen = {"transmitters": CANDIDATES} | observations
    return Study(
        target=NEAR, estimate=estimate or EstimateChoice(), observations=ObservationChoice(**chosen), name="x"
    )


def found(study, received):
    """Paths of the observations of the completed study."""
    arc, _ = prepared_arc(search(study, received).study, received)
    return arc.observations


def senders(observations):
    return {link.receiver: link.transmitter for k in observations.link if (link := observations.links[k])}


def test_each_pass_has_the_station_that_sent(received):
    assert senders(found(study(), received)) == TRUE


def test_a_handover_of_the_uplink_ends_a_pass():
    """The next station takes over within four minutes, and neither sees the target all the time."""
    over = "2020-12-01T15:00:00"
    received = heard(
        [
            ("JIAMUSI", "KUNMING", "2020-12-01T12:30:00", over),
            ("KASHI", "KUNMING", over, "2020-12-01T20:30:00"),
        ]
    )
    assert len(set(received.paths())) == 2
    value_m = received.value_m.copy()
    value_m[7::20] += 8.8e3 * CYCLE_M * COUNT_S  # read off another peak
    received = replace(received, value_m=value_m)
    assert [len(rows) for rows in _passes(unsaid(received), 4 * 3600.0)] == [38, 83]
    assert found(study(), unsaid(received)).paths().tolist() == received.paths().tolist()


@pytest.mark.parametrize(("jump_m_s", "expected"), [(0.0, []), (200.0, [150])])
def test_rounded_rates_end_no_pass_and_hide_no_handover(jump_m_s, expected):
    """Frequencies in steps of 100 Hz, 3.5 m/s, which change by less than that from count to count."""
    time_s = 60.0 * np.arange(330.0)
    rate_m_s = 300.0 * np.sin(time_s / 7000.0) + jump_m_s * (np.arange(330) >= 150)
    step_m_s = 3.548
    assert _jumps(time_s, step_m_s * np.rint(rate_m_s / step_m_s)) == expected


def test_the_true_sender_is_the_best_of_all_candidates(received):
    result = search(study(), received)
    for one in result.transmitters:
        assert one.decided
        assert one.ranking[0] == TRUE[one.receiver]
        best, *others = ((one.rms_m_s[name] or np.inf) / CYCLE_M for name in one.ranking)
        # The a-priori position is 10 km off, which is a fraction of the noise
        assert best == pytest.approx(NOISE_HZ, rel=0.3)
        assert min(others, default=np.inf) > 10.0 * NOISE_HZ
    [first, *_] = json.loads(json.dumps(result.to_dict()))["transmitters"]
    assert set(first["rms_m_s"]) == set(CANDIDATES)
    assert first["decided"] is True


def test_a_turnaround_ratio_is_found_as_well(received):
    ratio = 749 / 880 * 240 / 221  # what was written down for the wrong one
    whole_m = C_M_S * COUNT_S
    wrong = replace(
        received,
        value_m=whole_m - (whole_m - received.value_m) / ratio,
        wavelength_um=received.wavelength_um / ratio,
    )
    completed = found(study(turnarounds=("240/221", "880/749")), wrong)
    np.testing.assert_allclose(completed.value_m, received.value_m, atol=1e-3 * SIGMA_M)
    np.testing.assert_allclose(completed.wavelength_um, received.wavelength_um, rtol=1e-12)
    sent = replace(wrong, links=completed.links, link=completed.link)
    alone = search(study(turnarounds=("240/221", "880/749"), transmitters=None), sent)
    assert {one.ranking[0] for one in alone.transmitters} == {"880/749"}


def test_stations_beside_each_other_are_undecided(received):
    """A candidate a hundred metres from the true one fits as well, and the card says so."""
    catalogue = PhysicalModel.build().catalogue
    kashi = catalogue.get("KASHI")
    beside = replace(kashi, name="BESIDE", aliases=(), itrf_m=kashi.itrf_m + np.array([80.0, 60.0, 0.0]))
    chosen = study(EstimateChoice(position="none"), transmitters=("KASHI", "BESIDE"), stations=None)
    chosen = replace(chosen, catalogue=catalogue.with_station(beside))
    result = search(chosen, received[received.link == received.link[-1]])
    assert not result.is_usable
    assert "? undecided" in str(result)


STUDY = """
[target]
longitude_deg = -51.8
latitude_deg = 43.1
height_m = -2000.0
[observations]
files = ["received.csv"]
transmitters = ["NEUQUEN", "JIAMUSI", "KASHI"] # who of these?
turnarounds = ["880/749", "240/221"]
"""


def test_the_completed_file_states_each_pass(received, tmp_path):
    """Files of listeners name any station, here for all passes the same."""
    write_observations(tmp_path / "received.csv", received)
    (tmp_path / "study.toml").write_text(STUDY)
    completed = search(tmp_path / "study.toml").write(tmp_path / "completed.toml")
    assert [one.turnaround for one in radioloc.read_study(completed).observations.uplinks] == [(880, 749)] * 3
    solution = radioloc.compute_residuals(completed)
    assert set(solution.residuals.path) == {f"{TRUE[name]}>lander>{name}" for name in TRUE}
    for name in TRUE:
        mine = solution.residuals.path == f"{TRUE[name]}>lander>{name}"
        # About its offset the pass is as quiet as its noise, but for the a-priori position, 10 km off.
        assert np.std(solution.residuals.residual_m[mine]) < 2.0 * SIGMA_M


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"transmitters": ("ATLANTIS",)}, r"\[observations\] transmitters: .*ATLANTIS"),
        ({"turnarounds": ("x",)}, "turnarounds: 'x' is no ratio of frequency down to up"),
        ({"transmitters": ("MLRS2",)}, "none of MLRS2 sees the target while"),
    ],
)
def test_what_cannot_be_is_said(received, chosen, message):
    with pytest.raises(InputError, match=message):
        search(study(**chosen), received)


def test_without_doppler_there_is_nothing_to_tell():
    ranges = Observations.from_columns(
        epoch=radioloc.time.epochs_from_strings(["2020-12-01T15:00:00"], "UTC"),
        links=[Link("KASHI", "lander", "KASHI")],
        value_m=8e8,
        sigma_m=1.0,
        tag=1,
    )
    with pytest.raises(InputError, match="there is no Doppler of a transmitting station"):
        search(study(), ranges)


@pytest.mark.parametrize("job", [radioloc.locate, radioloc.compute_residuals])
def test_jobs_name_the_search_where_candidates_are_all_there_is(received, job):
    with pytest.raises(InputError, match=r"transmitters: expected .*uplinks.*`radioloc search STUDY.toml"):
        job(study(), received)
