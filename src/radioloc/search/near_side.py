"""Search over the near side of the Moon for a target far from its a-priori position.

Measurements from the Earth depend nearly linearly on Cartesian coordinates: the second derivatives are one over the
distance, which amounts to 4 km over the radius of the Moon. Only the curvature of the surface makes fits from distant
starts slow or wrong. A few observations of each link, linearized at one place, therefore determine the misfit
everywhere. At each point of a grid on the sphere of the a-priori height, the place within its cell and all other
parameters minimize the Huber loss (1964). The model is linearized again at the best place until it is stable.
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
from radioloc.jobs.verdict import MAX_START_DISTANCE_M
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import FixedPoint
from radioloc.study.study import EstimateChoice, HeightPrior
from radioloc.vectors import Floats

# Observations of a link and type, spread evenly over the arc: the loss tolerates 30 % outliers among them.
_MAX_SERIES_OBSERVATIONS = 12
_GRID_POINT_COUNT = 500  # 190 km apart
_MIN_LIMB_COSINE = math.cos(math.radians(98.0))  # librations show 8 deg beyond the mean limb
# Standard deviations of the adjustment from a point of the grid, along the sphere and in height.
_CELL_SIGMA_M, _HEIGHT_SIGMA_M = 1e5, 3e3
# Of another position to the a-priori one, which weakly determined positions do not reach.
_MAX_LOSS_RATIO = 0.5
_MAX_MEAN_LOSS = 5.0  # of an adequate a-priori position: residuals of a few sigmas
_STEP_TOLERANCE_M = 1e4
_REWEIGHTING_COUNT = 6
_MAX_STEPS = 10


def improved_positions(
    arc: Predictor, targets_pa: Mapping[str, LunarPosition], estimate: EstimateChoice
) -> dict[str, tuple[LunarPosition, float]]:
    """Return better positions of targets by name, principal axes, with the distance from the a-priori ones, m.

    Each of several targets is searched by the observations that involve it alone; a target that is only observed
    relative to another moves with it. Targets with adequate a-priori positions are omitted.
    """
    if arc.trajectories or estimate.position == "none" or not len(arc.observations):
        return {}
    observed = [[canonical_target(name) for name in link.targets] for link in arc.observations.links]
    positions: dict[str, tuple[LunarPosition, float]] = {}
    with_prior = {prior.target for prior in estimate.position_priors}
    for name, apriori in targets_pa.items():
        if name in with_prior:
            continue
        involved = np.array([len(targets_pa) == 1 or names == [name] for names in observed])
        rows = _sample(arc.observations, np.flatnonzero(involved[arc.observations.link]))
        if len(rows) and (start := _improved_position(arc.select(rows), apriori, estimate)) is not None:
            positions[name] = start
    single = {names[0] for names in observed if len(names) == 1}
    for name, partner in {pair for names in observed for pair in permutations(names, 2)}:
        if name not in single and partner in positions:
            position, away_m = positions[partner]
            offset_m = targets_pa[name].xyz_m - targets_pa[partner].xyz_m
            positions[name] = LunarPosition(position.frame, position.xyz_m + offset_m), away_m
    return positions


def _improved_position(
    sample: Predictor, target_pa: LunarPosition, estimate: EstimateChoice
) -> tuple[LunarPosition, float] | None:
    """Return a better position than the a-priori one, with the distance between them, m, or ``None``."""
    linearized = partial(_LinearizedMisfit, sample, target_pa.frame, estimate)
    prior = estimate.height_prior
    radius_m = float(np.linalg.norm(target_pa.xyz_m))
    if isinstance(prior, HeightPrior):
        radius_m = MEAN_LUNAR_RADIUS_M + prior.height_m
    apriori_m = target_pa.xyz_m * (radius_m / np.linalg.norm(target_pa.xyz_m))
    grid_m = radius_m * _near_side_directions()
    # The prepared predictor of a single target suffices for the test of its a-priori position.
    place_m, misfit, trials = apriori_m, linearized(apriori_m, prepared=not sample.targets), []
    if misfit.losses(apriori_m[None])[0][0] < _MAX_MEAN_LOSS * len(misfit):
        return None
    for _ in range(_MAX_STEPS):
        losses, moved_m = misfit.losses(np.concatenate([place_m[None], grid_m]))
        trials.append((float(losses[0]), place_m))
        best = int(losses.argmin())
        step_m = moved_m[best] * (radius_m / np.linalg.norm(moved_m[best])) - place_m
        if best == 0 and np.linalg.norm(step_m) < _STEP_TOLERANCE_M:
            break
        place_m = place_m + step_m
        misfit = linearized(place_m, prepared=False)
    loss, place_m = min(trials, key=lambda trial: trial[0])
    away_m = float(np.linalg.norm(place_m - apriori_m))
    if away_m <= MAX_START_DISTANCE_M or loss > _MAX_LOSS_RATIO * trials[0][0]:
        return None
    return LunarPosition(target_pa.frame, place_m), away_m


class _LinearizedMisfit:
    """Misfit of places in principal axes, by the model of an arc linearized at one place."""

    def __init__(
        self, arc: Predictor, frame: str, estimate: EstimateChoice, place_m: Floats, prepared: bool
    ) -> None:
        observations = arc.observations
        if not prepared:
            point = FixedPoint(place_m)
            arc = prepare_predictor(arc.model, observations, point, "exact", more_partials=arc.more_partials)
        estimate = replace(estimate, position="cartesian", height_prior=None).restricted_to(arc)
        points = surface_points({"": LunarPosition(frame, place_m)}, arc.model, estimate)
        problem = observation_model(arc, points, estimate)
        linearization = problem.linearize(problem.parameters.prior_values)
        partials = linearization.partials(np.arange(len(observations)))
        free = problem.parameters.free
        usable = np.isfinite(partials).all(axis=1) & np.isfinite(linearization.residual_m)
        sigma_m = observations.sigma_m[usable]
        rows = (partials[usable] / sigma_m[:, None])[:, free]
        # Scaled to unit partials.
        norm = np.sqrt(np.square(rows).sum(axis=0))
        self._norm = np.where(norm > 0.0, norm, 1.0)
        self._place_m = place_m
        self._residual, self._partials = linearization.residual_m[usable] / sigma_m, rows / self._norm
        self._prior = np.diag((self._norm * problem.parameters.prior_sigmas[free]) ** -2.0 + 1e-12)

    def __len__(self) -> int:
        return len(self._residual)

    def losses(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Return the smallest Huber losses near places (k, 3), and the places of the minima, (k,) and (k, 3)."""
        partials, norm = self._partials, self._norm
        m, p = partials.shape
        up = places_m / np.linalg.norm(places_m, axis=-1)[:, None]
        horizontal, height = _CELL_SIGMA_M**-2.0, _HEIGHT_SIGMA_M**-2.0
        prior = np.broadcast_to(self._prior, (len(places_m), p, p)).copy()
        prior[:, :3, :3] += (
            horizontal * np.eye(3) + (height - horizontal) * up[:, :, None] * up[:, None, :]
        ) / np.outer(norm[:3], norm[:3])
        residual = self._residual[:, None] - partials[:, :3] @ (norm[:3] * (places_m - self._place_m)).T
        products = (partials[:, :, None] * partials[:, None, :]).reshape(m, p * p)
        adjusted = residual
        for _ in range(_REWEIGHTING_COUNT):
            weights = 1.0 / np.maximum(1.0, np.abs(adjusted))
            normal = (weights.T @ products).reshape(-1, p, p) + prior
            shift = np.linalg.solve(normal, ((weights * residual).T @ partials)[..., None])[..., 0]
            adjusted = residual - partials @ shift.T
        loss = huber(adjusted).sum(axis=0)
        loss += 0.5 * np.einsum("ki,kij,kj->k", shift, prior, shift)
        return loss, places_m + shift[:, :3] / norm[:3]


def _sample(observations: Observations, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return some of the rows, equally many of each link and type, spread evenly over time."""
    order = rows[np.lexsort((observations.epoch.fraction[rows], observations.epoch.jd[rows]))]
    series = observations.link[order].astype(np.int64) * len(KINDS) + observations.kind[order]
    samples = []
    for number in np.unique(series):
        part = order[series == number]
        samples.append(part[np.unique(np.linspace(0, len(part) - 1, _MAX_SERIES_OBSERVATIONS).astype(int))])
    return np.sort(np.concatenate(samples)) if samples else order


def _near_side_directions() -> Floats:
    """Return unit vectors to the near side in principal axes, a spiral of equal areas, shape (n, 3)."""
    count = round(2.0 * _GRID_POINT_COUNT / (1.0 - _MIN_LIMB_COSINE))
    k = np.arange(count) + 0.5
    x = 1.0 - 2.0 * k / count
    x = x[x > _MIN_LIMB_COSINE]
    angle = math.pi * (1.0 + math.sqrt(5.0)) * k[: len(x)]
    across = np.sqrt(1.0 - x**2)
    return np.stack([x, across * np.cos(angle), across * np.sin(angle)], axis=-1)
