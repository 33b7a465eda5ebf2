"""Commands that simulate a tracking plan, or predict its accuracy."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import radioloc
from radioloc.cli.command import JSON, SIMULATED_STUDY, argument, command, flag, output_folder
from radioloc.cli.files import MESSAGE, observation_file
from radioloc.cli.fitting import ARC_HOURS
from radioloc.cli.output import DONE, INTERRUPTED, complain, exit_status, finish, tell

if TYPE_CHECKING:
    from radioloc.results.result import Result
    from radioloc.study import Study

_WORKERS = argument("--workers N", "processes (default: one for each core with 50 trials or sites)", int)
_RESUME = flag("--resume", "continue from the trials or sites in DIR")
_SEED = argument("--seed N", "seed of the random numbers (default: of the study)", int)


@command(
    "simulate",
    SIMULATED_STUDY,
    observation_file("--out FILE", required=True),
    *MESSAGE,
    _SEED,
    flag("--draw", "also draw the errors of [simulation.truth_sigma], as each Monte Carlo trial does"),
    examples=("plan.toml --out simulated.csv --seed 7",),
)
def simulate(options: argparse.Namespace) -> int:
    """Write simulated observations of the schedule in a study file."""
    from radioloc.io.formats import require_writable

    require_writable(options.out, options.originator)  # before the work, which may take long
    simulated = radioloc.simulate(options.study, options.seed, draw_errors=options.draw)
    summary = simulated.summary()
    radioloc.write_observations(
        options.out, simulated.observations, originator=options.originator, comments=[summary]
    )
    tell(options, summary)
    return DONE


@command(
    "montecarlo",
    SIMULATED_STUDY,
    JSON,
    argument("--trials N", "number of trials (default: 1000)", int, default=1000),
    ARC_HOURS,
    _SEED,
    _WORKERS,
    *output_folder(),
    _RESUME,
    flag("--full", "fit every trial with the whole model rather than its linearization; slow"),
    examples=(
        "plan.toml --trials 200 --hours 6 12 --out results",
        "plan.toml --trials 1000 --out results --resume",
    ),
)
def monte_carlo(options: argparse.Namespace) -> int:
    """Simulate a schedule many times, fit every trial for several arc lengths, and print the errors."""
    run = partial(
        radioloc.monte_carlo,
        options.study,
        options.trials,
        options.hours,
        seed=options.seed,
        full=options.full,
    )
    return _resumable(options, run, options.trials)


def _resumable(options: argparse.Namespace, run: Callable[..., Result], trials: int) -> int:
    """Run trials or sites on the requested workers, and finish; an interrupt names the option that continues."""
    from radioloc.jobs.workers import usual_workers

    if options.resume and options.out is None:
        options.parser.error("--resume needs --out DIR, where the trials or sites are")
    count = usual_workers(trials) if options.workers is None else options.workers
    try:
        result = run(workers=count, out=options.out, resume=options.resume, progress=not options.quiet)
    except KeyboardInterrupt:
        keeps = f"{options.out} keeps" if options.out else "with --out DIR, it keeps"
        complain(f"interrupted; {keeps} what is computed so far, and the same command with --resume goes on")
        return INTERRUPTED
    return finish(options, result)


@command(
    "covariance",
    argument("studies STUDY.toml", "study files, each with a plan or data", Path, nargs="+"),
    JSON,
    argument(
        "--hours H",
        "arc lengths in hours from the start (default: doubled from 0.5 to the end)",
        float,
        nargs="+",
    ),
    argument("--reach METRES", "find the hours after which the 95 %% radius is this small", float),
    argument("--grid DEG", "map the accuracy of landing sites at this distance", float),
    argument("--region DEG", "edges of the map: WEST SOUTH EAST NORTH", float, nargs=4),
    _WORKERS,
    _RESUME,
    *output_folder(),
    examples=(
        "plan.toml --reach 150",
        "one.toml two.toml --hours 6 12 24 --out plans",
        "plan.toml --grid 2 --out map",
    ),
)
def covariance(options: argparse.Namespace) -> int:
    """Predict how well a tracking plan, or the epochs of existing data, determine the position; no trials."""
    from radioloc.results.covariance import plans_card

    studies = [radioloc.read_study(path) for path in options.studies]
    if len({study.name for study in studies}) < len(studies):
        options.parser.error("expected study files of different names; rename one")
    if options.grid is not None:
        return _map(options, studies)
    if options.resume:
        options.parser.error("--resume is of maps; expected --grid")
    plans = [radioloc.covariance(study, options.hours, reach_m=options.reach) for study in studies]
    if len(plans) == 1:
        return finish(options, plans[0])
    if options.out is not None:
        for plan in plans:
            radioloc.write_report(options.out / plan.name, plan, html=options.report)
    card = "\n\n".join(map(str, [*plans, plans_card(plans)]))
    tell(options, card, lambda: [plan.to_dict() for plan in plans])
    return exit_status(options, *plans)


def _map(options: argparse.Namespace, studies: Sequence[Study]) -> int:
    """Map the accuracy of one plan over landing sites."""
    from radioloc.jobs.accuracy_map import NEAR_SIDE_DEG

    if len(studies) > 1 or len(options.hours or ()) > 1 or options.reach is not None:
        options.parser.error("--grid takes one study, at most one length and no --reach")
    west, south, east, north = region_deg = options.region or NEAR_SIDE_DEG
    sites = int((east - west) * (north - south) / max(options.grid, 1e-3) ** 2)
    hours = options.hours[0] if options.hours else None
    run = partial(radioloc.accuracy_map, studies[0], options.grid, region_deg=region_deg, hours=hours)
    return _resumable(options, run, sites)
