"""Tables of a study file as records: fields are keys, with types and rules of their values.

The same rules apply to records built in Python. Messages name the file, the table and the key.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import sys
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from radioloc.errors import InputError
from radioloc.plugins import Registry
from radioloc.quantities import convert_fields
from radioloc.time import Epochs, epochs_from_strings
from radioloc.units import set_fields

STDIN = Path("-")  # Standard input in place of a study file

_Record = TypeVar("_Record")
_MAX_SHOWN_CHARACTERS = 80
_COUNTS = {2: "two", 3: "three"}


def entry(default: Any = dataclasses.MISSING, *, factory: Any = dataclasses.MISSING, **rules: Any) -> Any:
    """Return a field with rules for values (:func:`check`) and rules for reading.

    `advice` completes messages; `kind` is the type in the file; `read` is a function of table and key that takes the
    `keys` of the file for the field.
    """
    return dataclasses.field(default=default, default_factory=factory, metadata=rules)


def check(record: Any) -> None:
    """Check the rules of a record's fields; a single name becomes a tuple, a date or Time an epoch."""
    convert_fields(record)
    for f in dataclasses.fields(record):
        raw = getattr(record, f.name)
        if raw is None:
            continue
        value = _normalized(f.name, raw, f.metadata)
        if value is not raw:
            set_fields(record, **{f.name: value})
        for key, item in _items(f.name, value):
            _require_rules(key, item, f.metadata)


def _normalized(name: str, value: Any, rules: Mapping[str, Any]) -> Any:
    if rules.get("names"):
        value = as_names(name, value)
        if not value:
            raise InputError(f"{name} is empty; leave it out to take all")
    if rules.get("both") and isinstance(value, Real):
        value = (float(value),) * 2
    if rules.get("moment"):
        if isinstance(value, str) or hasattr(value, "jd1"):
            value = epochs_from_strings(value, "UTC")
        if not isinstance(value, Epochs) or len(value) != 1:
            raise InputError(
                f'{name}: expected one epoch, such as epochs_from_strings("2024-05-02", "UTC"), got {value!r}'
            )
        value.require("UTC")
    return value


def _require_rules(key: str, item: Any, rules: Mapping[str, Any]) -> None:
    if item not in rules.get("choices", (item,)):
        allowed = ", ".join(f'"{choice}"' for choice in rules["choices"])
        raise InputError(f"{key}: expected one of {allowed}, got {item!r}")
    number = float(item) if isinstance(item, Real) and math.isfinite(item) else math.nan
    if rules.get("positive") and not number > 0.0:
        raise InputError(f"{key}: expected a number above zero, got {item!r}")
    if rules.get("not_negative") and not number >= 0.0:
        raise InputError(f"{key}: expected zero or more, got {item!r}")


