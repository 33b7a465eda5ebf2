"""What a solution leaves in a folder: ``solution.json``, ``residuals.csv``, plots, and a table of terms."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.estimation.solution import Solution
from radioloc.io.solution_files import write_json, write_residuals
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.studies.locate import arc_of
from radioloc.studies.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_report(solution: Solution, folder: str | Path) -> list[Path]:
    """Write a solution's files and plots.

    Parameters
    ----------
    solution : Solution
    folder : path-like
        Made where it does not exist; files of the same names are replaced.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        The folder cannot be made or written to, or the solution has no elevations.
    """
    written = write_numbers(solution, folder)
    return [*written, *_write_plots(solution, Path(folder))]


def write_numbers(solution: Solution, folder: str | Path) -> list[Path]:
    """Write ``solution.json`` and ``residuals.csv``.

    Parameters, result and errors as :func:`write_report`.
    """
    folder = made_folder(folder)
    rows = solution.residuals
    if rows.elevation_deg is None:
        raise InputError(
            "the solution has no elevations, which residuals.csv lists; give them to build_solution"
        )
    write_json(folder / "solution.json", solution.to_dict())
    write_residuals(
        folder / "residuals.csv",
        epoch=rows.epoch_utc,
        types=rows.types,
        paths=rows.paths,
        observed_m=rows.observed_m,
        computed_m=rows.computed_m,
        residual_m=rows.residual_m,
        sigma_m=rows.sigma_m,
        elevation_deg=rows.elevation_deg,
        status=rows.outcome,
    )
    return [folder / "solution.json", folder / "residuals.csv"]


def write_terms(study: Study | Predictor, solution: Solution, folder: str | Path) -> Path:
    """Write ``terms.csv``: for each observation, what each active term of the model adds to the computed value.

    Parameters
    ----------
    study : Study or Predictor
        The study of the solution, or its arc where it has been prepared already.
    solution : Solution
        Where the terms are evaluated.
    folder : path-like
        Made where it does not exist.

    Raises
    ------
    InputError
        The folder cannot be made or written to.
    """
    from radioloc.io.csv_file import batches_of, write_csv

    arc = arc_of(study)[0] if isinstance(study, Study) else study
    terms = arc.terms(solution.position_pa_m)
    path = made_folder(folder) / "terms.csv"
    rows = arc.observations
    types = Labels(rows.kind.astype(np.int32), KINDS)
    paths = Labels(rows.link, tuple(link.path for link in rows.links))
    columns = {"epoch_utc": rows.epoch, "type": types, "path": paths}
    named = {f"{name}_m": values for name, values in terms.items()}
    write_csv(path, batches_of(columns | named, dict.fromkeys(named, 6)))
    return path


def _write_plots(solution: Solution, folder: Path) -> list[Path]:
    from radioloc.report import plot_links, plot_position, plot_residuals

    rows = solution.residuals
    # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
    apart = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
    figures = {"residuals": plot_links(solution) if apart else plot_residuals(solution)}
    if solution.position_estimated and solution.position_determined:
        figures["position"] = plot_position(solution)
    return [path for name, figure in figures.items() for path in write_figure(figure, folder, name)]


def write_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    from radioloc.report import save_figure

    paths = [folder / f"{name}.{ending}" for ending in ("png", "svg")]
    try:
        save_figure(figure, paths)
    except OSError as error:
        raise InputError(f"{folder}: the plot of {name} cannot be written: {error.strerror}") from None
    return paths


def made_folder(folder: str | Path) -> Path:
    """The folder, made with those above it where it does not exist.

    Raises
    ------
    InputError
        It cannot be made.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: the output folder cannot be made: {error.strerror}") from None
    return folder
