"""Commands that convert observations, and that compare, verify, export or draw solutions which were written."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import radioloc
from radioloc.cli.command import JSON, Argument, Rows, argument, command, measurement_types, output_folder
from radioloc.cli.output import DONE, LAST_FILE, finish, say, tell
from radioloc.errors import InputError

_OUT = argument(
    "--out FILE",
    "file to write, in the format of its ending (default: the last argument)",
    Path,
    default=LAST_FILE,
)


def observation_file(usage: str, **keywords: Any) -> Argument:
    """Return a file of observations to write."""
    text = "file to write: .csv, .parquet, .tdm or .kvn; - for standard output"
    return argument(usage, text, Path, **keywords)


MESSAGE = (
    argument(
        "--format",
        "format of standard output (default: csv)",
        choices=("csv", "parquet", "tdm"),
        default="csv",
    ),
    argument("--originator NAME", "agency that makes the message"),
)


def _observation_formats() -> Rows:
    formats = {reader.name: reader.description for reader in radioloc.io.READERS.values()}
    return {"formats that are read, recognised by their first lines": formats} | measurement_types()


@command(
    "convert",
    argument("files IN", "files to read, each of any format; - for standard input", Path, nargs="+"),
    _OUT,
    argument(
        "--sigma TYPE=METRES",
        "sigma of a type, such as range=1.0, in Tracking Data Messages, which state none; may be repeated",
        action="append",
        default=[],
    ),
    argument("--study STUDY.toml", "read with the stations and conventions of this study", Path),
    *MESSAGE,
    examples=(
        "laser.npt --out ranges.csv",
        "message.tdm ranges.csv --sigma range=1.0",
        "- - --format parquet",
    ),
    help_tables=_observation_formats,
)
def convert(options: argparse.Namespace) -> int:
    """Read observation files of any known format and write them as one file."""
    from radioloc.io.formats import require_writable
    from radioloc.jobs.preparation import read_as

    require_writable(options.out, options.originator)  # before the reading, which may take long
    sigma_m = _sigmas_m(options.sigma)
    if options.study is not None:
        study = radioloc.read_study(options.study)
        agreed = study.observations.tdm
        tdm = replace(agreed, sigma_m={**agreed.sigma_m, **sigma_m})
        study = replace(study, observations=replace(study.observations, tdm=tdm))
        observations = read_as(study, options.files)
    else:
        try:
            agreement = radioloc.io.TdmAgreement(sigma_m=sigma_m)
            observations = radioloc.read_observations(options.files, tdm=agreement)
        except InputError as error:
            if not re.search(r"tdm_|frequencies\]|\[stations", str(error)):
                raise
            raise InputError(f"{error}; convert takes the study file as --study") from None
    written = radioloc.write_observations(options.out, observations, originator=options.originator)
    options.out = " and ".join(map(str, written))
    tell(options, observations.summary())
    return DONE


def _sigmas_m(texts: Sequence[str]) -> dict[str, float]:
    """Return sigmas by type from texts such as ``range=1.0``."""
    sigmas_m = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            sigmas_m[name] = float(number)
        except ValueError:
            raise InputError(f"--sigma {text}: write it as TYPE=METRES, such as range=1.0") from None
    return sigmas_m


def _solution_files(also: str = "") -> Argument:
    text = f"solution.json or arcs.json files{also}; - for standard input"
    return argument("solutions SOLUTION.json", text, Path, nargs="+")


def _contents(options: argparse.Namespace) -> list[Mapping[str, Any]]:
    """Return the contents of all solutions in the files given."""
    from radioloc.jobs.comparison import read_solutions

    return [solution.content for path in options.solutions for solution in read_solutions(path)[0]]


def _tell_written(options: argparse.Namespace, files: Sequence[Path]) -> int:
    if not options.quiet:
        say("written to " + " and ".join(map(str, files)))
    return DONE


@command(
    "compare",
    _solution_files(", or positions in a TOML file"),
    JSON,
    argument("--reference NAME", "compare with this solution or reference (default: the first reference)"),
    argument("--target NAME", "target to compare, of several"),
    argument("--published NAME", "also compare with published positions, such as of Chang'e-3"),
    *output_folder(),
    examples=(
        "results/solution.json published.toml",
        "a/solution.json b/solution.json --reference b --out compared",
        "results/solution.json --published 'Apollo 15 reflector'",
    ),
)
def compare(options: argparse.Namespace) -> int:
    """Compare solutions with each other and with published positions, test whether they agree, and combine them."""
    result = radioloc.compare(options.solutions, options.reference, options.target, options.published)
    return finish(options, result)


@command(
    "score",
    argument("entry ENTRY", "solution.json, or the JSON or CSV file of any program", Path, nargs="?"),
    argument("case CASE", "folder of a case, with its case.toml; without ENTRY also of several cases", Path),
    JSON,
    *output_folder(),
    examples=("results/solution.json examples/benchmark/apollo15-2006", "examples/benchmark"),
)
def score(options: argparse.Namespace) -> int:
    """Score a result of any program in a case of the benchmark, or run cases and score all their entries."""
    return finish(options, radioloc.score(options.case, options.entry))


@command(
    "verify",
    argument("solution SOLUTION.json", "a solution.json", Path),
    argument("--study FILE", "the study file, if it was moved", Path),
    examples=("results/solution.json",),
)
def verify(options: argparse.Namespace) -> int:
    """Repeat a solution from the files that its provenance names, and report any difference."""
    return finish(options, radioloc.verify(options.solution, options.study))


def _export_formats() -> Rows:
    """Return the formats of solutions that are written."""
    formats = {", ".join(item.endings): item.description for item in radioloc.io.EXPORTERS.values()}
    return {"formats, by the ending of the file": formats}


@command(
    "export",
    _solution_files(),
    _OUT,
    argument("--code N", "NAIF code of the lander in a .bsp file (default: 301001)", int),
    argument("--start UTC", "first epoch of an .oem file, such as 2020-12-01T12:00:00"),
    argument("--stop UTC", "last epoch of an .oem file"),
    argument("--step SECONDS", "from state to state of an .oem file (default: 3600)", float),
    argument("--originator NAME", "agency that makes the message"),
    argument("--target NAME", "target to write, of several"),
    examples=(
        "results/solution.json --out lander.geojson",
        "results/solution.json lander.bsp",
        "results/solution.json lander.tex",
        "results/solution.json lander.oem --start 2020-12-01 --stop 2020-12-15 --originator AGENCY",
    ),
    help_tables=_export_formats,
)
def export(options: argparse.Namespace) -> int:
    """Write solutions for other tools: map layers, SPICE kernels, an ephemeris message, tables."""
    names = {"code": "body", "start": "start_utc", "stop": "stop_utc", "step": "step_s"}
    stated = {
        names.get(name, name): value
        for name in ("code", "start", "stop", "step", "originator", "target")
        if (value := getattr(options, name)) is not None
    }
    settings = radioloc.io.ExportOptions(**stated)
    return _tell_written(options, radioloc.io.export_solutions(options.out, _contents(options), settings))


@command(
    "map",
    _solution_files(),
    _OUT,
    argument("--dem FILE", "elevation model to draw in shaded relief", Path),
    argument("--base-map FILE", "image to draw instead of an elevation model", Path),
    argument("--reach METRES", "distance from the middle of the map to its edges", float),
    examples=("results/solution.json --out map.png --dem dem.tif --reach 900",),
)
def plot_map(options: argparse.Namespace) -> int:
    """Draw solutions on a map, over shaded terrain or an image."""
    backgrounds = {"dem": options.dem, "base_map": options.base_map}
    figure = radioloc.report.plot_map(_contents(options), **backgrounds, reach_m=options.reach)
    radioloc.report.save_figure(figure, options.out)
    return _tell_written(options, [options.out])
