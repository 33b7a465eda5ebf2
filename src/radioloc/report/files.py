"""The files of an output folder: of a solution, of an arc-length study, of trials, of a plan."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.report.arc_study import ArcStudy
from radioloc.report.comparison import Comparison, plot_comparison
from radioloc.report.covariance import CovarianceStudy, plot_covariance
from radioloc.report.figures import save_figure
from radioloc.report.image_figures import plot_images
from radioloc.report.image_solution import ImageSolution
from radioloc.report.monte_carlo import MonteCarlo
from radioloc.report.parameter_figures import can_be_drawn, plot_contours, plot_correlations
from radioloc.report.position_figures import plot_error_by_length, plot_position, plot_trial_scatter
from radioloc.report.residual_figures import plot_links, plot_residuals
from radioloc.text_files import disk_failed, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DECIMALS = {"observed_m": 7, "computed_m": 7, "residual_m": 6, "sigma_m": 6, "elevation_deg": 4}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_DECIMALS, "status")
"""Columns of ``residuals.csv``, in order."""

INCOMPLETE = "INCOMPLETE"
"""File of a folder whose other files may be of different results, as it was not written to the end."""
_NUMBERS = ("solution.json", "residuals.csv")
_FIGURES = ("residuals", "position", "correlations", "contours")
_OF_A_SOLUTION = (*_NUMBERS, "terms.csv", *(f"{name}.[ps][nv]g" for name in _FIGURES))
_OF_ARCS = (
    "arcs.json",
    "table1.csv",
    "table1.md",
    "figure2.[ps][nv]g",
    *(f"[0-9]*h/{name}" for name in _NUMBERS),
)
OF_A_MONTE_CARLO = ("montecarlo.json", "trials.csv", "trials.[ps][nv]g", "error_by_length.[ps][nv]g")
_OF_IMAGES = ("solution.json", "images.[ps][nv]g")
_OF_A_COMPARISON = ("comparison.json", "table1.csv", "table1.md", "comparison.[ps][nv]g")
_OF_A_COVARIANCE = ("covariance.json", "covariance.csv", "covariance.[ps][nv]g")
"""Files of an output folder, by name or pattern."""


def write_report(solution: Solution, folder: str | Path, terms_by: Predictor | None = None) -> list[Path]:
    """Write a solution's files and plots.

    Parameters
    ----------
    solution : Solution
    folder : path-like
        Made where it does not exist. Its files are of one result: those of the same names are replaced, others of an
        earlier solution are removed, and until all are written there is one called ``INCOMPLETE``.
    terms_by : Predictor, optional
        That of the solution's study, to write ``terms.csv`` as well (:func:`write_terms`).

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        The folder cannot be made or written to, or the solution has no elevations.
    OSError
        The disk is full or fails.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [path.name for path in radioloc.write_report(solution, "out")][:2]
    ['solution.json', 'residuals.csv']
    """
    with _one_result(folder, _OF_A_SOLUTION) as written:
        written += write_numbers(solution, folder)
        rows = solution.residuals
        # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
        apart = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
        written += write_figure(
            plot_links(solution) if apart else plot_residuals(solution), Path(folder), "residuals"
        )
        if solution.position_estimated and solution.position_determined:
            written += write_figure(plot_position(solution), Path(folder), "position")
        correlations, contours = can_be_drawn(solution)
        if correlations:
            written += write_figure(plot_correlations(solution), Path(folder), "correlations")
        if contours:
            written += write_figure(plot_contours(solution), Path(folder), "contours")
        if terms_by is not None:
            written.append(write_terms(terms_by, solution, folder))
    return written


@contextmanager
def _one_result(folder: str | Path, names: tuple[str, ...]) -> Iterator[list[Path]]:
    """A list for what is written to a folder; other files of such names, of an earlier result, are removed at the end.

    Until then a file says that the folder is not complete, so it does where the program was stopped.
    """
    folder = made_folder(folder)
    marker = folder / INCOMPLETE
    write_text(
        marker, "radioloc has not finished writing here: files may be of different results. Run it again.\n"
    )
    written: list[Path] = []
    yield written
    remove_files(folder, names, written)
    marker.unlink()


def remove_files(folder: Path, names: tuple[str, ...], but: Collection[Path] = ()) -> None:
    """Remove files of a folder by name or pattern."""
    for name in names:
        for path in folder.glob(name):
            if path.is_file() and path not in but:
                path.unlink()


def write_numbers(solution: Solution, folder: str | Path) -> list[Path]:
    """Write ``solution.json`` and ``residuals.csv``."""
    folder = made_folder(folder)
    numbers, table = folder / "solution.json", folder / "residuals.csv"
    write_residuals(table, solution.residuals)
    write_json(numbers, solution.to_dict())
    return [numbers, table]


def write_residuals(path: Path, rows: Residuals) -> None:
    """Write residuals, one row for each observation in the order given, columns :data:`RESIDUAL_COLUMNS`."""
    from radioloc.io.csv_file import batches_of, write_csv

    if rows.elevation_deg is None:
        raise InputError(
            "the solution has no elevations, which residuals.csv lists; give them to build_solution"
        )
    columns: dict[str, Any] = {"epoch_utc": rows.epoch_utc, "type": rows.types, "path": rows.paths}
    columns |= {name: getattr(rows, name) for name in _DECIMALS} | {"status": rows.statuses}
    for name, column in columns.items():
        if name in _DECIMALS and not np.isfinite(column).all():
            bad = int(np.argmin(np.isfinite(column)))
            raise InputError(f"{name} of observation {bad + 1} is {column[bad]}; residuals must be finite")
    write_csv(path, batches_of(columns, _DECIMALS))


def write_terms(predictor: Predictor, solution: Solution, folder: str | Path) -> Path:
    """Write ``terms.csv``: for each observation, what each active term of the model adds to the computed value.

    Parameters
    ----------
    predictor : Predictor
        That of the solution's study, as :func:`~radioloc.studies.locate.arc_of` prepares it.
    solution : Solution
        Where the terms are evaluated.
    folder : path-like
        As of :func:`write_report`, errors too.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> predictor, _ = radioloc.studies.arc_of(study)
    >>> radioloc.report.write_terms(predictor, radioloc.residuals(study), "out").name
    'terms.csv'
    """
    from radioloc.io.csv_file import batches_of, write_csv

    terms = predictor.terms(solution.position_pa_m)
    path = made_folder(folder) / "terms.csv"
    rows = predictor.observations
    types = Labels(rows.kind.astype(np.int32), tuple(KINDS))
    paths = Labels(rows.link, tuple(link.path for link in rows.links))
    columns = {"epoch_utc": rows.epoch, "type": types, "path": paths}
    named = {f"{name}_m": values for name, values in terms.items()}
    write_csv(path, batches_of(columns | named, dict.fromkeys(named, 6)))
    return path


def write_arcs(study: ArcStudy, folder: str | Path) -> list[Path]:
    """Write ``arcs.json``, ``table1.csv``, ``table1.md``, ``figure2.png``, ``figure2.svg`` and a folder for each arc.

    Table and figure are what table 1 and figure 2 of Wang et al. (2021) show. Each arc's folder, such as ``12h``, has
    its ``solution.json`` and ``residuals.csv``. Parameters and errors are as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.arcs(radioloc.read_study("examples/change5/change5.toml"), hours=[12.0])
    >>> sorted(path.suffix for path in radioloc.report.write_arcs(found, "out") if path.parent.name == "out")
    ['.csv', '.json', '.md', '.png', '.svg']
    """
    folder = Path(folder)
    with _one_result(folder, _OF_ARCS) as written:
        written += [folder / name for name in ("table1.csv", "table1.md", "arcs.json")]
        write_text(written[0], study.to_csv())
        write_text(written[1], study.to_markdown())
        write_json(written[2], study.to_dict())
        for arc in study.arcs:
            written += write_numbers(arc.solution, folder / f"{arc.hours:g}h")
        written += write_figure(plot_links(study.longest), folder, "figure2")
    return written


def write_monte_carlo(study: MonteCarlo, folder: str | Path) -> list[Path]:
    """Write ``montecarlo.json``, ``trials.csv``, ``trials.png``, ``trials.svg``, ``error_by_length.png`` and ``.svg``.

    There are no figures where no trial has converged, and more than twelve arcs are an error, as they do not fit on a
    page. All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/change5/simulation.toml")
    >>> found = radioloc.monte_carlo(study, trials=20, hours=12.0)
    >>> [path.name for path in radioloc.report.write_monte_carlo(found, "out")][:2]
    ['montecarlo.json', 'trials.csv']
    """
    from radioloc.io.csv_file import batches_of, write_csv

    folder = Path(folder)
    with _one_result(folder, OF_A_MONTE_CARLO) as written:
        written += [folder / "montecarlo.json", folder / "trials.csv"]
        write_json(written[0], study.to_dict())
        write_csv(written[1], batches_of(study.columns_of_trials()))
        if (study["converged"] == 1.0).any():
            written += write_figure(plot_trial_scatter(study), folder, "trials")
            written += write_figure(plot_error_by_length(study), folder, "error_by_length")
    return written


def write_covariance(study: CovarianceStudy, folder: str | Path) -> list[Path]:
    """Write ``covariance.json``, ``covariance.csv``, ``covariance.png`` and ``covariance.svg``.

    There are no figures where the position is not determined. All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.covariance(radioloc.read_study("examples/change5/short_arc.toml"))
    >>> [path.name for path in radioloc.report.write_covariance(found, "out")][:2]
    ['covariance.json', 'covariance.csv']
    """
    folder = Path(folder)
    with _one_result(folder, _OF_A_COVARIANCE) as written:
        written += [folder / "covariance.json", folder / "covariance.csv"]
        write_json(written[0], study.to_dict())
        write_text(written[1], study.to_csv())
        if study.determined:
            written += write_figure(plot_covariance(study), folder, "covariance")
    return written


def write_images(solution: ImageSolution, folder: str | Path) -> list[Path]:
    """Write ``solution.json``, ``images.png`` and ``images.svg``; all else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate_images(radioloc.studies.read_image_study("examples/images/descent.toml"))
    >>> [path.name for path in radioloc.report.write_images(solution, "out")]
    ['solution.json', 'images.png', 'images.svg']
    """
    folder = Path(folder)
    with _one_result(folder, _OF_IMAGES) as written:
        written.append(folder / "solution.json")
        write_json(written[0], solution.to_dict())
        written += write_figure(plot_images(solution), folder, "images")
    return written


def write_comparison(found: Comparison, folder: str | Path) -> list[Path]:
    """Write ``comparison.json``, ``table1.csv``, ``table1.md``, ``comparison.png`` and ``comparison.svg``.

    All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> found = radioloc.studies.compare(radioloc.write_report(solution, "out")[:1])
    >>> [path.name for path in radioloc.report.write_comparison(found, "compared")][:2]
    ['table1.csv', 'table1.md']
    """
    folder = Path(folder)
    with _one_result(folder, _OF_A_COMPARISON) as written:
        written += [folder / name for name in ("table1.csv", "table1.md", "comparison.json")]
        write_text(written[0], found.to_csv())
        write_text(written[1], found.to_markdown())
        write_json(written[2], found.to_dict())
        written += write_figure(plot_comparison(found), folder, "comparison")
    return written


def write_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG."""
    paths = [folder / f"{name}.{ending}" for ending in ("png", "svg")]
    save_figure(figure, paths)
    return paths


def made_folder(folder: str | Path) -> Path:
    """The folder, made with those above it where it does not exist."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if disk_failed(error):
            raise
        raise InputError(f"{folder}: the output folder cannot be made: {error.strerror}") from None
    return folder


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a dictionary as JSON that any other program reads: numpy values as lists and numbers, never NaN."""
    write_text(path, json.dumps(_plain(content, ""), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _plain(value: Any, where: str) -> Any:
    """Value in the types that JSON has."""
    match value:
        case Mapping():
            return {
                str(key): _plain(item, f"{where}.{key}" if where else str(key)) for key, item in value.items()
            }
        case np.ndarray() | np.generic():
            return _plain(value.tolist(), where)
        case list() | tuple():
            return [_plain(item, f"{where}[{place}]") for place, item in enumerate(value)]
        case float() if not math.isfinite(value):
            raise InputError(f"{where} is {value}, which JSON cannot hold; leave it out or give None")
        case Path():
            return str(value)
        case None | bool() | int() | float() | str():
            return value
    raise InputError(
        f"{where} is a {type(value).__name__}, which JSON cannot hold; give numbers, text or lists"
    )
