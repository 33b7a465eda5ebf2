"""Whitening by the filter against the covariance written out."""

import numpy as np
import pytest

from radioloc.estimation.observation_noise import ALONE, ObservationNoise, SharedErrors
from radioloc.estimation.process_noise import NONE, Process, ProcessNoise

RANDOM = np.random.default_rng(4)
COLUMNS = RANDOM.standard_normal((200, 5))


def information(noise, columns=COLUMNS, used=None):
    used = np.ones(len(columns), bool) if used is None else used
    parts = [part.copy() for part in noise.among(used).whitened(lambda rows: columns[rows])]
    whitened = np.concatenate(parts)
    return whitened.T @ whitened


def written_out(noise):
    between = np.abs(noise.time_s[:, None] - noise.time_s)
    covariance = np.diag(noise.white_m2)
    for k, process in enumerate(noise.processes):
        effect = (noise.sign * (noise.process == k)).sum(axis=1)
        same = np.exp(-between / process.tau_s) if process.tau_s else (between == 0.0)
        walked = np.minimum(noise.time_s[:, None], noise.time_s) - process.start_s
        covariance += np.outer(effect, effect) * (process.variance_m2 * same + process.walk_m2_s * walked)
    return covariance


@pytest.fixture
def noise():
    """Two links with noise of their own, and three baselines of three stations at the same epochs."""
    time_s = np.concatenate([np.arange(0.0, 2400.0, 60.0)] * 5)
    link = np.repeat(np.arange(5), 40)
    processes = (
        Process(4.0, 900.0),
        Process(1.0, 100.0),
        Process(0.5, 0.0),
        Process(0.3, 3000.0),
        Process(0.2, 600.0),
        Process(walk_m2_s=1e-3, start_s=-120.0),
    )
    of_link = [[0, 5], [1, NONE], [2, 3], [3, 4], [4, 2]]
    signs = [[1, 1], [1, 0], [-1, 1], [-1, 1], [1, -1]]
    white_m2 = np.array([1.0, 2.0, 0.1, 0.2, 0.3])[link]
    made = ProcessNoise(time_s, white_m2, np.array(of_link)[link], np.array(signs, float)[link], processes)
    return made.select(RANDOM.permutation(200))  # in any order


def test_information_is_that_of_the_covariance_written_out(noise):
    covariance = written_out(noise)
    np.testing.assert_allclose(noise.sigma_m, np.sqrt(np.diag(covariance)), rtol=1e-12)
    expected = COLUMNS.T @ np.linalg.solve(covariance, COLUMNS)
    np.testing.assert_allclose(information(noise), expected, rtol=1e-9, atol=1e-9)
    assert len(np.unique(noise.networks())) == 3


def test_of_some_observations(noise):
    used = RANDOM.random(200) < 0.6
    covariance = written_out(noise)[np.ix_(used, used)]
    expected = COLUMNS[used].T @ np.linalg.solve(covariance, COLUMNS[used])
    np.testing.assert_allclose(information(noise, used=used), expected, rtol=1e-9, atol=1e-9)


def test_parts_of_a_long_series_go_on_where_the_last_ended(noise, monkeypatch):
    whole = information(noise)
    monkeypatch.setattr("radioloc.estimation.process_noise.ROWS_AT_ONCE", 7)
    np.testing.assert_allclose(information(noise), whole, rtol=1e-12)


def test_what_follows_from_others_tells_nothing():
    """Three baselines of three stations without noise of their own hold two delays."""
    stations, sign = np.array([[0, 1], [1, 2], [0, 2]]), np.tile([-1.0, 1.0], (3, 1))
    noise = ProcessNoise(np.zeros(3), np.zeros(3), stations, sign, (Process(1.0),) * 3)
    at_stations = RANDOM.standard_normal((3, 2))
    closed = at_stations[stations[:, 1]] - at_stations[stations[:, 0]]
    two = written_out(noise)[:2, :2]
    expected = closed[:2].T @ np.linalg.solve(two, closed[:2])
    np.testing.assert_allclose(information(noise, closed), expected, rtol=1e-9)


def test_stated_noise():
    """As the principal axes of the blocks have it."""
    group = np.repeat(np.arange(10), 4)
    group[3::4] = ALONE
    source = np.tile([[0, 1], [1, 2], [0, 2], [0, 1]], (10, 1))
    stated = ObservationNoise(
        RANDOM.uniform(0.5, 1.0, 40), SharedErrors(group, source, np.tile([-0.7, 0.9], (40, 1)))
    )
    time_s = np.repeat(np.arange(10.0), 4) + RANDOM.uniform(0.0, 0.01, 40)  # tags differ by milliseconds
    columns = COLUMNS[:40]
    parts = np.concatenate(list(stated.among().whitened(lambda rows: columns[rows])))
    noise = ProcessNoise.stated(stated, time_s)
    np.testing.assert_allclose(information(noise, columns), parts.T @ parts, rtol=1e-9)
    np.testing.assert_allclose(noise.sigma_m, stated.sigma_m, rtol=1e-12)
    alone = ProcessNoise.stated(ObservationNoise(stated.own_m), time_s)
    weighted = columns / stated.own_m[:, None]
    np.testing.assert_allclose(information(alone, columns), weighted.T @ weighted, rtol=1e-12)
