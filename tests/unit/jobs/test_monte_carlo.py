"""Monte Carlo studies: linear and full trials, wherever they run, interrupted and resumed, what is told and written."""

import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import change5_case
import numpy as np
import pytest
from change5_case import BIAS_M, LANDER, NEAR, PLAN, RANGING, START, VLBI, sessions
from quick import some

import radioloc
from radioloc.cli import main
from radioloc.errors import InputError, RadiolocError
from radioloc.jobs import workers
from radioloc.jobs.linear_trials import trial_seed
from radioloc.jobs.prepared_trials import Prepared
from radioloc.jobs.workers import open_workers
from radioloc.parameters.considered import considered_choices
from radioloc.results.monte_carlo import MonteCarlo, binomial_bounds
from radioloc.simulation import Noise, NoiseModel, Schedule, Session, Truth, TruthSigma
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.study.record import versions

HOURS = (12.0, 24.0)
NOISE = NoiseModel(
    {
        "range": Noise(
            white_m=0.8, coloured_m=1.0, correlation_s=7200.0, outlier_fraction=0.02, outlier_m=60.0
        ),
        "vlbi_delay": Noise(white_m=0.5),
    },
    vlbi_station=Noise(white_m=0.1),
)
TRUTH_SIGMA = TruthSigma(
    position_enu_m=(0.0, 0.0, 5.0),
    moon_position_m=(0.1, 0.5, 0.3),
    libration_rad=(1e-7, 1e-7, 1e-7),
    station_position_m=dict.fromkeys((*RANGING, *VLBI), (0.05, 0.05, 0.1)),
    ut1_s=2e-5,
    pole_rad=(5e-10, 5e-10),
    clock_s=dict.fromkeys(VLBI, 1e-10),
    clock_rate_s_s=dict.fromkeys(VLBI, 2e-15),
    range_bias_m=dict.fromkeys(RANGING, 10.0),
    zenith_delay_m=dict.fromkeys((*RANGING, *VLBI), 0.02),
    clock_epoch_utc=START,
)


def study_of(step_s=3600.0, *, truth_sigma=TRUTH_SIGMA, observations=None, **estimate):
    """Ranges and delays of a day; a-priori position 10 km off."""
    return change5_case.study_of(
        sessions(step_s, "2020-12-02T15:10:00"),
        NOISE,
        target=NEAR,
        estimate={"ephemeris_sigma_m": (0.5, 0.5, 0.3)} | estimate,
        scenario={"truth": Truth(range_bias_m=BIAS_M), "truth_sigma": truth_sigma, "seed": 5},
        observations=observations or ObservationChoice(),
        consider=considered_choices({"station_position_sigma_m": 0.1}),
        consider_defaults=True,
        name="plan",
    )


@pytest.fixture(scope="module")
def study():
    return study_of()


@pytest.fixture(scope="module")
def ready(study):
    return Prepared.from_study(study, HOURS)


@pytest.fixture(scope="module")
def trial_study(study, tmp_path_factory):
    return radioloc.monte_carlo(study, 60, HOURS, out=tmp_path_factory.mktemp("found"))


def columns_of(ready, values, *names):
    return values[..., [ready.columns.index(name) for name in names]]


@pytest.mark.study
def test_linear_trials_are_the_full_ones(study, ready):
    linear, full = ready.linear().run(5, range(4)), ready.run(5, range(4))
    error_m, sigma_m = ("east_m", "north_m", "up_m"), ("sigma_east_m", "sigma_north_m", "sigma_up_m")
    apart_m = np.abs(columns_of(ready, linear - full, *error_m))
    assert (apart_m < np.maximum(1e-3, 0.01 * columns_of(ready, full, *sigma_m))).all()
    ratio = columns_of(ready, linear, *sigma_m) / columns_of(ready, full, *sigma_m)
    np.testing.assert_allclose(ratio, 1.0, rtol=0.0, atol=1e-2)
    counts = ("used", "rejected", "converged")
    assert (columns_of(ready, linear, *counts) == columns_of(ready, full, *counts)).all()
    biases = [name for name in ready.columns if name.startswith("range_bias")]
    assert len(biases) == 9
    np.testing.assert_allclose(
        columns_of(ready, linear, *biases), columns_of(ready, full, *biases), rtol=0.0, atol=0.02
    )


