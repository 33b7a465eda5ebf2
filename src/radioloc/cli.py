"""The command line: ``radioloc locate``, ``residuals``, ``arcs``, ``simulate``, ``montecarlo``, ``convert``, ...

Exit status: 0 converged (or done), 1 the disk is full or fails, 2 bad input, 3 not converged or not observable, or
not verified, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from radioloc._version import __version__
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import CONSTANTS
from radioloc.errors import ConvergenceError, InputError, RadiolocError, RadiolocWarning
from radioloc.io.detect import READERS, read_observations
from radioloc.io.tdm import TdmAgreement
from radioloc.io.write import require_writable, write_observations
from radioloc.lunar import LunarPosition
from radioloc.measurements.registry import MEASUREMENTS
from radioloc.parameters.registry import PARAMETERS
from radioloc.report.covariance import plans_card
from radioloc.report.figures import save_figure
from radioloc.report.files import (
    write_arcs,
    write_comparison,
    write_covariance,
    write_images,
    write_monte_carlo,
    write_report,
)
from radioloc.report.gis import write_gis
from radioloc.report.map_figure import plot_map
from radioloc.report.sinex import write_sinex
from radioloc.report.spice_kernels import FIRST_SITE, write_spice
from radioloc.studies import locate
from radioloc.studies.arcs import arcs
from radioloc.studies.comparison import compare, read_solutions
from radioloc.studies.covariance import covariance
from radioloc.studies.doctor import doctor
from radioloc.studies.image_study import TABLES as IMAGE_TABLES
from radioloc.studies.image_study import read_image_study
from radioloc.studies.images import locate_images
from radioloc.studies.monte_carlo import monte_carlo
from radioloc.studies.schema import keys_of
from radioloc.studies.selection import DEFAULT_HOURS
from radioloc.studies.simulate import simulate
from radioloc.studies.study import PARAMETER_KEYS
from radioloc.studies.study_file import TABLES, read_study
from radioloc.studies.verification import verify
from radioloc.text_files import disk_failed

EXIT_DONE, EXIT_DISK, EXIT_BAD_INPUT, EXIT_NOT_CONVERGED, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    with warnings.catch_warnings():
        # Even where Python is told to make errors of warnings: ours are for the reader, not for a debugger.
        warnings.simplefilter("default", RadiolocWarning)
        warnings.showwarning = _shown_once()
        try:
            options = _parser().parse_args(arguments)
            return int(options.run(options))
        except SystemExit:  # of --help and --version, which have printed
            _print("", end="")
            raise
        except RadiolocError as error:
            _complain(str(error))
            return EXIT_NOT_CONVERGED if isinstance(error, ConvergenceError) else EXIT_BAD_INPUT
        except OSError as error:
            _complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            return EXIT_DISK if disk_failed(error) else EXIT_BAD_INPUT
        except KeyboardInterrupt:
            _complain("interrupted")
            return EXIT_INTERRUPTED


def _print(text: object, end: str = "\n") -> None:
    """Print at once; no word where the reader has seen enough, as `head` does, or standard output is closed."""
    try:
        print(text, end=end, flush=True)
    except OSError as error:
        # Python would try to write the rest again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OSError(error.errno, error.strerror, "standard output") from None


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as all others, and whose help ends with what registries hold."""

    more: Callable[[], dict[str, dict[str, str]]] = dict
    """Titles, and under each names with what they are; asked only when help is."""

    def error(self, message: str) -> NoReturn:
        _complain(f"{message}; see {self.prog} --help")
        self.exit(EXIT_BAD_INPUT)

    def format_help(self) -> str:
        text = super().format_help()
        for title, rows in self.more().items():
            text += f"\n{title}:\n"
            for name, what in rows.items():
                text += (
                    textwrap.fill(what, 80, initial_indent=f"  {name:<24}  ", subsequent_indent=" " * 28)
                    + "\n"
                )
        return text


def _keys_of_a_study() -> dict[str, dict[str, str]]:
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


def _keys_of_images() -> dict[str, dict[str, str]]:
    tables = {f"[{name}]": ", ".join(keys_of(record)) for name, record in IMAGE_TABLES.items()}
    return {"tables of a study file, one of [images], [image_point] and [stereo]": tables}


def _measurement_types() -> dict[str, dict[str, str]]:
    return {"types of measurement": {name: kind.description for name, kind in MEASUREMENTS.items()}}


def _formats() -> dict[str, dict[str, str]]:
    formats = {reader.name: reader.description for reader in READERS.values()}
    return {"formats that are read, told by how a file begins": formats} | _measurement_types()


