"""Exceptions and warning classes.

Every exception says what was given, what is allowed and what to do; what a program needs to act on it is kept
as attributes. All derive from :class:`RadiolocError`, so one ``except`` clause catches all that the library
raises on purpose.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = [
    "ConvergenceError",
    "CoverageError",
    "DataQualityWarning",
    "FileFormatError",
    "FontWarning",
    "InputError",
    "KernelError",
    "PluginWarning",
    "PredictedEopWarning",
    "RadiolocError",
    "RadiolocWarning",
    "StationError",
]

# What a message repeats of a file or an argument: a text in quotes, or a word that is not the name of a file.
_LONG = re.compile(r"""(?<!\w)(['"])(?:(?!\1).){100,}\1(?!\w)|[^\s/\\]{100,}""")
_SHOWN_CHARACTERS = 80
_LONGEST_VALUE = 60
_LONGEST_PROBLEM = 1000
_MAX_RAW_CHARACTERS = 100_000  # that are looked at
_MAX_MESSAGE_CHARACTERS = 3000
_MESSAGE_END_CHARACTERS = 500  # of a message that is cut: what to do stands at its end
_VISIBLE = "\n\t\u00a0\u200c\u200d"  # unprintable by Python's definition, but text of several scripts


def visible(text: str) -> str:
    """Return a text with control characters, such as those that terminals obey, as escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in _VISIBLE else ascii(c)[1:-1] for c in text)


def legible(message: str) -> str:
    """Return a message of visible characters and bounded length, in which long texts of a file or argument are cut."""
    if len(message) > _MAX_RAW_CHARACTERS:
        message = f"{message[:_MAX_RAW_CHARACTERS]} ... {message[-_MESSAGE_END_CHARACTERS:]}"
    message = visible(message)
    message = _LONG.sub(lambda found: f"{found[0][:_SHOWN_CHARACTERS]}...{found[1] or ''}", message)
    if len(message) <= _MAX_MESSAGE_CHARACTERS:
        return message
    start = message[: _MAX_MESSAGE_CHARACTERS - _MESSAGE_END_CHARACTERS]
    return f"{start} ... {message[-_MESSAGE_END_CHARACTERS:]}"


class RadiolocError(Exception):
    """Root of all errors that the library raises on purpose."""

    def __init__(self, message: str) -> None:
        super().__init__(legible(message))


class InputError(RadiolocError, ValueError):
    """An argument, a file's content or a study's key is not usable as it stands."""


class FileFormatError(InputError):
    """A file could not be read as what it claims to be; ``line`` is counted from 1."""

    def __init__(self, path: str | Path, problem: str, line: int | None = None) -> None:
        self.path = Path(path)
        self.line = line
        problem = legible(problem).replace("\t", "\\t")
        self.problem = problem if len(problem) <= _LONGEST_PROBLEM else f"{problem[:_LONGEST_PROBLEM]}..."
        where = str(path) if line is None else f"{path}, line {line}"
        super().__init__(f"{where}: {self.problem}")


@contextmanager
def named(where: str) -> Iterator[None]:
    """Begin the messages of errors of input, but for those that name a file, with where the wrong value is from."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise type(error)(f"{where} {error}") from None


@contextmanager
def in_file(path: str | Path, line: int | None = None) -> Iterator[None]:
    """Turn errors of input into errors of a file and line, but for those that name a file already."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(path, str(error), line) from None


def require_type(where: str, value: object, *expected: type) -> None:
    """Raise an InputError with the argument's name if a value has none of the expected types."""
    if isinstance(value, expected):
        return
    names = " or ".join("None" if one is type(None) else one.__name__ for one in expected)
    got = " ".join(repr(value).split())
    raise InputError(
        f"{where}: expected {names}, got {type(value).__name__} {got if len(got) <= _LONGEST_VALUE else '...'}"
    )


class KernelError(RadiolocError):
    """A kernel is missing, damaged, of the wrong kind or does not match its registered checksum."""


class CoverageError(RadiolocError):
    """An epoch lies outside what a kernel or a table, the source, covers; first and last epochs are readable dates."""

    def __init__(self, source: str, covered: tuple[str, str], asked: tuple[str, str], advice: str) -> None:
        self.source = source
        self.covered = covered
        self.asked = asked
        wanted = asked[0] if asked[0] == asked[1] else f"{asked[0]} to {asked[1]}"
        super().__init__(
            f"{source} covers {covered[0]} to {covered[1]}, but {wanted} was asked for; {advice}"
        )


class StationError(InputError):
    """A station is not known, or lacks what the model needs."""


class ConvergenceError(RadiolocError):
    """An iteration did not reach its tolerance."""


class RadiolocWarning(UserWarning):
    """Root of all warnings that the library gives."""

    def __init__(self, message: str) -> None:
        super().__init__(legible(message))


class PredictedEopWarning(RadiolocWarning):
    """Earth orientation parameters used are predictions, not measurements."""


class DataQualityWarning(RadiolocWarning):
    """A file marks its own data as suspect or poor."""


class FontWarning(RadiolocWarning):
    """The fonts of a figure lack characters of a name."""


class PluginWarning(RadiolocWarning):
    """An entry point of another package cannot be used and is left out."""
