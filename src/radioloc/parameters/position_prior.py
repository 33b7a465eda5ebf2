"""A-priori position of a target with its full covariance, such as a position on a map.

The a-priori information of a fit is one value and one sigma for each parameter. A correlated a-priori position
therefore gets parameters that are independent a priori: with the covariance C = L D L^T (L unit lower triangular,
D diagonal) of east, north and up, the displacement from the a-priori position is L u, and u has the a-priori covariance
D. The first parameter is the displacement to the east; the others are those to the north and up less their regression
on the ones before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import InputError
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.local import axes_at, displaced
from radioloc.lunar.position import LunarPosition
from radioloc.parameters.position import PositionParameters

_Floats = NDArray[np.float64]


def map_tie_names(map_name: str) -> tuple[str, str]:
    """Return the names of the errors east and north that all positions on a map have in common."""
    return f"map_tie.{map_name}.east", f"map_tie.{map_name}.north"


@dataclass(frozen=True, slots=True, eq=False)
class PositionPrior:
    """A-priori position of a target.

    Parameters
    ----------
    target : str
        Canonical name of the target; empty where there is only one.
    mean : LunarPosition
        In mean-Earth axes.
    covariance_enu_m2 : ndarray, shape (3, 3)
        Total covariance of east, north and up, m^2; NaN for a height that is not determined.
    errors_enu_m : mapping of str to ndarray, shape (3,)
        Errors that other results have in common with it, by name: displacement by one sigma of each, east, north, up,
        m. They are part of the covariance.
    data : tuple of str
        Identifiers of the data behind it.

    Raises
    ------
    InputError
        The covariance is not positive definite.
    """

    target: str
    mean: LunarPosition
    covariance_enu_m2: _Floats
    errors_enu_m: Mapping[str, _Floats] = field(default_factory=dict)
    data: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.factors()

    @property
    def has_height(self) -> bool:
        """Whether it determines the height."""
        return bool(np.isfinite(self.covariance_enu_m2[2, 2]))

    def with_height(self, height_m: float, sigma_m: float) -> PositionPrior:
        """Return the combination with an independent a-priori height above the 1737.4 km sphere."""
        here_m, covariance = self.mean.selenographic[2], self.covariance_enu_m2
        gain = covariance[:, 2] / (covariance[2, 2] + sigma_m**2)
        return replace(
            self,
            mean=self.mean_displaced(gain * (height_m - here_m)),
            covariance_enu_m2=covariance - np.outer(gain, covariance[2]),
            errors_enu_m={name: error - gain * error[2] for name, error in self.errors_enu_m.items()},
        )

    def mean_displaced(self, enu_m: _Floats) -> LunarPosition:
        """Return the point at a local difference from the mean."""
        return LunarPosition.from_cartesian(displaced(self.mean.xyz_m, enu_m), self.mean.frame)

    def factors(self) -> tuple[_Floats, _Floats]:
        """Return L (3, 3) and the standard deviations of u (3,), infinite for a height that is not determined."""
        known = 3 if self.has_height else 2
        lower, sigmas = np.eye(3), np.full(3, np.inf)
        try:
            root = np.linalg.cholesky(self.covariance_enu_m2[:known, :known])
        except np.linalg.LinAlgError:
            raise InputError(
                f"a-priori position: expected a positive definite covariance, got {self.covariance_enu_m2.tolist()} m^2"
            ) from None
        sigmas[:known] = np.diag(root)
        lower[:known, :known] = root / sigmas[:known]
        return lower, sigmas


def with_position_prior(
    position: PositionParameters, prior: PositionPrior, constants: EphemerisConstants
) -> PositionParameters:
    """Return parameters with the a-priori covariance of a position.

    Parameters
    ----------
    position : PositionParameters
        East and north along the 1737.4 km sphere and a height, about the a-priori position.
    prior : PositionPrior
    constants : EphemerisConstants
        Give the rotation from principal to mean-Earth axes.
    """
    parameters, function = position
    lower, sigmas = prior.factors()
    place_me_m = prior.mean.to_axes("ME", constants).xyz_m
    rot = rot_pa_to_me(constants)
    axes_me, axes_pa = axes_at(place_me_m), axes_at(rot.T @ place_me_m)
    # From displacements on the ground in mean-Earth axes to those of the parameters, on the sphere in principal axes.
    to_parameters = axes_pa @ rot.T @ axes_me.T
    to_parameters[:2] *= MEAN_LUNAR_RADIUS_M / np.linalg.norm(place_me_m)
    turned = to_parameters @ lower
    values = np.array([item.prior_value for item in parameters])
    errors = {name: np.linalg.solve(lower, error_m) for name, error_m in prior.errors_enu_m.items()}
    changed = [
        replace(
            item,
            prior_sigma=sigma_m if np.isfinite(sigma_m) else item.prior_sigma,
            prior_errors={name: float(by_parameter[k]) for name, by_parameter in errors.items()},
        )
        for k, (item, sigma_m) in enumerate(zip(parameters, sigmas.tolist(), strict=True))
    ]

    def moved(x: _Floats) -> tuple[_Floats, _Floats]:
        place_m, partials = function(values + turned @ (x - values))
        return place_m, partials @ turned

    return changed, moved
