"""Compiled integration of the equations of motion by DOP853, and its dense output.

The Runge-Kutta method of order 8(5,3) with an interpolant of order 7 (Hairer, Norsett and Wanner 1993, *Solving
Ordinary Differential Equations I*, sections II.5 and II.6), with scipy's coefficients, control of the step and
interpolant.
"""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.dynamics._force_data import (
    DENSE,
    DONE,
    EXTRA,
    IN_EARTH,
    IN_MOON,
    SHORTEST_S,
    STAGES,
    STUCK,
    TOO_MANY,
    ForceData,
    Tableau,
    Tolerance,
)
from radioloc.dynamics._force_kernels import EARTH_RADIUS_M, quantities, right_hand_side

Floats = NDArray[np.float64]

_SAFETY, _LEAST, _MOST = 0.9, 0.2, 10.0


@compiled()
def _combined(y: Floats, h: float, weights: Floats, k: Floats, count: int) -> Floats:
    """State and partials y + h sum of the first `count` stages by their weights, in one row."""
    out = y.copy()
    for s in range(count):
        factor = h * weights[s]
        if factor != 0.0:
            for i in range(len(out)):
                out[i] += factor * k[s, i]
    return out


@compiled()
def _error(k: Floats, h: float, tableau: Tableau, tolerance: Tolerance) -> float:
    """Error of a step over the tolerance, of the state only: its partials take the same steps."""
    of5, of3 = 0.0, 0.0
    for i in range(6):
        e5, e3 = 0.0, 0.0
        for s in range(STAGES + 1):
            e5 += tableau.e5[s] * k[s, i]
            e3 += tableau.e3[s] * k[s, i]
        scale = tolerance.position_m if i < 3 else tolerance.velocity_m_s
        of5 += (e5 / scale) ** 2
        of3 += (e3 / scale) ** 2
    if of5 == 0.0 and of3 == 0.0:
        return 0.0
    return abs(h) * of5 / np.sqrt(6.0 * (of5 + 0.01 * of3))


@compiled()
def _longer(a: Floats, capacity: int) -> Floats:
    """Rows with room for more."""
    out = np.empty((capacity, a.shape[1]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j]
    return out


@compiled()
def _within(t: float, y: Floats, data: ForceData, tolerance: Tolerance) -> int:
    """Whether a state is under the ground of the Moon or the Earth."""
    from_moon, from_earth = 0.0, 0.0
    sky = quantities(t, data)
    for i in range(3):
        from_moon += y[i] ** 2
        from_earth += (y[i] - sky[i]) ** 2
    if from_moon < tolerance.lowest_m**2:
        return IN_MOON
    return IN_EARTH if from_earth < EARTH_RADIUS_M**2 else DONE


@compiled()
def integrate(
    start: float,
    end: float,
    first_step: float,
    y: Floats,
    columns: NDArray[np.int64],
    data: ForceData,
    tableau: Tableau,
    tolerance: Tolerance,
) -> tuple[int, Floats, Floats, float]:
    """Integrate from a start to an end, in either direction, s.

    Parameters
    ----------
    start, end, first_step : float
    y : ndarray, shape (n,)
        State and partials at the start, 6 numbers each.

    Returns
    -------
    status : int
    states : ndarray, shape (n_steps + 1, 1 + n)
        Time, state and partials at the ends of the steps.
    dense : ndarray, shape (n_steps, DENSE * n)
        For :func:`interpolate`.
    next_step : float
    """
    n, sign = len(y), 1.0 if end > start else -1.0
    t, h = start, sign * abs(first_step)
    count, capacity = 0, 256
    states, dense = np.empty((capacity + 1, 1 + n)), np.empty((capacity, DENSE * n))
    states[0, 0], states[0, 1:] = t, y
    k = np.empty((STAGES + 1 + EXTRA, n))
    right_hand_side(t, y, columns, data, k[0])
    status, next_step = DONE, h
    while sign * (end - t) > 0.0:
        if abs(h) < SHORTEST_S or count >= tolerance.most_steps:
            status = STUCK if abs(h) < SHORTEST_S else TOO_MANY
            break
        last = sign * (t + h - end) >= 0.0
        if last:
            h = end - t
        else:
            next_step = h
        error = 0.0
        new = y
        for s in range(1, STAGES + 1 + EXTRA):
            if s == STAGES:
                new = _combined(y, h, tableau.b, k, STAGES)
                right_hand_side(t + h, new, columns, data, k[s])
                error = _error(k, h, tableau, tolerance)
                if not error < 1.0:
                    break
            else:
                right_hand_side(
                    t + tableau.c[s] * h, _combined(y, h, tableau.a[s], k, s), columns, data, k[s]
                )
        if not error < 1.0:
            h *= max(_LEAST, _SAFETY * error**-0.125) if error > 1.0 else _LEAST
            continue
        if count == capacity:
            capacity *= 2
            states, dense = _longer(states, capacity + 1), _longer(dense, capacity)
        f = dense[count]
        for i in range(n):
            change = new[i] - y[i]
            f[i] = change
            f[n + i] = h * k[0, i] - change
            f[2 * n + i] = 2.0 * change - h * (k[STAGES, i] + k[0, i])
        for q in range(DENSE - 3):
            f[(3 + q) * n : (4 + q) * n] = _combined(np.zeros(n), h, tableau.d[q], k, STAGES + 1 + EXTRA)
        count += 1
        t, y = (end if last else t + h), new
        states[count, 0], states[count, 1:] = t, y
        k[0] = k[STAGES]
        status = _within(t, y, data, tolerance)
        if status != DONE:
            break
        h *= _MOST if error == 0.0 else min(_MOST, _SAFETY * error**-0.125)
    return status, states[: count + 1], dense[:count], next_step


@compiled()
def interpolate(t: Floats, states: Floats, dense: Floats) -> Floats:
    """States and partials at times within the steps, shape (len(t), n)."""
    n, last = states.shape[1] - 1, len(states) - 1
    out = np.empty((len(t), n))
    sign = 1.0 if states[last, 0] > states[0, 0] else -1.0
    forward = sign * states[:, 0]
    for i in range(len(t)):
        step = min(max(np.searchsorted(forward, sign * t[i], side="right") - 1, 0), last - 1)
        x = (t[i] - states[step, 0]) / (states[step + 1, 0] - states[step, 0])
        for j in range(n):
            value = 0.0
            for q in range(DENSE - 1, -1, -1):
                value += dense[step, q * n + j]
                value *= x if (DENSE - 1 - q) % 2 == 0 else 1.0 - x
            out[i, j] = value + states[step, 1 + j]
    return out
