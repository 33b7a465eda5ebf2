"""The output folder of a result: its files, figures and page, of one result at a time."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.errors import InputError, require_type
from radioloc.io.ccsds import write_orbit_oem, write_orbit_opm
from radioloc.io.gis import CRS
from radioloc.io.spice_kernels import write_orbit_spk
from radioloc.io.table import batches_of, write_csv
from radioloc.labels import Labels
from radioloc.lunar import TerrainModel
from radioloc.lunar.map_files import new_geotiff
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import FixedPoint
from radioloc.progress import step
from radioloc.report.figure_types import FIGURES, available_figures
from radioloc.report.figures import save_figure
from radioloc.report.map_figures import plot_map
from radioloc.report.page import PAGE, write_html
from radioloc.report.residual_figures import plot_terms
from radioloc.results.registry import RESULTS, result_type
from radioloc.results.result import Content, OrbitFile, Raster, Result, ResultType, Table
from radioloc.results.solution import Solution
from radioloc.text_files import TEMPORARY_FILES, disk_failed, locked, replaced_file, write_text
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INCOMPLETE = "INCOMPLETE"
"""File that marks a folder with files of different results, as writing was interrupted."""
_WRITER_COUNT = 2  # files written at a time: maps of images take 150 MB each


def write_report(
    folder: str | Path,
    result: Result,
    terms_by: Predictor | None = None,
    *,
    html: bool = False,
    dem: TerrainModel | None = None,
) -> list[Path]:
    """Write the files and figures of a result into a folder.

    Parameters
    ----------
    folder : path-like
        Output folder, created if necessary. Files of an earlier result of the type are replaced or removed. The file
        ``INCOMPLETE`` exists until all files are written.
    result : Solution, ArcStudy, MonteCarlo, CovarianceStudy, LeaveOneOut, Comparison or another registered type
        Result of a job, or of a type that another package registers.
    terms_by : Predictor, optional
        Predictor of a solution, for ``terms.csv`` and its figure: the contribution of each active term of the model
        to each computed value at the estimate.
    html : bool
        Whether to write ``report.html`` as well (:func:`write_html`).
    dem : TerrainModel, optional
        Terrain for ``map.png`` and the page, used if its cells are no larger than three sigmas of the position.

    Raises
    ------
    InputError
        The folder cannot be written, the residuals lack elevations, or ``html`` needs the extra ``report``.
    OSError
        The disk is full or fails.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [path.name for path in radioloc.write_report("out", solution)][:2]
    ['solution.json', 'residuals.csv']
    >>> comparison = radioloc.compare(["out/solution.json"])
    >>> [path.name for path in radioloc.write_report("compared", comparison)][:2]
    ['table1.csv', 'table1.md']
    """
    require_type("folder", folder, str, Path)
    contents = dict(result.files())
    extra_figures: dict[str, Figure | None] = {}
    if isinstance(result, Solution) and terms_by is not None:
        points = [FixedPoint(item.position_pa_m) for item in result.targets or (result,)]
        terms = terms_by.terms(None if terms_by.trajectories else points)
        observations = terms_by.observations
        contents["terms.csv"] = _terms_table(terms, observations)
        extra_figures["terms"] = plot_terms(terms, observations)
    if isinstance(result, Solution) and dem is not None:
        extra_figures["map"] = _terrain_map(result, dem)
    folder = made_folder(folder)
    with _sole_writer(folder):
        written = [folder / name for name in contents]
        contexts = [copy_context() for _ in written]
        with step(f"writing {len(written)} files"), ThreadPoolExecutor(_WRITER_COUNT) as pool:
            runs = (context.run for context in contexts)
            list(pool.map(lambda run, *file: run(write_content, *file), runs, written, contents.values()))
        for figure_type in available_figures(result):
            if (figure := extra_figures.get(figure_type.name)) is not None:
                written += write_figure(figure, folder, figure_type.stem)
            elif not figure_type.page_only:
                with step(f"drawing {figure_type.stem}"):
                    figures = list(figure_type.drawn(result))
                for stem, figure in figures:
                    written += write_figure(figure, folder, stem)
        if html:
            drawn = {path.stem: path for path in written if path.suffix == ".png"}
            written.append(folder / PAGE)
            write_html(written[-1], result, figures=drawn)
        remove_files(folder, (*contents, *earlier_files(result_type(result))), written)
    return written


def earlier_files(declared: ResultType) -> tuple[str, ...]:
    """Return names and patterns of the files that a result replaces, also those of types with common files."""
    patterns = _file_patterns(declared)
    related = (item for item in map(_file_patterns, RESULTS.values()) if patterns & item)
    return (PAGE, *sorted(set().union(patterns, *related)))


def _file_patterns(declared: ResultType) -> set[str]:
    stems = [FIGURES[name].stem for name in declared.figures if not FIGURES[name].page_only]
    names = [f"{stem}{number}.[ps][nv]g" for stem in stems for number in ("", "_[0-9]*")]
    return {*declared.file_patterns, *names}


def _terms_table(terms: Mapping[str, Floats], rows: Observations) -> Table:
    types = Labels(rows.kind.astype(np.int32), tuple(KINDS))
    paths = Labels(rows.link, tuple(link.path for link in rows.links))
    named = {f"{name}_m": values for name, values in terms.items()}
    return Table({"epoch_utc": rows.epoch, "type": types, "path": paths, **named}, dict.fromkeys(named, 6))


def _terrain_map(solution: Solution, dem: TerrainModel) -> Figure | None:
    """Draw the position on terrain, or without terrain that is too small; return None if the cells are too large."""
    if not solution.converged or 3.0 * max(solution.sigma_enu_m()) <= dem.metadata.resolution_m:
        return None
    try:
        return plot_map(solution, dem=dem)
    except InputError:
        return plot_map(solution)


@contextmanager
def _sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder, mark it as incomplete until the end, and remove temporary files of interrupted runs."""
    marker = folder / INCOMPLETE
    if not marker.exists():
        text = "radioloc has not finished writing here: files may be of different results. Run it again.\n"
        write_text(marker, text)
    with locked(marker):
        remove_files(folder, (TEMPORARY_FILES, f"[0-9]*h/{TEMPORARY_FILES}"))
        yield
        marker.unlink()


