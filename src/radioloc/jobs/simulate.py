"""Simulated observations of a study, with one realization of the noise."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.preparation import model_of
from radioloc.jobs.problem import considered_errors
from radioloc.simulation import Scenario, Simulated, TruthSigma
from radioloc.study.study import Study
from radioloc.study.study_file import as_study


@on_one_blas_thread()
def simulate(study: Study | str | Path, seed: int | None = None, *, draw_errors: bool = False) -> Simulated:
    """Simulate the tracking that a study describes.

    Parameters
    ----------
    study : Study or path-like
        With a simulation; its model is the nominal one.
    seed : int, optional
        Seed of all random numbers; that of the scenario by default.
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
    scenario = scenario_of(study)
    considered = partial(considered_errors, study)
    if not draw_errors:  # partials by undrawn errors take hundreds of megabytes at 1 Hz
        scenario = replace(scenario, truth_sigma=TruthSigma(considered=False))
    return scenario.world(model_of(study), considered).draw(seed=seed, draw_errors=draw_errors)


def scenario_of(study: Study) -> Scenario:
    """Return the scenario of a study; a study without one is an error."""
    if study.simulation is None:
        raise InputError(
            f"{study.name}: expected a study with a simulation, got none; give the study file a [simulation] table "
            "(docs/reference/simulation.md), or in Python Study(simulation=Scenario(...))"
        )
    return study.simulation
