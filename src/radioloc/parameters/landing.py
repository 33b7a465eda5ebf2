"""The parameters of an orbit that ends on the ground: the landing place, the velocity at the touchdown, the forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.lunar import cartesian_to_selenographic, east_north_up
from radioloc.measurements.lunar_motion import lunar_motion
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.orbit import orbit_parameters
from radioloc.parameters.parameter import Parameter
from radioloc.parameters.position import PositionFunction, PositionParameters
from radioloc.time import Epochs

if TYPE_CHECKING:
    from radioloc.dynamics import AdjustableOrbit

Floats = NDArray[np.float64]


class Ground:
    """States of points of the ground at a touchdown (TDB), relative to the Moon's centre, ICRF axes."""

    def __init__(self, model: PhysicalModel, epoch: Epochs) -> None:
        self._model = model
        self._moon = lunar_motion(model, epoch, model.ephemeris.earth(epoch), np.zeros(1))
        self.rot_pa_to_icrf = self._moon.rot_pa_to_icrf[0]
        self.by_place = np.vstack([self.rot_pa_to_icrf, self._moon.rot_pa_to_icrf_rate[0]])

    def at_rest(self, place_pa_m: Floats) -> Floats:
        """State of a place, m and m/s, shape (6,), with its tide and in the lengths of barycentric coordinates."""
        point, centre = self._moon.point(self._model, place_pa_m), self._moon.centre
        return np.concatenate(
            [(point.position_m - centre.position_m)[0], (point.velocity_m_s - centre.velocity_m_s)[0]]
        )

    def place_pa_m(self, state: Floats) -> Floats:
        """The place, principal axes, m, at which a state is."""
        place_pa_m = state[:3] @ self.rot_pa_to_icrf
        for _ in range(2):  # the tide and the lengths depend on the place by parts of 1e-7
            place_pa_m = place_pa_m + (state[:3] - self.at_rest(place_pa_m)[:3]) @ self.rot_pa_to_icrf
        return np.asarray(place_pa_m)


@dataclass(frozen=True, slots=True, eq=False)
class LandingParameters:
    """From the parameters of a landing to those of its orbit, whose epoch is the touchdown."""

    parameters: list[Parameter]  # three of the place, three of the velocity, those of the forces
    place: PositionFunction  # of the first three
    orbit: AdjustableOrbit
    ground: Ground
    axes: Floats  # east, north and up at the a-priori place in the ICRF, as columns

    def changes(self, x: Floats) -> tuple[Floats, Floats]:
        """Changes of the orbit's parameters, shape (q,), and their partials, shape (q, p)."""
        place_pa_m, by_x = self.place(x[:3])
        state = self.ground.at_rest(place_pa_m)
        state[3:] += self.axes @ x[3:6]
        apriori = np.array(list(self.orbit.values.values()))
        partials = np.eye(len(x))
        partials[:6, :3] = self.ground.by_place @ by_x
        partials[3:6, 3:6] = self.axes
        return np.concatenate([state, x[6:]]) - apriori, partials

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """The place in principal axes, m, and its partials by all parameters, shape (3, p)."""
        place_pa_m, by_x = self.place(x[:3])
        return place_pa_m, np.pad(by_x, ((0, 0), (0, len(x) - 3)))

    def values_of(self, orbit: AdjustableOrbit) -> Floats:
        """The parameters of an orbit that lands near the a-priori place."""
        values = np.array(list(orbit.values.values()))
        place_pa_m = self.ground.place_pa_m(values[:6])
        x = np.zeros(3)
        for _ in range(10):
            at_pa_m, by_x = self.place(x)
            x = x + np.linalg.solve(by_x, place_pa_m - at_pa_m)
        return np.concatenate(
            [x, (values[3:6] - self.ground.at_rest(place_pa_m)[3:]) @ self.axes, values[6:]]
        )


def landing_parameters(
    orbit: AdjustableOrbit,
    ground: Ground,
    place: PositionParameters,
    velocity_sigma_m_s: float,
    sigmas: Mapping[str, float],
) -> LandingParameters:
    """The parameters of an orbit whose epoch is its touchdown, with a-priori sigmas by name.

    The velocity relative to the ground is zero a priori. `place` are the parameters of a position.
    """
    of_place, position = place
    x = np.array([one.prior_value for one in of_place])
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(position(x)[0])
    velocity = [
        Parameter(
            f"touchdown_velocity.{axis}", "m/s", "touchdown_velocity", 0.0, velocity_sigma_m_s, scale=0.1
        )
        for axis in ("east", "north", "up")
    ]
    forces = [one for one in orbit_parameters(orbit, sigmas, estimated=True)[0] if one.kind == "force"]
    axes = ground.rot_pa_to_icrf @ east_north_up(float(longitude_rad), float(latitude_rad)).T
    return LandingParameters([*of_place, *velocity, *forces], position, orbit, ground, axes)
