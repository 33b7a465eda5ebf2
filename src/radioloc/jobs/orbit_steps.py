"""Robust steps towards the orbit of the observations, from a state that may be far off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import erfa
import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import RadiolocError
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.target_motion import OrbitMotion
from radioloc.vectors import Floats

_MAX_STEP_COUNT = 8
_COUNTED_FRACTION = 0.9  # Fraction of the residuals, from the smallest, in the loss
_CORNER_SIGMAS = 2.0  # Robust sigmas above which residuals are weighted by their size only
_MIN_GAIN = 0.03  # Relative gain below which the steps end


@dataclass(frozen=True, slots=True, eq=False)
class OrbitPart:
    """Observations to which an orbit is fitted."""

    arc: Predictor
    orbit: AdjustableOrbit
    sigma_m: Floats
    apriori: Floats  # parameters of the orbit: state and forces
    target: int = 0
    # Of the orbit among the partials with respect to all motions.
    columns: slice = field(default_factory=lambda: slice(None))

    def compute(self, x: Floats) -> Computed:
        """Predict the observations for parameters x of the orbit."""
        motions = list(self.arc.motions)
        motions[self.target] = OrbitMotion(self.orbit, x - self.apriori)
        return self.arc.compute(motions)


def fitted_state(
    part: OrbitPart, x: Floats, free: NDArray[np.intp], sigmas: Floats, steps: int = _MAX_STEP_COUNT
) -> tuple[Floats, float]:
    """Return parameters after robust steps, each within `sigmas`, and the scale of the residuals in sigmas."""
    sigma_m = part.sigma_m
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
            ratio = (part.arc.observations.value_m - computed.value_m) / sigma_m
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