@pytest.mark.study
@pytest.mark.parametrize("vlbi_station_sigma_m", some([0.0, 0.1], [0.1]))
def test_correlated_weights_are_those_of_the_full_fit(vlbi_station_sigma_m):
    choice = ObservationChoice(vlbi_station_sigma_m=vlbi_station_sigma_m)
    study = study_of(600.0, observations=choice, weights="correlated")
    plain = study_of(600.0, observations=choice, weights="independent")
    ready = Prepared.from_study(study, (24.0,))
    linear, full = (way.run(5, [1]) for way in (ready.linear(), ready))
    errors = columns_of(ready, linear - full, "east_m", "north_m", "up_m")
    sigmas = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
    assert (np.abs(errors) < 0.01 * columns_of(ready, full, *sigmas)).all()
    ratio = columns_of(ready, linear, *sigmas) / columns_of(ready, full, *sigmas)
    np.testing.assert_allclose(ratio, 1.0, rtol=0.0, atol=0.01)
    # And other weights than before.
    unlike = Prepared.from_study(plain, (24.0,)).linear().run(5, [1])
    assert (np.abs(columns_of(ready, linear - unlike, "north_m")) > 0.01).all()


def test_a_full_trial_is_what_locate_gives(study, ready):
    quiet = replace(study.simulation, truth_sigma=TruthSigma(considered=False))
    item = replace(study, simulation=quiet, estimate=replace(study.estimate, clock_epoch=START))
    seed = trial_seed(5, 3)
    simulated = radioloc.simulate(item, seed=seed)
    separate_solution = radioloc.locate(
        replace(item, observations=ObservationChoice(hours=24.0), reference=radioloc.study.Reference(LANDER)),
        simulated.observations,
    )
    trial = Prepared.from_study(item, HOURS).run(5, [3])[0, 0]
    trial_values = dict(zip(ready.columns, trial, strict=True))
    np.testing.assert_allclose(
        [trial_values[f"{axis}_m"] for axis in ("east", "north", "up")],
        [
            separate_solution.reference.east_m,
            separate_solution.reference.north_m,
            separate_solution.reference.up_m,
        ],
        rtol=0.0,
        atol=1e-4,
    )
    assert trial_values["rejected"] == separate_solution.fit.total.rejected
    assert trial_values["nees"] == pytest.approx(separate_solution.reference.combined_sigmas**2, rel=1e-3)


def test_a_trial_does_not_depend_on_the_others(ready):
    linear = ready.linear()
    block = linear.run(9, range(7))
    one_by_one = np.concatenate([linear.run(9, [trial]) for trial in range(7)])
    np.testing.assert_array_equal(block, one_by_one)
    assert trial_seed(9, 2) != trial_seed(9, 3) != trial_seed(8, 3)
    child = np.random.SeedSequence(9).spawn(4)[3]
    assert trial_seed(9, 3) == sum(int(w) << (32 * k) for k, w in enumerate(child.generate_state(4)))


@pytest.mark.slow
def test_processes_give_the_same_bits(study, trial_study):
    in_pool = radioloc.monte_carlo(study, 60, HOURS, workers=2)
    np.testing.assert_array_equal(in_pool.values, trial_study.values)