def write_content(path: Path, content: Content) -> None:
    """Write a file of the output folder."""
    made_folder(path.parent)
    if isinstance(content, str):
        write_text(path, content)
    elif isinstance(content, Table):
        write_csv(path, batches_of(content.columns, content.decimals))
    elif isinstance(content, OrbitFile):
        _write_orbit(content, path)
    elif isinstance(content, Raster):
        _write_raster(content, path)
    elif isinstance(content, Mapping):
        write_json(path, content)
    else:
        content(path)


def _write_raster(content: Raster, path: Path) -> None:
    from rasterio.transform import Affine

    shape, step_deg = next(iter(content.bands.values())).shape, content.step_deg
    transform = Affine(step_deg, 0.0, content.west_deg, 0.0, -step_deg, content.north_deg)
    with replaced_file(path) as temporary:
        file = new_geotiff(temporary, CRS, transform, shape, np.float64, np.nan, len(content.bands))
        with file:
            for number, (name, band) in enumerate(content.bands.items(), start=1):
                file.write(band, number)
                file.set_band_description(number, name)


def _write_orbit(content: OrbitFile, path: Path) -> None:
    message: dict[str, Any] = {"originator": "radioloc", "covariance": content.covariance}
    if path.suffix == ".bsp":
        write_orbit_spk(path, content.orbit, body=content.body)
    elif path.suffix == ".oem":
        write_orbit_oem(path, content.orbit, **message)
    else:
        write_orbit_opm(path, content.orbit, **message)


def remove_files(folder: Path, names: tuple[str, ...], but: Collection[Path] = ()) -> None:
    """Remove files of a folder by name or pattern."""
    for name in names:
        for path in folder.glob(name):
            if path.is_file() and path not in but:
                path.unlink()


def write_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG."""
    paths = [folder / f"{name}.{ending}" for ending in ("png", "svg")]
    with step(f"drawing {name}.png"):
        save_figure(figure, paths)
    return paths


def made_folder(folder: str | Path) -> Path:
    """Return the folder, created with its parents if necessary."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if disk_failed(error):
            raise
        raise InputError(f"{folder}: cannot create the output folder: {error.strerror}") from None
    return folder


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a dictionary as :func:`json_text`."""
    write_text(path, json_text(content))


def json_text(content: Any, *, ascii_only: bool = False) -> str:
    """Return standard JSON: numpy values as lists and numbers, no NaN."""
    return json.dumps(_plain(content, ""), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


def _plain(value: Any, place: str) -> Any:
    """Convert a value to the types of JSON; errors name its place."""
    match value:
        case Mapping():
            return {
                str(key): _plain(item, f"{place}.{key}" if place else str(key)) for key, item in value.items()
            }
        case np.ndarray() | np.generic():
            return _plain(value.tolist(), place)
        case list() | tuple():
            return [_plain(item, f"{place}[{k}]") for k, item in enumerate(value)]
        case float() if not math.isfinite(value):
            raise InputError(f"{place}: expected a finite number or None for JSON, got {value}")
        case Path():
            return str(value)
        case None | bool() | int() | float() | str():
            return value
    raise InputError(f"{place}: expected numbers, text or lists for JSON, got a {type(value).__name__}")
