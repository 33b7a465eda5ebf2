"""Reading a TOML table so that every mistake in it is one clear sentence naming the file, the table and the key."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from radioloc.errors import InputError


class TomlTable:
    """One table of a study file; keys are taken from it one by one, and what is left over is an error.

    Parameters
    ----------
    path : Path
        The study file, for messages.
    name : str
        The table's name, such as ``"estimate"``.
    content : mapping
        What TOML gave for it.
    """

    def __init__(self, path: Path, name: str, content: Any) -> None:
        self._path = path
        self.name = name
        if not isinstance(content, Mapping):
            raise InputError(f"{path}: [{name}] must be a table, not {content!r}")
        self._content = dict(content)
        self._asked: list[str] = []

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise :class:`InputError` about one key."""
        raise InputError(f"{self._path}: [{self.name}] {key}: {problem}")

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def take(self, key: str) -> Any:
        """Value of a key, ``None`` where it is absent; the key then counts as known."""
        self._asked.append(key)
        return self._content.pop(key, None)

    def number(self, key: str, *, positive: bool = False) -> float | None:
        """Take a finite number."""
        value = self.take(key)
        return None if value is None else self.as_number(key, value, positive=positive)

    def as_number(self, key: str, value: Any, *, positive: bool = False) -> float:
        """Check that a value is a finite number."""
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            self.fail(key, f"must be a finite number, not {value!r}")
        if positive and value <= 0:
            self.fail(key, f"must be above zero, not {value!r}")
        return float(value)

    def text(self, key: str) -> str | None:
        """Take a string."""
        value = self.take(key)
        if value is not None and not isinstance(value, str):
            self.fail(key, f"must be a string, not {value!r}")
        return value

    def choice(self, key: str, allowed: tuple[str, ...]) -> str | None:
        """Take a string that must be one of some."""
        value = self.text(key)
        if value is not None and value not in allowed:
            self.fail(key, f"{value!r} is not one of {', '.join(map(repr, allowed))}")
        return value

    def texts(self, key: str) -> tuple[str, ...] | None:
        """Take a list of strings; a single string stands for a list of one."""
        value = self.take(key)
        if value is None:
            return None
        if isinstance(value, str):
            return (value,)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            self.fail(key, f"must be a list of strings, not {value!r}")
        return tuple(value)

    def vector(self, key: str) -> tuple[float, float, float] | None:
        """Take three numbers."""
        value = self.take(key)
        if value is None:
            return None
        if not isinstance(value, list) or len(value) != 3:
            self.fail(key, f"must be a list of three numbers, not {value!r}")
        x, y, z = (self.as_number(key, v) for v in value)
        return x, y, z

    def table(self, key: str) -> TomlTable | None:
        """Take a table inside this one."""
        value = self.take(key)
        return (
            None
            if value is None
            else TomlTable(self._path, f"{self.name}.{key}" if self.name else key, value)
        )

    def tables(self) -> list[TomlTable]:
        """Take all that is left, each a table of its own."""
        return [t for key in list(self._content) if (t := self.table(key)) is not None]

    def finish(self) -> None:
        """Raise :class:`InputError` if a key is left that nobody asked for."""
        for key in self._content:
            near = difflib.get_close_matches(key, self._asked, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; the keys are {', '.join(self._asked)}"
            where = f"[{self.name}] " if self.name else ""
            raise InputError(f"{self._path}: {where}{key!r} is not known{hint}")
