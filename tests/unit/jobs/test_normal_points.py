"""Normal points give the position and the sigmas of all observations, however their files are divided."""

from dataclasses import replace

import numpy as np
import pytest
from change5_case import LANDER, NOISE, RANGING, START, VLBI

from radioloc.errors import DataQualityWarning, InputError
from radioloc.io import write_observations
from radioloc.io.formats import READERS
from radioloc.jobs import preparation
from radioloc.jobs.covariance import covariance
from radioloc.jobs.locate import locate
from radioloc.jobs.preparation import prepared_arc
from radioloc.measurements import Observations, PhysicalModel
from radioloc.measurements.registry import kind_of
from radioloc.simulation import Scenario, Schedule, Session, all_ranges, baselines
from radioloc.study.study_file import read_study
from radioloc.time import tai_to_utc, utc_to_tai

# A priori 70 km off: residuals have slopes of centimetres a second.
STUDY = """
[target]
longitude_deg = -50.0
latitude_deg = 44.0
height_m = -2500.0
[observations]
files = ["dense.parquet"]
normal_point_s = 60
[estimate]
height_prior = { height_m = -2550.4, sigma_m = 5.0 }
[consider]
defaults = false
[model]
off = ["ionosphere"]
"""


@pytest.fixture(scope="module")
def dense():
    """Observations every two seconds for two hours, in random order."""
    stop = START.replace("15:11", "17:11")
    sessions = [
        Session("range", all_ranges(*RANGING), START, stop, 2.0, sigma_m=1.0, one_uplink=True),
        Session("vlbi_delay", baselines(*VLBI), START, stop, 2.0, sigma_m=0.3),
    ]
    model = PhysicalModel.build(off=["ionosphere"])
    scenario = Scenario(Schedule(sessions), LANDER, noise=NOISE, seed=3)
    observations = scenario.world(model).draw().observations
    return observations.select(np.random.default_rng(1).permutation(len(observations)))


@pytest.fixture(scope="module")
def study(dense, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dense")
    write_observations(folder / "dense.parquet", dense)
    (folder / "study.toml").write_text(STUDY)
    return read_study(folder / "study.toml")


def in_order(observations):
    return observations.select(np.lexsort((observations.paths(), observations.epoch.mjd)))


def with_choice(study, **changes):
    return replace(study, observations=replace(study.observations, **changes))


def test_position_and_sigmas_are_those_of_all_observations(study):
    condensed, full = locate(study), locate(with_choice(study, normal_point_s=None))
    assert condensed.converged
    assert len(condensed.residuals) < len(full.residuals) / 25
    np.testing.assert_allclose(condensed.sigma_enu_m(), full.sigma_enu_m(), rtol=0.01)
    difference_m = np.linalg.norm(condensed.position_pa_m - full.position_pa_m)
    assert difference_m < 0.05 * np.linalg.norm(full.sigma_enu_m())
    assert condensed.provenance["normal_point_s"] == 60.0


def test_points_do_not_depend_on_the_parts_in_which_observations_are_read(study, dense, monkeypatch):
    expected = in_order(prepared_arc(study)[0].observations)
    monkeypatch.setattr(preparation, "_ROWS_AT_ONCE", 3000)
    monkeypatch.setattr("radioloc.io.table._ROWS_READ", 1000)
    for observations in (None, dense):
        parts = in_order(prepared_arc(study, observations)[0].observations)
        assert (parts.paths() == expected.paths()).all()
        assert (parts.epoch.jd == expected.epoch.jd).all()
        np.testing.assert_allclose(parts.value_m, expected.value_m, rtol=0.0, atol=1e-5)
        np.testing.assert_allclose(parts.sigma_m, expected.sigma_m, rtol=1e-9)


def test_readers_of_other_formats_yield_parts(study, dense, tmp_path, monkeypatch):
    write_observations(tmp_path / "dense.csv", dense)
    reader, lengths = READERS["table of observations"], []

    def in_parts(path, settings, rows_at_once):
        for part in reader.read([path], settings).parts(rows_at_once):
            lengths.append(len(part))
            yield part

    monkeypatch.setitem(READERS._entries, reader.name, replace(reader, in_parts=in_parts))
    monkeypatch.setattr(preparation, "_ROWS_AT_ONCE", 3000)
    points = prepared_arc(with_choice(study, files=(tmp_path / "dense.csv",)))[0].observations
    assert sum(lengths) == len(dense)
    assert len(points) == len(prepared_arc(study)[0].observations)


def test_partials_of_many_sparse_observations_are_those_of_each(study, monkeypatch):
    expected = locate(study)
    monkeypatch.setattr("radioloc.targets.design._MAX_KEPT_ELEMENTS", 0)
    monkeypatch.setattr("radioloc.targets.design._MIN_SMOOTH_ROWS", 10)
    np.testing.assert_allclose(locate(study).position_pa_m, expected.position_pa_m, rtol=0.0, atol=1e-6)


def test_delays_of_an_interval_have_one_epoch(study):
    points = prepared_arc(with_choice(study, types=("vlbi_delay",)))[0].observations
    assert len(np.unique(points.epoch.mjd)) < len(points) / len(np.unique(points.link)) + 3


def test_outliers_are_rejected_and_counted(study, dense):
    value_m, rows = dense.value_m.copy(), [5, 70, 900]
    value_m[rows] += 40.0
    points = prepared_arc(study, dense)[0].observations
    arc, left_out = prepared_arc(study, replace(dense, value_m=value_m))
    assert left_out == {"outlier of a normal point": len(rows)}
    is_equal = arc.observations.epoch.mjd == points.epoch.mjd
    assert (~is_equal).sum() <= len(rows)
    assert abs(arc.observations.value_m - points.value_m)[is_equal].max() < 1.0


def test_observations_below_the_horizon_are_rejected_and_counted(study, dense):
    hidden = replace(dense[:4], epoch=tai_to_utc(utc_to_tai(dense.epoch[:4]).shifted(43200.0)))
    _, left_out = prepared_arc(study, Observations.concatenate([dense, hidden]))
    assert left_out == {"below the horizon": 4}


def test_single_observations_and_one_sided_intervals_keep_their_epochs(study, dense):
    sparse = dense.select(np.flatnonzero(dense.link == dense.link[0]))
    sparse = sparse.select(np.argsort(sparse.epoch.mjd))[::10]
    points = prepared_arc(with_choice(study, normal_point_s=15.0), sparse)[0].observations
    np.testing.assert_allclose(points.epoch.mjd, sparse.epoch.mjd, rtol=0.0, atol=0.16 / 86400.0)
    np.testing.assert_allclose(points.sigma_m, sparse.sigma_m)


def test_doppler_stays_as_it_is(study, dense):
    counts = replace(
        dense[:50],
        kind=np.full(50, kind_of("doppler"), dtype=np.int8),
        value_m=np.full(50, 100.0),
        count_s=np.ones(50),
        uplink_hz=np.full(50, 7.2e9),
        link=np.zeros(50, dtype=np.int32),
        tag=np.ones(50, dtype=np.int8),
    )
    arc, _ = prepared_arc(study, Observations.concatenate([counts, dense]))
    assert (arc.observations.kind == kind_of("doppler")).sum() == 50


def test_stations_that_no_part_has_are_refused(study):
    with pytest.raises(InputError, match=r"MADRID"):
        prepared_arc(with_choice(study, stations=("MADRID",)))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"normal_point_s": 3600.0}, "300 s"),
        ({"hours": 12.0}, "start"),
        ({"normal_point_s": -1.0}, "normal_point_s"),
    ],
)
def test_lengths_and_hours_that_cannot_be_used_are_refused(study, changes, expected):
    with pytest.raises(InputError, match=expected):
        prepared_arc(with_choice(study, **changes))