def _items(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        yield from ((f"{key}.{name}", item) for name, item in value.items())
    elif isinstance(value, tuple):
        yield from ((key, item) for item in value)
    else:
        yield key, value


def as_names(key: str, value: str | Iterable[Any]) -> tuple[str, ...]:
    """Return one name or several as a tuple."""
    names = (value,) if isinstance(value, str) else tuple(value)
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{key}: expected names, got {name!r}")
    return names


def keys_of(record: type) -> tuple[str, ...]:
    """Return the keys of a record in a file."""
    return tuple(key for f in dataclasses.fields(record) for key in f.metadata.get("keys", (f.name,)))


@dataclass(frozen=True, slots=True)
class Hints:
    """Hints on misplaced keys: keys by table, and advice by table and key."""

    keys: Mapping[str, Collection[str]] = field(default_factory=dict)
    advice: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def table_of(self, key: str, wrong_table: str) -> str:
        """Return the only table with a key that is misplaced in a table or at the top; else an empty text."""
        tables = [table for table, keys in self.keys.items() if key in keys]
        return tables[0] if len(tables) == 1 and (not wrong_table or wrong_table in self.keys) else ""


class TomlTable:
    """Table of a study file from which keys are taken one by one; a key that remains is an error."""

    def __init__(self, path: Path, name: str, content: Any, hints: Hints | None = None) -> None:
        self.path = path
        self.name = name
        self._hints = hints or Hints()
        if not isinstance(content, Mapping):
            table, _, key = name.rpartition(".")
            raise InputError(
                f"{path}: [{name}]: expected a table, got {_shown(content)}{self._advice(table, key)}"
            )
        self._content = dict(content)
        self._taken: list[str] = []

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise :class:`InputError` about one key."""
        raise InputError(f"{self.path}: [{self.name}] {key}: {problem}")

    def _refuse(self, key: str, expected: str, value: Any) -> NoReturn:
        advice = self._advice(self.name, key.partition(".")[0])
        self.fail(key, f"expected {expected}, got {_shown(value)}{advice}")

    def _advice(self, table: str, key: str) -> str:
        text = self._hints.advice.get((table, key))
        return f"; {text}" if text else ""

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def take(self, key: str) -> Any:
        """Return the value of a key, ``None`` if it is absent."""
        self._taken.append(key)
        return self._content.pop(key, None)

    def get(self, key: str, kind: Any) -> Any:
        """Take a value of a type, a tuple or mapping of types, a record or a union of them."""
        value = self.take(key)
        return None if value is None else self._convert(key, value, kind)

    def need(self, key: str, kind: Any) -> Any:
        """Take a required value."""
        value = self.get(key, kind)
        return self.fail(key, "is missing") if value is None else value

    def read(
        self, record: type[_Record], keys: Mapping[str, str] | None = None, finish: bool = True, **values: Any
    ) -> _Record:
        """Return a record from the keys, by default its fields, and from given values of fields."""
        kinds = get_type_hints(record, include_extras=True)
        fields = {f.name: f for f in dataclasses.fields(record) if f.name not in values}  # type: ignore[arg-type]
        for key, name in keys.items() if keys else zip(fields, fields, strict=True):
            rules = fields[name].metadata
            if "read" in rules:
                values[name] = rules["read"](self, key)
            else:
                kind = float | kinds[name] if rules.get("both") else kinds[name]
                values[name] = self.get(key, rules.get("kind", kind))
        if finish:
            self.finish()
        for name, f in fields.items():
            needed = f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
            if needed and values.get(name) is None:
                self.fail(name, "is missing")
        return self.build(record, **values)

    def build(self, make: Callable[..., _Record], **fields: Any) -> _Record:
        """Call with the fields that are not None, so that others keep their defaults; errors name this table."""
        try:
            return make(**{key: value for key, value in fields.items() if value is not None})
        except InputError as error:
            prefix = f"[{self.name}] " if self.name else ""
            raise InputError(f"{self.path}: {prefix}{error}") from None

    def replaced(self, record: _Record) -> _Record:
        """Return a record with other values of the table's keys; each key is a field."""
        kinds = get_type_hints(type(record), include_extras=True)
        fields = {key: self.get(key, kinds[key]) for key in kinds}
        self.finish()
        return self.build(partial(dataclasses.replace, record), **fields)  # type: ignore[type-var]

    def table(self, key: str) -> TomlTable | None:
        """Take a table inside this one."""
        value = self.take(key)
        return None if value is None else self._child(key, value)

    def with_defaults(self, content: Mapping[str, Any]) -> TomlTable:
        """Return the table with other content for the keys that it lacks."""
        return TomlTable(self.path, self.name, {**content, **self._content}, self._hints)

    def named(self) -> dict[str, TomlTable]:
        """Take all remaining keys as tables by name."""
        return {key: self._child(key, self.take(key)) for key in list(self._content)}

    def _child(self, key: str, value: Any) -> TomlTable:
        return TomlTable(self.path, f"{self.name}.{key}" if self.name else key, value, self._hints)

    def finish(self) -> None:
        """Raise :class:`InputError` for a key that remains, with the similar key or its table."""
        for key in self._content:
            matches = difflib.get_close_matches(key, self._taken, n=1)
            hint = (
                f"; did you mean {matches[0]!r}?" if matches else f"; the keys are {', '.join(self._taken)}"
            )
            if table := self._hints.table_of(key, self.name):
                hint = f"; it belongs to [{table}]"
            hint = self._advice(self.name, key) or hint
            prefix = f"[{self.name}] " if self.name else ""
            raise InputError(f"{self.path}: {prefix}{key!r} is not known{hint}")

    def _convert(self, key: str, value: Any, kind: Any) -> Any:
        origin, parts = get_origin(kind) or kind, get_args(kind)
        if origin in (Union, UnionType):
            return self._convert(
                key, value, _member(value, [part for part in parts if part is not type(None)])
            )
        if origin in (Epochs, Annotated):
            return self._epoch(key, value, parts[-1] if parts else "UTC")
        if origin is Literal or kind in _PLAIN:
            return self._scalar(key, value, str if origin is Literal else kind)
        if kind is Path:
            files = self.files(key, [self._scalar(key, value, str)])
            if len(files) > 1:
                self.fail(key, f"expected one file, got {len(files)}")
            return files[0]
        if issubclass(origin, Mapping):
            content = self._child(key, value)._content
            return {name: self._convert(f"{key}.{name}", item, parts[1]) for name, item in content.items()}
        return self._tuple(key, value, parts) if origin is tuple else self._child(key, value).read(kind)

    def _scalar(self, key: str, value: Any, kind: type) -> Any:
        expected, is_valid = _PLAIN[kind]
        if not is_valid(value):
            self._refuse(key, expected, value)
        if kind is not float:
            return value
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(key, f"expected a finite number, got {_shown(value)}")
        return number

    def _tuple(self, key: str, value: Any, kinds: tuple[Any, ...]) -> tuple[Any, ...]:
        """Read a list of numbers of fixed length, of texts, of files, or of tables."""
        if kinds[-1] is not Ellipsis:
            if not isinstance(value, list) or len(value) != len(kinds):
                count = _COUNTS.get(len(kinds), len(kinds))
                numbers = "whole numbers" if kinds[0] is int else "numbers"
                self.fail(key, f"expected a list of {count} {numbers}, got {_shown(value)}")
            return tuple(self._convert(key, item, kind) for item, kind in zip(value, kinds, strict=True))
        if kinds[0] in (str, Path):
            texts = [value] if isinstance(value, str) else value
            if not isinstance(texts, list) or not all(map(_is_text, texts)):
                self._refuse(key, "a list of strings that are not empty", value)
            return self.files(key, texts) if kinds[0] is Path else tuple(texts)
        if not isinstance(value, list):
            self._refuse(key, f"a list of tables, [[{self.name}.{key}]]", value)
        return tuple(self._child(key, item).read(kinds[0]) for item in value)

    def _epoch(self, key: str, value: Any, scale: str) -> Epochs:
        """Read a date as text or of TOML's type."""
        try:
            text = value if isinstance(value, str) else value.isoformat().replace("+00:00", "Z")
        except AttributeError:
            self.fail(key, f"expected a {scale} date, got {_shown(value)}")
        if scale == "TDB" and text.strip().upper().endswith("Z"):
            self.fail(key, "is TDB, 64 to 69 s ahead of UTC since 1999: convert it, and leave the Z out")
        try:
            return epochs_from_strings(text, scale)
        except InputError as error:
            self.fail(key, str(error))

    def files(self, key: str, patterns: Collection[str], may_be_missing: bool = False) -> tuple[Path, ...]:
        """Return files of names and globs, relative to the study file."""
        folder = self.path.parent
        files: dict[Path, None] = {}
        for pattern in patterns:
            paths = _matches(folder, pattern)
            if not paths and (folder / pattern).is_dir():
                self.fail(key, f"{pattern!r} is a directory; give the files in it, such as {pattern}/*.csv")
            if not paths and (folder / pattern).exists():
                self.fail(key, f"{pattern!r} is a pipe or a device; give a file")
            if not paths and may_be_missing and not set(pattern) & set("*?["):
                paths = [folder / pattern]
            if not paths:
                self.fail(key, f"{pattern!r} matches no file in {folder.resolve()}")
            files |= dict.fromkeys(paths)
        return tuple(files)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip())


