"""Simulated observations of a study, and its targets at the positions and on the orbits of its simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.preparation import build_model
from radioloc.jobs.problem import considered_parameters
from radioloc.measurements.link import canonical_target
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.target_motion import TargetMotion
from radioloc.simulation import Scenario, Simulated, TruthSigma
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.targets.target import declared_motion


@on_one_blas_thread()
def simulate(study: Study | str | Path, seed: int | None = None, *, draw_errors: bool = False) -> Simulated:
    """Simulate the tracking that a study describes.

    Parameters
    ----------
    study : Study or path-like
        Study with a simulation.
    seed : int, optional
        Seed of the random numbers; that of the simulation by default.
    draw_errors : bool
        Whether to draw the errors of ``truth_sigma`` and those that the fit considers, as each trial of a Monte Carlo
        study does, besides the fixed errors of ``truth``.

    Returns
    -------
    Simulated
        ``.observations`` to be fitted, and the true values.

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
    scenario = build_scenario(study)
    considered = partial(considered_parameters, study)
    if not draw_errors:  # partials with respect to undrawn errors take hundreds of megabytes at 1 Hz
        scenario = replace(scenario, truth_sigma=TruthSigma(considered=False))
    return scenario.world(build_model(study), considered).draw(seed=seed, draw_errors=draw_errors)


def build_scenario(study: Study) -> Scenario:
    """Return the scenario of a study; a study without one is an error."""
    if study.simulation is None:
        raise InputError(
            f"{study.name}: expected a study with a simulation, got none; give the study file a [simulation] table "
            "(docs/reference/simulation.md), or in Python Study(simulation=Scenario(...))"
        )
    return study.simulation


def names_in_scenario(study: Study, scenario: Scenario) -> dict[str, str]:
    """Return the names of the study's targets in the observations of a scenario."""
    if len(scenario.targets) == 1:
        return dict(zip(study.all_targets, scenario.targets, strict=True))
    names = {canonical_target(name): name for name in scenario.targets}
    return {name: names[name] for name in study.all_targets}


def with_true_positions(study: Study, scenario: Scenario) -> Study:
    """Return the study with its targets at their true positions and states; forces are those of the fit."""
    targets = dict(study.all_targets)
    for name, simulated in names_in_scenario(study, scenario).items():
        record = scenario.targets[simulated]
        if name in study.orbiters:
            targets[name] = study.orbiters[name].with_state(record.state)  # type: ignore[union-attr]
        elif name not in study.trajectories:
            targets[name] = record  # type: ignore[assignment]
    places = {"target": None, "targets": targets} if study.targets else {"target": targets[""]}
    return replace(study, reference=None, references=(), **places)


def planned_orbits(study: Study, scenario: Scenario, model: PhysicalModel) -> dict[str, AdjustableOrbit]:
    """Return the orbits of a study's targets over the sessions of a scenario, with partials for all parameters."""
    choice = study.estimate.orbit
    return {
        name: scenario.orbit(model, orbiter, choice.parameters(orbiter.forces))
        for name, orbiter in study.orbiters.items()
        if choice is not None
    }


def antenna_targets(
    study: Study, scenario: Scenario, model: PhysicalModel, orbits: Mapping[str, AdjustableOrbit]
) -> dict[str, TargetMotion]:
    """Return the points that antennas track, by the names of targets in the observations."""
    targets = dict[str, TargetMotion]()
    for name, simulated in names_in_scenario(study, scenario).items():
        record = orbits[name].nearest() if name in orbits else study.all_targets[name]
        targets[simulated] = declared_motion(record, model)  # type: ignore[arg-type]
    return targets
