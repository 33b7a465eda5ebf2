"""What a plan would tell, against fits, other studies and trials."""

import dataclasses
import json

import change5_case
import numpy as np
import pytest
from change5_case import LANDER, NOISE, PLAN, RANGING, VLBI, sessions
from dense_noise import dense

import radioloc
from radioloc import cli
from radioloc.errors import InputError
from radioloc.jobs.covariance import covariance
from radioloc.measurements import PhysicalModel
from radioloc.report import plot
from radioloc.results.covariance import radius_95_m
from radioloc.simulation import Noise, NoiseModel, TruthSigma, two_way
from radioloc.simulation.noise import NoiseDraws

STOP = "2020-12-02T15:10:00"
COLOURED = NoiseModel(
    link={"range": Noise(1.0, 1.5, 7200.0), "vlbi_delay": Noise(0.3)},
    vlbi_station=Noise(white_m=0.15, coloured_m=0.3, correlation_s=5400.0),
)


def study_of(noise=NOISE, stations=RANGING, vlbi=VLBI, step_s=1800.0, sigma=None, **changes):
    planned = sessions(step_s, STOP, stations, vlbi)
    drawn = {"truth_sigma": TruthSigma(**sigma or {})}
    return change5_case.study_of(planned, noise, scenario=drawn, **{"candidates": ()} | changes)


@pytest.fixture(scope="module")
def planned():
    reach_m = 1.2 * covariance(study_of(COLOURED), 24.0).longest.radius_95_m
    return covariance(study_of(COLOURED, candidates=["TIANMA65"]), reach_m=reach_m)


def test_a_radius_is_that_of_random_points():
    random = np.random.default_rng(1)
    for matrix in ([[4.0, 0.0], [0.0, 4.0]], [[9.0, 2.0], [2.0, 1.0]], [[1e-8, 0.0], [0.0, 25.0]]):
        points = random.multivariate_normal([0.0, 0.0], matrix, 200_000)
        fraction = np.mean(np.hypot(*points.T) < radius_95_m(np.array(matrix)))
        assert fraction == pytest.approx(0.95, abs=0.002)  # four sigmas of the fraction
    assert radius_95_m(np.eye(2)) == pytest.approx(np.sqrt(-2.0 * np.log(0.05)), rel=1e-6)
    assert radius_95_m(np.zeros((2, 2))) == 0.0
    assert radius_95_m(np.full((2, 2), np.inf)) == np.inf


@pytest.mark.slow
def test_noise_of_a_schedule_has_the_covariance_that_is_drawn():
    noise = NoiseModel(
        link={"range": Noise(0.5, 1.5, 3600.0, walk_m_sqrt_s=0.01, flicker_m=0.8), "vlbi_delay": Noise(0.3)},
        vlbi_station=Noise(white_m=0.2, coloured_m=0.3, correlation_s=5400.0, walk_m_sqrt_s=0.002),
    )
    model = PhysicalModel.build(off=["ionosphere"])
    study = study_of(noise, stations=("JIAMUSI", "KASHI"), vlbi=VLBI[:3], step_s=10800.0)
    plan = study.simulation.schedule.plan(model, LANDER)
    expected = dense(noise.covariance(plan))
    drawn_m, _ = NoiseDraws.from_plan(noise, plan).draw(range(4000))
    sigma_m = np.sqrt(np.diag(expected))
    off = (drawn_m.T @ drawn_m / 4000 - expected) / np.outer(sigma_m, sigma_m)
    # A correlation from 4000 draws is known to 0.016, a variance to 0.022.
    assert np.abs(off).max() < 5.0 * 0.022
    assert np.sqrt(np.mean(off**2)) < 1.3 * 0.016


def test_sigmas_of_data_are_the_formal_ones_of_a_fit():
    study = study_of()
    data = radioloc.simulate(study, seed=3).observations
    requested = dataclasses.replace(
        study, simulation=None, estimate=dataclasses.replace(study.estimate, weights="independent")
    )
    solution = radioloc.locate(requested, data)
    planned = covariance(study, 24.0).longest
    np.testing.assert_allclose(planned.sigma_m, solution.sigma_enu_m("formal"), rtol=1e-3)
    assert planned.count == solution.fit.total.used
    assert solution.fit.excess_noise_m["range"] == 0.0


def test_epochs_of_files(tmp_path):
    study = study_of()
    simulated = radioloc.simulate(study, seed=3)
    radioloc.write_observations(tmp_path / "d.csv", simulated.observations)
    files = dataclasses.replace(study.observations, files=(tmp_path / "d.csv",))
    of_files = covariance(dataclasses.replace(study, simulation=None, observations=files), 24.0)
    expected = covariance(study, 24.0)
    np.testing.assert_allclose(
        of_files.longest.covariance_m2, expected.longest.covariance_m2, rtol=1e-6, atol=1e-9
    )
    assert "taken as white" in of_files.notes[0]
    assert not any(item.change.startswith("station") for item in of_files.improvements)


@pytest.mark.study
def test_budget_adds_up(planned):
    for arc in planned.arcs:
        total = sum(np.diag(source.covariance_m2) for source in arc.sources)
        np.testing.assert_allclose(total, arc.sigma_m**2, rtol=1e-9)
        records = arc.to_dict()["budget"]
        assert [r["total_m"] for r in records] == sorted((r["total_m"] for r in records), reverse=True)
        assert np.sqrt(sum(r["total_m"] ** 2 for r in records)) == pytest.approx(np.linalg.norm(arc.sigma_m))
    assert {"measurement noise", "a priori"} <= set(planned.longest.by_source())


