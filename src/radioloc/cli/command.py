"""Commands of the command line and the arguments that they declare; nothing here takes time to import."""

from __future__ import annotations

import argparse
import difflib
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

from radioloc.cli.output import BAD_INPUT, complain

Rows = dict[str, dict[str, str]]  # Names with descriptions, by title


class Layout(argparse.HelpFormatter):
    """Two columns in 80 characters, the first as wide as the longest command, whose indent argparse forgets."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=80)
        self._action_max_length = 17


class Parser(argparse.ArgumentParser):
    """Parser with errors of one line, and with examples and tables below its help."""

    examples: Sequence[str] = ()
    help_tables: Callable[[], Rows] = dict
    """Called only when help is asked for."""
    commands: Mapping[str, Parser] = MappingProxyType({})
    """Parsers of commands by name."""
    options: Sequence[str] = ()
    """Names of the options of all commands."""

    def error(self, message: str) -> NoReturn:
        """End the program with one line, which suggests the nearest command or option."""
        if unknown := re.match(r"argument COMMAND: invalid choice: '(.*?)'", message):
            message = f"unknown command {unknown[1]!r}{_suggestion(unknown[1], self.commands)}"
        elif unknown := re.match(r"unrecognized arguments: (\S+)", message):
            option = unknown[1].partition("=")[0]
            is_of_others = option in self.options
            message += " (an option of other commands)" if is_of_others else _suggestion(option, self.options)
        complain(f"{message}; see {self.prog} --help")
        self.exit(BAD_INPUT)

    def format_help(self) -> str:
        """Return the usual help, followed by examples and tables."""
        text = super().format_help()
        if self.examples:
            text += "\nexamples:\n" + "".join(f"  {example}\n" for example in self.examples)
        return text + "".join(f"\n{table}" for table in text_tables(self.help_tables()))


def text_tables(tables: Rows) -> Iterator[str]:
    """Yield each table as text: its title, and names beside their descriptions."""
    for title, rows in tables.items():
        width = min(24, max(map(len, rows)))
        lines = [
            textwrap.fill(
                text, 80, initial_indent=f"  {name:<{width}}  ", subsequent_indent=" " * (width + 4)
            )
            for name, text in rows.items()
        ]
        yield "\n".join((f"{title}:", *lines, ""))


def _suggestion(name: str, names: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(name, names, n=1)
    return f" (did you mean {nearest[0]}?)" if nearest else ""


@dataclass(frozen=True, slots=True)
class Argument:
    """Names and keywords of an argument, as :meth:`argparse.ArgumentParser.add_argument` takes them."""

    names: tuple[str, ...]
    keywords: Mapping[str, Any]


def argument(usage: str, text: str, kind: type = str, **keywords: Any) -> Argument:
    """Return an option or a positional argument of a type from its name and placeholders.

    Keywords beside these are those of :meth:`argparse.ArgumentParser.add_argument`.

    Examples
    --------
    >>> from radioloc.cli import argument
    >>> argument("--hours H", "arc lengths in hours", float, nargs="+").names
    ('--hours',)
    """
    name, *places = usage.split()
    metavar = tuple(places) if len(places) > 1 else places[0] if places else None
    return Argument((name,), {"metavar": metavar, "help": text, "type": kind, **keywords})


def flag(name: str, text: str, *short: str) -> Argument:
    """Return an option without a value.

    Examples
    --------
    >>> from radioloc.cli import flag
    >>> flag("--terms", "also write terms.csv", "-t").names
    ('-t', '--terms')
    """
    return Argument((*short, name), {"action": "store_true", "help": text})


def study_file(text: str) -> Argument:
    """Return the study file as a positional argument."""
    return argument("study STUDY.toml", text, Path)


def output_folder() -> tuple[Argument, Argument]:
    """Return the options ``--out`` and ``--report``, which :func:`radioloc.cli.finish` obeys.

    Examples
    --------
    >>> from radioloc.cli import output_folder
    >>> [option.names for option in output_folder()]
    [('--out',), ('--report',)]
    """
    page = flag("--report", "with --out, also write the page report.html")
    return argument("--out DIR", "write all files of the result to DIR", Path), page


STUDY = study_file("the study file (keys: radioloc new keys); - for standard input, in the working directory")
"""The study file as the positional argument ``study``."""
STUDIES = argument(
    "studies STUDY.toml",
    f"{STUDY.keywords['help']}; several have a folder each in --out, named after the file or its folder",
    Path,
    nargs="+",
)
SIMULATED_STUDY = study_file("a study file with [simulation] (keys: radioloc new keys)")
JSON = flag("--json", "print the result as JSON and nothing else")
"""The option ``--json``, which :func:`radioloc.cli.finish` obeys."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the command line, for the group of entry points ``radioloc.commands``."""

    name: str  #: name, such as ``leave-one-out``
    summary: str  #: sentence that describes the command
    #: Arguments beside ``--quiet`` and ``--verbose``, which all commands have.
    arguments: tuple[Argument, ...]
    #: Function of the parsed arguments that does the work and returns the exit status. Slow imports are imported
    #: inside it. The attribute ``parser`` of the arguments is the parser of the command.
    run: Callable[[argparse.Namespace], int]
    examples: tuple[str, ...] = ()  #: arguments of examples, shown with the help
    #: Function that returns tables shown below the help: by title, names with their descriptions.
    help_tables: Callable[[], Rows] = dict


def command(
    name: str, *arguments: Argument, examples: tuple[str, ...] = (), help_tables: Callable[[], Rows] = dict
) -> Callable[[Callable[[argparse.Namespace], int]], Command]:
    """Return a decorator that makes a :class:`Command` of the function that runs it, whose docstring is the summary.

    Parameters are those of :class:`Command`.

    Examples
    --------
    >>> from radioloc.cli import STUDY, command
    >>> @command("largest", STUDY)
    ... def largest(options):
    ...     "Print the largest residual of a study."
    ...     return 0
    >>> largest.name, largest.summary
    ('largest', 'Print the largest residual of a study.')
    """
    return lambda run: Command(name, run.__doc__ or "", arguments, run, examples, help_tables)


def study_tables() -> Rows:
    """Return the tables of a study file with their keys, the parameters, and the types of measurement."""
    from radioloc.parameters.registry import PARAMETERS
    from radioloc.study.schema import STUDY_TABLES, keys_of
    from radioloc.study.study import PARAMETER_KEYS
    from radioloc.study.study_file import TABLES

    records = TABLES | {entry.name: entry.record for entry in STUDY_TABLES.values() if entry.run is None}
    tables = {
        f"[{table}]": ", ".join(
            key for key in keys_of(record) if table != "estimate" or key not in PARAMETER_KEYS
        )
        for table, record in records.items()
    }
    parameters = {f"{name} ({kind.unit})": kind.description for name, kind in PARAMETERS.items()}
    return {
        "tables of a study file": tables,
        "parameters, each with NAME_UNIT, NAME_sigma_UNIT and NAME_per, in [estimate] or [consider]": parameters,
    } | measurement_types()


def measurement_types() -> Rows:
    """Return the types of measurement with their descriptions."""
    from radioloc.measurements.registry import MEASUREMENTS

    return {"types of measurement": {name: kind.description for name, kind in MEASUREMENTS.items()}}
