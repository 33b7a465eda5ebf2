"""A point fixed to the Moon, and its parameters: along the sphere and in height, above the terrain, or Cartesian."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import EphemerisConstants
from radioloc.estimation.status import Doubt
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, east_north_up, rot_pa_to_me
from radioloc.lunar.terrain import height_and_gradient
from radioloc.measurements.target_motion import FixedPoint
from radioloc.parameters.parameter import Parameter, Role
from radioloc.targets.doubts import FittedObservations, place_doubts
from radioloc.targets.target import AtPlace, WithoutForces, solve_parameters
from radioloc.vectors import Floats

logger = logging.getLogger(__name__)

PositionFunction = Callable[[Floats], tuple[Floats, Floats]]
"""From the three position parameters to the principal-axes position, m, and its partials (3, 3)."""

PositionParameters = tuple[list[Parameter], PositionFunction]


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoint(AtPlace, WithoutForces):
    """A point fixed to the Moon, whose position follows from three parameters and those of the points before."""

    name: str
    parameters: list[Parameter]
    position: PositionFunction
    preceding: int = 0  #: parameters of the points before
    #: Where visibility is decided first; by default at the a-priori parameters.
    apriori_pa_m: Floats | None = None

    @property
    def start(self) -> FixedPoint:
        """A-priori position."""
        if self.apriori_pa_m is not None:
            return FixedPoint(self.apriori_pa_m)
        return self.motion(np.array([item.prior_value for item in self.parameters]))[0]

    def motion(self, x: Floats) -> tuple[FixedPoint, Floats]:
        """Return the point at parameters x, and the partials of its position in principal axes."""
        position_pa_m, by_x = self.position(x)
        return FixedPoint(position_pa_m), by_x

    def doubts(self, x: Floats, fitted: FittedObservations) -> Iterator[Doubt]:
        """Doubt an estimate off the Moon's surface, or one that no station sees."""
        if any(item.role is Role.ESTIMATED for item in self.parameters):
            yield from place_doubts(self.position(x)[0], fitted)

    def solved(self, target_values: Floats, x: Floats) -> Floats:
        """Return x with the last three parameters for a target position, principal axes, m."""
        return solve_parameters(self.position, target_values, x)


def on_sphere(
    start_pa_m: Floats, prior: tuple[float, float] | None, name: str = "position"
) -> PositionParameters:
    """Return east and north along the 1737.4 km sphere from the a-priori position, and the height above it."""
    # Longitude and latitude themselves are singular at the poles, where landers stand; in these coordinates the
    # a-priori position is on the equator, wherever on the Moon it is, and the height is still a parameter.
    longitude_rad = math.atan2(start_pa_m[1], start_pa_m[0])
    latitude_rad = math.atan2(start_pa_m[2], math.hypot(start_pa_m[0], start_pa_m[1]))
    height_m = float(np.linalg.norm(start_pa_m)) - MEAN_LUNAR_RADIUS_M
    to_pa = east_north_up(longitude_rad, latitude_rad).T
    height = (height_m, math.inf) if prior is None else prior
    parameters = [
        Parameter(f"{name}.east", "m", "position", 0.0),
        Parameter(f"{name}.north", "m", "position", 0.0),
        Parameter(f"{name}.height", "m", "position", *height),
    ]

    def position(x: Floats) -> tuple[Floats, Floats]:
        angles = x[:2] / MEAN_LUNAR_RADIUS_M
        (cos_e, cos_n), (sin_e, sin_n) = np.cos(angles), np.sin(angles)
        radius_m = MEAN_LUNAR_RADIUS_M + x[2]
        up = np.array([sin_e * cos_n, sin_n, cos_e * cos_n])
        by_east = np.array([cos_e * cos_n, 0.0, -sin_e * cos_n])
        by_north = np.array([-sin_e * sin_n, cos_n, -cos_e * sin_n])
        ratio = radius_m / MEAN_LUNAR_RADIUS_M
        return radius_m * (to_pa @ up), to_pa @ np.stack([ratio * by_east, ratio * by_north, up], axis=-1)

    return parameters, position


def cartesian(
    start_pa_m: Floats, *, role: Role = Role.ESTIMATED, name: str = "position"
) -> PositionParameters:
    """x, y, z in principal axes."""
    parameters = [
        Parameter(f"{name}.{axis}", "m", "position", float(value), role=role)
        for axis, value in zip("xyz", start_pa_m, strict=True)
    ]
    return parameters, lambda x: (x, np.eye(3))


def on_terrain(
    start_pa_m: Floats,
    terrain: TerrainModel,
    own_sigma_m: float,
    constants: EphemerisConstants,
    name: str = "position",
) -> PositionParameters:
    """Return east and north along the sphere, and the height above the terrain there."""
    # The prior on the height above the terrain follows the terrain with its slope wherever the estimate goes, and is
    # still a prior on one parameter.
    (east, north, _), along_sphere = on_sphere(start_pa_m, None, name)
    start_height_m = float(np.linalg.norm(start_pa_m)) - MEAN_LUNAR_RADIUS_M
    rot = rot_pa_to_me(constants)
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(rot @ start_pa_m)
    terrain_m = float(terrain.height_m(longitude_rad, latitude_rad))
    sigma_m = float(terrain.sigma_m(longitude_rad, latitude_rad, own_sigma_m))
    height = Parameter(f"{name}.height_above_terrain", "m", "position", 0.0, sigma_m)
    logger.info("terrain under the a-priori position: %.1f m, given height %.1f m", terrain_m, start_height_m)

    def position(x: Floats) -> tuple[Floats, Floats]:
        below_pa_m, partials_pa = along_sphere(np.array([x[0], x[1], 0.0]))
        me_m, along_me = rot @ below_pa_m, rot @ partials_pa
        longitude, latitude, _ = cartesian_to_selenographic(me_m)
        height_m, gradient = height_and_gradient(terrain.height_and_slope, longitude, latitude)
        slope = gradient @ along_me[:, :2] / MEAN_LUNAR_RADIUS_M
        pa_m, partials = along_sphere(np.array([x[0], x[1], height_m + x[2]]))
        partials[:, :2] += np.outer(partials[:, 2], slope)
        return pa_m, partials

    return [east, north, height], position
