"""Simulated tracking: what can be seen, what is measured when, how the world departs from the model, noise."""

from radioloc.lunar.visibility import hidden_by_moon
from radioloc.simulation.departures import Departure, Spread, departed
from radioloc.simulation.noise import Noise, NoiseModel
from radioloc.simulation.scenario import Scenario
from radioloc.simulation.schedule import (
    Plan,
    Schedule,
    Session,
    all_ranges,
    baselines,
    three_way,
    two_way,
)
from radioloc.simulation.simulate import Simulated, World, simulate
from radioloc.simulation.truth import Clock, Truth
from radioloc.simulation.visibility import Elevations, Masks, Window, elevations, windows

__all__ = [
    "Clock",
    "Departure",
    "Elevations",
    "Masks",
    "Noise",
    "NoiseModel",
    "Plan",
    "Scenario",
    "Schedule",
    "Session",
    "Simulated",
    "Spread",
    "Truth",
    "Window",
    "World",
    "all_ranges",
    "baselines",
    "departed",
    "elevations",
    "hidden_by_moon",
    "simulate",
    "three_way",
    "two_way",
    "windows",
]
