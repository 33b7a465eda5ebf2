"""The parameters of a study and what they do to the computed ranges."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import InputError
from radioloc.estimation.linearization import ROWS_AT_ONCE, Rows
from radioloc.estimation.parameters import Parameter, ParameterSet
from radioloc.lunar import cartesian_to_selenographic, east_north_up, rot_pa_to_me
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.predictor import Prediction, Predictor
from radioloc.studies.nuisance import NUISANCES, ArcRows, Nuisance, Owner, middle_of
from radioloc.studies.owners import owned_parameters
from radioloc.studies.study import EstimateChoice, HeightPrior, TerrainPrior
from radioloc.time import Epochs

logger = logging.getLogger(__name__)

PositionFunction = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""From the three position parameters to the principal-axes position, m, and its partials (3, 3)."""


@dataclass(frozen=True, slots=True)
class Problem:
    """What is solved for in an arc.

    Parameters
    ----------
    arc : Predictor
    parameters : ParameterSet
        Three of the position, then the nuisance parameters, kind by kind.
    position : PositionFunction
    nuisances : tuple of (Nuisance, list of Owner)
        The kinds that are estimated or held, each with those whom its parameters belong to.
    middle_tai : Epochs or None
        Middle of the arc, which clock rates count from, one epoch; None for an arc without observations.
    """

    arc: Predictor
    parameters: ParameterSet
    position: PositionFunction
    nuisances: tuple[tuple[Nuisance, list[Owner]], ...]
    middle_tai: Epochs | None = None

    @classmethod
    def of(
        cls,
        arc: Predictor,
        target_pa: LunarPosition | None,
        estimate: EstimateChoice | None,
        catalogue: StationCatalogue,
        held: EstimateChoice | None = None,
    ) -> Problem:
        """Set up the problem of an arc.

        Parameters
        ----------
        arc : Predictor
        target_pa : LunarPosition or None
            A-priori position in principal axes; none for a trajectory, whose offset is then held at zero.
        estimate : EstimateChoice or None
            What to estimate; nothing where ``None``.
        catalogue : StationCatalogue
            Resolves the names of stations.
        held : EstimateChoice, optional
            Where nothing is estimated, whose a-priori values of biases and the like hold; zero otherwise.

        Raises
        ------
        StationError
            A station is not in the catalogue.
        InputError
            A parameter is asked for of a station without observations, or nothing at all is to be estimated.
        """
        choice = (EstimateChoice() if held is None else held).held() if estimate is None else estimate
        if target_pa is None:
            position, function = _cartesian(np.zeros(3), fixed=True, name="offset")
        elif choice.position != "geographic":
            position, function = _cartesian(target_pa.xyz_m, fixed=choice.position == "none")
        elif isinstance(choice.height_prior, TerrainPrior):
            position, function = _on_terrain(
                target_pa.xyz_m, choice.height_prior, arc.model.ephemeris.constants
            )
        else:
            position, function = _on_sphere(target_pa.xyz_m, choice.height_prior)
        parameters = list(position)
        nuisances = []
        for nuisance in NUISANCES:
            owned = owned_parameters(nuisance, choice, catalogue, arc)
            parameters += [parameter for _, parameter in owned]
            if owned:
                nuisances.append((nuisance, [owner for owner, _ in owned]))
        if estimate is not None and all(p.fixed for p in parameters):
            raise InputError(
                'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        middle_tai = middle_of(arc) if len(arc.transmitters) else None
        return cls(arc, ParameterSet(parameters), function, tuple(nuisances), middle_tai)

    def position_pa_m(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position at parameters x, principal axes, m."""
        return self.position(x[:3])[0]

    def position_partials(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """d(position)/d(parameters), shape (3, p)."""
        partials = np.zeros((3, len(self.parameters)))
        partials[:, :3] = self.position(x[:3])[1]
        return partials

    def linearize(self, x: NDArray[np.float64]) -> ArcLinearization:
        """Residuals of all observations and partials of those asked for, at parameters x."""
        lander_pa_m, by_parameters = self.position(x[:3])
        at = self.arc.at(lander_pa_m)
        residual_m = self.arc.observations.value_m - at.value_m
        here = ArcLinearization(self, at, by_parameters, residual_m)
        if x[3:].any():
            for start in range(0, len(residual_m), ROWS_AT_ONCE):
                rows = np.arange(start, min(start + ROWS_AT_ONCE, len(residual_m)))
                residual_m[rows] -= here.nuisance_columns(here.part(rows)) @ x[3:]
        residual_m.flags.writeable = False
        return here

    def residuals(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Observed minus computed (n,), m, and partials of the computed (n, p), all at once."""
        here = self.linearize(x)
        return here.residual_m, here.partials(np.arange(len(here.residual_m)))


@dataclass(frozen=True, slots=True, eq=False)
class ArcLinearization:
    """A problem linearized at one set of parameters.

    Parameters
    ----------
    problem : Problem
    at : Prediction
    by_parameters : ndarray, shape (3, 3)
        d(position)/d(position parameters).
    residual_m : ndarray, shape (n,)
        Observed - computed, m.
    """

    problem: Problem
    at: Prediction
    by_parameters: NDArray[np.float64]
    residual_m: NDArray[np.float64]

    def partials(self, rows: Rows) -> NDArray[np.float64]:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        part = self.part(rows)
        computed = part.computed
        assert computed is not None  # there is a position
        return np.hstack([computed.by_position_pa @ self.by_parameters, self.nuisance_columns(part)])

    def part(self, rows: Rows) -> ArcRows:
        """Some observations as the nuisance parameters see them."""
        return ArcRows(self.problem.arc, rows, self.at.rows, self.problem.middle_tai)

    def nuisance_columns(self, part: ArcRows) -> NDArray[np.float64]:
        """Partials of some observations by the nuisance parameters, shape (m, p - 3)."""
        columns = [nuisance.columns(part, owners) for nuisance, owners in self.problem.nuisances]
        return np.hstack([np.zeros((len(part), 0)), *columns])


def _on_sphere(
    start_pa_m: NDArray[np.float64], prior: HeightPrior | None
) -> tuple[list[Parameter], PositionFunction]:
    """East and north along the 1737.4 km sphere from the a-priori position, and the height above it.

    Longitude and latitude themselves would stop at the poles, where landers stand; in these coordinates the
    a-priori position is on the equator, wherever on the Moon it is, and the height is still a parameter.
    """
    longitude_rad = math.atan2(start_pa_m[1], start_pa_m[0])
    latitude_rad = math.atan2(start_pa_m[2], math.hypot(start_pa_m[0], start_pa_m[1]))
    height_m = float(np.linalg.norm(start_pa_m)) - MEAN_LUNAR_RADIUS_M
    to_pa = east_north_up(longitude_rad, latitude_rad).T
    height = (height_m, math.inf) if prior is None else (prior.height_m, prior.sigma_m)
    parameters = [
        Parameter("position.east", "m", "position", 0.0),
        Parameter("position.north", "m", "position", 0.0),
        Parameter("position.height", "m", "position", *height),
    ]

    def position(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        (cos_e, cos_n), (sin_e, sin_n) = (
            np.cos(x[:2] / MEAN_LUNAR_RADIUS_M),
            np.sin(x[:2] / MEAN_LUNAR_RADIUS_M),
        )
        radius_m = MEAN_LUNAR_RADIUS_M + x[2]
        up = np.array([sin_e * cos_n, sin_n, cos_e * cos_n])
        by_east = np.array([cos_e * cos_n, 0.0, -sin_e * cos_n])
        by_north = np.array([-sin_e * sin_n, cos_n, -cos_e * sin_n])
        ratio = radius_m / MEAN_LUNAR_RADIUS_M
        return radius_m * (to_pa @ up), to_pa @ np.stack([ratio * by_east, ratio * by_north, up], axis=-1)

    return parameters, position


def _cartesian(
    start_pa_m: NDArray[np.float64], *, fixed: bool, name: str = "position"
) -> tuple[list[Parameter], PositionFunction]:
    """x, y, z in principal axes."""
    parameters = [
        Parameter(f"{name}.{axis}", "m", "position", float(value), fixed=fixed)
        for axis, value in zip("xyz", start_pa_m, strict=True)
    ]
    return parameters, lambda x: (x, np.eye(3))


def _on_terrain(
    start_pa_m: NDArray[np.float64], prior: TerrainPrior, constants: EphemerisConstants
) -> tuple[list[Parameter], PositionFunction]:
    """East and north along the sphere, and the height above the terrain there.

    The prior on the height above the terrain follows the terrain with its slope wherever the estimate goes, and is
    still a prior on one parameter.
    """
    _, on_sphere = _on_sphere(start_pa_m, None)
    start_height_m = float(np.linalg.norm(start_pa_m)) - MEAN_LUNAR_RADIUS_M
    rot = rot_pa_to_me(constants)
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(rot @ start_pa_m)
    terrain_m = float(prior.terrain.height_m(longitude_rad, latitude_rad))
    sigma_m = float(prior.terrain.sigma_m(longitude_rad, latitude_rad, prior.sigma_m))
    parameters = [
        Parameter("position.east", "m", "position", 0.0),
        Parameter("position.north", "m", "position", 0.0),
        Parameter("position.height_above_terrain", "m", "position", 0.0, sigma_m),
    ]
    logger.info("terrain under the a-priori position: %.1f m, given height %.1f m", terrain_m, start_height_m)

    def position(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        below_pa_m, along = on_sphere(np.array([x[0], x[1], 0.0]))
        me_m, along_me = rot @ below_pa_m, rot @ along
        longitude, latitude, _ = cartesian_to_selenographic(me_m)
        height_m, by_longitude, by_latitude = (
            float(v) for v in prior.terrain.height_and_slope(longitude, latitude)
        )
        east, north, _ = east_north_up(longitude, latitude)
        radius_m = MEAN_LUNAR_RADIUS_M
        slope = by_longitude / (radius_m * math.cos(float(latitude))) * (east @ along_me[:, :2])
        slope = slope + by_latitude / radius_m * (north @ along_me[:, :2])
        pa_m, partials = on_sphere(np.array([x[0], x[1], height_m + x[2]]))
        partials[:, :2] += np.outer(partials[:, 2], slope)
        return pa_m, partials

    return parameters, position