def test_precise_points_far_from_the_estimate_are_a_misfit(study, dense):
    precise = replace(dense, sigma_m=np.full(len(dense), 1e-3))
    solution = locate(with_choice(study, normal_point_s=300.0), precise)
    assert not solution.converged
    assert "normal_point_s" in solution.message


def test_copies_in_one_table_count_once_and_those_in_two_files_are_noted(study, dense, tmp_path):
    expected = prepared_arc(study, dense)[0].observations
    with pytest.warns(DataQualityWarning):
        points = prepared_arc(study, Observations.concatenate([dense, dense]))[0].observations
    np.testing.assert_allclose(points.sigma_m, expected.sigma_m)
    write_observations(tmp_path / "a.parquet", dense)
    write_observations(tmp_path / "b.parquet", dense)
    with pytest.warns(DataQualityWarning, match="in another file"):
        prepared_arc(with_choice(study, files=(tmp_path / "a.parquet", tmp_path / "b.parquet")))


def test_weights_of_a_file_are_those_of_its_points(study, dense, tmp_path):
    write_observations(tmp_path / "a.parquet", dense[::2])
    write_observations(tmp_path / "b.parquet", dense[1::2])
    chosen = {"files": (tmp_path / "a.parquet", tmp_path / "b.parquet")}
    with pytest.warns(DataQualityWarning):
        points = prepared_arc(with_choice(study, **chosen))[0].observations
    assert np.bincount(points.file).min() > 0.4 * len(points)


def test_misspelt_names_and_observations_of_another_type_are_refused(study):
    with pytest.raises(InputError, match=r"target_names.*ce55"):
        prepared_arc(with_choice(study, target_names={"ce55": "lander"}))
    with pytest.raises(InputError, match="observations"):
        locate(study, "dense.parquet")


def test_reasons_are_given_if_nothing_is_left(study, dense):
    hidden = replace(dense, epoch=tai_to_utc(utc_to_tai(dense.epoch).shifted(43200.0)))
    with pytest.raises(InputError, match="below the horizon"):
        prepared_arc(study, hidden)


def test_ramps_are_refused(study, dense):
    ramped = replace(dense, ramped=np.ones(len(dense), dtype=bool))
    with pytest.raises(InputError, match=r"normal_point_s.*ramps"):
        prepared_arc(study, ramped)


def test_orbits_and_schedules_are_refused(study, tmp_path):
    orbiter = tmp_path / "orbiter.toml"
    orbiter.write_text(
        '[target]\ndynamics = "moon"\nepoch = "2020-12-01T15:00:00"\nposition_m = [1.8e6, 0.0, 0.0]\n'
        'velocity_m_s = [0.0, 1600.0, 0.0]\n[observations]\nfiles = ["dense.parquet"]\nnormal_point_s = 60\n'
    )
    write_observations(tmp_path / "dense.parquet", prepared_arc(study)[0].observations)
    with pytest.raises(InputError, match=r"normal_point_s.*orbit"):
        locate(orbiter)
    plan = tmp_path / "plan.toml"
    plan.write_text(
        STUDY.replace('files = ["dense.parquet"]\n', "")
        + '[simulation.sessions.day]\nkind = "range"\nstations = ["KASHI"]\nstep_s = 10\nsigma_m = 1.0\n'
        "start = 2020-12-02T14:00:00\nstop = 2020-12-02T15:00:00\n"
    )
    with pytest.raises(InputError, match=r"normal_point_s.*step_s"):
        covariance(plan)
