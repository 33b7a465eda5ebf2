"""Export of solutions for other tools; the ending of the file's name selects the format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from radioloc.errors import InputError
from radioloc.io.ccsds import write_oem
from radioloc.io.gis import write_gis
from radioloc.io.sinex import write_sinex
from radioloc.io.spice_kernels import FIRST_SITE, write_spice
from radioloc.plugins import Registry, entry_errors
from radioloc.results.solution import Solution
from radioloc.results.tables import (
    SolutionLike,
    contents_by_target,
    single_content,
    solution_table,
    write_table_file,
)
from radioloc.text_files import require_ending


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of exporters; each exporter reads those that its format needs."""

    body: int = FIRST_SITE  #: NAIF code of the lander in an SPK
    start_utc: str | None = None  #: first and last epoch of an ephemeris message, UTC
    stop_utc: str | None = None  #: likewise
    step_s: float = 3600.0  #: interval between the states of an ephemeris message, s
    originator: str | None = None  #: agency that makes an ephemeris message
    target: str | None = None  #: target to write, of solutions with several


@dataclass(frozen=True, slots=True)
class Exporter:
    """A format of solutions, for the group of entry points ``radioloc.exporters``."""

    name: str  #: unique name of the format
    endings: tuple[str, ...]  #: endings of the names of its files in small letters, such as ``.geojson``
    description: str  #: content of a file, for the help of ``radioloc export``
    #: Function of the path, the solutions (:class:`~radioloc.results.Solution` or the content of
    #: ``solution.json``) and :class:`ExportOptions` that returns the paths written.
    write: Callable[[Path, Sequence[SolutionLike], ExportOptions], Sequence[Path]]


def _write_oem(path: Path, solutions: Sequence[SolutionLike], options: ExportOptions) -> list[Path]:
    start_utc, stop_utc, originator = options.start_utc, options.stop_utc, options.originator
    if start_utc is None or stop_utc is None or originator is None:
        names = {"--start": start_utc, "--stop": stop_utc, "--originator": originator}
        missing = " and ".join(name for name, value in names.items() if value is None)
        raise InputError(f"{path}: an ephemeris message needs {missing}")
    span = start_utc, stop_utc
    return [write_oem(path, single_content(solutions), *span, originator=originator, step_s=options.step_s)]


def _write_sinex(path: Path, solutions: Sequence[SolutionLike], options: ExportOptions) -> list[Path]:
    if len(solutions) != 1 or not isinstance(solutions[0], Solution):
        raise InputError(
            f"{path}: expected one solution with the covariance of all parameters, which solution.json lacks; use "
            "radioloc locate --sinex"
        )
    return [write_sinex(path, solutions[0])]


def _write_table(path: Path, solutions: Sequence[SolutionLike], options: ExportOptions) -> list[Path]:
    return [write_table_file(path, solution_table(solutions))]


def _write_gis(path: Path, solutions: Sequence[SolutionLike], options: ExportOptions) -> list[Path]:
    return [write_gis(path, solutions)]


EXPORTERS = Registry(
    "radioloc.exporters",
    Exporter,
    (
        Exporter("GeoJSON", (".geojson",), "map layer with positions, ellipses and references", _write_gis),
        Exporter("GeoPackage", (".gpkg",), "the same as two map layers; needs the extra gis", _write_gis),
        Exporter(
            "SPICE kernels",
            (".bsp",),
            "SPK with the lander, and beside it a frames kernel .tf",
            lambda path, solutions, options: write_spice(path, single_content(solutions), body=options.body),
        ),
        Exporter(
            "Orbit Ephemeris Message",
            (".oem",),
            "states of the lander over a span, of CCSDS; needs --start, --stop and --originator",
            _write_oem,
        ),
        Exporter("Markdown", (".md",), "table of positions and sigmas", _write_table),
        Exporter("LaTeX", (".tex",), "table of positions and sigmas", _write_table),
        Exporter(
            "SINEX", (".snx",), "not from solution.json, but by locate --sinex or in Python", _write_sinex
        ),
    ),
)
"""Formats of solutions by name: those of the package, and those of other packages."""


def export_solutions(
    path: str | Path, solutions: Sequence[SolutionLike], options: ExportOptions | None = None
) -> list[Path]:
    """Write solutions in the format of the ending of the file's name.

    Parameters
    ----------
    path : path-like
        File to write; an existing one is replaced.
    solutions : sequence of Solution, ImageSolution or mapping
        Solutions to write; a mapping is the content of ``solution.json``.
    options : ExportOptions, optional
        Options of single formats.

    Raises
    ------
    InputError
        No exporter has the ending, or the format cannot hold the solutions.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [file.name for file in radioloc.io.export_solutions("apollo15.bsp", [solution])]
    ['apollo15.bsp', 'apollo15.tf']
    """
    by_ending = {ending: exporter for exporter in EXPORTERS.values() for ending in exporter.endings}
    exporter = by_ending[require_ending(path, by_ending)]
    options = options or ExportOptions()
    solutions = solutions if options.target is None else contents_by_target(solutions, options.target)
    with entry_errors(f"exporter {exporter.name}", "write"):
        return [*exporter.write(Path(path), solutions, options)]
