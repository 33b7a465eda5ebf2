"""Simulated observations of a study, with one realization of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.preparation import model_of
from radioloc.measurements.observations import Observations
from radioloc.simulation import Scenario, Simulated, TruthSigma
from radioloc.study.study import Study
from radioloc.study.study_file import as_study


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedTargets:
    """Simulated observations of several targets."""

    targets: Mapping[str, Simulated]  # by the names of the targets

    @property
    def observations(self) -> Observations:
        """Observations of all targets in the order of time."""
        observations = Observations.concatenate([part.observations for part in self.targets.values()])
        epoch = observations.epoch
        return observations.select(np.lexsort((epoch.fraction, epoch.jd)))

    def __repr__(self) -> str:
        return f"<SimulatedTargets {', '.join(map(repr, self.targets.values()))}>"

    def summary(self) -> str:
        """Return a text about the observations and their errors, target by target."""
        return "\n".join(f"target {name}: {part.summary()}" for name, part in self.targets.items())


@on_one_blas_thread()
def simulate(
    study: Study | str | Path, seed: int | None = None, *, draw_errors: bool = False
) -> Simulated | SimulatedTargets:
    """Simulate the tracking that a study describes.

    Parameters
    ----------
    study : Study or path-like
        With a simulation; its model is the nominal one.
    seed : int, optional
        Seed of all random numbers; that of the scenario by default.
    draw_errors : bool
        Whether to draw the errors of ``truth_sigma``, as each trial of a Monte Carlo study does, besides the fixed
        errors of ``truth``.

    Returns
    -------
    Simulated or SimulatedTargets
        ``.observations`` to be fitted, and the true values. Of several targets each has its own record; errors of
        stations, and noise of their arrival times, are the same in all.

    Raises
    ------
    RadiolocError
        The study has no simulation, or an invalid one.

    Examples
    --------
    >>> import radioloc
    >>> made = radioloc.simulate("examples/change5/simulation.toml", seed=1)
    >>> sorted(set(made.observations.types().tolist()))
    ['range', 'vlbi_delay']
    """
    study = as_study(study)
    model = model_of(study)

    def drawn(scenario: Scenario) -> Simulated:
        if not draw_errors:  # partials by undrawn errors take hundreds of megabytes at 1 Hz
            scenario = replace(scenario, truth_sigma=TruthSigma())
        return scenario.world(model).draw(seed=seed, draw_errors=draw_errors)

    if study.simulations:
        return SimulatedTargets({name: drawn(scenario) for name, scenario in study.simulations.items()})
    return drawn(scenario_of(study))


def scenario_of(study: Study) -> Scenario:
    """Return the scenario of a study of one target; a study without one is an error."""
    if study.simulations:
        raise InputError(
            f"{study.name}: expected a simulation of one target, got {', '.join(study.simulations)}; "
            "`radioloc simulate` makes their observations, which the other commands take as files"
        )
    if study.simulation is None:
        raise InputError(
            f"{study.name}: expected a study with a simulation, got none; give the study file a [simulation] table "
            "(docs/reference/simulation.md), or in Python Study(simulation=Scenario(...))"
        )
    return study.simulation
