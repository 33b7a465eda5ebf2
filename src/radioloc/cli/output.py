"""Output of the command line: results on standard output, all else in single lines on standard error."""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, cast

from radioloc.errors import (
    ConvergenceError,
    InputError,
    PredictedEopWarning,
    RadiolocError,
    RadiolocWarning,
    legible,
    visible,
)
from radioloc.progress import erase_status

if TYPE_CHECKING:
    from radioloc.results.result import Result

DONE, DISK, BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 0, 1, 2, 3, 130
EXIT_STATUS = {
    DONE: "done; where something is fitted, it converged",
    DISK: "the disk is full or fails; make room and run again",
    BAD_INPUT: "bad input; standard error has the reason in one line",
    NOT_CONVERGED: "not converged or not observable; solutions do not agree (compare) or differ (verify), a claim "
    "fails (score); the installation is not sound (doctor). What is printed says why",
    INTERRUPTED: "interrupted (Ctrl-C); montecarlo prints how to continue",
}
"""Exit statuses and their meanings."""

_GREEN, _RED = 32, 31  # foreground colours of ECMA-48
_STATUS_LINE = re.compile(r"^(status +)(\S.*)$", re.MULTILINE)
STREAM = Path("-")  # In place of a file: standard input or output
LAST_FILE = Path("the last file")  # Default of --out: the last positional argument is the file to write


def escape_unprintable_output() -> None:
    """Make standard output show characters that its encoding lacks as escapes instead of failing."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def say(text: object, end: str = "\n", *, colour: int = 0) -> None:
    """Print at once, the status in a colour; output is dropped once its reader, such as `head`, has closed it."""
    erase_status()
    shown = visible(str(text))
    if colour and _has_colours(sys.stdout):
        shown = _STATUS_LINE.sub(lambda line: f"{line[1]}\x1b[{colour}m{line[2]}\x1b[0m", shown, count=1)
    try:
        print(shown, end=end, flush=True)
    except OSError as error:
        # Python would try to write the rest again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OSError(error.errno, error.strerror, "standard output") from None


def _has_colours(stream: TextIO) -> bool:
    """Return True for a terminal with colours; NO_COLOR switches them off (no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb"


def tell(
    options: argparse.Namespace, card: object, content: Callable[[], Any] = dict, *, colour: int = 0
) -> None:
    """Print a card and the output folder, or the content as JSON, or nothing with ``--quiet``."""
    out = getattr(options, "out", None)
    if options.json:
        from radioloc.report.files import json_text

        say(json_text(content(), ascii_only=True), end="")  # valid JSON in every encoding of the terminal
    elif not options.quiet:
        say(card if out is None else f"{card}\n\nwritten to {out}", colour=colour)


def require_report(options: argparse.Namespace) -> None:
    """Check, before long work, that a requested page can be written."""
    if getattr(options, "report", False):
        from radioloc.report.page import require_page

        if options.out is None:
            options.parser.error("--report needs --out DIR, where to write report.html")
        require_page()


def finish(options: argparse.Namespace, result: Result) -> int:
    """Write the files of a result if asked for, print its card or its numbers, and return the exit status.

    Examples
    --------
    >>> import argparse
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> radioloc.cli.finish(argparse.Namespace(json=False, quiet=True), solution)
    0
    """
    if "report" in options and options.out is not None:
        from radioloc.report.files import write_report

        write_report(options.out, result, html=options.report)
    tell(options, result, result.to_dict, colour=_GREEN if result.is_usable else _RED)
    return exit_status(options, result)


def exit_status(options: argparse.Namespace, *results: Result) -> int:
    """Return the exit status of results; without a card, print their failures on standard error."""
    failed = [result for result in results if not result.is_usable]
    for result in failed if options.quiet and not options.json else ():
        for name, status in result.failures():
            complain(f"{name or options.command}: {status}")
    return NOT_CONVERGED if failed else DONE


def complain(message: str) -> None:
    """Print a problem in one line on standard error."""
    erase_status()
    print(f"radioloc: {' '.join(legible(message).split())}", file=sys.stderr)


def failure(error: RadiolocError, where: str = "") -> int:
    """Print an error in one line on standard error and return its exit status."""
    complain(f"{where}{error}")
    return NOT_CONVERGED if isinstance(error, ConvergenceError) else BAD_INPUT


@contextmanager
def standard_streams(options: argparse.Namespace) -> Iterator[None]:
    """Replace ``-`` among the files of a command by temporary files, as readers need seekable files."""
    names = [name for name in ("files", "solutions") if name in options]
    if options.__dict__.get("out") is LAST_FILE:
        options.out = getattr(options, names[0]).pop()
        if not getattr(options, names[0]):
            options.parser.error("expected a file to write, --out FILE")
    inputs = [name for name in names if STREAM in getattr(options, name)]
    printed = "format" in options and options.out == STREAM
    if not inputs and not printed:
        yield
        return
    from radioloc.text_files import scratch_folder

    with scratch_folder() as folder:
        read, written = Path(folder, "stdin"), Path(folder, f"stdout.{getattr(options, 'format', '')}")
        if inputs:
            read.write_bytes(sys.stdin.buffer.read())
        for name in inputs:
            setattr(options, name, [read if path == STREAM else path for path in getattr(options, name)])
        if printed:
            options.out, options.quiet = written, True
        try:
            yield
        except RadiolocError as error:
            raise InputError(str(error).replace(f"{folder}{os.sep}", "")) from None
        if printed:
            sys.stdout.buffer.write(written.read_bytes())
            sys.stdout.buffer.flush()
            if written.with_suffix(".ramps.csv").exists():
                complain("warning: standard output has no place for the ramps; write to a file to keep them")


class _VisibleFormatter(logging.Formatter):
    """Formatter that escapes control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return visible(super().format(record))


@contextmanager
def logged(verbose: bool) -> Iterator[None]:
    """Print, if `verbose`, the log messages of the library with the time since the start."""
    logger = logging.getLogger("radioloc")
    handler = logging.StreamHandler()
    handler.setFormatter(_VisibleFormatter("radioloc: %(relativeCreated)6.0f ms  %(message)s"))
    level = logger.level
    if verbose:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def show_warnings_once() -> None:
    """Print each warning of the library once, as one line; others as Python does."""
    shown: set[str | type[Warning]] = set()
    as_python_does = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if not issubclass(category, RadiolocWarning):
            as_python_does(message, category, *where)
            return
        # Warnings of Earth orientation differ only in their counts.
        key = category if category is PredictedEopWarning else str(message)
        if key not in shown:
            shown.add(key)
            complain(f"warning: {message}")

    warnings.showwarning = cast(Any, show)
