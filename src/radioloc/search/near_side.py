"""A position near the target where the a-priori position is far from it: a search over the near side of the Moon.

Seen from the Earth, measurements depend nearly linearly on Cartesian coordinates: second derivatives are one over the
distance, 4 km over the Moon's radius. What makes fits from afar slow or false is the curvature of the surface. A few
observations of each link, linearized at one place, therefore determine the misfit everywhere: from each point of a
grid on the sphere of the a-priori height the place, within its cell, and all other parameters are adjusted to least
Huber loss (1964). The model is linearized again at the best place, until that stays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.estimation.robust import huber
from radioloc.jobs.problem import observation_model
from radioloc.jobs.study_targets import surface_points
from radioloc.jobs.verdict import NEAR_HOME_M
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import FixedPoint
from radioloc.study.study import EstimateChoice, HeightPrior
from radioloc.vectors import Floats

_MAX_SERIES_OBSERVATIONS = 12
"""Observations of a link and type, spread evenly over the arc: 30 % outliers among them do not carry the loss away."""
_GRID_POINT_COUNT = 500  # 190 km apart
_MIN_LIMB_COSINE = math.cos(math.radians(98.0))  # librations show 8 deg beyond the mean limb
_CELL_SIGMA_M, _HEIGHT_SIGMA_M = 1e5, 3e3
"""Standard deviations of the adjustment from a point of the grid, along the sphere and in height."""
_MAX_LOSS_RATIO = 0.5
"""Largest ratio of the losses at another and at the a-priori position: what the data hardly determine stays there."""
_MAX_MEAN_LOSS = 5.0  # largest mean loss, residuals of a few sigmas, with which an a-priori position serves
_SETTLED_M = 1e4
_REWEIGHTING_COUNT = 6
_MAX_STEPS = 10


def near_positions(
    arc: Predictor, targets_pa: Mapping[str, LunarPosition], estimate: EstimateChoice
) -> dict[str, tuple[LunarPosition, float]]:
    """Return better positions of targets by name, principal axes, with the distance from the a-priori ones, m.

    Of several targets each is sought by its own observations; one that is only observed beside another moves with it.
    Targets whose a-priori positions serve as well are not among them.
    """
    if arc.trajectories or estimate.position == "none" or not len(arc.observations):
        return {}
    observed = [[canonical_target(name) for name in link.targets] for link in arc.observations.links]
    found: dict[str, tuple[LunarPosition, float]] = {}
    placed = {prior.target for prior in estimate.position_priors}
    for name, given in targets_pa.items():
        if name in placed:
            continue
        own = np.array([len(targets_pa) == 1 or names == [name] for names in observed])
        mine = _some(arc.observations, np.flatnonzero(own[arc.observations.link]))
        if len(mine) and (start := _near_position(arc.select(mine), given, estimate)) is not None:
            found[name] = start
    alone = {names[0] for names in observed if len(names) == 1}
    for one, other in {pair for names in observed for pair in permutations(names, 2)}:
        if one not in alone and other in found:
            there, away_m = found[other]
            beside_m = targets_pa[one].xyz_m - targets_pa[other].xyz_m
            found[one] = LunarPosition(there.frame, there.xyz_m + beside_m), away_m
    return found


def _near_position(
    some: Predictor, target_pa: LunarPosition, estimate: EstimateChoice
) -> tuple[LunarPosition, float] | None:
    linearized = partial(_Linearized, some, target_pa.frame, estimate)
    prior = estimate.height_prior
    radius_m = float(np.linalg.norm(target_pa.xyz_m))
    if isinstance(prior, HeightPrior):
        radius_m = MEAN_LUNAR_RADIUS_M + prior.height_m
    given_m = target_pa.xyz_m * (radius_m / np.linalg.norm(target_pa.xyz_m))
    grid_m = radius_m * _near_side()
    # Whether a search is needed is told by what is prepared already, where that is for one target.
    here_m, there, found = given_m, linearized(given_m, prepared=not some.targets), []
    if there.losses(given_m[None])[0][0] < _MAX_MEAN_LOSS * len(there):
        return None
    for _ in range(_MAX_STEPS):
        losses, moved_m = there.losses(np.concatenate([here_m[None], grid_m]))
        found.append((float(losses[0]), here_m))
        best = int(losses.argmin())
        step_m = moved_m[best] * (radius_m / np.linalg.norm(moved_m[best])) - here_m
        if best == 0 and np.linalg.norm(step_m) < _SETTLED_M:
            break
        here_m = here_m + step_m
        there = linearized(here_m, prepared=False)
    loss, here_m = min(found, key=lambda one: one[0])
    away_m = float(np.linalg.norm(here_m - given_m))
    if away_m <= NEAR_HOME_M or loss > _MAX_LOSS_RATIO * found[0][0]:
        return None
    return LunarPosition(target_pa.frame, here_m), away_m


class _Linearized:
    """Misfit of other places by the model of an arc linearized at one, in principal axes; residuals in sigmas."""

    def __init__(
        self, arc: Predictor, frame: str, estimate: EstimateChoice, place_m: Floats, prepared: bool
    ) -> None:
        observations = arc.observations
        if not prepared:
            more = arc.more_partials
            arc = prepare_predictor(arc.model, observations, FixedPoint(place_m), "exact", more_partials=more)
        estimate = replace(estimate, position="cartesian", height_prior=None).restricted_to(arc)
        points = surface_points({"": LunarPosition(frame, place_m)}, arc.model, estimate)
        problem = observation_model(arc, points, estimate)
        at = problem.linearize(problem.parameters.prior_values)
        partials = at.partials(np.arange(len(observations)))
        free = problem.parameters.free
        usable = np.isfinite(partials).all(axis=1) & np.isfinite(at.residual_m)
        sigma_m = observations.sigma_m[usable]
        rows = (partials[usable] / sigma_m[:, None])[:, free]
        # In units in which every parameter has partials of one.
        norm = np.sqrt(np.square(rows).sum(axis=0))
        self._norm = np.where(norm > 0.0, norm, 1.0)
        self._place_m = place_m
        self._residual, self._partials = at.residual_m[usable] / sigma_m, rows / self._norm
        self._prior = np.diag((self._norm * problem.parameters.prior_sigmas[free]) ** -2.0 + 1e-12)

    def __len__(self) -> int:
        return len(self._residual)

    def losses(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Huber's loss near places (k, 3), with the best of all parameters, and where it is least, (k,) and (k, 3)."""
        partials, norm = self._partials, self._norm
        m, p = partials.shape
        up = places_m / np.linalg.norm(places_m, axis=-1)[:, None]
        along, height = _CELL_SIGMA_M**-2.0, _HEIGHT_SIGMA_M**-2.0
        prior = np.broadcast_to(self._prior, (len(places_m), p, p)).copy()
        prior[:, :3, :3] += (
            along * np.eye(3) + (height - along) * up[:, :, None] * up[:, None, :]
        ) / np.outer(norm[:3], norm[:3])
        residual = self._residual[:, None] - partials[:, :3] @ (norm[:3] * (places_m - self._place_m)).T
        products = (partials[:, :, None] * partials[:, None, :]).reshape(m, p * p)
        left = residual
        for _ in range(_REWEIGHTING_COUNT):
            weights = 1.0 / np.maximum(1.0, np.abs(left))
            normal = (weights.T @ products).reshape(-1, p, p) + prior
            shift = np.linalg.solve(normal, ((weights * residual).T @ partials)[..., None])[..., 0]
            left = residual - partials @ shift.T
        loss = huber(left).sum(axis=0)
        loss += 0.5 * np.einsum("ki,kij,kj->k", shift, prior, shift)
        return loss, places_m + shift[:, :3] / norm[:3]


def _some(observations: Observations, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Some of the rows, of all links and types as many, spread evenly over time."""
    order = rows[np.lexsort((observations.epoch.fraction[rows], observations.epoch.jd[rows]))]
    series = observations.link[order].astype(np.int64) * len(KINDS) + observations.kind[order]
    found = []
    for one in np.unique(series):
        mine = order[series == one]
        found.append(mine[np.unique(np.linspace(0, len(mine) - 1, _MAX_SERIES_OBSERVATIONS).astype(int))])
    return np.sort(np.concatenate(found)) if found else order


def _near_side() -> Floats:
    """Unit vectors of principal axes that the Earth can see, by equal areas in a spiral, shape (n, 3)."""
    count = round(2.0 * _GRID_POINT_COUNT / (1.0 - _MIN_LIMB_COSINE))
    k = np.arange(count) + 0.5
    x = 1.0 - 2.0 * k / count
    x = x[x > _MIN_LIMB_COSINE]
    angle = math.pi * (1.0 + math.sqrt(5.0)) * k[: len(x)]
    across = np.sqrt(1.0 - x**2)
    return np.stack([x, across * np.cos(angle), across * np.sin(angle)], axis=-1)
