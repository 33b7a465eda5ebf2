"""Commands that simulate a tracking plan, or predict its accuracy, passes of a target and computed observations."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import radioloc
from radioloc.cli.command import JSON, SIMULATED_STUDY, STUDIES, STUDY, argument, command, flag, output_folder
from radioloc.cli.files import MESSAGE, observation_file
from radioloc.cli.fitting import ARC_HOURS
from radioloc.cli.output import DONE, INTERRUPTED, complain, exit_status, finish, tell

if TYPE_CHECKING:
    from radioloc.results.result import Result
    from radioloc.study import Study

_SPAN = (
    argument(
        "--stations NAME",
        "stations or networks such as DSN (default: those of the study)",
        nargs="+",
        default=(),
    ),
    argument("--start UTC", "first epoch (default: of schedule or data)"),
    argument("--stop UTC", "last epoch (default: of schedule or data)"),
)


@command(
    "visibility",
    STUDY,
    JSON,
    *_SPAN,
    argument("--mask DEG", "lowest elevation at the stations (default: of the schedule, or 10)", float),
    examples=("plan.toml", "study.toml --stations KASHI APOLLO --start 2026-12-01 --stop 2026-12-08 --json"),
)
def visibility(options: argparse.Namespace) -> int:
    """List when each station sees the target of a study: rise, set and highest elevation."""
    span = {"start_utc": options.start, "stop_utc": options.stop}
    passes = radioloc.visibility(options.study, options.stations, **span, mask_deg=options.mask)
    tell(options, passes, passes.to_dict)
    return DONE


@command(
    "light-time",
    argument(
        "study STUDY.toml",
        "a study file, whose target, model, stations and span are taken; - for standard input",
        Path,
        nargs="?",
    ),
    JSON,
    argument(
        "--at LON LAT HEIGHT",
        "in place of a study: ME_DE421, m above 1737.4 km; needs --stations, --start and --stop",
        float,
        nargs=3,
    ),
    argument(
        "--eop-beyond METHOD",
        "with --at, continue Earth orientation after the end of its table",
        choices=("hold", "extrapolate"),
    ),
    *_SPAN,
    argument(
        "--links",
        "two-way, from the first station to the others, all pairs, or from the target (default: two_way)",
        choices=("two_way", "three_way", "all", "one_way"),
        default="two_way",
    ),
    argument("--step SECONDS", "from epoch to epoch (default: 600)", float, default=600.0),
    argument("--frequency HZ", "received frequency without motion, for a column of Doppler", float),
    argument("--mask DEG", "lowest elevation at the stations (default: 0)", float, default=0.0),
    argument("--out FILE", "write all rows and columns as .csv", Path),
    examples=(
        "plan.toml --links three_way --frequency 8.47e9 --out table.csv",
        "--at -51.9162 43.0584 -2550.4 --stations KASHI --start 2020-12-02 --stop 2020-12-03",
    ),
)
def light_time(options: argparse.Namespace) -> int:
    """Tabulate light times, ranges, Doppler and pointing of stations over a span."""
    from radioloc.io.table import batches_of, write_csv
    from radioloc.text_files import require_ending

    if (options.study is None) == (options.at is None):
        options.parser.error("give a study file or --at LON LAT HEIGHT")
    if options.out is not None:
        require_ending(options.out, (".csv",))
    study: radioloc.Study | Path = options.study
    if options.at is not None:
        if not (options.stations and options.start and options.stop):
            options.parser.error("--at needs --stations, --start and --stop")
        target = radioloc.LunarPosition.from_selenographic(*options.at)
        model = radioloc.study.ModelChoice(eop_beyond=options.eop_beyond)
        place = "lander at {:g} deg E, {:g} deg N, {:g} m".format(*options.at)
        study = radioloc.Study(target=target, name=place, model=model)
    elif options.eop_beyond is not None:
        options.parser.error("--eop-beyond is of --at; a study has [model] eop_beyond")
    table = radioloc.light_times(
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
        write_csv(options.out, batches_of(table.named_columns(), table.decimals))
    tell(options, table, table.to_dict)
    return DONE


_WORKERS = argument("--workers N", "processes (default: one for each core with 50 trials or sites)", int)
_SCHEDULER = argument(
    "--scheduler ADDRESS", "run on the Dask cluster of this scheduler, such as tcp://host:8786"
)
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
    _SCHEDULER,
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
    from radioloc.jobs.workers import dask_client, usual_workers

    if options.resume and options.out is None:
        options.parser.error("--resume needs --out DIR, where the trials or sites are")
    if options.scheduler and options.workers is not None:
        options.parser.error("expected --workers or --scheduler, got both")
    count = usual_workers(trials) if options.workers is None else options.workers
    workers = dask_client(options.scheduler) if options.scheduler else nullcontext(count)
    try:
        with workers as pool:
            result = run(workers=pool, out=options.out, resume=options.resume, progress=not options.quiet)
    except KeyboardInterrupt:
        keeps = f"{options.out} keeps" if options.out else "with --out DIR, it keeps"
        complain(f"interrupted; {keeps} what is computed so far, and the same command with --resume goes on")
        return INTERRUPTED
    return finish(options, result)


@command(
    "covariance",
    STUDIES,
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
    _SCHEDULER,
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
    if options.resume or options.scheduler:
        options.parser.error("--scheduler and --resume are of maps; expected --grid")
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
