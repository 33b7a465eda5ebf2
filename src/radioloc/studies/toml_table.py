"""Reading a TOML table so that every mistake in it is one clear sentence naming the file, the table and the key."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from radioloc.errors import InputError
from radioloc.studies.alike_keys import table_of, where_it_belongs
from radioloc.time import Epochs, epochs_from_strings

_Made = TypeVar("_Made")
_LONGEST_SHOWN = 80


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
        self.path = path
        self.name = name
        if not isinstance(content, Mapping):
            problem = _of_another_kind("a table", content, *name.rpartition(".")[::2])
            raise InputError(f"{path}: [{name}] {problem}")
        self._content = dict(content)
        self._asked: list[str] = []

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise :class:`InputError` about one key."""
        raise InputError(f"{self.path}: [{self.name}] {key}: {problem}")

    def _refuse(self, key: str, wanted: str, value: Any) -> NoReturn:
        """Raise :class:`InputError` about a value of another kind."""
        self.fail(key, _of_another_kind(wanted, value, self.name, key.partition(".")[0]))

    def build(self, make: Callable[..., _Made], **fields: Any) -> _Made:
        """Call with the fields that were given, so that others keep their defaults; errors name this table.

        Raises
        ------
        InputError
            As the callable says, with file and table in front.
        """
        try:
            return make(**{key: value for key, value in fields.items() if value is not None})
        except InputError as error:
            where = f"[{self.name}] " if self.name else ""
            raise InputError(f"{self.path}: {where}{error}") from None

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def take(self, key: str) -> Any:
        """Value of a key, ``None`` where it is absent; the key then counts as known."""
        self._asked.append(key)
        return self._content.pop(key, None)

    def holds_text(self, key: str) -> bool:
        """Whether a key is there and its value is a string."""
        return isinstance(self._content.get(key), str)

    def number_or_table(self, key: str) -> float | dict[str, float] | None:
        """Take a finite number, or a table of them under any names, at least one."""
        value = self.take(key)
        if value is None or not isinstance(value, Mapping):
            return None if value is None else self.as_number(key, value)
        if not value:
            self.fail(key, "names none; leave it out")
        return {name: self.as_number(f"{key}.{name}", number) for name, number in value.items()}

    def number(self, key: str) -> float | None:
        """Take a finite number."""
        value = self.take(key)
        return None if value is None else self.as_number(key, value)

    def as_number(self, key: str, value: Any) -> float:
        """Check that a value is a finite number."""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self._refuse(key, "a number", value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(key, f"must be a finite number, not {_shown(value)}")
        return number

    def text(self, key: str) -> str | None:
        """Take a string that is not empty."""
        value = self.take(key)
        if value is not None and not (isinstance(value, str) and value.strip()):
            self._refuse(key, "a string that is not empty", value)
        return value

    def texts(self, key: str) -> tuple[str, ...] | None:
        """Take a list of strings, none of them empty; a single string stands for a list of one."""
        value = self.take(key)
        if value is None:
            return None
        values = [value] if isinstance(value, str) else value
        if not isinstance(values, list) or not all(isinstance(v, str) and v.strip() for v in values):
            self._refuse(key, "a list of strings that are not empty", value)
        return tuple(values)

    def vector(self, key: str) -> tuple[float, float, float] | None:
        """Take three numbers."""
        values = self.numbers(key, 3)
        return None if values is None else (values[0], values[1], values[2])

    def numbers(self, key: str, length: int) -> tuple[float, ...] | None:
        """Take some numbers."""
        value = self.take(key)
        return None if value is None else self.as_numbers(key, value, length)

    def as_numbers(self, key: str, value: Any, length: int) -> tuple[float, ...]:
        """Check that a value is a list of so many finite numbers."""
        if not isinstance(value, list) or len(value) != length:
            count = {2: "two", 3: "three"}.get(length, str(length))
            self.fail(key, f"must be a list of {count} numbers, not {_shown(value)}")
        return tuple(self.as_number(key, v) for v in value)

    def epoch(self, key: str) -> Epochs | None:
        """Take a UTC date, as text or as TOML has them."""
        value = self.take(key)
        if value is None:
            return None
        try:
            # TOML dates arrive as datetime objects; their ISO form is what the text form would be.
            text = value if isinstance(value, str) else value.isoformat().replace("+00:00", "")
            return epochs_from_strings(text)
        except InputError as error:
            self.fail(key, str(error))
        except AttributeError:
            self.fail(key, f"must be a UTC date, not {_shown(value)}")

    def whole_numbers(self, key: str, count: int) -> tuple[int, ...] | None:
        """Take so many whole numbers."""
        value = self.take(key)
        if value is None:
            return None
        if not isinstance(value, list) or len(value) != count or not all(type(v) is int for v in value):
            self.fail(key, f"must be a list of {count} whole numbers, not {_shown(value)}")
        return tuple(value)

    def flag(self, key: str) -> bool | None:
        """Take ``true`` or ``false``."""
        value = self.take(key)
        if value is not None and not isinstance(value, bool):
            self.fail(key, f"must be true or false, not {_shown(value)}")
        return value

    def table(self, key: str) -> TomlTable | None:
        """Take a table inside this one."""
        value = self.take(key)
        return (
            None if value is None else TomlTable(self.path, f"{self.name}.{key}" if self.name else key, value)
        )

    def tables(self) -> list[TomlTable]:
        """Take all that is left, each a table of its own."""
        return [t for key in list(self._content) if (t := self.table(key)) is not None]

    def table_list(self, key: str) -> list[TomlTable]:
        """Take a list of tables, ``[[...]]``; empty where the key is absent."""
        value = self.take(key)
        if value is None:
            return []
        if not isinstance(value, list):
            self._refuse(key, f"a list of tables, [[{self.name}.{key}]]", value)
        return [TomlTable(self.path, f"{self.name}.{key}", item) for item in value]

    def finish(self) -> None:
        """Raise :class:`InputError` if a key is left that nobody asked for."""
        for key in self._content:
            near = difflib.get_close_matches(key, self._asked, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; the keys are {', '.join(self._asked)}"
            if table := table_of(key, self.name):
                hint = f"; it belongs to [{table}]"
            where = f"[{self.name}] " if self.name else ""
            raise InputError(f"{self.path}: {where}{key!r} is not known{hint}")


def _of_another_kind(wanted: str, value: Any, table: str, key: str) -> str:
    advice = where_it_belongs(table, key)
    return f"must be {wanted}, not {_shown(value)}" + (f"; {advice}" if advice else "")


def _shown(value: Any) -> str:
    """What was given, short enough for a message of one line."""
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