@pytest.mark.study
def test_longer_is_better_and_the_reach_lies_between(planned):
    radii = [arc.radius_95_m for arc in planned.arcs]
    assert radii == sorted(radii, reverse=True)
    assert planned.arcs[0].hours == 0.5
    earlier, at = covariance(study_of(COLOURED), [planned.reach_h - 0.1, planned.reach_h]).arcs
    assert at.radius_95_m <= planned.reach_m < earlier.radius_95_m
    assert covariance(study_of(COLOURED), 24.0, reach_m=0.1).reach_h is None


def test_what_a_candidate_would_buy_is_the_plan_with_it(planned):
    [item] = [item for item in planned.improvements if item.change == "station TIANMA65"]
    larger = covariance(study_of(COLOURED, vlbi=(*VLBI, "TIANMA65")), planned.longest.hours)
    assert item.radius_95_m == pytest.approx(larger.longest.radius_95_m, rel=1e-6)
    assert item.radius_95_m < planned.longest.radius_95_m


def test_a_candidate_link_is_measured_as_its_session():
    planned = covariance(
        study_of(stations=("JIAMUSI",), vlbi=(), candidates=["JIAMUSI>lander>KASHI", "KASHI"]), 24.0
    )
    buys = {item.change: item.radius_95_m for item in planned.improvements}
    receives = study_of(stations=("JIAMUSI",), vlbi=())
    [session] = receives.simulation.schedule.sessions
    extra = dataclasses.replace(session, pairs=(*session.pairs, ("JIAMUSI", "KASHI")))
    schedule = dataclasses.replace(receives.simulation.schedule, sessions=[extra])
    scenario = dataclasses.replace(receives.simulation, schedule=schedule)
    expected = covariance(dataclasses.replace(receives, simulation=scenario), 24.0)
    assert buys["link JIAMUSI>lander>KASHI"] == pytest.approx(expected.longest.radius_95_m, rel=1e-6)
    itself = dataclasses.replace(session, pairs=two_way("JIAMUSI", "KASHI"))
    scenario = dataclasses.replace(scenario, schedule=dataclasses.replace(schedule, sessions=[itself]))
    expected = covariance(dataclasses.replace(receives, simulation=scenario), 24.0)
    assert buys["station KASHI"] == pytest.approx(expected.longest.radius_95_m, rel=1e-6)


@pytest.mark.study
def test_what_is_known_and_what_is_left_out(planned):
    buys = {item.change: item.radius_95_m for item in planned.improvements}
    reference = covariance(
        study_of(COLOURED, estimate={"range_bias": "none", "range_bias_sigma_m": None}), planned.longest.hours
    )
    assert buys["range_bias known"] == pytest.approx(reference.longest.radius_95_m, rel=1e-3)
    ranges = covariance(study_of(COLOURED, vlbi=()), planned.longest.hours).longest
    of_type = {share.name: share for share in planned.contributions if share.group == "type"}
    assert of_type["range"].alone_m == pytest.approx(ranges.radius_95_m, rel=1e-3)
    assert of_type["vlbi_delay"].without_m == of_type["range"].alone_m
    shorter = covariance(study_of(COLOURED, vlbi=VLBI[1:]), planned.longest.hours).longest
    [seshan] = [share for share in planned.contributions if share.name == VLBI[0]]
    assert seshan.without_m == pytest.approx(shorter.radius_95_m, rel=1e-3)
    assert seshan.without_m > planned.longest.radius_95_m


def test_what_cannot_be_observed_is_said():
    free = {"height_prior": None, "range_bias_sigma_m": None}
    planned = covariance(study_of(stations=("KASHI",), vlbi=(), estimate=free), 0.1)
    assert not planned.determined
    assert "NOT OBSERVABLE: the data do not determine" in " ".join(str(planned).split())
    assert planned.to_dict()["arcs"][0]["radius_95_m"] is None
    assert planned.improvements == ()
    with pytest.raises(InputError, match="a length that determines"):
        plot(planned, "covariance")


@pytest.mark.parametrize(
    ("changes", "extra", "message"),
    [
        ({"estimate": {"position": "none", "height_prior": None}}, {}, 'position is "none"'),
        ({}, {"hours": [0.0]}, "hours"),
        ({"candidates": ["NOWHERE"]}, {}, "NOWHERE"),
    ],
)
def test_studies_that_cannot_be(changes, extra, message):
    with pytest.raises(radioloc.RadiolocError, match=message):
        covariance(study_of(step_s=7200.0, **changes), **({"hours": 24.0} | extra))


@pytest.mark.study
@pytest.mark.usefixtures("undrawn")
def test_the_command(tmp_path, capsys):
    plan, second = tmp_path / "plan.toml", tmp_path / "other.toml"
    plan.write_text(PLAN, encoding="utf-8")
    second.write_text(PLAN.replace("T03:10", "T01:10"), encoding="utf-8")
    assert cli.main(["covariance", str(plan), "--reach", "15000", "--out", str(tmp_path / "one")]) == 0
    written = json.loads((tmp_path / "one" / "covariance.json").read_text())
    assert written["reach"]["hours"] < 11.0
    assert written["arcs"][-1]["observations"] == 20
    rows = (tmp_path / "one" / "covariance.csv").read_text().splitlines()
    assert len(rows) == 1 + len(written["arcs"])
    assert cli.main(["covariance", str(plan), str(second), "--out", str(tmp_path), "--quiet"]) == 0
    assert (tmp_path / "plan" / "covariance.json").exists()
    assert (tmp_path / "other" / "covariance.json").exists()
    blind = tmp_path / "blind.toml"
    blind.write_text(PLAN.replace('"JIAMUSI", "KASHI"', '"KASHI"'))
    assert cli.main(["covariance", str(blind), "--hours", "0.1"]) == 3
    assert "NOT OBSERVABLE" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        cli.main(["covariance", str(plan), str(plan)])
    assert end.value.code == 2
