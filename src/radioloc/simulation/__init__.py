"""Simulated tracking: visibility, schedules, errors of the world relative to the model, and noise."""

from radioloc.simulation.noise import Noise, NoiseModel
from radioloc.simulation.schedule import (
    Plan,
    Schedule,
    Session,
    all_ranges,
    baselines,
    one_way,
    three_way,
    two_way,
)
from radioloc.simulation.simulate import Scenario, Simulated, World
from radioloc.simulation.truth import Truth, TruthSigma
from radioloc.simulation.visibility import Elevations, Masks, Window, elevations, windows

__all__ = [
    "Elevations",
    "Masks",
    "Noise",
    "NoiseModel",
    "Plan",
    "Scenario",
    "Schedule",
    "Session",
    "Simulated",
    "Truth",
    "TruthSigma",
    "Window",
    "World",
    "all_ranges",
    "baselines",
    "elevations",
    "one_way",
    "three_way",
    "two_way",
    "windows",
]
