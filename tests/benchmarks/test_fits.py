"""Time of a fit with editing, additive noise and all of its solution, by the number of observations."""

import pytest
from harmonic_series import Series, solved


@pytest.mark.parametrize("n", [10_000, 100_000, 1_000_000, 10_000_000])
def test_fit(benchmark, n):
    series = Series(n, p=9, excess_m=0.02, blunders=0.01)
    solution = benchmark.pedantic(solved, args=(series,), rounds=1)
    assert solution.converged
