"""The command line: ``radioloc locate``, ``residuals``, ``arcs``, ``simulate``, ``montecarlo``, ``convert``, ...

Commands import what they need once their arguments are known to be right, so that help and errors come at once.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from radioloc.cli.command import JSON, STUDY, Argument, Command, argument, command, flag, output_folder
from radioloc.cli.output import (
    BAD_INPUT,
    DISK,
    INTERRUPTED,
    complain,
    escape_unprintable_output,
    failure,
    finish,
    logged,
    require_report,
    say,
    show_warnings_once,
    standard_streams,
)
from radioloc.cli.registry import make_parser
from radioloc.errors import RadiolocError, RadiolocWarning
from radioloc.progress import SILENT, status_line

__all__ = [
    "JSON",
    "STUDY",
    "Argument",
    "Command",
    "argument",
    "command",
    "finish",
    "flag",
    "main",
    "output_folder",
]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Examples
    --------
    >>> from radioloc.cli import main
    >>> main(["locate", "examples/apollo15/apollo15.toml", "--quiet"])
    0
    """
    escape_unprintable_output()
    with warnings.catch_warnings():
        # Even where Python is told to make errors of warnings: ours are for the reader, not for a debugger.
        warnings.simplefilter("default", RadiolocWarning)
        show_warnings_once()
        token = SILENT.set(SILENT.get())
        try:
            options = make_parser().parse_args(arguments)
            SILENT.set(options.quiet)
            with logged(options.verbose), standard_streams(options), status_line(options.command):
                require_report(options)
                status: int = options.run(options)
                return status
        except SystemExit:  # of --help and --version, which have printed
            say("", end="")
            raise
        except RadiolocError as error:
            return failure(error)
        except OSError as error:
            from radioloc.text_files import disk_failed

            complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            return DISK if disk_failed(error) else BAD_INPUT
        except KeyboardInterrupt:
            complain("interrupted")
            return INTERRUPTED
        finally:
            SILENT.reset(token)
