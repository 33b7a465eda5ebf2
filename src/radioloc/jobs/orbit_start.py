"""Starts for the fit of an orbit.

An error of hundreds of metres in the a-priori state grows to hundreds of kilometres in some days, far beyond the linear
range. So growing parts of an arc are fitted by robust steps, from two hours about the epoch to the whole arc, each from
the result of the part before it.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace

import erfa
import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import RadiolocError
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.target_motion import OrbitMotion
from radioloc.targets.design import ObservationModel
from radioloc.time import tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask

_MAX_STEP_COUNT = 8
_COUNTED_FRACTION = 0.9  # Fraction of the residuals, from the smallest, in the loss
_CORNER_SIGMAS = 2.0  # Robust sigmas above which residuals are weighted by their size only
_MIN_GAIN = 0.03  # Relative gain below which the steps end


@dataclass(frozen=True, slots=True, eq=False)
class OrbitPart:
    """Observations to which an orbit is fitted."""

    predictor: Predictor
    orbit: AdjustableOrbit
    sigma_m: Floats
    apriori: Floats  # parameters of the orbit: state and forces
    free: Indices
    step_sigmas: Floats  # of the free parameters
    target: int = 0
    # Of the orbit among the partials with respect to all motions.
    columns: slice = field(default_factory=lambda: slice(None))

    def compute(self, x: Floats) -> Computed:
        """Predict the observations for parameters x of the orbit."""
        motions = list(self.predictor.motions)
        motions[self.target] = OrbitMotion(self.orbit, x - self.apriori)
        return self.predictor.compute(motions)

    def select(self, rows: Indices) -> OrbitPart:
        """Return the part with some of the observations."""
        return replace(self, predictor=self.predictor.select(rows), sigma_m=self.sigma_m[rows])


def fitted_state(part: OrbitPart, x: Floats, steps: int = _MAX_STEP_COUNT) -> tuple[Floats, float]:
    """Return parameters after robust steps, and the scale of the residuals in sigmas."""
    sigma_m, free, sigmas = part.sigma_m, part.free, part.step_sigmas
    best, min_loss, spread = x, math.inf, math.inf
    shrink = 1.0
    step = np.zeros(len(x))
    for _ in range(steps):
        try:
            computed = part.compute(x)
        except RadiolocError:
            if x is best:
                raise
            loss = math.inf  # the orbit meets the ground, or the model does not cover it
        else:
            ratio = (part.predictor.observations.value_m - computed.value_m) / sigma_m
            spread_here = max(1.0, robust_scale(ratio, len(free)))
            # Without the largest one, which could hide the reduction of all others.
            loss = float(np.sort(np.abs(ratio))[: math.ceil(_COUNTED_FRACTION * len(ratio))].mean())
        if loss > min_loss:
            # Too far: return and take a shorter step.
            shrink *= 0.3
            x = _with_rotated_orbit(best, shrink * step)
            continue
        gain, best, min_loss, spread = min_loss - loss, x, loss, spread_here
        if gain < _MIN_GAIN * loss and shrink == 1.0:
            break
        shrink = 1.0
        weight = np.sqrt(1.0 / np.maximum(np.abs(ratio) / (_CORNER_SIGMAS * spread), 1.0)) / spread
        by_orbit = computed.by_motion[:, part.columns][:, free]
        design = (by_orbit / sigma_m[:, None] * sigmas) * weight[:, None]
        stacked = np.vstack([design, np.eye(len(free))])
        right = np.concatenate([ratio * weight, np.zeros(len(free))])
        step = np.zeros(len(x))
        step[free] = sigmas * np.linalg.lstsq(stacked, right, rcond=None)[0]
        x = _with_rotated_orbit(best, step)
    return best, spread


def _with_rotated_orbit(x: Floats, step: Floats) -> Floats:
    """Return parameters after a step with rotations of the whole orbit, which Doppler determines worst."""
    moved = x + step
    (r, v), (dr, dv) = x[:6].reshape(2, 3), step[:6].reshape(2, 3)
    distance = np.linalg.norm(r)
    up = r / distance
    across = np.cross(r, v)
    speed = np.linalg.norm(across) / distance  # along the ground
    turn = np.cross(up, dr) / distance
    turn = turn + up * ((dv - np.cross(turn, v)) @ across) / np.linalg.norm(across) / speed
    moved[:6] = turned_state(np.concatenate([r + up * (dr @ up), v + dv - np.cross(turn, v)]), turn)
    return moved


def turned_state(state: Floats, turn_rad: Floats) -> Floats:
    """Return position and velocity, shape (6,), rotated by a vector."""
    # ERFA's matrix rotates the axes, its transpose vectors.
    return np.asarray((state.reshape(2, 3) @ erfa.rv2m(turn_rad)).ravel())


logger = logging.getLogger(__name__)

_MIN_OBSERVATIONS = 30  # Fewest observations of the first part
REACH_FACTOR = 3.0  # Ratio of the time spans about the epoch of one part and the next
_MIN_REACH_S = 7200.0
_MAX_STEP_M, _MAX_STEP_M_S = 2e3, 2.0
"""Scale of one step of a state without a-priori sigmas: directions that a short part does not determine stay fixed."""
_FREE_SIGMA_SCALES = 1e6  # Sigma of a free parameter, in scales


@dataclass(frozen=True, eq=False)
class StagedStart:
    """Robust fits of parts of an arc about the epoch of its orbit."""

    part: OrbitPart  # all observations, with the coarse orbit
    away_s: Floats  # time of each observation from the epoch; infinite for other targets

    @classmethod
    def from_model(cls, problem: ObservationModel, sigma_m: Floats, target: int = 0) -> StagedStart | None:
        """Return the start of a target's orbit, or ``None`` if no state is estimated."""
        parameters, orbit = problem.parameters, problem.targets[target].orbit
        free = np.flatnonzero(parameters.free[problem.columns_of(target)])
        if orbit is None or problem.targets[target].has_place or not len(free):
            return None  # a descent starts where it is known to land
        motions = list(problem.predictor.motions)
        coarse = orbit.coarse()
        motions[target] = OrbitMotion(coarse)
        predictor = problem.predictor.with_motions(motions)
        apriori, sigmas = np.array(list(orbit.values.values())), _cartesian_sigmas(problem, target)[free]
        columns = problem.motion_columns_of(target)
        part = OrbitPart(predictor, coarse, sigma_m, apriori, free, sigmas, target, columns)
        since_s = tt_to_tdb(utc_to_tt(predictor.observations.epoch)).seconds_since(orbit.epoch)
        return cls(part, np.where(predictor.target == target, np.abs(since_s), np.inf))

    def first_reach_s(self, usable: Mask) -> float:
        """Return the time from the epoch within which observations are fitted first."""
        ordered_s = np.sort(self.away_s[usable])
        return max(_MIN_REACH_S, float(ordered_s[min(_MIN_OBSERVATIONS, len(ordered_s)) - 1]))

    def rows_within(self, reach_s: float, usable: Mask) -> Indices:
        """Return the usable observations of a part."""
        return np.flatnonzero(usable & (self.away_s <= reach_s))

    def fitted(self, rows: Indices, x: Floats) -> Floats:
        """Return the parameters of the orbit that fit some observations, starting at x."""
        x, spread = fitted_state(self.part.select(rows), x)
        logger.info(
            "orbit within %.1f h of the epoch: %d observations, robust misfit %.3g sigmas",
            self.away_s[rows].max() / 3600.0,
            len(rows),
            spread,
        )
        return x


