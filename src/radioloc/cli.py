"""The command line: ``radioloc locate``, ``residuals``, ``arcs``, ``simulate``, ``montecarlo``, ``convert``, ...

Exit status: 0 converged (or done), 2 bad input, 3 not converged or not observable.
"""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO

from radioloc._version import __version__
from radioloc.errors import ConvergenceError, InputError, RadiolocError, RadiolocWarning
from radioloc.studies.arc_parts import DEFAULT_HOURS

if TYPE_CHECKING:
    from radioloc.estimation.solution import Solution

_ORIGINATOR_HELP = "agency that makes a Tracking Data Message, which must be named"
EXIT_DONE, EXIT_BAD_INPUT, EXIT_NOT_CONVERGED = 0, 2, 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    options = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        # Even where Python is told to make errors of warnings: ours are for the reader, not for a debugger.
        warnings.simplefilter("default", RadiolocWarning)
        warnings.showwarning = _shown_once()
        try:
            status = int(options.run(options))
            sys.stdout.flush()
            return status
        except BrokenPipeError:
            # Whoever read our output has seen enough, as `head` does. Python would complain again at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return EXIT_DONE
        except ConvergenceError as error:
            _complain(str(error))
            return EXIT_NOT_CONVERGED
        except RadiolocError as error:
            _complain(str(error))
            return EXIT_BAD_INPUT
        except OSError as error:
            _complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            return EXIT_BAD_INPUT


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as all others, and whose help ends with what registries hold."""

    more: Callable[[], dict[str, dict[str, str]]] | None = None
    """Titles, and under each names with what they are; asked only when help is."""

    def error(self, message: str) -> NoReturn:
        _complain(f"{message}; see {self.prog} --help")
        self.exit(EXIT_BAD_INPUT)

    def format_help(self) -> str:
        lists = self.more() if self.more else {}
        return super().format_help() + "".join(
            f"\n{title}:\n" + "".join(map(_listed, rows, rows.values())) for title, rows in lists.items()
        )


def _listed(name: str, text: str) -> str:
    return textwrap.fill(text, 80, initial_indent=f"  {name:<24}  ", subsequent_indent=" " * 28) + "\n"


def _keys_of_a_study() -> dict[str, dict[str, str]]:
    from radioloc.parameters.registry import PARAMETERS
    from radioloc.studies.schema import keys_of
    from radioloc.studies.study import PARAMETER_KEYS
    from radioloc.studies.study_file import TABLES

    tables = {
        f"[{table}]": ", ".join(
            key for key in keys_of(record) if table != "estimate" or key not in PARAMETER_KEYS
        )
        for table, record in TABLES.items()
    }
    parameters = {f"{name} ({kind.unit})": kind.description for name, kind in PARAMETERS.items()}
    return {
        "tables of a study file": tables,
        "parameters, each with NAME_UNIT, NAME_sigma_UNIT and NAME_per, in [estimate] or [consider]": parameters,
    } | _measurement_types()


def _measurement_types() -> dict[str, dict[str, str]]:
    from radioloc.measurements.registry import MEASUREMENTS

    return {"types of measurement": {name: kind.description for name, kind in MEASUREMENTS.items()}}


def _formats() -> dict[str, dict[str, str]]:
    from radioloc.io.detect import READERS

    formats = {reader.name: reader.description for reader in READERS.values()}
    return {"formats that are read, told by how a file begins": formats} | _measurement_types()


def _complain(message: str) -> None:
    print(f"radioloc: {_one_line(message)}", file=sys.stderr)


def _one_line(message: str) -> str:
    return " ".join(message.split())


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="radioloc", description="Where a lander stands on the Moon, from Earth-based tracking."
    )
    parser.add_argument("--version", action="version", version=f"radioloc {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    locate = commands.add_parser("locate", help="fit a position and print a result card")
    residuals = commands.add_parser("residuals", help="observed minus computed at the given position, no fit")
    for command, run in ((locate, _locate), (residuals, _residuals)):
        _add_study(command)
        command.add_argument(
            "--out", type=Path, metavar="DIR", help="write solution.json, residuals.csv and plots there"
        )
        _add_quiet(command)
        command.add_argument(
            "--terms", action="store_true", help="with --out, also write terms.csv: what each model term adds"
        )
        command.set_defaults(run=run, parser=command)
    arcs = commands.add_parser("arcs", help="fit the first hours only, for several lengths, and compare")
    _add_study(arcs)
    _add_hours(arcs)
    arcs.add_argument("--out", type=Path, metavar="DIR", help="write tables, figure and all solutions there")
    _add_quiet(arcs)
    arcs.set_defaults(run=_arcs)
    simulate = commands.add_parser("simulate", help="simulate the tracking that a study describes")
    _add_study(simulate, "a study file with [simulation]")
    simulate.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        required=True,
        help="write the observations there, by its ending: .csv, .parquet, .tdm, .kvn or .xml",
    )
    simulate.add_argument("--originator", metavar="NAME", help=_ORIGINATOR_HELP)
    simulate.add_argument("--seed", type=int, metavar="N", help="of the noise (default: the study's)")
    _add_quiet(simulate)
    simulate.set_defaults(run=_simulate)
    convert = commands.add_parser(
        "convert", help="read observations of any format and write them as one file"
    )
    convert.add_argument(
        "files", type=Path, nargs="+", metavar="IN", help="files to read, each of any format"
    )
    convert.add_argument(
        "out",
        type=Path,
        metavar="OUT",
        help="file to write, by its ending: .csv, .parquet, .tdm, .kvn or .xml",
    )
    convert.add_argument(
        "--sigma",
        action="append",
        default=[],
        metavar="TYPE=METRES",
        help="sigmas of observations in Tracking Data Messages, which state none, such as range=1.0; one for each type",
    )
    convert.add_argument("--originator", metavar="NAME", help=_ORIGINATOR_HELP)
    convert.more = _formats
    _add_quiet(convert)
    convert.set_defaults(run=_convert)
    trials = commands.add_parser(
        "montecarlo",
        help="simulate the tracking that a study describes many times, and fit it, for several arcs",
    )
    _add_study(trials, "a study file with [simulation]")
    trials.add_argument("--trials", type=int, default=1000, metavar="N", help="how many (default: 1000)")
    _add_hours(trials)
    trials.add_argument("--seed", type=int, metavar="N", help="of all that is drawn (default: the study's)")
    trials.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default: 1)")
    trials.add_argument("--out", type=Path, metavar="DIR", help="write trials, summary and figures there")
    trials.add_argument("--resume", action="store_true", help="take over the trials that are in DIR already")
    trials.add_argument("--full", action="store_true", help="fit every trial with the whole model")
    _add_quiet(trials)
    trials.set_defaults(run=_monte_carlo, parser=trials)
    stations = commands.add_parser("stations", help="list the stations that are known by name")
    stations.set_defaults(run=_stations)
    return parser


def _add_study(command: _Parser, text: str = "the study file") -> None:
    command.add_argument("study", type=Path, metavar="STUDY.toml", help=text)
    command.more = _keys_of_a_study


def _add_hours(command: argparse.ArgumentParser) -> None:
    lengths = " ".join(f"{hours:g}" for hours in DEFAULT_HOURS)
    command.add_argument(
        "--hours",
        type=float,
        nargs="+",
        default=list(DEFAULT_HOURS),
        metavar="H",
        help=f"lengths of the arcs (default: {lengths})",
    )


def _add_quiet(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _tell(options: argparse.Namespace, card: object) -> None:
    """Print a card and where files were written, unless told to be quiet."""
    if options.quiet:
        return
    print(card)
    if options.out is not None:
        print(f"\nwritten to {options.out}")


def _locate(options: argparse.Namespace) -> int:
    solution = _run(options, fitted=True)
    return EXIT_DONE if solution.converged else EXIT_NOT_CONVERGED


def _residuals(options: argparse.Namespace) -> int:
    _run(options, fitted=False)
    return EXIT_DONE


def _arcs(options: argparse.Namespace) -> int:
    from radioloc.report.files import write_arcs
    from radioloc.studies.arcs import arcs
    from radioloc.studies.study_file import read_study

    found = arcs(read_study(options.study), options.hours)
    if options.out is not None:
        write_arcs(found, options.out)
    _tell(options, found)
    return EXIT_DONE if found.converged else EXIT_NOT_CONVERGED


def _simulate(options: argparse.Namespace) -> int:
    from radioloc.io.write import require_writable, write_observations
    from radioloc.studies.simulate import simulate
    from radioloc.studies.study_file import read_study

    require_writable(options.out, options.originator)  # before the work, which may take long
    made = simulate(read_study(options.study), options.seed)
    comments = [made.summary()]
    write_observations(options.out, made.observations, originator=options.originator, comments=comments)
    _tell(options, made.summary())
    return EXIT_DONE


def _convert(options: argparse.Namespace) -> int:
    from radioloc.io.detect import read_observations
    from radioloc.io.tdm import TdmAgreement
    from radioloc.io.write import require_writable, write_observations

    require_writable(options.out, options.originator)  # before the reading, which may take long
    tdm = TdmAgreement(sigma_m=_sigmas(options.sigma)) if options.sigma else None
    observations = read_observations(options.files, tdm=tdm)
    write_observations(options.out, observations, originator=options.originator)
    _tell(options, observations.summary())
    return EXIT_DONE


def _sigmas(texts: Sequence[str]) -> dict[str, float]:
    """Sigmas by type, from texts such as ``range=1.0``."""
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            raise InputError(f"--sigma {text}: write it as TYPE=METRES, such as range=1.0") from None
    return found


def _monte_carlo(options: argparse.Namespace) -> int:
    from radioloc.report.files import write_monte_carlo
    from radioloc.studies.monte_carlo import monte_carlo
    from radioloc.studies.study_file import read_study

    if options.resume and options.out is None:
        options.parser.error("--resume needs --out DIR, where the trials are")
    found = monte_carlo(
        read_study(options.study),
        options.trials,
        options.hours,
        seed=options.seed,
        workers=options.workers,
        out=options.out,
        resume=options.resume,
        full=options.full,
        progress=not options.quiet,
    )
    if options.out is not None:
        write_monte_carlo(found, options.out)
    _tell(options, found)
    return EXIT_DONE if found.converged else EXIT_NOT_CONVERGED


def _run(options: argparse.Namespace, *, fitted: bool) -> Solution:
    """Do a study, write its files and print its card."""
    from radioloc.report.files import write_report, write_terms
    from radioloc.studies.locate import fit_arc, prepared_arc
    from radioloc.studies.study_file import read_study

    if options.terms and options.out is None:
        options.parser.error("--terms needs --out DIR, where to write terms.csv")
    study = read_study(options.study)
    arc, left_out = prepared_arc(study)
    solution = fit_arc(study, arc, left_out, study.estimate if fitted else None)
    if options.out is not None:
        write_report(solution, options.out)
        if options.terms:
            write_terms(arc, solution, options.out)
    _tell(options, solution)
    return solution


def _stations(options: argparse.Namespace) -> int:
    from radioloc.earth.stations import StationCatalogue

    for station in StationCatalogue.default():
        x, y, z = station.itrf_m
        print(
            f"{station.name:<10} {station.kind:<5} {station.quality:<8} {x:15.4f} {y:15.4f} {z:15.4f} m  "
            f"{', '.join(station.aliases)}"
        )
    return EXIT_DONE


def _shown_once() -> Callable[..., None]:
    """Make what shows the library's own warnings as one line each, and each once; others as Python does."""
    seen: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if not issubclass(category, RadiolocWarning):
            text = warnings.formatwarning(message, category, filename, lineno, line)
            print(text, file=file or sys.stderr, end="")
        elif str(message) not in seen:
            seen.add(str(message))
            _complain(f"warning: {message}")

    return show


if __name__ == "__main__":
    sys.exit(main())