def _complain(message: str) -> None:
    print(f"radioloc: {' '.join(message.split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="radioloc", description="Where a lander stands on the Moon, from Earth-based tracking."
    )
    parser.add_argument("--version", action="version", version=f"radioloc {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    flag: dict[str, Any] = {"action": "store_true"}
    folder: dict[str, Any] = {"type": Path, "metavar": "DIR"}
    number: dict[str, Any] = {"type": int, "metavar": "N"}
    hours: dict[str, Any] = {"type": float, "nargs": "+", "default": list(DEFAULT_HOURS), "metavar": "H"}
    hours["help"] = f"lengths of the arcs (default: {' '.join(f'{length:g}' for length in DEFAULT_HOURS)})"
    file: dict[str, Any] = {
        "type": Path,
        "help": "file to write, by its ending: .csv, .parquet, .tdm, .kvn or .xml",
    }
    agency: dict[str, Any] = {
        "metavar": "NAME",
        "help": "agency that makes a Tracking Data Message, which must be named",
    }

    def command(name: str, run: Callable[..., int], text: str, study: str = "the study file") -> _Parser:
        made: _Parser = commands.add_parser(name, help=text)
        made.set_defaults(run=run, parser=made)
        if study:
            made.add_argument("study", type=Path, metavar="STUDY.toml", help=study)
            made.more = _keys_of_a_study
        made.add_argument("--quiet", **flag, help="print nothing but errors")
        return made

    for name, fitted, text in (
        ("locate", True, "fit a position and print a result card"),
        ("residuals", False, "observed minus computed at the given position, no fit"),
    ):
        of_a_fit = command(name, partial(_locate, fitted=fitted), text)
        of_a_fit.add_argument("--out", **folder, help="write solution.json, residuals.csv and plots there")
        of_a_fit.add_argument(
            "--terms", **flag, help="with --out, also write terms.csv: what each model term adds"
        )
        of_a_fit.set_defaults(sinex=None)
        if fitted:
            of_a_fit.add_argument(
                "--sinex",
                type=Path,
                metavar="FILE",
                help="write the solution with its covariance in SINEX 2.02",
            )

    of_arcs = command("arcs", _arcs, "fit the first hours only, for several lengths, and compare")
    of_arcs.add_argument("--hours", **hours)
    of_arcs.add_argument("--out", **folder, help="write tables, figure and all solutions there")

    simulated = "a study file with [simulation]"
    made = command("simulate", _simulate, "simulate the tracking that a study describes", simulated)
    made.add_argument("--out", **file, metavar="FILE", required=True)
    made.add_argument("--originator", **agency)
    made.add_argument("--seed", **number, help="of all that is drawn (default: the study's)")
    made.add_argument("--draw", **flag, help="draw the errors of [simulation.truth_sigma], too")

    convert = command("convert", _convert, "read observations of any format and write them as one file", "")
    convert.add_argument(
        "files", type=Path, nargs="+", metavar="IN", help="files to read, each of any format"
    )
    convert.add_argument("out", **file, metavar="OUT")
    convert.add_argument(
        "--sigma",
        action="append",
        default=[],
        metavar="TYPE=METRES",
        help="sigmas of observations in Tracking Data Messages, which state none, such as range=1.0; one for each type",
    )
    convert.add_argument("--originator", **agency)
    convert.more = _formats

    text = "simulate the tracking that a study describes many times, and fit it, for several arcs"
    trials = command("montecarlo", _monte_carlo, text, simulated)
    trials.add_argument("--trials", **number, default=1000, help="how many (default: 1000)")
    trials.add_argument("--hours", **hours)
    trials.add_argument("--seed", **number, help="of all that is drawn (default: the study's)")
    trials.add_argument("--workers", **number, default=1, help="processes (default: 1)")
    trials.add_argument("--out", **folder, help="write trials, summary and figures there")
    trials.add_argument("--resume", **flag, help="take over the trials that are in DIR already")
    trials.add_argument("--full", **flag, help="fit every trial with the whole model")

    text = "locate a lander by its descent images, a point in an orbital image, or stereo images of landmarks"
    of_images = command("images", _images, text, "a study file with [images], [image_point] or [stereo]")
    of_images.add_argument("--out", **folder, help="write solution.json and a figure there")
    of_images.more = _keys_of_images

    text = "put solutions beside each other, test whether they agree, and combine them"
    beside = command("compare", _compare, text, "")
    beside.add_argument(
        "solutions",
        type=Path,
        nargs="+",
        metavar="SOLUTION.json",
        help="solution.json, arcs.json, or positions (TOML)",
    )
    beside.add_argument(
        "--reference",
        metavar="NAME",
        help="the benchmark: a solution's or a reference's name (default: the first reference)",
    )
    beside.add_argument("--out", **folder, help="write table, comparison.json and figure there")

    text = "write solutions for other tools: a map layer or SPICE kernels"
    other = command("export", _export, text, "")
    other.add_argument(
        "solutions", type=Path, nargs="+", metavar="SOLUTION.json", help="files solution.json or arcs.json"
    )
    other.add_argument(
        "out",
        type=Path,
        metavar="OUT",
        help="file to write, by its ending: .geojson, .gpkg, or .bsp, beside which a frames kernel .tf is written",
    )
    other.add_argument(
        "--code",
        **number,
        default=FIRST_SITE,
        help=f"NAIF code of the lander in .bsp (default: {FIRST_SITE})",
    )

    text = "draw solutions on a map, over shaded terrain or an image"
    drawn = command("map", _map, text, "")
    drawn.add_argument(
        "solutions", type=Path, nargs="+", metavar="SOLUTION.json", help="files solution.json or arcs.json"
    )
    drawn.add_argument("out", type=Path, metavar="OUT", help="file to write, .png, .svg or .pdf")
    drawn.add_argument("--dem", type=Path, metavar="FILE", help="elevation model to shade")
    drawn.add_argument("--base-map", type=Path, metavar="FILE", help="map image, in its place")
    drawn.add_argument("--reach", type=float, metavar="METRES", help="from the middle to the edges")

    text = "make a solution again from what its provenance names, and compare"
    again = command("verify", _verify, text, "")
    again.add_argument("solution", type=Path, metavar="SOLUTION.json", help="a solution.json")
    again.add_argument(
        "--study", type=Path, metavar="FILE", help="the study file, if it is no longer where it was"
    )

    text = "say how well plans of tracking, or the epochs of data, would tell the position, without trials"
    plans = command("covariance", _covariance, text, study="")
    plans.add_argument(
        "studies", type=Path, nargs="+", metavar="STUDY.toml", help="study files, each a plan or data"
    )
    plans.add_argument(
        "--hours",
        **(hours | {"default": None, "help": "lengths from the start (default: doubled up to the end)"}),
    )
    plans.add_argument(
        "--reach", type=float, metavar="METRES", help="say how long it takes to a 95 %% radius of so much"
    )
    plans.add_argument(
        "--out", **folder, help="write tables and figure there; of several plans by their names"
    )
    plans.more = _keys_of_a_study

    text = "look at kernels, Earth orientation, leap seconds, the compiler's cache and optional packages"
    command("doctor", _doctor, text, study="")

    axes = command("frames", _frames, "show a point of the Moon in the axes of each ephemeris", study="")
    for name in ("longitude", "latitude", "height"):
        unit = "above 1737.4 km, m" if name == "height" else "deg east" if name == "longitude" else "deg"
        axes.add_argument(name, type=float, help=unit)
    axes.add_argument(
        "--frame", default="ME_DE421", metavar="FRAME", help="axes of these numbers (default: ME_DE421)"
    )

    stations = commands.add_parser("stations", help="list the stations that are known by name")
    stations.add_argument(
        "name", nargs="?", default="", metavar="NAME", help="a name, an alias, or a part of one"
    )
    stations.set_defaults(run=_stations)
    return parser


def _done(options: argparse.Namespace, found: object, write: Callable[..., object], good: bool) -> int:
    """Write the files of a result if asked for, print its card, and give the exit status."""
    if options.out is not None:
        write(found, options.out)
    _tell(options, found)
    return EXIT_DONE if good else EXIT_NOT_CONVERGED


def _tell(options: argparse.Namespace, card: object) -> None:
    """Print a card and where files were written, unless told to be quiet."""
    if options.quiet:
        return
    _print(card if options.out is None else f"{card}\n\nwritten to {options.out}")


def _locate(options: argparse.Namespace, *, fitted: bool) -> int:
    """Do a study, write its files and print its card."""
    if options.terms and options.out is None:
        options.parser.error("--terms needs --out DIR, where to write terms.csv")
    study = read_study(options.study)
    arc, left_out = locate.prepared_arc(study)
    solution = locate.fit_arc(study, arc, left_out, study.estimate if fitted else None)
    if options.out is not None:
        write_report(solution, options.out, arc if options.terms else None)
    _tell(options, solution)
    if options.sinex is not None:  # after the card, which says why a solution has none
        write_sinex(solution, options.sinex)
    return EXIT_DONE if solution.converged or not fitted else EXIT_NOT_CONVERGED


def _arcs(options: argparse.Namespace) -> int:
    found = arcs(read_study(options.study), options.hours)
    return _done(options, found, write_arcs, found.converged)


def _simulate(options: argparse.Namespace) -> int:
    require_writable(options.out, options.originator)  # before the work, which may take long
    made = simulate(read_study(options.study), options.seed, draw_errors=options.draw)
    comments = [made.summary()]
    write_observations(options.out, made.observations, originator=options.originator, comments=comments)
    _tell(options, made.summary())
    return EXIT_DONE


def _convert(options: argparse.Namespace) -> int:
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
    if options.resume and options.out is None:
        options.parser.error("--resume needs --out DIR, where the trials are")
    try:
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
    except KeyboardInterrupt:
        keeps = f"{options.out} keeps" if options.out else "with --out DIR, it keeps"
        _complain(f"interrupted; {keeps} the trials made so far, and the same command with --resume goes on")
        return EXIT_INTERRUPTED
    return _done(options, found, write_monte_carlo, found.converged)


def _images(options: argparse.Namespace) -> int:
    solution = locate_images(read_image_study(options.study), progress=not options.quiet)
    return _done(options, solution, write_images, solution.converged)


def _compare(options: argparse.Namespace) -> int:
    found = compare(options.solutions, options.reference)
    return _done(options, found, write_comparison, found.consistent)


def _map(options: argparse.Namespace) -> int:
    contents = [one.content for path in options.solutions for one in read_solutions(path)[0]]
    made = plot_map(contents, dem=options.dem, base_map=options.base_map, reach_m=options.reach)
    save_figure(made, options.out)
    if not options.quiet:
        _print(f"written to {options.out}")
    return EXIT_DONE


def _export(options: argparse.Namespace) -> int:
    contents = [one.content for path in options.solutions for one in read_solutions(path)[0]]
    if options.out.suffix != ".bsp":
        written: Sequence[Path] = [write_gis(contents, options.out)]
    elif len(contents) == 1:
        written = write_spice(contents[0], options.out, code=options.code)
    else:
        raise InputError(f"{options.out}: SPICE kernels hold one lander; give one solution")
    if not options.quiet:
        _print("written to " + " and ".join(map(str, written)))
    return EXIT_DONE


def _verify(options: argparse.Namespace) -> int:
    found = verify(options.solution, options.study)
    if not options.quiet:
        _print(found)
    return EXIT_DONE if found.same else EXIT_NOT_CONVERGED


def _covariance(options: argparse.Namespace) -> int:
    studies = [read_study(path) for path in options.studies]
    if len({study.name for study in studies}) < len(studies):
        options.parser.error("two study files have one name, by which their plans are told apart; rename one")
    found = [covariance(study, options.hours, reach_m=options.reach) for study in studies]
    for plan in found:
        if options.out is not None:
            write_covariance(plan, options.out / plan.name if len(found) > 1 else options.out)
    cards = [str(plan) for plan in found]
    _tell(options, "\n\n".join([*cards, str(plans_card(found))] if len(found) > 1 else cards))
    return EXIT_DONE if all(plan.determined for plan in found) else EXIT_NOT_CONVERGED


def _doctor(options: argparse.Namespace) -> int:
    found = doctor()
    if not options.quiet:
        _print(found)
    return EXIT_DONE if found.sound else EXIT_NOT_CONVERGED


def _frames(options: argparse.Namespace) -> int:
    place = LunarPosition.from_selenographic(
        options.longitude, options.latitude, options.height, options.frame
    )
    own = place.to_frame(options.frame)  # an error where these axes are not known
    for name in dict.fromkeys(
        name for one in CONSTANTS.values() for name in (f"PA_{one.name}", one.me_frame)
    ):
        try:
            there = own.to_frame(name)
        except InputError:  # no angles lead there
            continue
        longitude_deg, latitude_deg, height_m = there.selenographic
        x, y, z = there.xyz_m
        _print(
            f"{name:<9} {longitude_deg:14.9f} {latitude_deg:13.9f} deg {height_m:11.4f} m   "
            f"{x:14.4f} {y:14.4f} {z:14.4f} m"
        )
    return EXIT_DONE


def _stations(options: argparse.Namespace) -> int:
    wanted = options.name.casefold()
    found = [
        station
        for station in StationCatalogue.default()
        if any(wanted in name.casefold() for name in (station.name, *station.aliases))
    ]
    if not found:
        raise InputError(f"no station has {options.name!r} in its name; list all with radioloc stations")
    for station in found:
        x, y, z = station.itrf_m
        _print(
            f"{station.name:<10} {station.kind:<5} {station.quality:<8} {x:15.4f} {y:15.4f} {z:15.4f} m  "
            f"{', '.join(station.aliases)}"
        )
    return EXIT_DONE


def _shown_once() -> Callable[..., None]:
    """Make what shows the library's own warnings as one line each, and each once; others as Python does."""
    seen: set[str] = set()
    as_python_does = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if not issubclass(category, RadiolocWarning):
            as_python_does(message, category, *where)
        elif str(message) not in seen:
            seen.add(str(message))
            _complain(f"warning: {message}")

    return show
