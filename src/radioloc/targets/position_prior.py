"""A-priori position of a target with its full covariance, such as a position on a map.

The a-priori information of a fit is one value and one sigma for each parameter. A correlated a-priori position
therefore gets parameters that are independent a priori: with the covariance C = L D L^T (L unit lower triangular,
D diagonal) of east, north and up, the displacement from the a-priori position is L u, and u has the a-priori covariance
D. The first parameter is the displacement to the east; the others are those to the north and up less their regression
on the ones before. Of several targets, whose positions on one map share its tie, C is that of all their positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import InputError
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.local import axes_at, displaced
from radioloc.lunar.position import LunarPosition
from radioloc.parameters.parameter import Parameter
from radioloc.targets.surface_point import PositionFunction, PositionParameters
from radioloc.vectors import Floats


def map_tie_names(map_name: str) -> tuple[str, str]:
    """Return the names of the errors east and north that all positions on a map have in common."""
    return f"map_tie.{map_name}.east", f"map_tie.{map_name}.north"


@dataclass(frozen=True, slots=True, eq=False)
class PositionPrior:
    """A-priori position of a target; an InputError where its covariance is not positive definite."""

    target: str  #: canonical name; empty where there is only one
    mean: LunarPosition  #: in mean-Earth axes
    covariance_enu_m2: Floats  #: total, of east, north and up; NaN for a height that is not determined
    #: One sigma of errors shared with other results.
    errors_enu_m: Mapping[str, Floats] = field(default_factory=dict)
    data: tuple[str, ...] = ()  #: identifiers of the data behind it
    #: (rows) with positions of other targets, by name.
    cross_enu_m2: Mapping[str, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _factors(self.covariance_enu_m2)  # refuses what is not positive definite

    @property
    def has_height(self) -> bool:
        """True if the prior determines the height."""
        return bool(np.isfinite(self.covariance_enu_m2[2, 2]))

    def with_height(self, height_m: float, sigma_m: float) -> PositionPrior:
        """Return the combination with an independent a-priori height above the 1737.4 km sphere."""
        here_m, covariance = self.mean.selenographic[2], self.covariance_enu_m2
        gain = covariance[:, 2] / (covariance[2, 2] + sigma_m**2)
        return replace(
            self,
            mean=LunarPosition.from_cartesian(
                displaced(self.mean.xyz_m, gain * (height_m - here_m)), self.mean.frame
            ),
            covariance_enu_m2=covariance - np.outer(gain, covariance[2]),
            errors_enu_m={name: error - gain * error[2] for name, error in self.errors_enu_m.items()},
        )


def _factors(covariance_enu_m2: Floats) -> tuple[Floats, Floats]:
    """Return L (p, p) and the standard deviations of u (p,), infinite where the covariance is not finite."""
    is_known = np.isfinite(np.diag(covariance_enu_m2))
    lower, sigmas = np.eye(len(is_known)), np.full(len(is_known), np.inf)
    try:
        root = np.linalg.cholesky(covariance_enu_m2[np.ix_(is_known, is_known)])
    except np.linalg.LinAlgError:
        raise InputError(
            f"a-priori position: expected a positive definite covariance, got {covariance_enu_m2.tolist()} m^2"
        ) from None
    sigmas[is_known] = np.diag(root)
    lower[np.ix_(is_known, is_known)] = root / sigmas[is_known]
    return lower, sigmas


def with_position_priors(
    positions: Sequence[PositionParameters],
    priors: Sequence[PositionPrior | None],
    constants: EphemerisConstants,
) -> list[tuple[list[Parameter], PositionFunction, int]]:
    """Return the parameters of each target's position with its a-priori covariance, if it has a prior.

    They are east and north along the 1737.4 km sphere and a height, about the a-priori position. The position is a
    function of these three and, before them, a number of parameters of the preceding positions, which is returned, too.
    """
    covariance_m2 = np.zeros((3 * len(priors),) * 2)
    for k, prior in enumerate(priors):
        rows = slice(3 * k, 3 * k + 3)
        covariance_m2[rows, rows] = np.nan if prior is None else prior.covariance_enu_m2
        for j, second in enumerate(priors):
            if prior is not None and second is not None and second.target in prior.cross_enu_m2:
                covariance_m2[rows, 3 * j : 3 * j + 3] = prior.cross_enu_m2[second.target]
    lower, sigmas = _factors(covariance_m2)
    names = dict.fromkeys(name for prior in priors if prior is not None for name in prior.errors_enu_m)
    zero = np.zeros(3)
    errors = {
        name: np.linalg.solve(
            lower,
            np.concatenate([zero if item is None else item.errors_enu_m.get(name, zero) for item in priors]),
        )
        for name in names
    }
    values = np.array([item.prior_value for parameters, _ in positions for item in parameters])
    placed = list[tuple[list[Parameter], PositionFunction, int]]()
    for k, ((parameters, function), prior) in enumerate(zip(positions, priors, strict=True)):
        if prior is None:
            placed.append((parameters, function, 0))
            continue
        first, end = 3 * k, 3 * k + 3
        changed = [
            replace(
                item,
                prior_sigma=sigmas[j] if np.isfinite(sigmas[j]) else item.prior_sigma,
                prior_errors={name: float(error[j]) for name, error in errors.items()},
            )
            for j, item in enumerate(parameters, first)
        ]
        begin = int(lower[first:end].any(axis=0).argmax()) // 3 * 3
        turned = _to_parameters(prior, constants) @ lower[first:end, begin:end]
        placed.append((changed, partial(_displaced, function, turned, values[begin:end]), first - begin))
    return placed


def _displaced(
    function: PositionFunction, turned: Floats, values: Floats, x: Floats
) -> tuple[Floats, Floats]:
    """Position and its partials (3, p) by p independent parameters x; the last three belong to this target."""
    place_m, partials = function(values[-3:] + turned @ (x - values))
    return place_m, partials @ turned


def _to_parameters(prior: PositionPrior, constants: EphemerisConstants) -> Floats:
    """Rotate displacements on the ground in mean-Earth axes to those on the sphere in principal axes, (3, 3)."""
    place_me_m = prior.mean.to_axes("ME", constants).xyz_m
    rot = rot_pa_to_me(constants)
    rotation = axes_at(rot.T @ place_me_m) @ rot.T @ axes_at(place_me_m).T
    rotation[:2] *= MEAN_LUNAR_RADIUS_M / np.linalg.norm(place_me_m)
    return np.asarray(rotation)