_PLAIN: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    float: ("a number", lambda value: type(value) in (int, float)),
    int: ("a whole number", lambda value: type(value) is int),
    bool: ("true or false", lambda value: type(value) is bool),
    str: ("a string that is not empty", _is_text),
}
"""Names of the types in messages, and tests of values of TOML."""


def _member(value: Any, kinds: list[Any]) -> Any:
    """Return the first type of a union that is a table or list as the value is; else the first type."""
    container = Mapping if isinstance(value, Mapping) else tuple if isinstance(value, list) else None
    matches = [
        kind
        for kind in kinds
        if (isinstance(get_origin(kind), type) and container and issubclass(get_origin(kind), container))
    ]
    return (matches or kinds)[0]


def _matches(folder: Path, pattern: str) -> list[Path]:
    """Return the sorted files of a name or a glob; none for an invalid pattern."""
    try:
        plain = folder / pattern
        if plain.is_file():
            return [plain]
        start = Path(plain.anchor) if Path(pattern).is_absolute() else folder
        relative = str(Path(pattern).relative_to(start)) if Path(pattern).is_absolute() else pattern
        return sorted(path for path in start.glob(relative) if path.is_file())
    except (ValueError, IndexError, NotImplementedError):
        return []


def _shown(value: Any) -> str:
    """Return the text of a value, shortened for messages."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN_CHARACTERS else f"{text[:_MAX_SHOWN_CHARACTERS]}..."


def source_of(path: str | Path) -> tuple[Path, Path | None]:
    """Return the path of a study file for messages and relative paths, and the file unless it is standard input."""
    return (Path("stdin"), None) if Path(path) == STDIN else (Path(path), Path(path))


def toml_content(path: Path) -> dict[str, object]:
    """Return the content of a study file; an InputError names the file."""
    try:
        content = sys.stdin.buffer.read() if path == STDIN else path.read_bytes()
        # Some editors write a byte order mark, which TOML forbids.
        text = content.decode("utf-8-sig")
        return tomllib.loads(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such study file; check the name and the directory") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a directory; give the study file in it") from None
    except OSError as error:
        raise InputError(f"{path}: the study file cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte 0x{error.object[error.start]:02x} is not UTF-8; save the study file as UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        place = re.search(r"\(at line (\d+)", str(error))
        line = text.split("\n")[int(place[1]) - 1].strip() if place else ""
        quoted = f": {line[:_MAX_SHOWN_CHARACTERS]!r}" if line else ""
        raise InputError(f"{path}: not valid TOML: {error}{quoted}") from None


@dataclass(frozen=True, slots=True)
class StudyTable:
    """Declaration of a further top-level table of study files (:func:`~radioloc.study.read_study`)."""

    name: str  #: unique name, such as ``"images"``
    #: Dataclass of its keys. ``Study.extensions[name]`` is the record of a study with the table.
    record: type
    #: Function of the path that returns the result, if a file with this table is a study of its own kind.
    run: Callable[[Path], Any] | None = None
    command: str = ""  #: name of the command that runs such a study


STUDY_TABLES = Registry("radioloc.study_tables", StudyTable, ())
"""Tables by name."""


def run_study_file(path: Path) -> Any:
    """Return the result of a study file of a kind in :data:`STUDY_TABLES`."""
    kinds = {table.name: table.run for table in STUDY_TABLES.values() if table.run is not None}
    for name in toml_content(path):
        if name in kinds:
            return kinds[name](path)
    raise InputError(f"{path}: expected a study with one of {', '.join(kinds) or 'no'} tables")
