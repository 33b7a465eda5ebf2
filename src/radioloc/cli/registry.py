"""Registry of commands, and the parser of all of them."""

from __future__ import annotations

from radioloc._version import __version__
from radioloc.cli import files, fitting, lookups, planning
from radioloc.cli.command import Command, Layout, Parser, flag
from radioloc.cli.output import EXIT_STATUS
from radioloc.plugins import Registry, entry_errors

COMMANDS = Registry(
    "radioloc.commands",
    Command,
    (
        lookups.new,
        *(fitting.locate, fitting.residuals, fitting.arcs, fitting.leave_one_out),
        *(planning.simulate, planning.covariance, planning.monte_carlo),
        *(planning.visibility, planning.light_time),
        *(files.convert, files.compare, files.score, files.verify, files.export, files.plot_map),
        *(lookups.kernels, lookups.doctor, lookups.frames, lookups.stations, lookups.completion),
    ),
)
"""Commands by name, in the order of the help."""


_COMMON = (
    flag("--quiet", "print no result and no progress, only what is wrong", "-q"),
    flag("--verbose", "say on standard error what is being done", "-v"),
)


def make_parser() -> Parser:
    """Return the parser of all commands; the arguments it parses carry the `run` and the `parser` of their command."""
    text = "Locate a lander on the Moon, or determine an orbit about it, from Earth-based tracking."
    program = Parser(prog="radioloc", description=text, formatter_class=Layout)
    program.examples = (
        "radioloc locate study.toml --out results",
        "radioloc residuals study.toml --json",
        "radioloc locate --help",
    )
    program.help_tables = lambda: {
        "exit status": {str(status): meaning for status, meaning in EXIT_STATUS.items()}
    }
    program.add_argument("--version", action="version", version=f"radioloc {__version__}")
    commands = program.add_subparsers(required=True, title="commands", metavar="COMMAND", dest="command")
    program.commands = commands.choices
    arguments = [item for command in COMMANDS.values() for item in (*command.arguments, *_COMMON)]
    program.options = [name for item in arguments for name in item.names if name.startswith("-")]
    for name, command in COMMANDS.items():
        summary = command.summary.replace("%", "%%")
        line = summary[:1].lower() + summary[1:].rstrip(".")
        parser: Parser = commands.add_parser(name, help=line, description=summary, formatter_class=Layout)
        parser.set_defaults(run=command.run, parser=parser, program=program, json=False)
        parser.examples = tuple(f"radioloc {name} {example}".rstrip() for example in command.examples)
        parser.help_tables = command.help_tables
        with entry_errors(f"command {name}", "arguments"):
            for argument in (*command.arguments, *_COMMON):
                parser.add_argument(*argument.names, **argument.keywords)
    return program