@pytest.mark.slow
def test_threads_of_linear_algebra_give_the_same_bits(tmp_path):
    code = (
        "import pickle, sys, numpy as np; job = pickle.load(open(sys.argv[1] + '.job', 'rb')); "
        "np.save(sys.argv[1], job.run(1, range(3)))"
    )
    job = Prepared.from_study(study_of(120.0), HOURS).linear()
    results = []
    for threads in ("1", "2"):
        name = tmp_path / f"{threads}.npy"
        Path(f"{name}.job").write_bytes(pickle.dumps(job))
        environment = os.environ | {"OPENBLAS_NUM_THREADS": threads}
        subprocess.run([sys.executable, "-c", code, str(name)], check=True, env=environment)
        results.append(np.load(name))
    np.testing.assert_array_equal(*results)


class _LosingCluster:
    """A job during which its cluster loses all that it holds."""

    def run(self, seed, trials):
        distributed = pytest.importorskip("distributed")
        distributed.get_client().restart(wait_for_workers=False)
        return np.zeros((len(trials), 1, 1))


@pytest.mark.study
@pytest.mark.filterwarnings("ignore")  # those of the cluster's own
def test_unusable_clusters_are_one_error(monkeypatch):
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        with open_workers(client) as pool, pytest.raises(RadiolocError, match="lost its workers"):
            list(pool.run(_LosingCluster(), 1, [[0], [1]]))
        installed = versions()
        monkeypatch.setattr(client, "run", lambda function: {"tcp://w": installed | {"radioloc": "0.0.1"}})
        with open_workers(client) as pool, pytest.raises(InputError, match=r"0\.0\.1"):
            list(pool.run(_LosingCluster(), 1, [[0]]))
        monkeypatch.setattr(client, "run", lambda function: {})
        with open_workers(client) as pool, pytest.raises(InputError, match="no workers"):
            list(pool.run(_LosingCluster(), 1, [[0]]))
    monkeypatch.setattr(workers, "_CONNECTION_TIMEOUT_S", 0.5)
    with pytest.raises(InputError, match="cannot be reached"), workers.dask_client("tcp://127.0.0.1:1"):
        pass


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # those of the cluster's own
def test_a_cluster_gives_the_same_bits(study, trial_study):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        second = radioloc.monte_carlo(study, 60, HOURS, workers=client)
    np.testing.assert_array_equal(second.values, trial_study.values)


@pytest.mark.slow
def test_where_the_linear_model_is_off_all_is_fitted_in_full(study, ready, monkeypatch):
    from radioloc.jobs import monte_carlo as module

    monkeypatch.setattr(module, "_ALLOWED_M", 0.0)
    monkeypatch.setattr(module, "_ALLOWED_SIGMAS", 1e-9)
    result = radioloc.monte_carlo(study, 3, HOURS)
    assert not result.linear
    assert not result.linearity.passed
    np.testing.assert_array_equal(result.values, ready.run(5, range(3)))
    assert "every trial fitted in full, as the linear model differs by up to" in str(result)


def test_where_not_everything_is_determined_all_is_fitted_in_full():
    stop = "2020-12-01T15:21:00"
    separate = [Session("range", (("KASHI", "KASHI"),), START, stop, 600.0, sigma_m=1.0)]
    item = study_of(height_prior=None, range_bias="none")
    item = replace(
        item, simulation=replace(item.simulation, schedule=Schedule(separate), truth_sigma=TruthSigma())
    )
    result = radioloc.monte_carlo(item, 2, [1.0])
    assert not result.linear
    assert result.linearity is None
    assert not result.converged
    assert "NOT CONVERGED in 2 of the trials" in str(result)
    assert result.arcs == (None,)
    assert result.to_dict()["arcs"] == [{"hours": 1.0, "converged": 0}]


UNGUARDED = """
from radioloc.jobs.workers import open_workers
with open_workers(2) as pool:
    list(pool.run(None, 0, [[0], [1]]))
"""


