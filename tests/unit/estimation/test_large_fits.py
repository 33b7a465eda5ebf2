"""Fits of many observations: partials by rows, whatever the parts; memory; the same on any number of threads."""

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from delay_network import DelayNetwork
from harmonic_series import Series, solved

from radioloc.estimation import Parameter, ParameterSet, robust
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.noise import ObservationCovariance, White, whitening

PARTS = 1e-12
"""Rounding of sums in another order, relative."""
SAME_ANSWER_SIGMAS = 0.01
"""The step tolerance, a thousandth of a sigma, and some reserve."""


def test_rows_on_demand_are_the_same_as_all_at_once():
    series = Series(5000, excess_m=0.02, blunders=0.02)
    dense = fit_with_variance_components(series.dense, series.parameters, series.sigma_m)
    by_rows = fit_with_variance_components(series.linearize, series.parameters, series.sigma_m)
    np.testing.assert_array_equal(by_rows.fit.used, dense.fit.used)
    np.testing.assert_allclose(by_rows.fit.x, dense.fit.x, rtol=PARTS * 1e3)
    np.testing.assert_allclose(by_rows.fit.covariance, dense.fit.covariance, rtol=PARTS * 1e3)


@pytest.mark.parametrize("rows_at_once", [7, 500, 10**6])
def test_size_of_parts_does_not_matter(rows_at_once, monkeypatch):
    series = Series(3000)
    expected = fit_least_squares(series.linearize, series.parameters, series.sigma_m)
    monkeypatch.setattr(whitening, "ROWS_AT_ONCE", rows_at_once)
    result = fit_least_squares(series.linearize, series.parameters, series.sigma_m)
    # The condition number of the columns is 100.
    np.testing.assert_allclose(
        result.factor.singular_values, expected.factor.singular_values, rtol=100 * PARTS
    )
    np.testing.assert_allclose(result.x, expected.x, rtol=0.0, atol=1e-6 * expected.sigmas.min())
    assert result.chi2 == pytest.approx(expected.chi2, rel=PARTS)


def test_a_sample_starts_what_the_whole_ends(monkeypatch):
    """Every hundredth observation has a bias of its own; most blunders are of one sign."""
    rng = np.random.default_rng(4)
    n = 30000
    rare = np.arange(n) % 100 == 17
    design = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n), rare])
    bad = rng.random(n) < 0.15
    observed_m = design @ [100.0, -50.0, 7.0] + 0.01 * rng.normal(size=n)
    observed_m += bad * 10.0 ** rng.uniform(0.3, 4.0, n)
    parameters = ParameterSet([Parameter(f"a.{k}", "m", "a") for k in range(3)])
    function = lambda x: (observed_m - design @ x, design)  # noqa: E731
    sampled = fit_with_editing(function, parameters, 0.01)
    monkeypatch.setattr(robust, "_MAX_ROWS", n)
    total = fit_with_editing(function, parameters, 0.01)
    assert sampled.converged
    np.testing.assert_array_equal(sampled.fit.used, ~bad)
    np.testing.assert_array_equal(total.fit.used, sampled.fit.used)
    np.testing.assert_allclose(
        sampled.fit.x, total.fit.x, rtol=0.0, atol=SAME_ANSWER_SIGMAS * total.fit.sigmas.min()
    )


def test_blocks_are_factorized_where_their_covariance_changes(monkeypatch):
    stated = DelayNetwork.make(epochs=50).noise
    white_m, shared = stated.white_m.copy(), stated.terms[1]
    white_m[8] *= 2.0
    calls = []
    genuine = np.linalg.eigh
    monkeypatch.setattr(np.linalg, "eigh", lambda a: calls.append(len(a)) or genuine(a))
    [blocks] = ObservationCovariance((White(white_m), shared)).whitener().structures
    # Before, at and after the epoch of that delay
    assert calls == [3]
    for rows, root in zip(blocks.rows, blocks.roots[blocks.which], strict=True):
        covariance = shared.covariance_m2(rows[None])[0] + np.diag(white_m[rows] ** 2)
        np.testing.assert_allclose(root @ covariance @ root.T, np.eye(6), rtol=0.0, atol=1e-12)


@pytest.mark.slow
def test_a_million_observations_take_less_than_300_bytes_each():
    series = Series(1_000_000, excess_m=0.02, blunders=0.02)
    tracemalloc.start()
    solution = solved(series)
    str(solution)
    maximum = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert solution.converged
    # Some ten megabytes are the same however many there are.
    assert maximum < 300 * 1_000_000


SCRIPT = """
import numpy as np
from harmonic_series import Series
from radioloc.estimation.variance_components import fit_with_variance_components
series = Series(200_000, p=12, excess_m=0.02, blunders=0.02)
fit = fit_with_variance_components(series.linearize, series.parameters, series.sigma_m).fit
print(fit.x.tobytes().hex(), fit.covariance.tobytes().hex(), fit.chi2.hex(), int(fit.used.sum()))
"""


@pytest.mark.slow
def test_number_of_threads_does_not_matter():
    toys = str(Path(__file__).resolve().parents[2] / "support")
    messages = []
    for threads in ("1", "2", "4"):
        paths = os.pathsep.join([toys, *sys.path])
        environment = dict(os.environ, OPENBLAS_NUM_THREADS=threads, PYTHONPATH=paths)
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
        )
        messages.append(done.stdout)
    assert messages[0] == messages[1] == messages[2]
