"""What a Monte Carlo study leaves in a folder: ``montecarlo.json``, ``trials.csv`` and figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radioloc.io.solution_files import write_json
from radioloc.studies.monte_carlo import MonteCarlo
from radioloc.studies.report import made_folder, write_figure


def write_monte_carlo(study: MonteCarlo, folder: str | Path) -> list[Path]:
    """Write ``montecarlo.json``, ``trials.csv``, ``trials.png``, ``trials.svg``, ``error_by_length.png`` and ``.svg``.

    Parameters
    ----------
    study : MonteCarlo
    folder : path-like
        Made where it does not exist; files of the same names are replaced.

    Returns
    -------
    list of Path
        What was written; no figures where no trial has converged.

    Raises
    ------
    InputError
        The folder cannot be made or written to, or there are more arcs than panels fit on a page.
    """
    from radioloc.report.position_figures import plot_error_by_length, plot_trial_scatter

    folder = made_folder(folder)
    numbers, table = folder / "montecarlo.json", folder / "trials.csv"
    write_json(numbers, study.to_dict())
    _write_trials(study, table)
    written = [numbers, table]
    good = study["converged"] == 1.0
    shown = [k for k in range(len(study.hours)) if good[:, k].any()]
    if not shown:
        return written
    axes = ("east", "north", "up")
    error_m = np.stack([study[f"{axis}_m"] for axis in axes], axis=-1)
    sigma_m = np.stack([study[f"sigma_{axis}_m"] for axis in axes], axis=-1)
    errors = [error_m[good[:, k], k] for k in shown]
    sigmas = [sigma_m[good[:, k], k] for k in shown]
    hours = [study.hours[k] for k in shown]
    claimed = []
    for k in shown:
        east_m, north_m = np.median(sigma_m[good[:, k], k, :2], axis=0)
        across_m2 = float(np.median(study["correlation_east_north"][good[:, k], k])) * east_m * north_m
        claimed.append(np.array([[east_m**2, across_m2], [across_m2, north_m**2]]))
    title = f"{study.name}: {study.trials} trials"
    scatter = plot_trial_scatter([f"{h:g} h" for h in hours], [e[:, :2] for e in errors], claimed, title)
    written += write_figure(scatter, folder, "trials")
    return written + write_figure(
        plot_error_by_length(hours, errors, sigmas, title), folder, "error_by_length"
    )


def _write_trials(study: MonteCarlo, path: Path) -> None:
    """One row for each trial and arc, numbers to the last bit; what is not a number is left empty."""
    import pyarrow

    from radioloc.io.csv_file import write_csv

    arcs = len(study.hours)
    columns = {"trial": np.repeat(np.arange(study.trials), arcs), "hours": np.tile(study.hours, study.trials)}
    columns |= dict(zip(study.columns, study.values.reshape(-1, len(study.columns)).T, strict=True))
    arrays = {name: pyarrow.array(column, from_pandas=True) for name, column in columns.items()}
    write_csv(path, [pyarrow.record_batch(arrays)])
