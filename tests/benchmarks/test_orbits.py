"""Orbits about the Moon with their partials: compiled integration, and scipy's loop about the same forces.

Run with ``make bench``.
"""

import time

import numpy as np
import pytest
from low_orbit import EPOCH, STATE, forces, propagated
from scipy.integrate import solve_ivp

from radioloc.compiled import compiled
from radioloc.dynamics._force_kernels import accelerations, quantities, variations
from radioloc.dynamics.accelerations import force_data, parameter_columns
from radioloc.dynamics.orbit import STATE as NAMES
from radioloc.ephemeris import Ephemeris, LunarOrientation

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


@compiled()
def right_hand_side(time_s, y, columns, data, out):
    """Derivatives of the state and of its partials."""
    sky = quantities(time_s, data)
    parts = accelerations(y[:3], y[3:6], sky, data)
    out[:3] = y[3:6]
    out[3:6] = 0.0
    for k in range(len(parts)):
        out[3:6] += data.scales[k] * parts[k]
    by_state, by_parameters = variations(y[:6], sky, parts, columns, data)
    for k in range(len(columns)):
        first = 6 + 6 * k
        out[first : first + 3] = y[first + 3 : first + 6]
        out[first + 3 : first + 6] = by_parameters[k]
        for i in range(3):
            for j in range(6):
                out[first + 3 + i] += by_state[i, j] * y[first + j]


def test_scipys_loop_takes_longer(benchmark):
    model = forces(100, radiation_m2_kg=0.02)
    names = (*NAMES, *PARAMETERS)
    columns = parameter_columns(model, names)
    span_s = (0.0, 4 * HOURS_S)
    data = force_data(model, Ephemeris.open(), LunarOrientation.open(), EPOCH, span_s, STATE, names)
    begin = np.concatenate([STATE, np.eye(7, 6).ravel()])

    def rate(time_s, y):
        out = np.empty_like(y)
        right_hand_side(time_s, y, columns, data, out)
        return out

    rate(0.0, begin)
    start = time.perf_counter()
    propagated(model, span_s, parameters=PARAMETERS)
    own_s = time.perf_counter() - start
    found = benchmark.pedantic(
        lambda: solve_ivp(rate, span_s, begin, method="DOP853", rtol=1e-13, atol=1e-7, dense_output=True),
        rounds=1,
    )
    assert found.success
    benchmark.extra_info["own_s"] = own_s
    assert own_s < benchmark.stats.stats.min
