"""Solutions written for other tools, in a format by the ending of the file's name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from radioloc.errors import InputError
from radioloc.io.ccsds import write_oem
from radioloc.io.gis import write_gis
from radioloc.io.sinex import write_sinex
from radioloc.io.spice_kernels import FIRST_SITE, write_spice
from radioloc.plugins import named_where_it_fails, registry
from radioloc.results.solution import Solution
from radioloc.results.tables import Located, solution_table, write_table_file
from radioloc.text_files import require_ending


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of exporters; each exporter reads those that its format needs.

    Parameters
    ----------
    code : int
        NAIF code of the lander in an SPK.
    start_utc, stop_utc : str, optional
        First and last epoch of an ephemeris message, UTC.
    step_s : float
        Interval between the states of an ephemeris message, s.
    originator : str, optional
        Agency that makes an ephemeris message.
    """

    code: int = FIRST_SITE
    start_utc: str | None = None
    stop_utc: str | None = None
    step_s: float = 3600.0
    originator: str | None = None


@dataclass(frozen=True, slots=True)
class Exporter:
    """A format of solutions, for the group of entry points ``radioloc.exporters``.

    Parameters
    ----------
    name : str
        Unique name of the format.
    endings : tuple of str
        Endings of the names of its files in small letters, such as ``.geojson``.
    description : str
        Content of a file, for the help of ``radioloc export``.
    write : callable
        Function of solutions (:class:`~radioloc.results.Solution` or what ``solution.json`` holds), path and
        :class:`ExportOptions` that returns the paths written.
    """

    name: str
    endings: tuple[str, ...]
    description: str
    write: Callable[[Sequence[Located], Path, ExportOptions], Sequence[Path]]


def _single(solutions: Sequence[Located], path: Path) -> Located:
    if len(solutions) != 1:
        raise InputError(f"{path}: such a file holds one lander, got {len(solutions)}; give one solution")
    return solutions[0]


def _write_oem(solutions: Sequence[Located], path: Path, options: ExportOptions) -> list[Path]:
    start_utc, stop_utc, originator = options.start_utc, options.stop_utc, options.originator
    if start_utc is None or stop_utc is None or originator is None:
        names = {"--start": start_utc, "--stop": stop_utc, "--originator": originator}
        missing = " and ".join(name for name, value in names.items() if value is None)
        raise InputError(f"{path}: an ephemeris message needs a span and an originator; give {missing}")
    span = start_utc, stop_utc
    solution = _single(solutions, path)
    return [write_oem(solution, path, *span, originator=originator, step_s=options.step_s)]


def _write_sinex(solutions: Sequence[Located], path: Path, options: ExportOptions) -> list[Path]:
    solution = _single(solutions, path)
    if not isinstance(solution, Solution):
        raise InputError(
            f"{path}: SINEX needs the covariance of all parameters, which solution.json does not have; "
            "use radioloc locate --sinex"
        )
    return [write_sinex(solution, path)]


def _write_table(solutions: Sequence[Located], path: Path, options: ExportOptions) -> list[Path]:
    return [write_table_file(solution_table(solutions), path)]


def _write_gis(solutions: Sequence[Located], path: Path, options: ExportOptions) -> list[Path]:
    return [write_gis(solutions, path)]


EXPORTERS = registry(
    "radioloc.exporters",
    Exporter,
    (
        Exporter("GeoJSON", (".geojson",), "map layer with positions, ellipses and references", _write_gis),
        Exporter("GeoPackage", (".gpkg",), "the same as two map layers; needs the extra gis", _write_gis),
        Exporter(
            "SPICE kernels",
            (".bsp",),
            "SPK with the lander, and beside it a frames kernel .tf",
            lambda solutions, path, its: write_spice(_single(solutions, path), path, code=its.code),
        ),
        Exporter(
            "Orbit Ephemeris Message",
            (".oem",),
            "states of the lander over a span, of CCSDS; needs --start, --stop and --originator",
            _write_oem,
        ),
        Exporter("Markdown", (".md",), "table of positions and sigmas", _write_table),
        Exporter("LaTeX", (".tex",), "table of positions and sigmas", _write_table),
        Exporter("SINEX", (".snx",), "estimates with their covariance; by locate --sinex", _write_sinex),
    ),
)
"""Formats of solutions by name: those of the package, and those of other packages."""


def export_solutions(
    solutions: Sequence[Located], path: str | Path, options: ExportOptions | None = None
) -> list[Path]:
    """Write solutions in the format that the ending of the file's name says.

    Parameters
    ----------
    solutions : sequence of Solution, ImageSolution or mapping
        Solutions to write; a mapping is the content of ``solution.json``.
    path : path-like
        File to write; an existing one is replaced.
    options : ExportOptions, optional
        Options of single formats.

    Returns
    -------
    list of Path
        Files that were written.

    Raises
    ------
    InputError
        No exporter has the ending, or the format cannot hold the solutions.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [file.name for file in radioloc.io.export_solutions([solution], "apollo15.bsp")]
    ['apollo15.bsp', 'apollo15.tf']
    """
    by_ending = {ending: exporter for exporter in EXPORTERS.values() for ending in exporter.endings}
    exporter = by_ending[require_ending(path, by_ending)]
    with named_where_it_fails(f"exporter {exporter.name}", "write"):
        return [*exporter.write(solutions, Path(path), options or ExportOptions())]
