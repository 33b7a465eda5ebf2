"""The command line: ``radioloc locate``, ``residuals``, ``arcs``, ``simulate``, ``montecarlo``, ``convert``, ...

What each command does is imported once the arguments are known to be right, so that help and complaints come at once.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from radioloc.cli.output import complain, escape_unprintable_output, prepared, say, standard_streams
from radioloc.cli.parser import BAD_INPUT, DISK, INTERRUPTED, LOOKUPS, NOT_CONVERGED, make_parser
from radioloc.errors import ConvergenceError, RadiolocError, RadiolocWarning
from radioloc.text_files import disk_failed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    escape_unprintable_output()
    with warnings.catch_warnings():
        # Even where Python is told to make errors of warnings: ours are for the reader, not for a debugger.
        warnings.simplefilter("default", RadiolocWarning)
        try:
            options = make_parser().parse_args(arguments)
            with prepared(options.verbose), standard_streams(options):
                if options.command in LOOKUPS:
                    from radioloc.cli.lookups import COMMANDS
                else:
                    from radioloc.cli.commands import COMMANDS, ready

                    ready(options)
                return COMMANDS[options.command](options)
        except SystemExit:  # of --help and --version, which have printed
            say("", end="")
            raise
        except RadiolocError as error:
            complain(str(error))
            return NOT_CONVERGED if isinstance(error, ConvergenceError) else BAD_INPUT
        except OSError as error:
            complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            return DISK if disk_failed(error) else BAD_INPUT
        except KeyboardInterrupt:
            complain("interrupted")
            return INTERRUPTED
