"""Commands that fit a study, or parts of its data."""

from __future__ import annotations

import argparse
from pathlib import Path

import radioloc
from radioloc.cli.command import JSON, STUDIES, STUDY, argument, command, flag, output_folder
from radioloc.cli.output import DONE, exit_status, failure, finish, tell
from radioloc.errors import RadiolocError

ARC_HOURS = argument(
    "--hours H",
    "arc lengths in hours from the start (default: 12 24 48)",
    float,
    nargs="+",
    default=(12.0, 24.0, 48.0),
)
_FIT = (
    STUDIES,
    JSON,
    *output_folder(),
    flag("--terms", "with --out, also write terms.csv: contribution of each term"),
)


@command(
    "locate",
    *_FIT,
    argument("--sinex FILE", "write the position with its covariance in SINEX 2.02", Path),
    examples=("study.toml", "study.toml --out results --terms", "a.toml b.toml --out results --quiet"),
)
def locate(options: argparse.Namespace) -> int:
    """Fit a position, or an orbit, to tracking data and print a result card."""
    if options.sinex is not None and len(options.studies) > 1:
        options.parser.error("--sinex takes one study, got several; run locate for each")
    return _fit(options, fitted=True)


@command("residuals", *_FIT, examples=("study.toml --out results",))
def residuals(options: argparse.Namespace) -> int:
    """Print observed minus computed at the study's position; nothing is fitted."""
    return _fit(options, fitted=False)


def _fit(options: argparse.Namespace, *, fitted: bool) -> int:
    """Fit studies one after another, even if one fails, and print their cards; return the highest exit status."""
    if options.terms and options.out is None:
        options.parser.error("--terms needs --out DIR, where to write terms.csv")
    statuses, contents, several = [], [], len(options.studies) > 1
    names = [path.stem for path in options.studies]
    if len(set(names)) < len(names):  # such as a/study.toml and b/study.toml
        names = [path.resolve().parent.name for path in options.studies]
    if len(set(names)) < len(names):
        options.parser.error("expected study files, or their folders, of different names; rename one")
    for path, name in zip(options.studies, names, strict=True):
        out = options.out / name if several and options.out else options.out
        single = argparse.Namespace(**vars(options) | {"out": out})
        try:
            solution = _solution(single, path, fitted=fitted)
        except RadiolocError as error:
            if not several:
                raise
            statuses.append(failure(error, f"{name}: "))
            continue
        if options.json:
            contents.append(solution.to_dict())
        else:
            tell(single, f"\n{solution}" if statuses else solution)
        if fitted and options.sinex is not None:  # after the card, which says why a solution has none
            from radioloc.io.sinex import write_sinex

            write_sinex(options.sinex, solution)
        statuses.append(exit_status(single, solution) if fitted else DONE)
    if options.json:
        tell(options, "", lambda: contents if several else contents[0])
    return max(statuses)


def _solution(options: argparse.Namespace, path: Path, *, fitted: bool) -> radioloc.Solution:
    """Fit a study and write its files."""
    from radioloc.jobs.locate import fit_arc
    from radioloc.jobs.preparation import prepared_arc
    from radioloc.study.study import TerrainPrior

    study = radioloc.read_study(path)
    predictor, left_out = prepared_arc(study)
    solution = fit_arc(study, predictor, left_out, fixed=not fitted)
    if options.out is not None:
        prior = study.estimate.height_prior
        dem = prior.terrain if fitted and isinstance(prior, TerrainPrior) else None
        terms = predictor if options.terms else None
        radioloc.write_report(options.out, solution, terms, html=options.report, dem=dem)
    return solution


@command(
    "arcs", STUDY, JSON, ARC_HOURS, *output_folder(), examples=("study.toml --hours 6 12 24 --out results",)
)
def arcs(options: argparse.Namespace) -> int:
    """Fit only the first hours of the data, for several arc lengths, and compare the positions."""
    return finish(options, radioloc.arcs(options.study, options.hours))


@command("leave-one-out", STUDY, JSON, *output_folder(), examples=("study.toml --out results",))
def leave_one_out(options: argparse.Namespace) -> int:
    """Fit a study without each of its stations and links, and print how the position moves."""
    result = radioloc.leave_one_out(options.study, progress=not options.quiet)
    return finish(options, result)
