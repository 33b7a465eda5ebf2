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

    def flag(self, name: str, text: str, *short: str) -> None:
        """Take an option without a value."""
        self.add_argument(*short, name, action="store_true", help=text)

    def value(
        self, name: str, metavar: str | tuple[str, ...] | None, text: str, kind: type = str, **more: Any
    ) -> None:
        """Take an option with a value of a type, or an argument."""
        self.add_argument(name, type=kind, metavar=metavar, help=text, **more)

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

    def command(name: str, text: str, *examples: str, study: str = "", json: bool = True) -> Parser:
        sentence = f"{text[0].upper()}{text[1:]}."
        made: Parser = commands.add_parser(name, help=text, description=sentence, formatter_class=_Layout)
        made.set_defaults(parser=made, json=False)
        made.examples = tuple(f"radioloc {name} {example}".rstrip() for example in examples)
        if study:
            made.value("study", "STUDY.toml", study, Path)
            made.more = _keys_of_a_study
        if json:
            made.flag("--json", "print the result as JSON and nothing else")
        made.flag("--quiet", "print no result and no progress, only what is wrong", "-q")
        made.flag("--verbose", "say on standard error what is being done", "-v")
        return made

    def solutions(to: Parser, also: str = "") -> None:
        text = f"solution.json or arcs.json files{also}; - for standard input"
        to.value("solutions", "SOLUTION.json", text, Path, nargs="+")

    def hours(to: Parser, text: str) -> None:
        to.value("--hours", "H", text, float, nargs="+")

    def seed(to: Parser) -> None:
        to.value("--seed", "N", "seed of the random numbers (default: the one in the study file)", int)

    def span(to: Parser) -> None:
        to.value("--stations", "NAME", "stations (default: those of the study)", nargs="+", default=())
        for name, which in (("--start", "first"), ("--stop", "last")):
            to.value(name, "UTC", f"{which} epoch (default: that of the schedule or of the data)")

    def folder(to: Parser, text: str) -> None:
        to.value("--out", "DIR", text, Path)
        to.flag("--report", "with --out, also write report.html, one page that shows everything")

    def written(to: Parser, name: str, metavar: str, **more: Any) -> None:
        text = "file to write; its ending names the format: .csv, .parquet, .tdm, .kvn or .xml; - for standard output"
        to.value(name, metavar, text, Path, **more)

    def message(to: Parser) -> None:
        text = "format of what is written to standard output (default: csv)"
        to.value("--format", None, text, choices=("csv", "parquet", "tdm", "xml"), default="csv")
        text = "agency that makes the Tracking Data Message; required for .tdm, .kvn and .xml"
        to.value("--originator", "NAME", text)

    any_study = "the study file; - for standard input, with paths relative to the working directory"
    simulated = "a study file with [simulation]"
    of_arcs = "fit arcs of these lengths, in hours from the start (default: 12 24 48)"

    locate = command(
        "locate",
        "fit a position, or an orbit, to tracking data and print a result card",
        *("study.toml", "study.toml --out results --terms", "study.toml --json"),
        study=any_study,
    )
    residuals = command(
        "residuals",
        "print observed minus computed at the study's position; nothing is fitted",
        "study.toml --out results",
        study=any_study,
    )
    for to in (locate, residuals):
        folder(to, "write solution.json, residuals.csv and plots to DIR")
        to.flag("--terms", "with --out, also write terms.csv: what each term of the model adds")
        text = "write the residuals to FILE as a Tracking Data Message, .xml or KVN; needs --originator"
        to.value("--residuals-tdm", "FILE", text, Path)
        to.value("--originator", "NAME", "agency that makes that message")
        to.set_defaults(sinex=None)
    text = "write the position with its covariance to FILE, in SINEX 2.02"
    locate.value("--sinex", "FILE", text, Path)

    to = command(
        "arcs",
        "fit only the first hours of the data, for several arc lengths, and compare the positions",
        "study.toml --hours 6 12 24 --out results",
        study=any_study,
    )
    hours(to, of_arcs)
    folder(to, "write tables, a figure and all solutions to DIR")

    to = command(
        "simulate",
        "write simulated observations of the schedule in a study file",
        "plan.toml --out simulated.csv --seed 7",
        study=simulated,
        json=False,
    )
    written(to, "--out", "FILE", required=True)
    message(to)
    seed(to)
    to.flag("--draw", "also draw the errors of [simulation.truth_sigma], as each Monte Carlo trial does")

    to = command(
        "convert",
        "read observation files of any known format and write them as one file",
        *("laser.npt ranges.csv", "message.tdm ranges.csv --sigma range=1.0", "- - --format parquet"),
        json=False,
    )
    to.value("files", "IN", "files to read, each of any format; - for standard input", Path, nargs="+")
    written(to, "out", "OUT")
    to.value(
        "--sigma",
        "TYPE=METRES",
        "sigma of the observations of one type, such as range=1.0, in Tracking Data Messages, which state none; "
        "may be repeated",
        action="append",
        default=[],
    )
    text = "read as this study does, with its stations and what it says of Tracking Data Messages"
    to.value("--study", "STUDY.toml", text, Path)
    message(to)
    to.more = _formats

    to = command(
        "montecarlo",
        "simulate a schedule many times, fit every trial for several arc lengths, and print the errors",
        "plan.toml --trials 200 --hours 6 12 --out results",
        "plan.toml --trials 1000 --out results --resume",
        study=simulated,
    )
    to.value("--trials", "N", "number of trials (default: 1000)", int, default=1000)
    hours(to, of_arcs)
    seed(to)
    text = "processes to share the trials among (default: one for each core, if each has 50 trials or more)"
    to.value("--workers", "N", text, int)
    folder(to, "write trials, summary and figures to DIR")
    to.flag("--resume", "go on from the trials that are already in DIR")
    to.flag("--full", "fit every trial with the whole model rather than its linearization; slow")

    to = command(
        "images",
        "locate a lander from descent images, a point in an orbital image, or a rover from stereo images",
        "descent.toml --out results",
        study="a study file with [images], [image_point] or [stereo]",
    )
    folder(to, "write solution.json and a figure to DIR")
    to.more = _keys_of_images

    to = command(
        "compare",
        "compare solutions with each other and with published positions, test whether they agree, and combine them",
        "results/solution.json published.toml",
        "a/solution.json b/solution.json --reference b --out compared",
    )
    solutions(to, ", or positions in a TOML file")
    text = "the solution or reference to compare the others with (default: the first reference)"
    to.value("--reference", "NAME", text)
    to.value("--target", "NAME", "the target to compare, of solutions that have several")
    folder(to, "write a table, comparison.json and a figure to DIR")

    to = command(
        "export",
        "write solutions for other tools: map layers, SPICE kernels, an ephemeris message, tables",
        "results/solution.json lander.geojson",
        "results/solution.json lander.bsp",
        "results/solution.json lander.tex",
        "results/solution.json lander.oem --start 2020-12-01 --stop 2020-12-15 --originator AGENCY",
        json=False,
    )
    solutions(to)
    text = "file to write, by its ending: .geojson, .gpkg, .bsp (with a frames kernel .tf), .oem, .md or .tex"
    to.value("out", "OUT", text, Path)
    to.value("--code", "N", "NAIF code of the lander in a .bsp file (default: 301001)", int)
    to.value("--start", "UTC", "first epoch of an .oem file, such as 2020-12-01T12:00:00")
    to.value("--stop", "UTC", "last epoch of an .oem file")
    text = "from state to state of an .oem file (default: 3600)"
    to.value("--step", "SECONDS", text, float, default=3600.0)
    to.value("--originator", "NAME", "agency that makes an .oem file")

    to = command(
        "map",
        "draw solutions on a map, over shaded terrain or an image",
        "results/solution.json map.png --dem dem.tif --reach 900",
        json=False,
    )
    solutions(to)
    to.value("out", "OUT", "file to write: .png, .svg or .pdf", Path)
    to.value("--dem", "FILE", "elevation model to draw in shaded relief", Path)
    to.value("--base-map", "FILE", "image to draw instead of an elevation model", Path)
    to.value("--reach", "METRES", "distance from the middle of the map to its edges", float)

    to = command(
        "verify",
        "repeat a solution from the files that its provenance names, and report any difference",
        "results/solution.json",
        json=False,
    )
    to.value("solution", "SOLUTION.json", "a solution.json", Path)
    to.value("--study", "FILE", "the study file, if it is no longer where it was", Path)

    to = command(
        "covariance",
        "predict how well a tracking plan, or the epochs of existing data, determine the position; no trials",
        *("plan.toml --reach 150", "one.toml two.toml --hours 6 12 24 --out plans"),
    )
    to.value("studies", "STUDY.toml", "study files, each with a plan or data", Path, nargs="+")
    hours(to, "arc lengths in hours from the start (default: doubled from 0.5 to the end)")
    to.value("--reach", "METRES", "say after how many hours the 95 %% error radius is this small", float)
    folder(to, "write tables and a figure to DIR; of several plans, to a folder each")
    to.more = _keys_of_a_study

    to = command(
        "visibility",
        "list when each station sees the target of a study: rise, set and highest elevation",
        *("plan.toml", "study.toml --stations KASHI APOLLO --start 2026-12-01 --stop 2026-12-08 --json"),
        study=any_study,
    )
    span(to)
    text = "lowest elevation at the stations (default: that of the schedule, or 10)"
    to.value("--mask", "DEG", text, float)

    to = command(
        "light-time",
        "tabulate light times, ranges, Doppler and pointing of stations over a span",
        "plan.toml --links three_way --frequency 8.47e9 --out table.csv",
        "--at -51.9162 43.0584 -2550.4 --stations KASHI --start 2020-12-02 --stop 2020-12-03",
    )
    text = "a study file, whose target, model, stations and span are taken; - for standard input"
    to.value("study", "STUDY.toml", text, Path, nargs="?")
    text = "in place of a study: degrees in ME_DE421, m above 1737.4 km; needs --stations, --start and --stop"
    to.value("--at", ("LON", "LAT", "HEIGHT"), text, float, nargs=3)
    span(to)
    text = "each station by itself, the first to the others, each to each, or the target to each (default: two_way)"
    to.value("--links", None, text, choices=("two_way", "three_way", "all", "one_way"), default="two_way")
    to.value("--step", "SECONDS", "from epoch to epoch (default: 600)", float, default=600.0)
    to.value("--frequency", "HZ", "received frequency without motion, for a column of Doppler", float)
    to.value("--mask", "DEG", "lowest elevation at the stations (default: 0)", float, default=0.0)
    to.value("--out", "FILE", "write all rows and columns to FILE, as .csv", Path)

    to = command(
        "leave-one-out",
        "fit a study without each of its stations and links, and print how the position moves",
        "study.toml --out results",
        study=any_study,
    )
    folder(to, "write leave_one_out.json and leave_one_out.csv to DIR")

    to = command(
        "kernels",
        "list the kernels that are found by name, verify their checksums, or add one",
        *("", "verify", "add de430.bsp moon_pa_de430.bpc"),
    )
    text = "what to do (default: list)"
    to.value("action", None, text, nargs="?", choices=("list", "verify", "add"), default="list")
    to.value("files", "FILE", "kernel files to add", Path, nargs="*")

    text = "check kernels, Earth orientation, leap seconds, the compiler's cache and optional packages"
    command("doctor", text, "", "--json")

    to = command(
        "frames",
        "convert a point on the Moon to the axes of each ephemeris",
        *("3.6285 26.1334 -1922.9", "-51.9162 43.0584 -2550.4 --epoch 2020-12-01T15:11"),
    )
    to.value("longitude", None, "deg east", float)
    to.value("latitude", None, "deg", float)
    to.value("height", None, "above 1737.4 km, m", float)
    text = "axes of these numbers, such as PA_DE440 or, with --epoch, IAU_MOON (default: ME_DE421)"
    to.value("--frame", "FRAME", text, default="ME_DE421")
    to.value("--epoch", "UTC", "also show IAU_MOON, the IAU's mean rotation, at this epoch")

    to = command("stations", "list the stations that are known by name", "", "kashi", "china --json")
    text = "a name, an alias, a complex, a country, or a part of one"
    to.value("name", "NAME", text, nargs="?", default="")

    to = command(
        "completion",
        "print a script by which a shell completes commands, options and files",
        "bash > ~/.local/share/bash-completion/completions/radioloc",
        json=False,
    )
    to.value("shell", None, "the shell", choices=("bash", "zsh", "fish"))
    return parser


def _keys_of_a_study() -> Rows:
    from radioloc.parameters.registry import PARAMETERS
    from radioloc.study.schema import keys_of
    from radioloc.study.study import PARAMETER_KEYS
    from radioloc.study.study_file import TABLES

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
    from radioloc.jobs.image_study import TABLES
    from radioloc.study.schema import keys_of

    tables = {f"[{name}]": ", ".join(keys_of(record)) for name, record in TABLES.items()}
    return {"tables of a study file, one of [images], [image_point] and [stereo]": tables}


def _measurement_types() -> Rows:
    from radioloc.measurements.registry import MEASUREMENTS

    return {"types of measurement": {name: kind.description for name, kind in MEASUREMENTS.items()}}


def _formats() -> Rows:
    from radioloc.io.formats import READERS

    formats = {reader.name: reader.description for reader in READERS.values()}
    return {"formats that are read, told by how a file begins": formats} | _measurement_types()
