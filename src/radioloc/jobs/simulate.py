"""The simulated tracking of a study: what it would have as observations, with one realization of the noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.preparation import model_of
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
        Of all that is drawn; the scenario's where not given.
    draw_errors : bool
        Draw the errors of ``truth_sigma`` too, as each trial of a Monte Carlo study does; else there are only those of
        ``truth``.

    Returns
    -------
    Simulated
        ``.observations`` to be fitted, and what was put into them.

    Raises
    ------
    RadiolocError
        The study has no simulation, or it cannot be.

    Examples
    --------
    >>> import radioloc
    >>> made = radioloc.simulate("examples/change5/simulation.toml", seed=1)
    >>> sorted(set(made.observations.types().tolist()))
    ['range', 'vlbi_delay']
    """
    study = as_study(study)
    scenario = scenario_of(study)
    if not draw_errors:  # partials of what is not drawn are hundreds of megabytes at 1 Hz
        scenario = replace(scenario, truth_sigma=TruthSigma())
    return scenario.world(model_of(study)).draw(seed=seed, draw_errors=draw_errors)


def scenario_of(study: Study) -> Scenario:
    """The study's scenario, which it must have."""
    if study.simulation is None:
        raise InputError(
            f"{study.name}: there is nothing to simulate; give the study file a [simulation] table "
            "(docs/reference/simulation.md), or in Python Study(simulation=Scenario(...))"
        )
    return study.simulation