def initial_orbit(problem: ObservationModel, sigma_m: Floats, usable: Mask) -> Floats | None:
    """Return parameters of an arc's problem near the estimate, or ``None`` if no orbit is estimated."""
    # Without it a fit of 36 hours from 1.9 km and 1.9 m/s off does not converge (tests/unit/jobs/test_orbit_study.py).
    values, is_changed = problem.parameters.prior_values.copy(), False
    for target in problem.orbit_indices:
        start = StagedStart.from_model(problem, sigma_m, target)
        if start is not None and (usable & np.isfinite(start.away_s)).any():
            columns = problem.columns_of(target)
            orbit = _fit_growing_arcs(start, usable & np.isfinite(start.away_s))
            values[columns] = problem.targets[target].solved(orbit, values[columns])
            is_changed = True
    return values if is_changed else None


def _fit_growing_arcs(start: StagedStart, usable: Mask) -> Floats:
    """Return the parameters of an orbit from fits of growing parts of an arc."""
    x, reach_s = start.part.apriori, start.first_reach_s(usable)
    while True:
        x = start.fitted(start.rows_within(reach_s, usable), x)
        if reach_s >= start.away_s[usable].max():
            return x
        reach_s *= REACH_FACTOR


def _cartesian_sigmas(problem: ObservationModel, target: int) -> Floats:
    """Return the scale of one step of the state and of the forces, from the a-priori sigmas."""
    parameters, columns = problem.parameters, problem.columns_of(target)
    sigmas = np.minimum(parameters.prior_sigmas, _FREE_SIGMA_SCALES * parameters.scales)[columns]
    by = problem.targets[target].motion(parameters.prior_values[columns])[1]
    largest = np.concatenate([[_MAX_STEP_M] * 3, [_MAX_STEP_M_S] * 3, np.full(len(sigmas) - 6, math.inf)])
    largest[[item.unit == "m/s" for item in parameters.parameters[columns]]] = _MAX_STEP_M_S
    return np.minimum(np.sqrt(by**2 @ sigmas**2), largest)
