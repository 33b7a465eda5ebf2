"""Commands that simulate a tracking plan, or predict its accuracy."""

from __future__ import annotations

import argparse
from pathlib import Path

import radioloc
from radioloc.cli.command import JSON, SIMULATED_STUDY, argument, command, flag, output_folder
from radioloc.cli.files import MESSAGE, observation_file
from radioloc.cli.fitting import ARC_HOURS
from radioloc.cli.output import DONE, INTERRUPTED, complain, exit_status, finish, tell

_SEED = argument("--seed N", "seed of the random numbers (default: the one in the study file)", int)


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
    argument(
        "--workers N",
        "processes to share the trials among (default: one for each core, if each has 50 trials or more)",
        int,
    ),
    *output_folder("write trials, summary and figures to DIR"),
    flag("--resume", "go on from the trials that are already in DIR"),
    flag("--full", "fit every trial with the whole model rather than its linearization; slow"),
    examples=(
        "plan.toml --trials 200 --hours 6 12 --out results",
        "plan.toml --trials 1000 --out results --resume",
    ),
)
def monte_carlo(options: argparse.Namespace) -> int:
    """Simulate a schedule many times, fit every trial for several arc lengths, and print the errors."""
    from radioloc.jobs.workers import usual_workers

    if options.resume and options.out is None:
        options.parser.error("--resume needs --out DIR, where the trials are")
    try:
        result = radioloc.monte_carlo(
            options.study,
            options.trials,
            options.hours,
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
    argument("--reach METRES", "say after how many hours the 95 %% error radius is this small", float),
    *output_folder("write tables and a figure to DIR; of several plans, to a folder each"),
    examples=("plan.toml --reach 150", "one.toml two.toml --hours 6 12 24 --out plans"),
)
def covariance(options: argparse.Namespace) -> int:
    """Predict how well a tracking plan, or the epochs of existing data, determine the position; no trials."""
    from radioloc.results.covariance import plans_card

    studies = [radioloc.read_study(path) for path in options.studies]
    if len({study.name for study in studies}) < len(studies):
        options.parser.error("expected study files of different names; rename one")
    plans = [radioloc.covariance(study, options.hours, reach_m=options.reach) for study in studies]
    if len(plans) == 1:
        return finish(options, plans[0])
    if options.out is not None:
        for plan in plans:
            radioloc.write_report(options.out / plan.name, plan, html=options.report)
    card = "\n\n".join(map(str, [*plans, plans_card(plans)]))
    tell(options, card, lambda: [plan.to_dict() for plan in plans])
    return exit_status(options, *plans)
