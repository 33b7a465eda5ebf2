"""Starts for the fit of an orbit.

An error of hundreds of metres in the a-priori state grows to hundreds of kilometres in some days, far beyond the linear
range. So growing parts of an arc are fitted, from two hours about the epoch to the whole arc, each from the result of
the part before it.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.jobs.orbit_steps import OrbitPart, fitted_state
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.target_motion import OrbitMotion
from radioloc.targets.design import ObservationModel, orbit_of
from radioloc.time import tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats

logger = logging.getLogger(__name__)

_MIN_OBSERVATIONS = 30  # Fewest observations of the first part
REACH_FACTOR = 3.0  # Ratio of the time spans about the epoch of one part and the next
_MIN_REACH_S = 7200.0
_MAX_STEP_M, _MAX_STEP_M_S = 2e3, 2.0
"""Scale of one step of a state without a-priori sigmas: directions that a short part does not determine stay fixed."""
_FREE_SIGMA_SCALES = 1e6  # Sigma of a free parameter, in scales
_NEWTON_STEP_COUNT = 8  # From a state to its elements


@dataclass(frozen=True, eq=False)
class StagedStart:
    """Robust fits of parts of an arc about the epoch of its orbit."""

    arc: Predictor  # of the coarse orbit
    sigma_m: Floats
    apriori: Floats  # parameters of the orbit: state and forces
    free: NDArray[np.intp]
    step_sigmas: Floats  # of the free parameters
    away_s: Floats  # time of each observation from the epoch; infinite for other targets

    @classmethod
    def of(cls, problem: ObservationModel, sigma_m: Floats) -> StagedStart | None:
        """Return the start of a problem, or ``None`` if no orbit is estimated."""
        parameters, orbit, target = problem.parameters, problem.orbit, problem.orbit_index
        if orbit is None or target is None or not parameters.of_kind("state"):
            return None  # a descent starts where it is known to land
        columns = problem.columns_of(target)
        free = np.flatnonzero(parameters.free[columns])
        if not len(free):
            return None
        others = problem.predictor.motions[:-1]
        arc = problem.predictor.with_motions((*others, orbit.coarse()))
        tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch))
        return cls(
            arc,
            sigma_m,
            np.array(list(orbit.values.values())),
            free,
            _cartesian_sigmas(problem, target)[free],
            np.where(arc.target == target, np.abs(tdb.seconds_since(orbit.epoch)), np.inf),
        )

    def first_reach_s(self, usable: NDArray[np.bool_]) -> float:
        """Return the time from the epoch within which observations are fitted first."""
        ordered_s = np.sort(self.away_s[usable])
        return max(_MIN_REACH_S, float(ordered_s[min(_MIN_OBSERVATIONS, len(ordered_s)) - 1]))

    def rows_within(self, reach_s: float, usable: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the usable observations of a part."""
        return np.flatnonzero(usable & (self.away_s <= reach_s))

    def fitted(self, rows: NDArray[np.intp], x: Floats) -> Floats:
        """Return the parameters of the orbit that fit some observations, starting at x."""
        arc = self.arc.select(rows)
        orbit = orbit_of(arc)
        assert orbit is not None
        part = OrbitPart(arc, orbit, self.sigma_m[rows], self.apriori)
        x, spread = fitted_state(part, x, self.free, self.step_sigmas)
        logger.info(
            "orbit within %.1f h of the epoch: %d observations, robust misfit %.3g sigmas",
            self.away_s[rows].max() / 3600.0,
            len(rows),
            spread,
        )
        return x


def near_orbit(problem: ObservationModel, sigma_m: Floats, usable: NDArray[np.bool_]) -> Floats | None:
    """Return parameters of an arc's problem near the estimate, or ``None`` if no orbit is estimated."""
    # Without it a fit of 36 hours from 1.9 km and 1.9 m/s off does not converge (tests/unit/jobs/test_orbit_study.py).
    start = StagedStart.of(problem, sigma_m)
    if start is None:
        return None
    usable = usable & np.isfinite(start.away_s)  # of this target
    if not usable.any():
        return None
    x, reach_s = start.apriori, start.first_reach_s(usable)
    while True:
        x = start.fitted(start.rows_within(reach_s, usable), x)
        if reach_s >= start.away_s[usable].max():
            return _with_orbit(problem, x - start.apriori)
        reach_s *= REACH_FACTOR


def _with_orbit(problem: ObservationModel, changes: Floats) -> Floats:
    """Return a-priori values of all parameters, with those of the orbit that give these changes of state and forces."""
    target = problem.orbit_index
    assert target is not None
    start, columns = problem.parameters.prior_values.copy(), problem.columns_of(target)
    for _ in range(_NEWTON_STEP_COUNT):
        made, by = problem.targets[target].motion(start[columns])
        assert isinstance(made, OrbitMotion)
        start[columns] += np.linalg.solve(by, changes - made.changes)
    return start


def _cartesian_sigmas(problem: ObservationModel, target: int) -> Floats:
    """Return the scale of one step of the state and of the forces, from the a-priori sigmas."""
    parameters, columns = problem.parameters, problem.columns_of(target)
    sigmas = np.minimum(parameters.prior_sigmas, _FREE_SIGMA_SCALES * parameters.scales)[columns]
    by = problem.targets[target].motion(parameters.prior_values[columns])[1]
    largest = np.concatenate([[_MAX_STEP_M] * 3, [_MAX_STEP_M_S] * 3, np.full(len(sigmas) - 6, math.inf)])
    largest[[item.unit == "m/s" for item in parameters.parameters[columns]]] = _MAX_STEP_M_S
    return np.minimum(np.sqrt(by**2 @ sigmas**2), largest)
