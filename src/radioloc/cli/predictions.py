"""Commands that predict passes of a target and computed observations."""

from __future__ import annotations

import argparse
from pathlib import Path

import radioloc
from radioloc.cli.command import JSON, STUDY, argument, command
from radioloc.cli.output import DONE, tell

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
        study = radioloc.Study(target=target, name="lander", model=model)
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
