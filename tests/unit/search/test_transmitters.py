"""Transmitters of passes of listeners to a lander, selected among candidates by the residuals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from change5_case import LANDER, NEAR

import radioloc
from radioloc import Observations, Study
from radioloc.cli import main
from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io.formats import write_observations
from radioloc.jobs.preparation import prepared_arc
from radioloc.measurements import PhysicalModel
from radioloc.search import search
from radioloc.search.transmitters import _jumps, _passes
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, Truth
from radioloc.study import EstimateChoice, ObservationChoice

CANDIDATES = ("NEUQUEN", "JIAMUSI", "KASHI")
DOWN_HZ = 8.471e9
CYCLE_M = C_M_S / DOWN_HZ
NOISE_HZ, COUNT_S = 0.5, 10.0
SIGMA_M = NOISE_HZ * CYCLE_M * COUNT_S
# Transmitters by listening station, in Germany and China.
TRANSMITTERS = {"WETTZELL": "NEUQUEN", "KUNMING": "JIAMUSI", "URUMQI": "KASHI"}
HOURS = {
    "WETTZELL": ("2020-12-02T02:00:00", "2020-12-02T05:00:00"),
    "KUNMING": ("2020-12-01T15:00:00", "2020-12-01T18:00:00"),
    "URUMQI": ("2020-12-02T16:00:00", "2020-12-02T19:00:00"),
}


@pytest.fixture(scope="module")
def received():
    """Simulate X-band Doppler of three passes with offsets of the oscillators, without transmitters."""
    return without_transmitters(
        listened([(sender, listener, *HOURS[listener]) for listener, sender in TRANSMITTERS.items()])
    )


def listened(passes):
    """Simulate Doppler of passes: transmitter, listener, start and stop."""
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


def without_transmitters(observations):
    links = tuple(replace(link, transmitter="KASHI") for link in observations.links)
    return Observations.concatenate([replace(observations, links=links)])  # each link once


def study(estimate=None, **observations):
    chosen = {"transmitters": CANDIDATES} | observations
    return Study(
        target=NEAR, estimate=estimate or EstimateChoice(), observations=ObservationChoice(**chosen), name="x"
    )


def completed_observations(study, received):
    arc, _ = prepared_arc(search(study, received).study, received)
    return arc.observations


def transmitters(observations):
    return {link.receiver: link.transmitter for k in observations.link if (link := observations.links[k])}


def test_each_pass_has_its_true_transmitter(received):
    assert transmitters(completed_observations(study(), received)) == TRANSMITTERS


def test_handover_of_the_uplink_ends_a_pass():
    handover = "2020-12-01T15:00:00"
    received = listened(
        [
            ("JIAMUSI", "KUNMING", "2020-12-01T12:30:00", handover),
            ("KASHI", "KUNMING", handover, "2020-12-01T20:30:00"),
        ]
    )
    assert len(set(received.paths())) == 2
    value_m = received.value_m.copy()
    value_m[7::20] += 8.8e3 * CYCLE_M * COUNT_S  # from another spectral peak
    received = replace(received, value_m=value_m)
    assert [len(rows) for rows in _passes(without_transmitters(received), 4 * 3600.0)] == [38, 83]
    assert (
        completed_observations(study(), without_transmitters(received)).paths().tolist()
        == received.paths().tolist()
    )


@pytest.mark.parametrize(("jump_m_s", "expected"), [(0.0, []), (200.0, [150])])
def test_handovers_are_detected_in_rounded_rates(jump_m_s, expected):
    """Round to steps of 100 Hz, 3.5 m/s, which exceed the change between counts."""
    time_s = 60.0 * np.arange(330.0)
    rate_m_s = 300.0 * np.sin(time_s / 7000.0) + jump_m_s * (np.arange(330) >= 150)
    step_m_s = 3.548
    assert _jumps(time_s, step_m_s * np.rint(rate_m_s / step_m_s)) == expected


def test_true_transmitter_has_the_noise_of_the_data(received):
    result = search(study(), received)
    for item in result.transmitters:
        assert item.decided
        assert item.ranking[0] == TRANSMITTERS[item.receiver]
        best, *alternatives = ((item.rms_m_s[name] or np.inf) / CYCLE_M for name in item.ranking)
        # The a-priori position is wrong by 10 km, which amounts to a fraction of the noise.
        assert best == pytest.approx(NOISE_HZ, rel=0.3)
        assert min(alternatives, default=np.inf) > 10.0 * NOISE_HZ
    [first, *_] = json.loads(json.dumps(result.to_dict()))["transmitters"]
    assert set(first["rms_m_s"]) == set(CANDIDATES)
    assert first["decided"] is True


def test_turnaround_ratio_is_selected(received):
    ratio = 749 / 880 * 240 / 221
    carrier_m = C_M_S * COUNT_S
    wrong = replace(
        received,
        value_m=carrier_m - (carrier_m - received.value_m) / ratio,
        wavelength_um=received.wavelength_um / ratio,
    )
    completed = completed_observations(study(turnarounds=("240/221", "880/749")), wrong)
    np.testing.assert_allclose(completed.value_m, received.value_m, atol=1e-3 * SIGMA_M)
    np.testing.assert_allclose(completed.wavelength_um, received.wavelength_um, rtol=1e-12)
    with_transmitters = replace(wrong, links=completed.links, link=completed.link)
    ratios = search(study(turnarounds=("240/221", "880/749"), transmitters=None), with_transmitters)
    assert {item.ranking[0] for item in ratios.transmitters} == {"880/749"}


def test_candidates_a_hundred_metres_apart_are_undecided(received):
    catalogue = PhysicalModel.build().catalogue
    kashi = catalogue.get("KASHI")
    neighbour = replace(kashi, name="BESIDE", aliases=(), itrf_m=kashi.itrf_m + np.array([80.0, 60.0, 0.0]))
    chosen = study(EstimateChoice(position="none"), transmitters=("KASHI", "BESIDE"), stations=None)
    chosen = replace(chosen, catalogue=catalogue.with_station(neighbour))
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
transmitters = ["NEUQUEN", "JIAMUSI", "KASHI"] # candidates
turnarounds = ["880/749", "240/221"]
"""


