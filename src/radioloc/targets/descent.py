"""A target that lands: an orbit whose parameters are the place and the velocity at the touchdown, not a state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit
from radioloc.estimation.status import Doubt
from radioloc.lunar import cartesian_to_selenographic, east_north_up
from radioloc.measurements.lunar_motion import lunar_motion
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.parameter import Parameter, Role
from radioloc.targets.doubts import FittedObservations, cut_off_doubts, height_doubts
from radioloc.targets.orbit import GravityErrors, OnOrbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.targets.surface_point import PositionFunction
from radioloc.targets.target import AtPlace, solve_parameters
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices

_BEFORE_S = 1.0  # end of the states before the touchdown, where the orbit still has a plane


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
        """Return the position of a state in principal axes, m."""
        place_pa_m = state[:3] @ self.rot_pa_to_icrf
        for _ in range(2):  # the tide and the lengths depend on the place by parts of 1e-7
            place_pa_m = place_pa_m + (state[:3] - self.at_rest(place_pa_m)[:3]) @ self.rot_pa_to_icrf
        return np.asarray(place_pa_m)


@dataclass(frozen=True, slots=True, eq=False)
class Descent(AtPlace, OnOrbit):
    """A spacecraft that comes to rest on the Moon; the epoch of its orbit is the touchdown."""

    name: str
    parameters: list[Parameter]  #: three of the place, three of the velocity, those of the forces
    place: PositionFunction  #: of the parameters `place_columns`
    orbit: AdjustableOrbit  #: a priori
    ground: Ground
    axes: Floats  #: east, north and up at the a-priori place in the ICRF, as columns
    errors: GravityErrors
    body: int  #: NAIF code of the spacecraft in kernels
    epoch: Epochs  #: TDB, of the state that is reported, before the touchdown
    process_noise: None = None  #: its axes vanish with the velocity at the touchdown
    place_columns: Indices = field(default_factory=lambda: np.arange(3))  #: its own are the last three
    preceding: int = 0  #: those of other targets, whose places share errors of a map with its own

    def doubts(self, x: Floats, fitted: FittedObservations) -> Iterator[Doubt]:
        """Doubt a descent as an orbit, or one that ends off the Moon's surface."""
        yield from cut_off_doubts(fitted)
        yield from height_doubts(float(np.linalg.norm(self.position(x)[0])) - MEAN_LUNAR_RADIUS_M)

    def estimate(
        self, x: Floats, covariance: Floats, sensitivity: Floats, errors: AdjustableOrbit | None
    ) -> OrbitState:
        """Return the state at the epoch before the touchdown, with its covariance until there."""
        _, by_x = self.changes(x)
        landed = self.orbit_at(x)
        # A part of the data may begin after the epoch of the state.
        first_s = float(self.epoch.seconds_since(landed.epoch)[0])
        landed = replace(landed, span_s=(min(landed.span_s[0], first_s), landed.span_s[1]))
        landed.require_above_ground()
        moved_at_touchdown = by_x @ sensitivity
        independent = by_x @ covariance @ by_x.T - moved_at_touchdown @ moved_at_touchdown.T
        to_epoch = np.vstack([landed.partials(self.epoch)[0], np.eye(len(independent))[6:]])
        flight = landed.with_epoch(self.epoch)
        until_s = float(landed.epoch.seconds_since(self.epoch)[0]) - _BEFORE_S
        flight = replace(flight, span_s=(flight.span_s[0], until_s))
        moved, disturbed = to_epoch @ moved_at_touchdown, None
        if errors is not None and moved.size:
            moved[:6] -= errors.effects(self.epoch)[0]
            disturbed = self.errors.draw(flight)
        return OrbitState(
            flight, to_epoch @ independent @ to_epoch.T + moved @ moved.T, moved, disturbed, self.body
        )

    def changes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return changes of the orbit's parameters, shape (q,), and their partials, shape (q, p)."""
        place_pa_m, by_x = self.position(x)
        state, velocity = self.ground.at_rest(place_pa_m), slice(self.preceding + 3, self.preceding + 6)
        state[3:] += self.axes @ x[velocity]
        apriori = np.array(list(self.orbit.values.values()))
        partials = np.eye(len(apriori), len(x), self.preceding)
        partials[:6] = self.ground.by_place @ by_x
        partials[3:6, velocity] = self.axes
        return np.concatenate([state, x[velocity.stop :]]) - apriori, partials

    def position(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the place in principal axes, m, and its partials with respect to all parameters, shape (3, p)."""
        place_pa_m, by_place = self.place(x[self.place_columns])
        by_x = np.zeros((3, len(x)))
        by_x[:, self.place_columns] = by_place
        return place_pa_m, by_x

    def solved(self, target_values: Floats, x: Floats) -> Floats:
        """Return x with its own parameters for target values of the orbit's parameters."""
        place_pa_m, end = self.ground.place_pa_m(target_values[:6]), self.preceding + 3

        def place(place_x: Floats) -> tuple[Floats, Floats]:
            position_pa_m, by_x = self.position(np.concatenate([x[: end - 3], place_x, x[end:]]))
            return position_pa_m, by_x[:, end - 3 : end]

        place_x = solve_parameters(place, place_pa_m, x[end - 3 : end])
        velocity = (target_values[3:6] - self.ground.at_rest(place_pa_m)[3:]) @ self.axes
        return np.concatenate([x[: end - 3], place_x, velocity, target_values[6:]])

    def held(self) -> Descent:
        """Return the target with all parameters held at those of its orbit."""
        apriori = np.array(list(self.orbit.values.values()))
        values = self.solved(apriori, np.array([item.prior_value for item in self.parameters])).tolist()
        fixed = [
            replace(item, prior_value=value, role=Role.FIXED)
            for item, value in zip(self.parameters, values, strict=True)
        ]
        return replace(self, parameters=fixed)


def touchdown_parameters(
    ground: Ground, place_pa_m: Floats, forces: list[Parameter], velocity_sigma_m_s: float
) -> tuple[list[Parameter], Floats]:
    """Return the parameters of the velocity at a touchdown, 0 a priori, and of forces, and the velocity's axes."""
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(place_pa_m)
    velocity = [
        Parameter(
            f"touchdown_velocity.{axis}", "m/s", "touchdown_velocity", 0.0, velocity_sigma_m_s, scale=0.1
        )
        for axis in ("east", "north", "up")
    ]
    axes = ground.rot_pa_to_icrf @ east_north_up(float(longitude_rad), float(latitude_rad)).T
    return [*velocity, *forces], axes
