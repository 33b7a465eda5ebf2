"""Orbits about the Moon with their partials; run with ``make bench``."""

import pytest
from low_orbit import forces, propagated

HOURS_S = 3600.0
ARCS = [(4, 100, 1.0), (24, 150, 5.0)]  # hours, degree, s that they may take
PARAMETERS = ("radiation",)


@pytest.mark.parametrize(("hours", "degree", "limit_s"), ARCS)
def test_propagation_with_partials(benchmark, hours, degree, limit_s):
    model = forces(degree, radiation_m2_kg=0.02)
    propagated(model, (0.0, 60.0), parameters=PARAMETERS)  # compiles
    benchmark.pedantic(
        propagated, (model, (0.0, hours * HOURS_S)), {"parameters": PARAMETERS}, rounds=3, iterations=1
    )
    assert benchmark.stats.stats.min < limit_s
