"""Edited study files that state the result of a search; comments are preserved."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from radioloc.errors import InputError
from radioloc.lazy import optional
from radioloc.study.study import Study


@dataclass(frozen=True, slots=True)
class Change:
    """Change of one table of a study file."""

    table: tuple[str, ...]  # its name in parts
    values: Mapping[str, Any]  # keys that are set
    removed: tuple[str, ...] = ()  # keys that are removed
    added: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)  # to arrays of tables

    def apply(self, content: Any) -> None:
        """Change a document, which is a mapping of mappings."""
        for name in self.table:
            if name not in content:
                content[name] = {}
            content = content[name]
        for key in self.removed:
            content.pop(key, None)
        for key, value in self.values.items():
            content[key] = value
        for key, tables in self.added.items():
            content[key] = [*content.get(key, ()), *map(dict, tables)]


def require_beside(path: Path, study: Study) -> Path:
    """Return the file of a study; InputError unless a completed study can be written beside it."""
    source = study.path
    if source is None:
        raise InputError(
            f"{path}: expected a study from a file, got one from Python; use the `study` of the result"
        )
    if path.absolute().parent.resolve() != source.absolute().parent.resolve():
        raise InputError(
            f"{path}: expected a file in the folder of {source}, to which paths in the study are relative"
        )
    _tomlkit()
    return source


def _tomlkit() -> ModuleType:
    return optional("tomlkit", "completed studies are written by TOML Kit, which is not installed;", "search")


def completed_text(source: Path, changes: Iterable[Change]) -> str:
    """Return the text of a study file with some changes; InputError if it cannot be edited."""
    tomlkit = _tomlkit()
    text = source.read_text(encoding="utf-8-sig")
    document, expected = tomlkit.parse(text), tomllib.loads(text)
    for change in changes:
        change.apply(document)
        change.apply(expected)
    completed = str(tomlkit.dumps(document))
    if tomllib.loads(completed) != expected:
        raise InputError(
            f"{source}: expected tables that can be edited, got others; enter by hand: {expected}"
        )
    return completed
