"""Command that writes a starter study."""

from __future__ import annotations

import argparse
from importlib.resources import files
from pathlib import Path

from radioloc.cli.command import argument, command
from radioloc.cli.output import DONE, say
from radioloc.errors import InputError
from radioloc.text_files import require_ending, write_text

STARTERS = ("lander", "reflector", "orbiter")


@command(
    "new",
    argument("kind", "target of the study", choices=STARTERS),
    argument(
        "out STUDY.toml", "study file to write (default: the target's name in this folder)", Path, nargs="?"
    ),
    examples=("lander", "orbiter my_orbiter.toml"),
)
def new(options: argparse.Namespace) -> int:
    """Write a commented starter study, with a plan of simulated tracking to try it."""
    study: Path = options.out or Path(f"{options.kind}.toml")
    require_ending(study, (".toml",))
    if study.exists():
        raise InputError(f"{study}: the file exists; give another name")
    data = study.with_suffix(".csv")
    template = files("radioloc.cli").joinpath("starters", f"{options.kind}.toml").read_text(encoding="utf-8")
    write_text(study, template.replace("{study}", study.name).replace("{data}", data.name))
    if not options.quiet:
        say(
            f"written to {study}; try it:\n  radioloc simulate {study} --out {data}\n  radioloc locate {study}"
        )
    return DONE
