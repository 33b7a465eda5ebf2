"""Starts for the fit of an orbit.

Hundreds of metres of the a-priori state are hundreds of kilometres after some days, far outside of what is linear. So
growing parts of an arc are fitted, each from where the one before ended: within two hours of the epoch they are not;
what these settle is good for six, and so on to the whole arc.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.jobs.manoeuvres import Manoeuvre, unnamed_manoeuvre
from radioloc.jobs.orbit_steps import fitted_state
from radioloc.parameters.design import ObservationModel
from radioloc.time import tt_to_tdb, utc_to_tt

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]

_FIRST_S = 7200.0
_FEWEST = 30
_WEAK_M, _WEAK_M_S = 2e3, 2.0
"""How far a state without a-priori sigmas goes in one step: what a short part does not tell stays where it is."""
_FREE = 1e6
"""Scales of a parameter that stand for no a-priori sigma."""
_INVERSIONS = 8
"""Newton's steps from a state to its elements."""


def near_orbit(
    problem: ObservationModel, sigma_m: Floats, usable: NDArray[np.bool_], seek: bool = False
) -> tuple[Floats | None, list[Manoeuvre]]:
    """Parameters of an arc's problem near the estimate, with manoeuvres if they are sought; ``None`` without an orbit.

    Without it a fit of 36 hours from 1.9 km and 1.9 m/s off does not converge (`tests/unit/jobs/test_orbit_study.py`).
    """
    parameters, orbit = problem.parameters, problem.predictor.trajectory
    count = len(parameters.of_kind("state")) + len(parameters.of_kind("force"))
    free = np.flatnonzero(parameters.free[:count])
    if not isinstance(orbit, AdjustableOrbit) or not len(free) or not usable.any():
        return None, []
    arc = problem.predictor.along(orbit.coarse())
    tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch))
    away_s = np.abs(tdb.seconds_since(orbit.epoch))
    apriori = np.array(list(orbit.values.values()))
    sigmas = _cartesian_sigmas(problem, count)[free]
    x, found = apriori.copy(), list[Manoeuvre]()
    reach_s = max(_FIRST_S, float(np.sort(away_s[usable])[min(_FEWEST, int(usable.sum())) - 1]))
    while True:
        rows = np.flatnonzero(usable & (away_s <= reach_s))
        part, before = arc.select(rows), x
        x, spread = fitted_state(part, sigma_m[rows], before, apriori, free, sigmas)
        logger.info(
            "orbit within %.1f h of the epoch: %d observations, robust misfit %.3g sigmas",
            reach_s / 3600.0,
            len(rows),
            spread,
        )

        def starts(
            rows: NDArray[np.intp] = rows, first: Floats = x, before: Floats = before
        ) -> Iterator[Floats]:
            """Of which the later ones may fit on the epoch's side of a manoeuvre."""
            yield from (first, before)
            for fraction in (2, 4):
                near = rows[np.argsort(away_s[rows])[: max(_FEWEST, len(rows) // fraction)]]
                yield fitted_state(arc.select(near), sigma_m[near], before, apriori, free, sigmas)[0]

        manoeuvre = unnamed_manoeuvre(part, sigma_m[rows], starts(), apriori, free, sigmas) if seek else None
        if manoeuvre is not None:
            found.append(manoeuvre)
            x, usable = manoeuvre.x, usable & ~manoeuvre.hides(arc.observations)
        elif reach_s >= away_s[usable].max():
            break
        else:
            reach_s *= 3.0
    return _with_orbit(problem, x - apriori), found


def _with_orbit(problem: ObservationModel, changes: Floats) -> Floats:
    """A-priori values of all parameters, but for the orbit those that change it so."""
    start, mine = problem.parameters.prior_values.copy(), slice(len(changes))
    for _ in range(_INVERSIONS):
        made, by = problem.positions[0](start[mine])
        start[mine] += np.linalg.solve(by, changes - made)
    return start


def _cartesian_sigmas(problem: ObservationModel, count: int) -> Floats:
    """How far one step of the state and of the forces may go, by what is known a priori."""
    parameters = problem.parameters
    known = np.minimum(parameters.prior_sigmas, _FREE * parameters.scales)[:count]
    by = problem.positions[0](parameters.prior_values[:count])[1]
    most = np.concatenate([[_WEAK_M] * 3, [_WEAK_M_S] * 3, np.full(count - 6, math.inf)])
    most[[one.unit == "m/s" for one in parameters.parameters[:count]]] = _WEAK_M_S
    return np.minimum(np.sqrt(by**2 @ known**2), most)