@pytest.mark.slow
def test_a_script_without_a_guard_is_told(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "InputError: a script that asks for several workers needs" in ended.stderr
    assert "freeze_support" not in ended.stderr  # what multiprocessing has to say of it


# Interrupted and resumed.


@pytest.mark.slow
def test_resumed_with_more_trials(study, trial_study, tmp_path):
    first = radioloc.monte_carlo(study, 20, HOURS, out=tmp_path)
    parts = {path: path.stat().st_mtime_ns for path in (tmp_path / "parts").glob("*.npz")}
    extra = radioloc.monte_carlo(study, 60, HOURS, out=tmp_path, resume=True)
    np.testing.assert_array_equal(first.values, trial_study.values[:20])
    np.testing.assert_array_equal(extra.values, trial_study.values)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in parts.items())
    # Fewer are the first of them.
    shorter = radioloc.monte_carlo(study, 10, HOURS, out=tmp_path, resume=True)
    np.testing.assert_array_equal(shorter.values, trial_study.values[:10])


KILLED = """
import os, signal, sys
sys.path[:0] = sys.argv[2:]
import radioloc
from radioloc.jobs.trial_folder import TrialFolder
from test_monte_carlo import HOURS, study_of

add = TrialFolder.add
def add_and_die(self, *arguments):
    add(self, *arguments)
    os.kill(os.getpid(), signal.SIGKILL)
TrialFolder.add = add_and_die
radioloc.monte_carlo(study_of(), 60, HOURS, out=sys.argv[1])
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_killed_and_resumed(study, trial_study, tmp_path):
    local = Path(__file__).resolve()
    paths = [str(local.parent), str(local.parents[2] / "support")]
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), *paths], check=False)
    assert killed.returncode == -signal.SIGKILL
    [part] = (tmp_path / "parts").glob("*.npz")
    assert part.name == "linear-000000-000024.npz"
    time.sleep(0.01)
    stamp = part.stat().st_mtime_ns
    resumed = radioloc.monte_carlo(study, 60, HOURS, out=tmp_path, resume=True)
    np.testing.assert_array_equal(resumed.values, trial_study.values)
    assert part.stat().st_mtime_ns == stamp


CHANGES = [
    (lambda s: replace(s, estimate=replace(s.estimate, rejection_sigma=6.0)), "estimate"),
    (lambda s: replace(s, simulation=replace(s.simulation, noise=NoiseModel())), "simulation"),
    (lambda s: replace(s, model=ModelChoice()), "model"),
]


@pytest.mark.parametrize(("changed", "message"), some(CHANGES, CHANGES[:1]))
def test_another_study_is_refused(study, tmp_path, changed, message):
    radioloc.monte_carlo(study, 1, [12.0], out=tmp_path)
    with pytest.raises(InputError, match=f"of another study .what differs: {message}.; give another folder"):
        radioloc.monte_carlo(changed(study), 1, [12.0], out=tmp_path, resume=True)
    with pytest.raises(InputError, match="what differs: seed, hours"):
        radioloc.monte_carlo(study, 1, [6.0], seed=1, out=tmp_path, resume=True)


# What is told and written.


@pytest.mark.study
def test_the_summary_is_that_of_the_trials(trial_study):
    [day, half] = trial_study.arcs
    assert (day.hours, half.hours) == (24.0, 12.0)
    for k, arc in enumerate((day, half)):
        assert arc.trials == arc.converged == 60
        enu_m = np.stack([trial_study[f"{axis}_m"][:, k] for axis in ("east", "north", "up")])
        np.testing.assert_allclose(arc.rms_m, np.sqrt((enu_m**2).mean(axis=1)), rtol=1e-12)
        np.testing.assert_allclose(arc.mean_m, enu_m.mean(axis=1), rtol=1e-9)
        horizontal_m = np.hypot(*enu_m[:2])
        assert (horizontal_m <= arc.radius_95_m).sum() == 57
        fraction = np.abs(enu_m[2]) <= 1.959963984540054 * trial_study["sigma_up_m"][:, k]
        assert arc.coverage["up"].count == fraction.sum()
        assert arc.nees.mean == pytest.approx(trial_study["nees"][:, k].mean() / 3.0)
        [bias] = [p for p in arc.parameters if p.name == "range_bias.KASHI"]
        errors_m = trial_study["range_bias.KASHI.error"][:, k]
        assert bias.rms_error == pytest.approx(np.sqrt((errors_m**2).mean()))
        assert bias.rms_error < bias.std
    apart_m = np.hypot(
        *(trial_study[f"{axis}_m"][:, 1] - trial_study[f"{axis}_m"][:, 0] for axis in ("east", "north"))
    )
    assert half.from_longest_95_m == pytest.approx(np.quantile(apart_m, 0.95))
    assert day.from_longest_95_m is None


def test_types_without_noise_are_named(ready, trial_study):
    notes = tuple(NoiseModel({"range": Noise(white_m=1.0)}).notes(ready.world.plan.observations))
    assert notes == ("[simulation.noise.vlbi_delay] is not given: values without noise",)
    silent = replace(ready, world=replace(ready.world, notes=notes))
    [result] = silent.results(trial_study.values, seed=5, linear=True, linearity=None)
    assert result.notes == notes
    assert "[simulation.noise.vlbi_delay]" in str(result)
    assert not trial_study.notes


def test_binomial_bounds_are_exact():
    # Tables of the binomial distribution: n = 20, p = 0.95, P(X <= 16) = 0.0159, P(X <= 17) = 0.0755.
    assert binomial_bounds(20, 0.95) == (17 / 20, 1.0)
    # n = 200: quantiles of 2.5 and 97.5 %, as tests/statistics has them.
    assert binomial_bounds(200, 0.95) == (0.92, 0.98)


def test_trials_that_did_not_converge_do_not_count():
    columns = ("converged", "used", "rejected", "east_m", "north_m", "up_m", "sigma_east_m", "sigma_north_m")
    columns += ("sigma_up_m", "nees", "nees_horizontal")
    good = [1.0, 10.0, 1.0, 3.0, 4.0, 0.0, 1.0, 1.0, 1.0, 25.0, 25.0]
    bad = [0.0, 10.0, 1.0, 3e3, 4e3, 0.0, 1.0, 1.0, 1.0, np.nan, np.nan]
    values = np.array([[good], [bad], [good]])
    [trial_study] = MonteCarlo("plan", 1, (12.0,), (11.9,), columns, values, True, None, ()).arcs
    assert (trial_study.trials, trial_study.converged) == (3, 2)
    assert trial_study.radius_95_m == pytest.approx(5.0)
    assert trial_study.coverage["horizontal"].count == 0


@pytest.mark.study
def test_the_command(tmp_path, capsys):
    (tmp_path / "plan.toml").write_text(PLAN)
    arguments = ["montecarlo", str(tmp_path / "plan.toml"), "--trials", "5", "--hours", "6", "12"]
    assert main([*arguments, "--seed", "3", "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr()
    assert "5 trials, 2 arcs: all converged" in output.out
    assert output.err == ""
    assert (tmp_path / "out" / "trials.csv").is_file()
    assert main([*arguments, "--quiet", "--out", str(tmp_path / "out"), "--resume"]) == 2
    assert "what differs: seed" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*arguments, "--resume"])
    assert "--resume needs --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"trials": 0}, "trials is 0"),
        ({"hours": [-1.0]}, "hours: expected a number above zero"),
        ({"resume": True}, "to resume needs the folder"),
    ],
)
def test_arguments_that_cannot_be(study, arguments, message):
    with pytest.raises(InputError, match=message):
        radioloc.monte_carlo(study, **arguments)


def test_studies_that_cannot_be(study):
    with pytest.raises(InputError, match="with a simulation"):
        radioloc.monte_carlo(replace(study, simulation=None))
    with pytest.raises(InputError, match="needs the position estimated"):
        radioloc.monte_carlo(replace(study, estimate=EstimateChoice(position="none", range_bias="all")))
