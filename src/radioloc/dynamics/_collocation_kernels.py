"""Compiled integration of the equations of motion by Gauss-Legendre collocation, and interpolation between its steps.

The accelerations of a step are a polynomial through their values at the nodes, whose integrals are velocities and
positions at any time in the step (Hairer, Norsett and Wanner 1993, *Solving Ordinary Differential Equations I*, section
II.7). Picard's iteration finds these values. The central term is iterated separately, at little cost, so that two
evaluations of all other terms are sufficient (Bradley, Jones, Beylkin, Sandberg and Axelrad 2014, *Celestial Mechanics*
119, 143). Partials follow from the converged path by an iteration with constant gradients.
"""

import math

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.dynamics._force_data import (
    CENTRAL,
    DONE,
    IN_EARTH,
    IN_MOON,
    MIN_STEP_S,
    NODES,
    PARTS,
    QUANTITIES,
    STUCK,
    TOO_MANY,
    Collocation,
    ForceData,
    Tolerance,
)
from radioloc.dynamics._force_kernels import EARTH_RADIUS_M, accelerations, quantities, variations
from radioloc.dynamics._vector_kernels import add, dot, minus, put
from radioloc.vectors import Floats

_SAFETY_FACTOR, _MIN_STEP_RATIO, _MAX_STEP_RATIO = 0.9, 0.2, 4.0
"""Safety factor of the next step, and its bounds relative to the present step (Hairer et al. 1993, II.4)."""
_MAX_EVALUATIONS, _MAX_ITERATIONS = 12, 50
"""Limits of a step: evaluations of all accelerations, and iterations of the central term or the partials."""
_ROUNDING = 1e-15  # relative rounding error of positions
_PARTIALS_TOLERANCE = 1e-13
"""Relative tolerance of the accelerations of partials; the remaining error is some hundred times smaller."""


@compiled()
def _product(weights: Floats, values: Floats) -> Floats:
    out = np.zeros((weights.shape[0], values.shape[1]))
    for i in range(weights.shape[0]):
        for j in range(weights.shape[1]):
            for k in range(values.shape[1]):
                out[i, k] += weights[i, j] * values[j, k]
    return out


