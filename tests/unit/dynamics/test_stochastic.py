"""Effects of stochastic accelerations on an orbit against integrations."""

from dataclasses import replace

import numpy as np
import pytest

from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.dynamics.stochastic import StochasticEffects, colours, stochastic_forces
from radioloc.time import epochs_from_strings

EPOCH = epochs_from_strings("2012-04-09T04:30:00", "TDB")
STATE = np.array([575739.0, -463249.0, -1631639.0, -567.864, 1434.223, -600.209])
SPAN_S = (-1500.0, 2000.0)
INTERVAL_S = 600.0
SIGMA_M_S2 = np.array([1e-5, 2e-5, 3e-5])
SECOND_ORDER = 2e-3
"""Relative: rotation of the axes by 1e-5 m/s^2 in an hour, and the truncation of the gradient at degree 8."""


@pytest.fixture(scope="module")
def forces():
    return Forces(GravityField.open("GRGM660PRIM", 8), gradient_degree=8)


@pytest.fixture(scope="module")
def orbit(forces):
    return propagate(EPOCH, STATE[:3], STATE[3:], forces, SPAN_S, parameters=())


@pytest.fixture(scope="module")
def effects(orbit):
    return StochasticEffects(orbit, SIGMA_M_S2, INTERVAL_S)


def at(*seconds):
    return EPOCH.shifted(np.array(seconds))


@pytest.mark.parametrize("interval", [-3, -2, -1, 0, 1, 3])
@pytest.mark.parametrize("axis", range(3))
def test_effects_against_integrations(forces, orbit, effects, interval, axis):
    """Compare in the interval, in the next interval, and beyond by the state mapped to the epoch."""
    values = np.zeros((4, 3)), np.zeros((3, 3))
    chain, step = (0, interval) if interval >= 0 else (1, -1 - interval)
    values[chain][step, axis] = SIGMA_M_S2[axis]
    added = stochastic_forces(EPOCH, values, INTERVAL_S)
    moved = propagate(EPOCH, STATE[:3], STATE[3:], replace(forces, accelerations=added), SPAN_S)
    sign = 1.0 if chain == 0 else -1.0
    inside_s = sign * (INTERVAL_S * step + np.array([100.0, 299.0]))
    next_s = sign * (INTERVAL_S * (step + 1) + np.array([0.1, 300.0]))
    seconds = [t for t in (*inside_s, *next_s) if SPAN_S[0] <= t <= SPAN_S[1]]
    changed = np.hstack(moved.states(at(*seconds))) - np.hstack(orbit.states(at(*seconds)))
    column = 6 + 3 * int(colours(np.array(chain), np.array(step))) + axis
    computed = effects.state_partials(at(*seconds))[:, :, column]
    for k in (slice(3), slice(3, 6)):
        size = np.linalg.norm(changed[:, k], axis=1)
        assert (np.linalg.norm((computed - changed)[:, k], axis=1) < SECOND_ORDER * size).all()
    if len(seconds) == 4:
        far_s = SPAN_S[1 - chain]
        effect = orbit.partials(at(far_s))[0] @ effects.moved[chain][step, :, axis]
        change = np.hstack(moved.states(at(far_s))) - np.hstack(orbit.states(at(far_s)))
        np.testing.assert_allclose(effect[:3], change[0, :3], atol=SECOND_ORDER * np.abs(change[0, :3]).max())


def test_later_intervals_have_no_effect(effects):
    for seconds, chain, step in ((650.0, 0, 2), (-650.0, 1, 2), (10.0, 1, 0), (-10.0, 0, 0)):
        colour = int(colours(np.array(chain), np.array(step)))
        assert not effects.state_partials(at(seconds))[0, :, 6 + 3 * colour : 9 + 3 * colour].any()
