"""What the command line accepts, and its help; nothing that takes time to import."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

from radioloc._version import __version__
from radioloc.cli.output import complain

DONE, DISK, BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 0, 1, 2, 3, 130
EXIT_STATUS = {
    DONE: "done; where something is fitted, it converged",
    DISK: "the disk is full or fails; make room and run again",
    BAD_INPUT: "bad input, told in one line",
    NOT_CONVERGED: "not converged or not observable; solutions do not agree (compare) or differ (verify); the "
    "installation is not sound (doctor). What is printed says why",
    INTERRUPTED: "interrupted (Ctrl-C); montecarlo says how to go on",
}
"""Exit statuses and what they mean."""

LOOKUPS = ("doctor", "frames", "kernels", "stations", "completion")
"""Commands that do no study."""

Rows = dict[str, dict[str, str]]
"""Titles, and under each names with what they are."""


class _Layout(argparse.HelpFormatter):
    """Two columns in 80 characters, the first as wide as the longest command, whose indent argparse forgets."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=80)
        self._action_max_length = 17


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as all others, and whose help ends with examples and what registries hold."""

    examples: Sequence[str] = ()
    more: Callable[[], Rows] = dict
    """Asked only when help is."""
    commands: Mapping[str, Parser] = MappingProxyType({})
    """Parsers of commands by name."""

    def error(self, message: str) -> NoReturn:
        """End with one line."""
        complain(f"{message}; see {self.prog} --help")
        self.exit(BAD_INPUT)

    def format_help(self) -> str:
        """The usual help, then examples and tables."""
        text = super().format_help()
        if self.examples:
            text += "\nexamples:\n" + "".join(f"  {example}\n" for example in self.examples)
        for title, rows in self.more().items():
            width = min(24, max(map(len, rows)))
            text += f"\n{title}:\n"
            for name, what in rows.items():
                indent = " " * (width + 4)
                text += (
                    textwrap.fill(what, 80, initial_indent=f"  {name:<{width}}  ", subsequent_indent=indent)
                    + "\n"
                )
        return text


def make_parser() -> Parser:
    """Make the parser of all commands; what it parses says in ``command`` which one it was."""
    text = "Locate a lander on the Moon, or determine an orbit about it, from Earth-based tracking."
    parser = Parser(prog="radioloc", description=text, formatter_class=_Layout)
    parser.examples = (
        "radioloc locate study.toml --out results",
        "radioloc residuals study.toml --json",
        "radioloc locate --help",
    )
    parser.more = lambda: {"exit status": {str(status): text for status, text in EXIT_STATUS.items()}}
    parser.add_argument("--version", action="version", version=f"radioloc {__version__}")
    commands = parser.add_subparsers(required=True, title="commands", metavar="COMMAND", dest="command")
    parser.commands = commands.choices

    flag: dict[str, Any] = {"action": "store_true"}
    folder: dict[str, Any] = {"type": Path, "metavar": "DIR"}
    number: dict[str, Any] = {"type": int, "metavar": "N"}
    metres: dict[str, Any] = {"type": float, "metavar": "METRES"}
    hours: dict[str, Any] = {"type": float, "nargs": "+", "metavar": "H"}
    hours["help"] = "fit arcs of these lengths, in hours from the start (default: 12 24 48)"
    seed: dict[str, Any] = number | {
        "help": "seed of the random numbers (default: the one in the study file)"
    }
    file: dict[str, Any] = {
        "type": Path,
        "help": "file to write; its ending names the format: .csv, .parquet, .tdm, .kvn or .xml; - for standard output",
    }
    format_of_stdout: dict[str, Any] = {
        "choices": ("csv", "parquet", "tdm", "xml"),
        "default": "csv",
        "help": "format of what is written to standard output (default: csv)",
    }
    agency: dict[str, Any] = {
        "metavar": "NAME",
        "help": "agency that makes the Tracking Data Message; required for .tdm, .kvn and .xml",
    }

    def command(name: str, text: str, *examples: str, study: str = "", json: bool = True) -> Parser:
        sentence = f"{text[0].upper()}{text[1:]}."
        made: Parser = commands.add_parser(name, help=text, description=sentence, formatter_class=_Layout)
        made.set_defaults(parser=made, json=False)
        made.examples = tuple(f"radioloc {name} {example}".rstrip() for example in examples)
        if study:
            made.add_argument("study", type=Path, metavar="STUDY.toml", help=study)
            made.more = _keys_of_a_study
        if json:
            made.add_argument("--json", **flag, help="print the result as JSON and nothing else")
        made.add_argument("-q", "--quiet", **flag, help="print no result and no progress, only what is wrong")
        made.add_argument("-v", "--verbose", **flag, help="say on standard error what is being done")
        return made

    def solutions(made: Parser) -> None:
        made.add_argument(
            "solutions",
            type=Path,
            nargs="+",
            metavar="SOLUTION.json",
            help="solution.json or arcs.json files; - for standard input",
        )

    def of_a_span(to: Parser) -> None:
        to.add_argument(
            "--stations", nargs="+", default=(), metavar="NAME", help="stations (default: those of the study)"
        )
        for name, which in (("start", "first"), ("stop", "last")):
            to.add_argument(
                f"--{name}",
                metavar="UTC",
                help=f"{which} epoch (default: that of the schedule or of the data)",
            )

    def add_folder(to: Parser, text: str) -> None:
        to.add_argument("--out", **folder, help=text)
        to.add_argument(
            "--report", **flag, help="with --out, also write report.html, one page that shows everything"
        )

    file_of_a_study = "the study file; - for standard input, with paths relative to the working directory"
    for name, text, examples in (
        (
            "locate",
            "fit a position, or an orbit, to tracking data and print a result card",
            ("study.toml", "study.toml --out results --terms", "study.toml --json"),
        ),
        (
            "residuals",
            "print observed minus computed at the study's position; nothing is fitted",
            ("study.toml --out results",),
        ),
    ):
        of_a_fit = command(name, text, *examples, study=file_of_a_study)
        add_folder(of_a_fit, "write solution.json, residuals.csv and plots to DIR")
        of_a_fit.add_argument(
            "--terms", **flag, help="with --out, also write terms.csv: what each term of the model adds"
        )
        of_a_fit.add_argument(
            "--residuals-tdm",
            type=Path,
            metavar="FILE",
            help="write the residuals to FILE as a Tracking Data Message, .xml or KVN; needs --originator",
        )
        of_a_fit.add_argument("--originator", metavar="NAME", help="agency that makes that message")
        of_a_fit.set_defaults(sinex=None)
        if name == "locate":
            of_a_fit.add_argument(
                "--sinex",
                type=Path,
                metavar="FILE",
                help="write the position with its covariance to FILE, in SINEX 2.02",
            )

    of_arcs = command(
        "arcs",
        "fit only the first hours of the data, for several arc lengths, and compare the positions",
        "study.toml --hours 6 12 24 --out results",
        study=file_of_a_study,
    )
    of_arcs.add_argument("--hours", **hours)
    add_folder(of_arcs, "write tables, a figure and all solutions to DIR")

    simulated = "a study file with [simulation]"
    made = command(
        "simulate",
        "write simulated observations of the schedule in a study file",
        "plan.toml --out simulated.csv --seed 7",
        study=simulated,
        json=False,
    )
    made.add_argument("--out", **file, metavar="FILE", required=True)
    made.add_argument("--format", **format_of_stdout)
    made.add_argument("--originator", **agency)
    made.add_argument("--seed", **seed)
    made.add_argument(
        "--draw",
        **flag,
        help="also draw the errors of [simulation.truth_sigma], as each Monte Carlo trial does",
    )

    convert = command(
        "convert",
        "read observation files of any known format and write them as one file",
        "laser.npt ranges.csv",
        "message.tdm ranges.csv --sigma range=1.0",
        "- - --format parquet",
        json=False,
    )
    convert.add_argument(
        "files",
        type=Path,
        nargs="+",
        metavar="IN",
        help="files to read, each of any format; - for standard input",
    )
    convert.add_argument("out", **file, metavar="OUT")
    convert.add_argument(
        "--sigma",
        action="append",
        default=[],
        metavar="TYPE=METRES",
        help="sigma of the observations of one type, such as range=1.0, in Tracking Data Messages, which state none; "
        "may be repeated",
    )
    convert.add_argument(
        "--study",
        type=Path,
        metavar="STUDY.toml",
        help="read as this study does, with its stations and what it says of Tracking Data Messages",
    )
    convert.add_argument("--format", **format_of_stdout)
    convert.add_argument("--originator", **agency)
    convert.more = _formats

    trials = command(
        "montecarlo",
        "simulate a schedule many times, fit every trial for several arc lengths, and print the errors",
        "plan.toml --trials 200 --hours 6 12 --workers 2 --out results",
        "plan.toml --trials 1000 --out results --resume",
        study=simulated,
    )
    trials.add_argument("--trials", **number, default=1000, help="number of trials (default: 1000)")
    trials.add_argument("--hours", **hours)
    trials.add_argument("--seed", **seed)
    trials.add_argument(
        "--workers", **number, default=1, help="processes to share the trials among (default: 1)"
    )
    add_folder(trials, "write trials, summary and figures to DIR")
    trials.add_argument("--resume", **flag, help="go on from the trials that are already in DIR")
    trials.add_argument(
        "--full", **flag, help="fit every trial with the whole model rather than its linearization; slow"
    )

    of_images = command(
        "images",
        "locate a lander from descent images, a point in an orbital image, or a rover from stereo images",
        "descent.toml --out results",
        study="a study file with [images], [image_point] or [stereo]",
    )
    add_folder(of_images, "write solution.json and a figure to DIR")
    of_images.more = _keys_of_images

    beside = command(
        "compare",
        "compare solutions with each other and with published positions, test whether they agree, and combine them",
        "results/solution.json published.toml",
        "a/solution.json b/solution.json --reference b --out compared",
    )
    beside.add_argument(
        "solutions",
        type=Path,
        nargs="+",
        metavar="SOLUTION.json",
        help="solution.json or arcs.json files, or positions in a TOML file; - for standard input",
    )
    beside.add_argument(
        "--reference",
        metavar="NAME",
        help="the solution or reference to compare the others with (default: the first reference)",
    )
    add_folder(beside, "write a table, comparison.json and a figure to DIR")

    other = command(
        "export",
        "write solutions for other tools: map layers, SPICE kernels, an ephemeris message, tables",
        "results/solution.json lander.geojson",
        "results/solution.json lander.bsp",
        "results/solution.json lander.tex",
        "results/solution.json lander.oem --start 2020-12-01 --stop 2020-12-15 --originator AGENCY",
        json=False,
    )
    solutions(other)
    other.add_argument(
        "out",
        type=Path,
        metavar="OUT",
        help="file to write, by its ending: .geojson, .gpkg, .bsp (with a frames kernel .tf), .oem, .md or .tex",
    )
    other.add_argument("--code", **number, help="NAIF code of the lander in a .bsp file (default: 301001)")
    other.add_argument(
        "--start", metavar="UTC", help="first epoch of an .oem file, such as 2020-12-01T12:00:00"
    )
    other.add_argument("--stop", metavar="UTC", help="last epoch of an .oem file")
    other.add_argument(
        "--step",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="from state to state of an .oem file (default: 3600)",
    )
    other.add_argument("--originator", metavar="NAME", help="agency that makes an .oem file")

    drawn = command(
        "map",
        "draw solutions on a map, over shaded terrain or an image",
        "results/solution.json map.png --dem dem.tif --reach 900",
        json=False,
    )
    solutions(drawn)
    drawn.add_argument("out", type=Path, metavar="OUT", help="file to write: .png, .svg or .pdf")
    drawn.add_argument("--dem", type=Path, metavar="FILE", help="elevation model to draw in shaded relief")
    drawn.add_argument(
        "--base-map", type=Path, metavar="FILE", help="image to draw instead of an elevation model"
    )
    drawn.add_argument("--reach", **metres, help="distance from the middle of the map to its edges")

    again = command(
        "verify",
        "repeat a solution from the files that its provenance names, and report any difference",
        "results/solution.json",
        json=False,
    )
    again.add_argument("solution", type=Path, metavar="SOLUTION.json", help="a solution.json")
    again.add_argument(
        "--study", type=Path, metavar="FILE", help="the study file, if it is no longer where it was"
    )

    plans = command(
        "covariance",
        "predict how well a tracking plan, or the epochs of existing data, determine the position; no trials",
        "plan.toml --reach 150",
        "one.toml two.toml --hours 6 12 24 --out plans",
    )
    plans.add_argument(
        "studies", type=Path, nargs="+", metavar="STUDY.toml", help="study files, each with a plan or data"
    )
    plans.add_argument(
        "--hours",
        **hours | {"help": "arc lengths in hours from the start (default: doubled from 0.5 to the end)"},
    )
    plans.add_argument(
        "--reach", **metres, help="say after how many hours the 95 %% error radius is this small"
    )
    add_folder(plans, "write tables and a figure to DIR; of several plans, to a folder each")
    plans.more = _keys_of_a_study

    passes = command(
        "visibility",
        "list when each station sees the target of a study: rise, set and highest elevation",
        "plan.toml",
        "study.toml --stations KASHI APOLLO --start 2026-12-01 --stop 2026-12-08 --json",
        study=file_of_a_study,
    )
    of_a_span(passes)
    passes.add_argument(
        "--mask",
        type=float,
        metavar="DEG",
        help="lowest elevation at the stations (default: that of the schedule, or 10)",
    )

    light = command(
        "light-time",
        "tabulate light times, ranges, Doppler and pointing of stations over a span",
        "plan.toml --links three_way --frequency 8.47e9 --out table.csv",
        "--at -51.9162 43.0584 -2550.4 --stations KASHI --start 2020-12-02 --stop 2020-12-03",
    )
    light.add_argument(
        "study",
        type=Path,
        nargs="?",
        metavar="STUDY.toml",
        help="a study file, whose target, model, stations and span are taken; - for standard input",
    )
    light.add_argument(
        "--at",
        type=float,
        nargs=3,
        metavar=("LON", "LAT", "HEIGHT"),
        help="in place of a study: degrees in ME_DE421, m above 1737.4 km; needs --stations, --start and --stop",
    )
    of_a_span(light)
    light.add_argument(
        "--links",
        choices=("two_way", "three_way", "all", "one_way"),
        default="two_way",
        help="each station by itself, the first to the others, each to each, or the target to each (default: two_way)",
    )
    light.add_argument(
        "--step", type=float, default=600.0, metavar="SECONDS", help="from epoch to epoch (default: 600)"
    )
    light.add_argument(
        "--frequency",
        type=float,
        metavar="HZ",
        help="received frequency without motion, for a column of Doppler",
    )
    light.add_argument(
        "--mask", type=float, default=0.0, metavar="DEG", help="lowest elevation at the stations (default: 0)"
    )
    light.add_argument("--out", type=Path, metavar="FILE", help="write all rows and columns to FILE, as .csv")

    of_subsets = command(
        "leave-one-out",
        "fit a study without each of its stations and links, and print how the position moves",
        "study.toml --out results",
        study=file_of_a_study,
    )
    add_folder(of_subsets, "write leave_one_out.json and leave_one_out.csv to DIR")

    kernels = command(
        "kernels",
        "list the kernels that are found by name, verify their checksums, or add one",
        "",
        "verify",
        "add de430.bsp moon_pa_de430.bpc",
    )
    kernels.add_argument(
        "action",
        nargs="?",
        choices=("list", "verify", "add"),
        default="list",
        help="what to do (default: list)",
    )
    kernels.add_argument("files", type=Path, nargs="*", metavar="FILE", help="kernel files to add")

    command(
        "doctor",
        "check kernels, Earth orientation, leap seconds, the compiler's cache and optional packages",
        "",
        "--json",
    )

    axes = command(
        "frames",
        "convert a point on the Moon to the axes of each ephemeris",
        "3.6285 26.1334 -1922.9",
        "-51.9162 43.0584 -2550.4 --epoch 2020-12-01T15:11",
    )
    for name in ("longitude", "latitude", "height"):
        unit = "above 1737.4 km, m" if name == "height" else "deg east" if name == "longitude" else "deg"
        axes.add_argument(name, type=float, help=unit)
    axes.add_argument(
        "--frame",
        default="ME_DE421",
        metavar="FRAME",
        help="axes of these numbers, such as PA_DE440 or, with --epoch, IAU_MOON (default: ME_DE421)",
    )
    axes.add_argument(
        "--epoch", metavar="UTC", help="also show IAU_MOON, the IAU's mean rotation, at this epoch"
    )

    stations = command("stations", "list the stations that are known by name", "", "kashi", "china --json")
    stations.add_argument(
        "name",
        nargs="?",
        default="",
        metavar="NAME",
        help="a name, an alias, a complex, a country, or a part of one",
    )

    complete = command(
        "completion",
        "print a script by which a shell completes commands, options and files",
        "bash > ~/.local/share/bash-completion/completions/radioloc",
        json=False,
    )
    complete.add_argument("shell", choices=("bash", "zsh", "fish"), help="the shell")
    return parser


def _keys_of_a_study() -> Rows:
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


def _keys_of_images() -> Rows:
    from radioloc.studies.image_study import TABLES
    from radioloc.studies.schema import keys_of

    tables = {f"[{name}]": ", ".join(keys_of(record)) for name, record in TABLES.items()}
    return {"tables of a study file, one of [images], [image_point] and [stereo]": tables}


def _measurement_types() -> Rows:
    from radioloc.measurements.registry import MEASUREMENTS

    return {"types of measurement": {name: kind.description for name, kind in MEASUREMENTS.items()}}


def _formats() -> Rows:
    from radioloc.io.formats import READERS

    formats = {reader.name: reader.description for reader in READERS.values()}
    return {"formats that are read, told by how a file begins": formats} | _measurement_types()