def test_completed_file_states_the_uplink_of_each_pass(received, tmp_path):
    write_observations(tmp_path / "received.csv", received)
    (tmp_path / "study.toml").write_text(STUDY)
    completed, elsewhere = tmp_path / "completed.toml", tmp_path / "folder" / "completed.toml"
    assert main(["search", str(tmp_path / "study.toml"), "--out", str(completed), "--quiet"]) == 0
    assert "# candidates" not in completed.read_text()
    with pytest.raises(InputError, match="in the folder of"):
        search(tmp_path / "study.toml").write(elsewhere)
    assert [uplink.turnaround for uplink in radioloc.read_study(completed).observations.uplinks] == [
        (880, 749)
    ] * 3
    solution = radioloc.compute_residuals(completed)
    assert set(solution.residuals.path) == {f"{TRANSMITTERS[name]}>lander>{name}" for name in TRANSMITTERS}
    for name in TRANSMITTERS:
        in_pass = solution.residuals.path == f"{TRANSMITTERS[name]}>lander>{name}"
        # The scatter about the offset is the noise, and the effect of 10 km in the a-priori position.
        assert np.std(solution.residuals.residual_m[in_pass]) < 2.0 * SIGMA_M


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"transmitters": ("ATLANTIS",)}, r"\[observations\] transmitters: .*ATLANTIS"),
        ({"turnarounds": ("x",)}, r"turnarounds: .* 'x'"),
        ({"transmitters": ("MLRS2",)}, "below the horizon of MLRS2"),
    ],
)
def test_invalid_candidates_are_refused(received, chosen, message):
    with pytest.raises(InputError, match=message):
        search(study(**chosen), received)


@pytest.mark.parametrize("job", [radioloc.locate, radioloc.compute_residuals])
def test_jobs_need_uplinks_in_place_of_candidates(received, job):
    with pytest.raises(InputError, match=r"transmitters: expected .*uplinks"):
        job(study(), received)
