"""The files of an output folder: of a solution, of an arc-length study, of trials, of a plan."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.orbit_state import OrbitState
from radioloc.estimation.statistics import Residuals
from radioloc.io.table import batches_of, write_csv
from radioloc.labels import Labels
from radioloc.lunar import TerrainModel
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.report.ccsds import write_orbit_oem, write_orbit_opm
from radioloc.report.figures import save_figure
from radioloc.report.map_figures import plot_map
from radioloc.report.page import PAGE, Result, figures_of, write_page
from radioloc.report.residual_figures import plot_terms
from radioloc.report.spice_kernels import write_orbit_spk
from radioloc.results.comparison import Comparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.image_solution import ImageSolution, PointSolution
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy, LeaveOneOut
from radioloc.text_files import TEMPORARY_FILES, disk_failed, locked, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DECIMALS = {"observed_m": 7, "computed_m": 7, "residual_m": 6, "sigma_m": 6, "elevation_deg": 4}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_DECIMALS, "status", "residual_mm_s")
"""Columns of ``residuals.csv``, in order; the last only where something is counted."""

INCOMPLETE = "INCOMPLETE"
"""File of a folder whose other files may be of different results, as it was not written to the end."""
OF_A_MONTE_CARLO = ("montecarlo.json", "trials.csv", "trials.[ps][nv]g", "error_by_length.[ps][nv]g", PAGE)
"""Files of a Monte Carlo study, by name or pattern."""


ORBIT_FILES = ("orbit.bsp", "orbit.oem", "orbit.opm")
"""Names of the files of an orbit that was determined."""

# Results that share names of files replace each other whole; others can stand in one folder.
_SOLUTION_FILES = (
    *("solution.json", "residuals.csv", "terms.csv", *ORBIT_FILES),
    *(f"{name}.[ps][nv]g" for name in ("residuals", "position", "correlations", "distribution", "budget")),
    *(f"{name}.[ps][nv]g" for name in ("terms", "map", "images")),
)
_TABLE_FILES = (
    *("table1.csv", "table1.md", "table1.tex", "arcs.json", "comparison.json"),
    *(f"{name}.[ps][nv]g" for name in ("figure2", "arcs", "comparison")),
    *("[0-9]*h/solution.json", "[0-9]*h/residuals.csv", "arcs_[0-9]*.[ps][nv]g"),
)


def write_report(
    solution: Solution,
    folder: str | Path,
    terms_by: Predictor | None = None,
    *,
    html: bool = False,
    dem: TerrainModel | None = None,
) -> list[Path]:
    """Write a solution's files and plots.

    Parameters
    ----------
    solution : Solution
    folder : path-like
        Made where it does not exist. Its files are of one result: those of the same names are replaced, others of an
        earlier solution are removed, and until all are written there is one called ``INCOMPLETE``.
    terms_by : Predictor, optional
        That of the solution's study, to write ``terms.csv`` (:func:`write_terms`) and its figure as well.
    html : bool
        Write ``report.html`` as well (:func:`write_html`).
    dem : TerrainModel, optional
        To draw the position on, as ``map.png`` and in the page, where its cells are no larger than three sigmas.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        The folder cannot be made or written to, the solution has no elevations, or the extra ``report`` is not
        installed and a page is wanted.
    OSError
        The disk is full or fails.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [path.name for path in radioloc.write_report(solution, "out")][:2]
    ['solution.json', 'residuals.csv']
    """
    contents: dict[str, _Content] = _numbers(solution)
    more: dict[str, Callable[[], Figure]] = {}
    if terms_by is not None:
        terms, observations = terms_by.terms(solution.position_pa_m), terms_by.observations
        contents["terms.csv"] = partial(_write_terms, terms, observations)
        more["terms"] = partial(plot_terms, terms, observations)
    if solution.state is not None and solution.converged:
        contents |= _orbit_writers(solution.state)
    cell_m = math.inf if dem is None else dem.metadata.resolution_m
    if dem is not None and solution.converged and 3.0 * max(solution.sigma_enu_m()) > cell_m:
        more["map"] = partial(_on_terrain, solution, dem)
    return _write(solution, folder, contents, html, _SOLUTION_FILES, more)


def _orbit_writers(state: OrbitState) -> dict[str, Callable[[Path], Path]]:
    """Return writers of an orbit that was determined to :data:`ORBIT_FILES`; messages have the state's covariance."""
    orbit = state.orbit.integrate()
    message: dict[str, Any] = {"originator": "radioloc"}
    if np.isfinite(state.covariance).all() and state.covariance.any():
        message["covariance"] = state.covariance
    writers = (
        partial(write_orbit_spk, [orbit], body=state.body),
        partial(write_orbit_oem, [orbit], **message),
        partial(write_orbit_opm, orbit, **message),
    )
    return dict(zip(ORBIT_FILES, writers, strict=True))


