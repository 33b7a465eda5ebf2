"""A start for the fit of an orbit: fits of growing parts of the arc, each from where the one before ended.

Hundreds of metres of the a-priori state are hundreds of kilometres after some days, far outside of what is linear.
Within two hours of the epoch they are not; what these settle is good for six, and so on to the whole arc.
"""

from __future__ import annotations

import logging
import math

import erfa
import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import RadiolocError
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.design import ObservationModel
from radioloc.time import tt_to_tdb, utc_to_tt

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]

_FIRST_S = 7200.0
_FEWEST = 30
_STEPS = 8
_WEAK_M, _WEAK_M_S = 2e3, 2.0
"""How far a state without a-priori sigmas goes in one step: what a short part does not tell stays where it is."""
_FREE = 1e6
"""Scales of a parameter that stand for no a-priori sigma."""
_INVERSIONS = 8
"""Newton's steps from a state to its elements."""
_COUNTED = 0.9
"""Part of the residuals by which steps are judged."""
_CORNER = 2.0
"""Robust sigmas from which residuals count by their size only."""
_SETTLED = 0.03  # of the robust sigma of the residuals


def near_orbit(problem: ObservationModel, sigma_m: Floats, usable: NDArray[np.bool_]) -> Floats | None:
    """Parameters of an arc's problem that are near the estimate; ``None`` where the target is no orbit to be fitted."""
    parameters, orbit = problem.parameters, problem.predictor.trajectory
    count = len(parameters.of_kind("state")) + len(parameters.of_kind("force"))
    free = np.flatnonzero(parameters.free[:count])
    if not isinstance(orbit, AdjustableOrbit) or not len(free) or not usable.any():
        return None
    arc = problem.predictor.along(orbit.coarse())
    tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch))
    away_s = np.abs(tdb.seconds_since(orbit.epoch))
    apriori = np.array(list(orbit.values.values()))
    sigmas = _cartesian_sigmas(problem, count)[free]
    x = apriori.copy()
    reach_s = max(_FIRST_S, float(np.sort(away_s[usable])[min(_FEWEST, int(usable.sum())) - 1]))
    while True:
        rows = np.flatnonzero(usable & (away_s <= reach_s))
        part = arc.select(rows)
        x, spread = fitted_state(part, sigma_m[rows], x, apriori, free, sigmas)
        logger.info(
            "orbit within %.1f h of the epoch: %d observations, robust misfit %.3g sigmas",
            reach_s / 3600.0,
            len(rows),
            spread,
        )
        if reach_s >= away_s[usable].max():
            break
        reach_s *= 3.0
    start = parameters.prior_values.copy()
    for _ in range(_INVERSIONS):
        made, by = problem.positions[0](start[:count])
        start[:count] += np.linalg.solve(by, x - apriori - made)
    return start


def _cartesian_sigmas(problem: ObservationModel, count: int) -> Floats:
    """How far one step of the state and of the forces may go, by what is known a priori."""
    parameters = problem.parameters
    known = np.minimum(parameters.prior_sigmas, _FREE * parameters.scales)[:count]
    by = problem.positions[0](parameters.prior_values[:count])[1]
    most = np.concatenate([[_WEAK_M] * 3, [_WEAK_M_S] * 3, np.full(count - 6, math.inf)])
    most[[one.unit == "m/s" for one in parameters.parameters[:count]]] = _WEAK_M_S
    return np.minimum(np.sqrt(by**2 @ known**2), most)


def fitted_state(
    part: Predictor,
    sigma_m: Floats,
    x: Floats,
    apriori: Floats,
    free: NDArray[np.intp],
    sigmas: Floats,
    steps: int = _STEPS,
) -> tuple[Floats, float]:
    """Parameters after some robust Gauss-Newton steps, and the robust scale of the residuals in sigmas.

    `apriori` are the values that the part's trajectory has; `sigmas` say how far one step goes.
    """
    best, least, spread = x, math.inf, math.inf
    shrink = 1.0
    step = np.zeros(len(x))
    for _ in range(steps):
        try:
            computed = part.compute(x - apriori)
        except RadiolocError:
            if x is best:
                raise
            loss = math.inf  # into the ground, or out of the model's reach
        else:
            ratio = (part.observations.value_m - computed.value_m) / sigma_m
            spread_here = max(1.0, robust_scale(ratio, len(free)))
            # Without the largest, of which one that is far off would hide what a step gains in all others.
            loss = float(np.sort(np.abs(ratio))[: math.ceil(_COUNTED * len(ratio))].mean())
        if loss > least:
            # Too far: back, and half as far.
            shrink *= 0.3
            x = _moved(best, shrink * step)
            continue
        gain, best, least, spread = least - loss, x, loss, spread_here
        if gain < _SETTLED * loss and shrink == 1.0:
            break
        shrink = 1.0
        weight = np.sqrt(1.0 / np.maximum(np.abs(ratio) / (_CORNER * spread), 1.0)) / spread
        design = (computed.by_orbit[:, free] / sigma_m[:, None] * sigmas) * weight[:, None]
        stacked = np.vstack([design, np.eye(len(free))])
        right = np.concatenate([ratio * weight, np.zeros(len(free))])
        step = np.zeros(len(x))
        step[free] = sigmas * np.linalg.lstsq(stacked, right, rcond=None)[0]
        x = _moved(best, step)
    return best, spread


def _moved(x: Floats, step: Floats) -> Floats:
    """Parameters after a step, in which the orbit turns as a whole: Doppler holds it but for turns by many degrees."""
    out = x + step
    (r, v), (dr, dv) = x[:6].reshape(2, 3), step[:6].reshape(2, 3)
    distance = np.linalg.norm(r)
    up = r / distance
    across = np.cross(r, v)
    speed = np.linalg.norm(across) / distance  # along the ground
    turn = np.cross(up, dr) / distance
    turn = turn + up * ((dv - np.cross(turn, v)) @ across) / np.linalg.norm(across) / speed
    out[:6] = turned_state(np.concatenate([r + up * (dr @ up), v + dv - np.cross(turn, v)]), turn)
    return out


def turned_state(state: Floats, turn_rad: Floats) -> Floats:
    """Position and velocity, shape (6,), turned by a rotation vector."""
    # ERFA's matrix turns the axes, its transpose what is in them.
    return np.asarray((state.reshape(2, 3) @ erfa.rv2m(turn_rad)).ravel())
