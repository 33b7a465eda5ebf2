"""Counts of Doppler are summed where they follow each other, and only there."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.io import write_table
from radioloc.jobs.covariance import covariance
from radioloc.jobs.monte_carlo import monte_carlo
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.selection import with_averaged_counts
from radioloc.measurements import Link, Observations
from radioloc.measurements.registry import kind_of
from radioloc.study.study_file import read_study
from radioloc.time import epochs_from_strings, tai_to_utc, utc_to_tai

NOON = utc_to_tai(epochs_from_strings(["2020-12-02T15:00:00"], "UTC"))
LINKS = (Link("KASHI", "lander", "KASHI"), Link("KASHI", "lander", "JIAMUSI"))


def counts(second, **changes):
    """Counts of 1 s whose middles are so many seconds after the start; the value is a smooth path's growth."""
    second = np.asarray(second, dtype=np.float64)
    at = np.zeros(len(second), dtype=int)
    columns = {
        "epoch": tai_to_utc(NOON[at].shifted(second)),
        "links": LINKS,
        "kind": kind_of("doppler"),
        "tag": 1,
        "count_s": 1.0,
        "uplink_hz": 2.1e9,
        "value_m": path_m(second + 0.5) - path_m(second - 0.5),
        "sigma_m": 0.001,
    }
    return Observations.from_columns(**(columns | changes))


def path_m(second):
    return 7.6e8 + 300.0 * second - 0.4 * second**2 + 1e-3 * second**3


def since_s(observations):
    return utc_to_tai(observations.epoch).seconds_since(NOON)


def test_sums_are_those_of_the_longer_count():
    averaged, left_out = with_averaged_counts(counts(np.arange(37.0)), 10.0)
    assert left_out == 7
    np.testing.assert_allclose(since_s(averaged), [4.5, 14.5, 24.5], rtol=0.0, atol=1e-9)
    start = np.array([-0.5, 9.5, 19.5])
    # Rounding of a path of 7.6e8 m, ten times.
    np.testing.assert_allclose(averaged.value_m, path_m(start + 10.0) - path_m(start), rtol=0.0, atol=2e-6)
    assert (averaged.count_s == 10.0).all()
    np.testing.assert_allclose(averaged.sigma_m, 0.001 * 10.0**0.5, rtol=1e-12)
    assert averaged.line.tolist() == [1, 11, 21]
    repeated, left_out = with_averaged_counts(averaged, 10.0)
    assert repeated is averaged
    assert left_out == 0


def test_nothing_is_summed_over_gaps_links_frequencies_or_types():
    seconds = np.concatenate([np.arange(6.0), np.arange(7.0, 13.0), np.arange(13.0, 19.0)])
    second = np.repeat([2.1e9, 2.1e9, 2.1001e9], 6)
    joint = Observations.concatenate([counts(seconds, uplink_hz=second), counts(seconds[:6], link=1)])
    shuffled = joint.select(np.random.default_rng(4).permutation(len(joint)))
    averaged, left_out = with_averaged_counts(shuffled, 3.0)
    assert left_out == 0
    order = np.lexsort((since_s(averaged), averaged.paths()))
    solution = since_s(averaged)[order]
    np.testing.assert_allclose(solution, [1.0, 4.0, 1.0, 4.0, 8.0, 11.0, 14.0, 17.0], rtol=0.0, atol=1e-9)
    assert len(np.unique(averaged.uplink_hz)) == 2
    _, left_out = with_averaged_counts(shuffled, 4.0)
    assert left_out == 8


def test_in_a_study(tmp_path):
    write_table(tmp_path / "counts.csv", counts(np.arange(25.0)))
    (tmp_path / "study.toml").write_text(
        "[target]\nlongitude_deg = -51.9\nlatitude_deg = 43.0\nheight_m = -2500.0\n"
        '[observations]\nfiles = ["counts.csv"]\ndoppler_average_s = 10\n'
    )
    arc, left_out = prepared_arc(read_study(tmp_path / "study.toml"))
    assert arc.observations.count_s.tolist() == [10.0, 10.0]
    assert left_out == {"left over from averages of Doppler over 10 s": 5}


@pytest.mark.parametrize("study_of", [covariance, lambda study: monte_carlo(study, 2)])
def test_a_schedule_plans_its_counts(study_of, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(
        "[target]\nlongitude_deg = -51.9\nlatitude_deg = 43.0\nheight_m = -2500.0\n"
        "[observations]\ndoppler_average_s = 60\n"
        '[simulation.sessions.day]\nkind = "doppler"\nstations = ["KASHI"]\ncount_s = 10\nstep_s = 10\nsigma_m = 1e-3\n'
        "start = 2020-12-02T14:00:00\nstop = 2020-12-02T15:00:00\n"
    )
    with pytest.raises(InputError, match=r"doppler_average_s.*count_s"):
        study_of(read_study(path))
