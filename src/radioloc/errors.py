"""Exceptions and warning classes.

Messages state the input, what is allowed and what to do; attributes have what a program needs. All exceptions derive
from :class:`RadiolocError`.
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

# A quoted text, or a word other than the name of a file, that is too long to be repeated in a message.
_LONG_TEXT = re.compile(r"""(?<!\w)(['"])(?:(?!\1).){100,}\1(?!\w)|[^\s/\\]{100,}""")
_MAX_TEXT_CHARACTERS = 80
_MAX_VALUE_CHARACTERS = 60
_MAX_PROBLEM_CHARACTERS = 1000
_MAX_MESSAGE_CHARACTERS = 3000
_MESSAGE_END_CHARACTERS = 500  # kept when a message is shortened, because its end states the remedy
_MAX_RAW_CHARACTERS = 100_000  # bounds the time of the search for long texts
# Unprintable by Python's definition, but part of the text of several scripts.
_VISIBLE = "\n\t\u00a0\u200c\u200d"


def visible(text: str) -> str:
    """Return a text with control characters, such as those that terminals obey, as escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in _VISIBLE else ascii(c)[1:-1] for c in text)


def legible(message: str) -> str:
    """Return a message of visible characters and bounded length, in which long texts are cut."""
    message = visible(_shortened(message, _MAX_RAW_CHARACTERS))
    message = _LONG_TEXT.sub(lambda match: f"{match[0][:_MAX_TEXT_CHARACTERS]}...{match[1] or ''}", message)
    return _shortened(message, _MAX_MESSAGE_CHARACTERS)


def _shortened(message: str, max_characters: int) -> str:
    if len(message) <= max_characters:
        return message
    start = message[: max_characters - _MESSAGE_END_CHARACTERS]
    return f"{start} ... {message[-_MESSAGE_END_CHARACTERS:]}"


class RadiolocError(Exception):
    """Root of the exceptions of the library."""

    def __init__(self, message: str) -> None:
        super().__init__(legible(message))


class InputError(RadiolocError, ValueError):
    """An argument, the content of a file or a key of a study is not usable."""


class FileFormatError(InputError):
    """A file cannot be read or written; ``line`` is counted from 1."""

    def __init__(self, path: str | Path, problem: str, line: int | None = None) -> None:
        self.path = Path(path)
        self.line = line
        problem = legible(problem).replace("\t", "\\t")
        self.problem = (
            f"{problem[:_MAX_PROBLEM_CHARACTERS]}{'...' * (len(problem) > _MAX_PROBLEM_CHARACTERS)}"
        )
        place = str(path) if line is None else f"{path}, line {line}"
        super().__init__(f"{place}: {self.problem}")


@contextmanager
def error_context(place: str) -> Iterator[None]:
    """Prefix the messages of input errors with the place of the wrong value, unless they name a file."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise type(error)(f"{place} {error}") from None


@contextmanager
def in_file(path: str | Path, line: int | None = None) -> Iterator[None]:
    """Turn input errors into errors of a file and line, unless they name a file."""
    try:
        yield
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(path, str(error), line) from None


def require_type(argument: str, value: object, *expected: type) -> None:
    """Raise an InputError with the argument's name unless a value has one of the expected types."""
    if isinstance(value, expected):
        return
    names = " or ".join("None" if kind is type(None) else kind.__name__ for kind in expected)
    text = " ".join(repr(value).split())
    shown = text if len(text) <= _MAX_VALUE_CHARACTERS else "..."
    raise InputError(f"{argument}: expected {names}, got {type(value).__name__} {shown}")


class KernelError(RadiolocError):
    """A kernel is missing, damaged, of the wrong kind or does not match its registered checksum."""


class CoverageError(RadiolocError):
    """An epoch is outside the span of a kernel or table, the source; ``covered`` and ``requested`` are dates."""

    def __init__(
        self, source: str, covered: tuple[str, str], requested: tuple[str, str], advice: str
    ) -> None:
        self.source = source
        self.covered = covered
        self.requested = requested
        span = requested[0] if requested[0] == requested[1] else f"{requested[0]} to {requested[1]}"
        super().__init__(f"{source} covers {covered[0]} to {covered[1]}, got {span}; {advice}")


class StationError(InputError):
    """A station is unknown, or lacks data that the model needs."""


class ConvergenceError(RadiolocError):
    """An iteration did not reach its tolerance."""


class RadiolocWarning(UserWarning):
    """Root of the warnings of the library."""

    def __init__(self, message: str) -> None:
        super().__init__(legible(message))


class PredictedEopWarning(RadiolocWarning):
    """Earth orientation parameters used are predictions, not measurements."""


class DataQualityWarning(RadiolocWarning):
    """A file marks its own data as suspect or poor."""


class FontWarning(RadiolocWarning):
    """The fonts of a figure lack characters of a name."""


class PluginWarning(RadiolocWarning):
    """An entry point of another package is left out, or a registered medium repeats a built-in one."""