@compiled()
def _path(y: Floats, h: float, at: Floats, to_speeds: Floats, to_places: Floats, rates: Floats) -> Floats:
    """Return state and partials at places `at` of a step from -1 to 1, shape (len(at), len(y))."""
    # `rates`: accelerations of state and partials, (NODES, len(y) / 2); `to_speeds`, `to_places`: as in Collocation.
    speeds, places = _product(to_speeds, rates), _product(to_places, rates)
    out = np.empty((len(at), len(y)))
    half = 0.5 * h
    for i in range(len(at)):
        for j in range(len(y) // 6):
            for k in range(6 * j, 6 * j + 3):
                out[i, k] = y[k] + half * ((at[i] + 1.0) * y[k + 3] + half * places[i, k - 3 * j])
                out[i, k + 3] = y[k + 3] + half * speeds[i, k - 3 * j]
    return out


@compiled()
def _noncentral(parts: Floats, scales: Floats) -> Floats:
    """Return the sum of all accelerations without the central term."""
    out = np.zeros(3)
    for k in range(len(PARTS)):
        if k != CENTRAL:
            add(out, scales[k], parts[k])
    return out


@compiled()
def _max_displacement(first: Floats, second: Floats) -> float:
    """Return the largest difference of a coordinate of the positions of two paths; NaN if any is NaN."""
    largest = 0.0
    for i in range(len(second)):
        for k in range(3):
            change = abs(second[i, k] - first[i, k])
            if math.isnan(change):
                return change
            largest = max(largest, change)
    return largest


@compiled()
def _solve_step(
    y: Floats, h: float, sky: Floats, guess: Floats, data: ForceData, method: Collocation, tolerance_m: float
) -> tuple[bool, Floats, Floats, Floats, Floats]:
    """Solve for the state in a step; `guess` is the acceleration without the central term."""
    # Returns whether the iteration converged; the path at the nodes and the end, (NODES + 1, 6); the accelerations at
    # the nodes, (NODES, 3), and their parts, (NODES, len(PARTS), 3); the guess for the next step, (3,).
    rates, noncentral, parts = np.zeros((NODES, 3)), np.empty((NODES, 3)), np.empty((NODES, len(PARTS), 3))
    for i in range(NODES):
        put(noncentral[i], guess)
    path = _path(y, h, method.ends, method.to_speeds, method.to_places, rates)
    distance = math.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
    limit_m = max(0.01 * tolerance_m, 10.0 * _ROUNDING * distance)
    previous_m = math.inf
    for evaluation in range(_MAX_EVALUATIONS):
        begin = path
        for _ in range(_MAX_ITERATIONS):
            for i in range(NODES):
                square = path[i, 0] ** 2 + path[i, 1] ** 2 + path[i, 2] ** 2
                for k in range(3):
                    rates[i, k] = noncentral[i, k] - data.gm[0] / (square * math.sqrt(square)) * path[i, k]
            new_path = _path(y, h, method.ends, method.to_speeds, method.to_places, rates)
            settled = _max_displacement(path, new_path) <= _ROUNDING * distance
            path = new_path
            if settled:
                break
        change_m = _max_displacement(begin, path)
        # The next change would be smaller by the same ratio.
        if evaluation > 0 and (change_m < limit_m or change_m * change_m < limit_m * previous_m):
            return True, path, rates, parts, noncentral[NODES - 1]
        previous_m = change_m
        for i in range(NODES):
            of_node = accelerations(path[i, :3], path[i, 3:], sky[i], data)
            for k in range(len(PARTS)):
                put(parts[i, k], of_node[k])
            put(noncentral[i], _noncentral(of_node, data.scales))
    return False, path, rates, parts, guess


@compiled()
def _partial_accelerations(
    y: Floats, h: float, by_state: Floats, sources: Floats, method: Collocation
) -> Floats:
    """Return the accelerations of partials y at the nodes, shape (NODES, len(y) / 2)."""
    # Partials of the acceleration: `by_state`, (NODES, 3, 6); `sources`, by the parameters, (NODES, len(y) / 2).
    rates = sources.copy()
    for _ in range(_MAX_ITERATIONS):
        path = _path(y, h, method.ends, method.to_speeds, method.to_places, rates)
        settled = True
        for j in range(len(y) // 6):
            change, size = 0.0, 0.0
            for i in range(NODES):
                for k in range(3):
                    rate = sources[i, 3 * j + k]
                    for c in range(6):
                        rate += by_state[i, k, c] * path[i, 6 * j + c]
                    change, size = max(change, abs(rate - rates[i, 3 * j + k])), max(size, abs(rate))
                    rates[i, 3 * j + k] = rate
            settled = settled and change <= _PARTIALS_TOLERANCE * size
        if settled:
            break
    return rates


@compiled()
def _error(series: Floats, h: float, tolerance: Tolerance) -> float:
    """Return the ratio of the error of a step to the tolerance, by the last terms of the Legendre series."""
    last = max(np.abs(series[NODES - 1]).max(), 0.1 * np.abs(series[NODES - 2]).max())
    # An integral of the term of degree n is at most the term divided by n.
    scale = 0.5 * abs(h) / NODES
    return max(scale * last / tolerance.velocity_m_s, scale * scale * last / tolerance.position_m)


@compiled()
def _body_at(r: Floats, earth: Floats, tolerance: Tolerance) -> int:
    """Return IN_MOON or IN_EARTH for a position below the ground, else DONE."""
    if dot(r, r) < tolerance.min_radius_m**2:
        return IN_MOON
    from_earth = minus(r, earth)
    return IN_EARTH if dot(from_earth, from_earth) < EARTH_RADIUS_M**2 else DONE


@compiled()
def _extended(rows: Floats) -> Floats:
    """Return the rows with space for as many more."""
    return np.concatenate((rows, np.empty_like(rows)))


@compiled()
def integrate(
    start: float,
    end: float,
    first_step: float,
    y: Floats,
    columns: NDArray[np.int64],
    data: ForceData,
    method: Collocation,
    tolerance: Tolerance,
) -> tuple[int, Floats, Floats, float]:
    """Integrate state and partials y, shape (n,), 6 numbers each, from a start to an end, in either direction, s."""
    # Returns the status; time, state and partials at the ends of the steps, (n_steps + 1, 1 + n), the last one at the
    # ground if the path meets it; the series for `interpolate`, (n_steps, NODES * n / 2); the next step, s.
    n, sign = len(y), 1.0 if end > start else -1.0
    t, h = start, sign * abs(first_step)
    count = 0
    states, dense = np.empty((65, 1 + n)), np.empty((64, NODES * n // 2))
    states[0, 0] = t
    put(states[0, 1:], y)
    sky = np.empty((NODES + 1, QUANTITIES))
    by_state, sources = np.empty((NODES, 3, 6)), np.empty((NODES, n // 2 - 3))
    guess = _noncentral(accelerations(y[:3], y[3:6], quantities(t, data), data), data.scales)
    status, next_step = DONE, h
    while sign * (end - t) > 0.0:
        if abs(h) < MIN_STEP_S or count >= tolerance.max_steps:
            status = STUCK if abs(h) < MIN_STEP_S else TOO_MANY
            break
        last = sign * (t + h - end) >= 0.0
        if last:
            h = end - t
        else:
            next_step = h
        for i in range(NODES + 1):
            put(sky[i], quantities(t + 0.5 * h * (method.ends[i] + 1.0), data))
        converged, path, rates, parts, next_guess = _solve_step(
            y[:6], h, sky, guess, data, method, tolerance.position_m
        )
        series = _product(method.to_series, rates)
        error = _error(series, h, tolerance) if converged else math.inf
        if not error < 1.0:
            h *= max(_MIN_STEP_RATIO, _SAFETY_FACTOR * error ** (-1.0 / NODES) if error > 1.0 else 0.0)
            continue
        if count == len(dense):
            states, dense = _extended(states), _extended(dense)
        of_step = dense[count].reshape((NODES, n // 2))
        for i in range(NODES):
            put(of_step[i, :3], series[i])
        count += 1
        put(states[count, 1:7], path[NODES])
        if n > 6:
            for i in range(NODES):
                gradient, of_node = variations(path[i], sky[i], parts[i], columns, data)
                for k in range(3):
                    put(by_state[i, k], gradient[k])
                put(sources[i], of_node.ravel())
            rates = _partial_accelerations(y[6:], h, by_state, sources, method)
            series = _product(method.to_series, rates)
            for i in range(NODES):
                put(of_step[i, 3:], series[i])
            at_end = _path(
                y[6:], h, method.ends[NODES:], method.to_speeds[NODES:], method.to_places[NODES:], rates
            )
            put(states[count, 7:], at_end[0])
        for i in range(NODES + 1):
            status = _body_at(path[i, :3], sky[i, :3], tolerance)
            if status != DONE:
                states[count, 0] = t + 0.5 * h * (method.ends[i] + 1.0)
                return status, states[: count + 1], dense[:count], next_step
        t, y, guess = (end if last else t + h), states[count, 1:], next_guess
        states[count, 0] = t
        h *= (
            _MAX_STEP_RATIO
            if error == 0.0
            else min(_MAX_STEP_RATIO, _SAFETY_FACTOR * error ** (-1.0 / NODES))
        )
    return status, states[: count + 1], dense[:count], next_step


@compiled()
def interpolate(t: Floats, states: Floats, dense: Floats) -> Floats:
    """Return states and partials at times within the steps, shape (len(t), n)."""
    n, last = states.shape[1] - 1, len(states) - 1
    out = np.empty((len(t), n))
    sign = 1.0 if states[last, 0] > states[0, 0] else -1.0
    forward = sign * states[:, 0]
    at, legendre, integrals = np.empty(1), np.empty(NODES + 2), np.empty(NODES + 1)
    to_speeds, to_places = np.empty((1, NODES)), np.empty((1, NODES))
    for i in range(len(t)):
        step = min(max(np.searchsorted(forward, sign * t[i], side="right") - 1, 0), last - 1)
        h = states[step + 1, 0] - states[step, 0]
        x = 2.0 * (t[i] - states[step, 0]) / h - 1.0
        # The integral of P_k from -1 on is (P_k+1 - P_k-1) / (2 k + 1).
        legendre[0], legendre[1] = 1.0, x
        at[0], integrals[0], to_places[0, 0] = x, x + 1.0, 0.5 * (x + 1.0) ** 2
        for k in range(1, NODES + 1):
            legendre[k + 1] = ((2 * k + 1) * x * legendre[k] - k * legendre[k - 1]) / (k + 1)
            integrals[k] = (legendre[k + 1] - legendre[k - 1]) / (2 * k + 1)
        for k in range(1, NODES):
            to_places[0, k] = (integrals[k + 1] - integrals[k - 1]) / (2 * k + 1)
        put(to_speeds[0], integrals[:NODES])
        series = dense[step].reshape((NODES, n // 2))
        put(out[i], _path(states[step, 1:], h, at, to_speeds, to_places, series)[0])
    return out