def _on_terrain(solution: Solution, dem: TerrainModel) -> Figure:
    """The position on shaded terrain, or without it where that does not reach far enough."""
    try:
        return plot_map(solution, dem=dem)
    except InputError:
        return plot_map(solution)


_Content = str | Mapping[str, Any] | Callable[[Path], object]
"""Text, what becomes JSON, or what writes itself to a path."""


def _numbers(solution: Solution, folder: str = "") -> dict[str, _Content]:
    """The files of a solution by name, in a folder that ends in a slash."""
    rows = partial(write_residuals, rows=solution.residuals)
    return {f"{folder}solution.json": solution.to_dict(), f"{folder}residuals.csv": rows}


def _write(
    result: Result,
    folder: str | Path,
    contents: Mapping[str, _Content],
    html: bool,
    earlier: tuple[str, ...] = (),
    more: Mapping[str, Callable[[], Figure]] | None = None,
) -> list[Path]:
    """Write files and figures by name, those that there are; others of such names, or of earlier ones, are removed.

    Until then a file marks the folder as incomplete, also after a run that was stopped. A second run that writes there
    at the same time is refused.
    """
    folder = made_folder(folder)
    with _sole_writer(folder):
        return _write_all(result, folder, contents, html, earlier, dict(more or {}))


@contextmanager
def _sole_writer(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder, and remove what one that was killed has left of its temporary files."""
    marker = folder / INCOMPLETE
    if not marker.exists():
        text = "radioloc has not finished writing here: files may be of different results. Run it again.\n"
        write_text(marker, text)
    with locked(marker):
        remove_files(folder, (TEMPORARY_FILES, f"[0-9]*h/{TEMPORARY_FILES}"))
        yield
        marker.unlink()


def _write_all(
    result: Result,
    folder: Path,
    contents: Mapping[str, _Content],
    html: bool,
    earlier: tuple[str, ...],
    more: Mapping[str, Callable[[], Figure]],
) -> list[Path]:
    written = []
    for name, content in contents.items():
        written.append(folder / name)
        made_folder(written[-1].parent)
        if isinstance(content, str):
            write_text(written[-1], content)
        elif isinstance(content, Mapping):
            write_json(written[-1], content)
        else:
            content(written[-1])
    figures = {**figures_of(result), **more}
    for name, draw in figures.items():
        written += [] if draw is None else write_figure(draw(), folder, name)
    if html:
        drawn = {path.stem: path for path in written if path.suffix == ".png"}
        written.append(folder / PAGE)
        write_page(result, drawn, written[-1])
    earlier = (PAGE, *(f"{name}.[ps][nv]g" for name in figures), *earlier)
    remove_files(folder, (*contents, *earlier), written)
    return written


def remove_files(folder: Path, names: tuple[str, ...], but: Collection[Path] = ()) -> None:
    """Remove files of a folder by name or pattern."""
    for name in names:
        for path in folder.glob(name):
            if path.is_file() and path not in but:
                path.unlink()


def write_residuals(path: Path, rows: Residuals) -> None:
    """Write residuals, one row for each observation in the order given, columns :data:`RESIDUAL_COLUMNS`."""
    if rows.elevation_deg is None:
        raise InputError(
            "the solution has no elevations, which residuals.csv lists; give them to build_solution"
        )
    columns: dict[str, Any] = {"epoch_utc": rows.epoch_utc, "type": rows.types, "path": rows.paths}
    columns |= {name: getattr(rows, name) for name in _DECIMALS} | {"status": rows.statuses}
    if rows.count_s is not None and not np.isnan(rows.count_s).all():
        columns["residual_mm_s"] = rows.residual_mm_s
    for name, column in columns.items():
        if name in _DECIMALS and name != "elevation_deg" and not np.isfinite(column).all():
            bad = int(np.argmin(np.isfinite(column)))
            raise InputError(f"{name} of observation {bad + 1} is {column[bad]}; residuals must be finite")
    _write_csv(path, columns, _DECIMALS | {"residual_mm_s": 5})


def _write_csv(path: Path, columns: Mapping[str, Any], decimals: Mapping[str, int] | None = None) -> None:
    write_csv(path, batches_of(columns, decimals or {}))


def write_terms(predictor: Predictor, solution: Solution, folder: str | Path) -> Path:
    """Write ``terms.csv``: for each observation, what each active term of the model adds to the computed value.

    Parameters
    ----------
    predictor : Predictor
        That of the solution's study, as :func:`~radioloc.jobs.locate.arc_of` prepares it.
    solution : Solution
        Where the terms are evaluated.
    folder : path-like
        As of :func:`write_report`, errors too.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> predictor, _ = radioloc.jobs.arc_of(study)
    >>> radioloc.report.write_terms(predictor, radioloc.residuals(study), "out").name
    'terms.csv'
    """
    path = made_folder(folder) / "terms.csv"
    _write_terms(predictor.terms(solution.position_pa_m), predictor.observations, path)
    return path


def _write_terms(terms: Mapping[str, NDArray[np.float64]], rows: Observations, path: Path) -> None:
    types = Labels(rows.kind.astype(np.int32), tuple(KINDS))
    paths = Labels(rows.link, tuple(link.path for link in rows.links))
    columns = {"epoch_utc": rows.epoch, "type": types, "path": paths}
    named = {f"{name}_m": values for name, values in terms.items()}
    _write_csv(path, columns | named, dict.fromkeys(named, 6))


def write_arcs(study: ArcStudy, folder: str | Path, *, html: bool = False) -> list[Path]:
    """Write ``arcs.json``, ``table1.csv``, ``.md``, ``.tex``, two figures as PNG and SVG, and a folder for each arc.

    ``table1`` and ``figure2`` are what table 1 and figure 2 of Wang et al. (2021) show, ``arcs.png`` the positions by
    length of the arc; ``arcs_2.png`` and so on are those of further targets. Each arc has a folder, such as ``12h``,
    with ``solution.json`` and ``residuals.csv``. Parameters and errors are as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.arcs(radioloc.read_study("examples/change5/change5.toml"), hours=[12.0])
    >>> [path.name for path in radioloc.report.write_arcs(found, "out") if path.suffix == ".png"]
    ['figure2.png', 'arcs.png']
    """
    contents = _table1(study) | {"arcs.json": study.to_dict()}
    for arc in study.arcs:
        contents |= _numbers(arc.solution, f"{arc.hours:g}h/")
    return _write(study, folder, contents, html, _TABLE_FILES)


def write_monte_carlo(study: MonteCarlo, folder: str | Path, *, html: bool = False) -> list[Path]:
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
    trials = partial(_write_csv, columns=study.columns_of_trials())
    return _write(study, folder, {"montecarlo.json": study.to_dict(), "trials.csv": trials}, html)


def write_covariance(study: CovarianceStudy, folder: str | Path, *, html: bool = False) -> list[Path]:
    """Write ``covariance.json``, ``covariance.csv``, ``covariance.png`` and ``covariance.svg``.

    There are no figures where the position is not determined. All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.covariance(radioloc.read_study("examples/change5/short_arc.toml"))
    >>> [path.name for path in radioloc.report.write_covariance(found, "out")][:2]
    ['covariance.json', 'covariance.csv']
    """
    contents: dict[str, _Content] = {"covariance.json": study.to_dict(), "covariance.csv": study.to_csv()}
    return _write(study, folder, contents, html)


def write_leave_one_out(found: LeaveOneOut, folder: str | Path, *, html: bool = False) -> list[Path]:
    """Write ``leave_one_out.json`` and ``leave_one_out.csv``, a row for each station and link.

    All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.jobs.leave_one_out("examples/change5/short_arc.toml")
    >>> [path.name for path in radioloc.report.write_leave_one_out(found, "out")]
    ['leave_one_out.json', 'leave_one_out.csv']
    """
    table = partial(_write_csv, columns=found.columns())
    return _write(found, folder, {"leave_one_out.json": found.to_dict(), "leave_one_out.csv": table}, html)


def write_images(
    solution: ImageSolution | PointSolution, folder: str | Path, *, html: bool = False
) -> list[Path]:
    """Write ``solution.json``, and ``images.png`` and ``images.svg``, or of a point ``position.png`` and ``.svg``.

    All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate_images(radioloc.jobs.read_image_study("examples/images/descent.toml"))
    >>> [path.name for path in radioloc.report.write_images(solution, "out")]
    ['solution.json', 'images.png', 'images.svg']
    """
    return _write(solution, folder, {"solution.json": solution.to_dict()}, html, _SOLUTION_FILES)


def write_comparison(found: Comparison, folder: str | Path, *, html: bool = False) -> list[Path]:
    """Write ``comparison.json``, ``table1.csv``, ``.md``, ``.tex``, ``comparison.png`` and ``comparison.svg``.

    All else is as of :func:`write_report`.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> found = radioloc.jobs.compare(radioloc.write_report(solution, "out")[:1])
    >>> [path.name for path in radioloc.report.write_comparison(found, "compared")][:2]
    ['table1.csv', 'table1.md']
    """
    contents = _table1(found) | {"comparison.json": found.to_dict()}
    return _write(found, folder, contents, html, _TABLE_FILES)


def _table1(found: ArcStudy | Comparison) -> dict[str, _Content]:
    return {
        "table1.csv": found.to_csv(),
        "table1.md": found.to_markdown(),
        "table1.tex": found.to_latex(),
    }


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
    """Write a dictionary as :func:`json_text`."""
    write_text(path, json_text(content))


def json_text(content: Any, *, ascii_only: bool = False) -> str:
    """JSON that any other program reads: numpy values as lists and numbers, never NaN."""
    return json.dumps(_plain(content, ""), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


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
