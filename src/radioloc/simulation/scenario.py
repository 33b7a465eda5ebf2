"""A scenario of tracking: where the point is, what is measured when, what is wrong with it, what is drawn by lot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from radioloc.lunar import cartesian_to_selenographic, east_north_up
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.simulation.departures import Departure, Spread, departed, position_departure_m
from radioloc.simulation.noise import NoiseModel
from radioloc.simulation.schedule import Plan, Schedule
from radioloc.simulation.simulate import Simulated, World
from radioloc.simulation.truth import Truth


@dataclass(frozen=True, slots=True)
class Scenario:
    """All that a simulation needs besides the nominal model.

    Parameters
    ----------
    schedule : Schedule
        What is measured and when.
    position : LunarPosition
        Where the point stands.
    truth : Truth
        In what the world departs from the nominal model.
    noise : NoiseModel
        Random errors.
    spread : Spread
        Departures that are drawn anew in every trial, about those of the truth.
    seed : int
        Not negative.
    name : str
        Name of the point in the observations.
    """

    schedule: Schedule
    position: LunarPosition
    truth: Truth = field(default_factory=Truth)
    noise: NoiseModel = field(default_factory=NoiseModel)
    spread: Spread = field(default_factory=Spread)
    seed: int = 0
    name: str = "lander"

    def world(
        self,
        model: PhysicalModel,
        departures: Mapping[Departure, float] | None = None,
        plan: Plan | None = None,
    ) -> World:
        """The simulated world; errors as :func:`~radioloc.simulation.simulate.simulate`.

        Parameters
        ----------
        model : PhysicalModel
            The nominal model.
        departures : mapping of Departure to float, optional
            Beyond those of the truth.
        plan : Plan, optional
            What is measured, where the schedule has been planned already.
        """
        departures = departures or {}
        truth = departed(self.truth, departures, self.spread.clock_epoch_utc)
        position = moved(self.position.to_axes("ME", model.ephemeris.constants), departures)
        return World.prepare(self.schedule, position, truth, model=model, name=self.name, plan=plan)

    def simulate(self, model: PhysicalModel, seed: int | None = None) -> Simulated:
        """Observations with one realization of the noise and no drawn departures; errors as :meth:`world`.

        Parameters
        ----------
        model : PhysicalModel
            The nominal model.
        seed : int, optional
            In place of the scenario's.
        """
        return self.world(model).draw(self.noise, seed=self.seed if seed is None else seed)


def moved(position_me: LunarPosition, departures: Mapping[Departure, float]) -> LunarPosition:
    """A position in mean-Earth axes with its departure to the east, to the north and up."""
    enu_m = position_departure_m(departures)
    if not enu_m.any():
        return position_me
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(position_me.xyz_m)
    axes = east_north_up(longitude_rad, latitude_rad)
    return LunarPosition(position_me.frame, position_me.xyz_m + enu_m @ axes)
