"""Whiteners of each structure against a dense Cholesky factor of R, for all rows and for selections of them."""

from dataclasses import dataclass

import numpy as np
import pytest
from dense_noise import dense, information

from radioloc.errors import InputError
from radioloc.noise import (
    ALONE,
    NONE,
    DopplerPhase,
    GaussMarkov,
    ObservationCovariance,
    Process,
    SharedAtEpoch,
    White,
)

ROUNDING = 1e-10
"""Relative; conditions of the covariances are up to a thousand."""
N = 200
RANDOM = np.random.default_rng(4)
COLUMNS = RANDOM.standard_normal((N, 5))
TIME = RANDOM.permutation(N)
"""Place of each row in the order of time."""
WHITE = White(RANDOM.uniform(0.5, 1.0, N))
KIND = TIME % 4
"""One of three delays of an epoch, or a count."""


def shared(kinds=(0, 1, 2)):
    """Delays between three stations, up to three at each epoch."""
    group = np.where(np.isin(KIND, kinds), TIME // 4, ALONE)
    baseline = RANDOM.integers(0, 3, N)
    source = np.array([[0, 1], [1, 2], [0, 2]])[baseline]
    return SharedAtEpoch(group, source, np.array([-0.7, 0.9]) * (group != ALONE)[:, None])


def phases(steps=1, kinds=(3,)):
    """Counts of two links, so many steps long, with gaps."""
    link = np.where(np.isin(KIND, kinds), TIME // 4 % 2, ALONE)
    start = TIME // 8 + 3 * (TIME > 90)
    return DopplerPhase(np.where(link == ALONE, 0.0, 1.0 + link), link, start, start + steps)


def processes():
    """Two processes in each row at most: of links, of stations with signs, new at each epoch, a random walk."""
    calls = (
        Process(4.0, 900.0),
        Process(1.0, 100.0),
        Process(0.5, 0.0),
        Process(0.3, 3000.0),
        Process(walk_m2_s=1e-3, start_s=-120.0),
        Process(2.0, 700.0),
    )
    index = np.array([[0, 4], [1, NONE], [2, 3], [5, NONE]])[KIND]
    sign = np.array([[1.0, 1.0], [1.0, 0.0], [-1.0, 1.0], [0.5, 0.0]])[KIND]
    return GaussMarkov(60.0 * (TIME // 4), index, sign, calls)


CASES = {
    "diagonal": [WHITE],
    "blocks": [WHITE, shared()],
    "two kinds of blocks": [WHITE, shared((0, 1)), shared((2,))],
    "banded": [WHITE, phases()],
    "overlapping counts": [WHITE, phases(2)],
    "blocks and banded": [WHITE, shared(), phases()],
    "filtered": [WHITE, processes()],
    "filtered with all terms": [WHITE, shared(), phases(), processes()],
    "filtered with overlapping counts": [WHITE, phases(3), processes()],
}


@pytest.fixture(params=CASES)
def covariance(request):
    return ObservationCovariance(tuple(CASES[request.param]))


def assert_generalized(whitener, matrix, used, columns=COLUMNS):
    root = np.linalg.cholesky(matrix[np.ix_(used, used)])
    independent = np.linalg.solve(root, columns[used])
    expected = independent.T @ independent
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((information(whitener, columns) - expected) / size).max() < ROUNDING


def test_information_is_that_of_the_dense_covariance(covariance):
    matrix = dense(covariance)
    np.testing.assert_allclose(covariance.sigma_m, np.sqrt(np.diag(matrix)), rtol=1e-12)
    assert_generalized(covariance.whitener(), matrix, np.ones(N, bool))


@pytest.mark.parametrize("fraction", [0.3, 0.8])
def test_information_of_some_rows_is_that_of_their_covariance(covariance, fraction):
    used, matrix = np.random.default_rng(1).random(N) < fraction, dense(covariance)
    assert_generalized(covariance.whitener(used), matrix, used)
    rows = np.flatnonzero(used)[::-1]
    selected = covariance.select(rows)
    np.testing.assert_allclose(dense(selected), matrix[np.ix_(rows, rows)], rtol=1e-12, atol=1e-15)
    assert_generalized(selected.whitener(), dense(selected), np.ones(len(rows), bool), COLUMNS[rows])


@pytest.mark.parametrize("at_once", [7, 65536])
def test_whitening_and_its_transpose_multiply_by_the_inverse(covariance, at_once, monkeypatch):
    monkeypatch.setattr("radioloc.noise.whitening.ROWS_AT_ONCE", at_once)
    used = np.random.default_rng(2).random(N) < 0.8
    whitener = covariance.whitener(used)
    parts = [part.copy() for part in whitener.whitened(lambda rows: COLUMNS[rows])]
    weighted = np.zeros((N, COLUMNS.shape[1]))
    for rows, values in whitener.transposed(parts):
        weighted[rows] = values
    expected = np.linalg.solve(dense(covariance)[np.ix_(used, used)], COLUMNS[used])
    np.testing.assert_allclose(weighted[used], expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    assert (weighted[~used] == 0.0).all()


def test_sigmas_in_a_block_may_differ_by_seven_orders():
    """Variance components of exchanged stations are hundreds of kilometres, beside centimetres of the others."""
    white = White(np.where(np.arange(N) % 3 == 0, 3e5, 0.03))
    noise = ObservationCovariance((white, shared()))
    assert_generalized(noise.whitener(), dense(noise), np.ones(N, bool))


def test_added_noise_is_independent(covariance):
    added_m = RANDOM.uniform(0.0, 0.5, N)
    additional = covariance.plus(White(added_m))
    np.testing.assert_allclose(dense(additional), dense(covariance) + np.diag(added_m**2), rtol=1e-12)
    np.testing.assert_allclose(additional.white_m, np.hypot(WHITE.sigma_m, added_m), rtol=1e-12)


def test_rows_alone_are_whitened_in_the_order_asked_for():
    order = np.argsort(TIME)
    whitener = ObservationCovariance((WHITE, phases())).whitener(order=order)
    rows = np.concatenate([item.rows for item in whitener.structures])
    separate_fit = KIND[order] != 3
    np.testing.assert_array_equal(rows[: separate_fit.sum()], order[separate_fit])


def test_observations_that_follow_from_others_have_no_weight():
    """Three baselines of three stations without noise of their own hold two delays."""
    stations, sign = np.array([[0, 1], [1, 2], [0, 2]]), np.tile([-1.0, 1.0], (3, 1))
    term = GaussMarkov(np.zeros(3), stations, sign, (Process(1.0),) * 3)
    noise = ObservationCovariance((White(np.zeros(3)), term))
    at_stations = RANDOM.standard_normal((3, 2))
    closed = at_stations[stations[:, 1]] - at_stations[stations[:, 0]]
    expected = closed[:2].T @ np.linalg.solve(dense(noise)[:2, :2], closed[:2])
    np.testing.assert_allclose(information(noise.whitener(), closed), expected, rtol=1e-9)


@dataclass(frozen=True)
class Drift:
    """An error that grows in proportion to time: a term as another package would write it."""

    time_s: np.ndarray
    rate_m_s: float

    @property
    def variance_m2(self):
        return (self.rate_m_s * self.time_s) ** 2

    @property
    def states(self):
        return np.zeros((len(self.time_s), 1), dtype=np.intp), self.rate_m_s * self.time_s[:, None]

    def transitions(self, rows, step_s, states):
        first = (np.arange(len(rows)) == 0)[:, None]
        return 1.0 - first, 1.0 * first


def test_a_term_of_another_package_is_filtered():
    reference = ObservationCovariance(tuple(CASES["blocks and banded"]))
    noise = reference.plus(Drift(0.01 * TIME, 3.0)).select(np.arange(0, N, 2))
    matrix = dense(reference) + np.outer(0.03 * TIME, 0.03 * TIME)
    used = np.arange(N) % 2 == 0
    assert_generalized(noise.whitener(), matrix[np.ix_(used, used)], np.ones(N // 2, bool), COLUMNS[used])


def test_terms_of_different_lengths_are_refused():
    with pytest.raises(InputError, match="equal numbers"):
        ObservationCovariance((WHITE, White(np.ones(3))))
