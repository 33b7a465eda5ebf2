"""The command line: ``radioloc locate``, ``radioloc residuals`` and ``radioloc stations``.

Exit status: 0 converged (or done), 2 bad input, 3 not converged or not observable.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from radioloc._version import __version__
from radioloc.errors import RadiolocError, RadiolocWarning

if TYPE_CHECKING:
    from radioloc.estimation.solution import Solution

EXIT_DONE, EXIT_BAD_INPUT, EXIT_NOT_CONVERGED = 0, 2, 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    options = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        try:
            return int(options.run(options))
        except RadiolocError as error:
            print(f"radioloc: {error}", file=sys.stderr)
            return EXIT_BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="radioloc", description="Where a lander stands on the Moon, from Earth-based tracking."
    )
    parser.add_argument("--version", action="version", version=f"radioloc {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    locate = commands.add_parser("locate", help="fit a position and print a result card")
    residuals = commands.add_parser("residuals", help="observed minus computed at the given position, no fit")
    for command, run in ((locate, _locate), (residuals, _residuals)):
        command.add_argument("study", type=Path, metavar="STUDY.toml", help="the study file")
        command.add_argument(
            "--out", type=Path, metavar="DIR", help="write solution.json, residuals.csv and plots there"
        )
        command.add_argument("--quiet", action="store_true", help="print nothing but errors")
        command.add_argument(
            "--terms", action="store_true", help="with --out, also write terms.csv: what each model term adds"
        )
        command.set_defaults(run=run)
    stations = commands.add_parser("stations", help="list the stations that are known by name")
    stations.set_defaults(run=_stations)
    return parser


def _locate(options: argparse.Namespace) -> int:
    from radioloc.studies.locate import locate
    from radioloc.studies.study import read_study

    study = read_study(options.study)
    solution = locate(study)
    _deliver(options, solution)
    return EXIT_DONE if solution.converged else EXIT_NOT_CONVERGED


def _residuals(options: argparse.Namespace) -> int:
    from radioloc.studies.locate import residuals
    from radioloc.studies.study import read_study

    _deliver(options, residuals(read_study(options.study)))
    return EXIT_DONE


def _deliver(options: argparse.Namespace, solution: Solution) -> None:
    """Print the card and write the files."""
    if options.out is not None:
        from radioloc.studies.report import write_report

        write_report(solution, options.out)
        if options.terms:
            from radioloc.studies.report import write_terms
            from radioloc.studies.study import read_study

            write_terms(read_study(options.study), solution, options.out)
    if not options.quiet:
        print(solution)
        if options.out is not None:
            print(f"\nwritten to {options.out}")


def _stations(options: argparse.Namespace) -> int:
    from radioloc.earth.stations import StationCatalogue

    for station in StationCatalogue.default():
        x, y, z = station.itrf_m
        print(
            f"{station.name:<10} {station.kind:<5} {station.quality:<8} {x:15.4f} {y:15.4f} {z:15.4f} m  "
            f"{', '.join(station.aliases)}"
        )
    return EXIT_DONE


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Show the library's own warnings as one line each, others as Python does."""
    if issubclass(category, RadiolocWarning):
        print(f"radioloc: warning: {message}", file=sys.stderr)
    else:
        print(
            warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr, end=""
        )


if __name__ == "__main__":
    sys.exit(main())
