"""What each command does: read, compute, write files, print, and give the exit status."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from radioloc.cli.output import complain, say, tell
from radioloc.cli.parser import DONE, INTERRUPTED, NOT_CONVERGED
from radioloc.errors import InputError
from radioloc.io.formats import read_observations, require_writable, write_observations
from radioloc.io.tdm import TdmAgreement
from radioloc.jobs import locate
from radioloc.jobs.arcs import arcs, leave_one_out
from radioloc.jobs.comparison import compare, read_solutions
from radioloc.jobs.covariance import covariance
from radioloc.jobs.image_study import read_image_study
from radioloc.jobs.images import locate_images
from radioloc.jobs.monte_carlo import monte_carlo
from radioloc.jobs.passes import light_times, visibility
from radioloc.jobs.selection import DEFAULT_HOURS
from radioloc.jobs.simulate import simulate
from radioloc.jobs.verification import verify
from radioloc.jobs.workers import usual_workers
from radioloc.lunar.position import LunarPosition
from radioloc.report.ccsds import write_oem, write_residuals_tdm
from radioloc.report.figures import save_figure
from radioloc.report.files import (
    write_arcs,
    write_comparison,
    write_covariance,
    write_images,
    write_leave_one_out,
    write_monte_carlo,
    write_report,
)
from radioloc.report.gis import GIS_ENDINGS, write_gis
from radioloc.report.map_figures import plot_map
from radioloc.report.page import is_usable, require_page
from radioloc.report.sinex import write_sinex
from radioloc.report.spice_kernels import FIRST_SITE, write_spice
from radioloc.results.covariance import plans_card
from radioloc.results.solution import Solution
from radioloc.results.solution_card import solution_card
from radioloc.results.subsets import ArcStudy, LeaveOneOut
from radioloc.results.tables import TABLE_ENDINGS, solution_table, write_table_file
from radioloc.study.study import Study, TerrainPrior
from radioloc.study.study_file import read_study


def ready(options: argparse.Namespace) -> None:
    """Complain, before work that may take long, of a page that could not be written after it."""
    if getattr(options, "report", False):
        if options.out is None:
            options.parser.error("--report needs --out DIR, where to write report.html")
        require_page()


def _done(options: argparse.Namespace, found: Any, write: Callable[..., object]) -> int:
    """Write the files of a result if asked for, print its card or its numbers, and give the exit status."""
    if options.out is not None:
        write(found, options.out, html=options.report)
    tell(options, found, found.to_dict)
    return _exit_status(options, found)


def _exit_status(options: argparse.Namespace, *results: Any) -> int:
    """Give the exit status of results; where no card says so, tell on standard error what is wrong with them."""
    failed = [result for result in results if not is_usable(result)]
    for result in failed if options.quiet and not options.json else ():
        for part in [arc.solution for arc in result.arcs] if isinstance(result, ArcStudy) else [result]:
            if not is_usable(part):
                whole = part.solution if isinstance(part, LeaveOneOut) else part
                card = solution_card(whole) if isinstance(whole, Solution) else whole.card()
                status = "; ".join(
                    line for field in card.fields if field.label == "status" for line in field.lines
                )
                complain(f"{getattr(whole, 'name', options.command)}: {status}")
    return NOT_CONVERGED if failed else DONE


def _locate(options: argparse.Namespace) -> int:
    """Do a study, write its files and print its card."""
    if options.terms and options.out is None:
        options.parser.error("--terms needs --out DIR, where to write terms.csv")
    if options.residuals_tdm is not None and options.originator is None:
        options.parser.error("--residuals-tdm needs --originator NAME, the agency that makes the message")
    fitted = options.command == "locate"
    study = read_study(options.study)
    if not fitted:
        locate.require_apriori_state(study)
    arc, left_out = locate.prepared_arc(study)
    solution = locate.fit_arc(study, arc, left_out, study.estimate if fitted else None)
    if options.out is not None:
        prior = study.estimate.height_prior
        dem = prior.terrain if fitted and isinstance(prior, TerrainPrior) else None
        write_report(solution, options.out, arc if options.terms else None, html=options.report, dem=dem)
    if options.residuals_tdm is not None:
        write_residuals_tdm(solution, arc.observations, options.residuals_tdm, originator=options.originator)
    tell(options, solution, solution.to_dict)
    if options.sinex is not None:  # after the card, which says why a solution has none
        write_sinex(solution, options.sinex)
    return _exit_status(options, solution) if fitted else DONE


def _simulate(options: argparse.Namespace) -> int:
    require_writable(options.out, options.originator)  # before the work, which may take long
    made = simulate(read_study(options.study), options.seed, draw_errors=options.draw)
    comments = [made.summary()]
    write_observations(options.out, made.observations, originator=options.originator, comments=comments)
    tell(options, made.summary())
    return DONE


def _convert(options: argparse.Namespace) -> int:
    require_writable(options.out, options.originator)  # before the reading, which may take long
    sigma_m = _sigmas(options.sigma)
    if options.study is not None:
        study = read_study(options.study)
        agreed = study.observations.tdm
        tdm = replace(agreed, sigma_m={**agreed.sigma_m, **sigma_m})
        study = replace(study, observations=replace(study.observations, tdm=tdm))
        observations = locate.read_as(study, options.files)
    else:
        try:
            observations = read_observations(options.files, tdm=TdmAgreement(sigma_m=sigma_m))
        except InputError as error:
            if not re.search(r"tdm_|frequencies\]|\[stations", str(error)):
                raise
            raise InputError(f"{error}; convert takes the study file as --study") from None
    written = write_observations(options.out, observations, originator=options.originator)
    options.out = " and ".join(map(str, written))
    tell(options, observations.summary())
    return DONE


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
            options.hours or DEFAULT_HOURS,
            seed=options.seed,
            workers=usual_workers(options.trials) if options.workers is None else options.workers,
            out=options.out,
            resume=options.resume,
            full=options.full,
            progress=not options.quiet,
        )
    except KeyboardInterrupt:
        keeps = f"{options.out} keeps" if options.out else "with --out DIR, it keeps"
        complain(f"interrupted; {keeps} the trials made so far, and the same command with --resume goes on")
        return INTERRUPTED
    return _done(options, found, write_monte_carlo)


def _images(options: argparse.Namespace) -> int:
    found = locate_images(read_image_study(options.study), progress=not options.quiet)
    return _done(options, found, write_images)


def _contents(options: argparse.Namespace) -> list[Mapping[str, Any]]:
    return [one.content for path in options.solutions for one in read_solutions(path)[0]]


def _written(options: argparse.Namespace, files: Sequence[Path]) -> int:
    if not options.quiet:
        say("written to " + " and ".join(map(str, files)))
    return DONE


def _map(options: argparse.Namespace) -> int:
    made = plot_map(_contents(options), dem=options.dem, base_map=options.base_map, reach_m=options.reach)
    save_figure(made, options.out)
    return _written(options, [options.out])


def _export(options: argparse.Namespace) -> int:
    contents, ending = _contents(options), options.out.suffix
    if ending in (".bsp", ".oem") and len(contents) > 1:
        raise InputError(f"{options.out}: such a file holds one lander; give one solution")
    if ending == ".bsp":
        code = FIRST_SITE if options.code is None else options.code
        written: Sequence[Path] = write_spice(contents[0], options.out, code=code)
    elif ending == ".oem":
        for name in ("start", "stop", "originator"):
            if getattr(options, name) is None:
                options.parser.error(f"{options.out} needs --{name}")
        span, agency = (options.start, options.stop), options.originator
        written = [write_oem(contents[0], options.out, *span, originator=agency, step_s=options.step)]
    elif ending in TABLE_ENDINGS:
        written = [write_table_file(solution_table(contents), options.out)]
    elif ending in GIS_ENDINGS:
        written = [write_gis(contents, options.out)]
    else:
        known = ", ".join((*GIS_ENDINGS, ".bsp", ".oem", *TABLE_ENDINGS))
        raise InputError(f"{options.out}: the ending says no format that is written; use one of {known}")
    return _written(options, written)


def _verify(options: argparse.Namespace) -> int:
    found = verify(options.solution, options.study)
    if not options.quiet:
        say(found)
    elif not found.same:
        complain(f"{found.name}: DIFFERS in {len(found.differences)} of {found.compared} values")
    return DONE if found.same else NOT_CONVERGED


def _covariance(options: argparse.Namespace) -> int:
    studies = [read_study(path) for path in options.studies]
    if len({study.name for study in studies}) < len(studies):
        options.parser.error("two study files have one name, by which their plans are told apart; rename one")
    found = [covariance(study, options.hours, reach_m=options.reach) for study in studies]
    for plan in found:
        if options.out is not None:
            folder = options.out / plan.name if len(found) > 1 else options.out
            write_covariance(plan, folder, html=options.report)
    cards = [str(plan) for plan in found]
    card = "\n\n".join([*cards, str(plans_card(found))] if len(found) > 1 else cards)
    tell(options, card, lambda: [plan.to_dict() for plan in found] if len(found) > 1 else found[0].to_dict())
    return _exit_status(options, *found)


def _visibility(options: argparse.Namespace) -> int:
    found = visibility(
        options.study,
        options.stations,
        start_utc=options.start,
        stop_utc=options.stop,
        mask_deg=options.mask,
    )
    tell(options, found, found.to_dict)
    return DONE


def _light_time(options: argparse.Namespace) -> int:
    if (options.study is None) == (options.at is None):
        options.parser.error("give a study file or --at LON LAT HEIGHT")
    if options.out is not None and options.out.suffix != ".csv":
        raise InputError(f"{options.out}: such a table is written as .csv")
    study: Study | Path = options.study
    if options.at is not None:
        if not (options.stations and options.start and options.stop):
            options.parser.error("--at needs --stations, --start and --stop")
        study = Study(target=LunarPosition.from_selenographic(*options.at), name="lander")
    found = light_times(
        study,
        options.stations,
        links=options.links,
        start_utc=options.start,
        stop_utc=options.stop,
        step_s=options.step,
        frequency_hz=options.frequency,
        mask_deg=options.mask,
    )
    if options.out is not None:
        found.write_csv(options.out)
    tell(options, found, found.to_dict)
    return DONE


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "locate": _locate,
    "residuals": _locate,
    "arcs": lambda o: _done(o, arcs(read_study(o.study), o.hours or DEFAULT_HOURS), write_arcs),
    "simulate": _simulate,
    "convert": _convert,
    "montecarlo": _monte_carlo,
    "images": _images,
    "compare": lambda o: _done(o, compare(o.solutions, o.reference, o.target), write_comparison),
    "export": _export,
    "map": _map,
    "verify": _verify,
    "covariance": _covariance,
    "leave-one-out": lambda o: _done(o, leave_one_out(o.study, progress=not o.quiet), write_leave_one_out),
    "light-time": _light_time,
    "visibility": _visibility,
}
"""Commands by name."""
