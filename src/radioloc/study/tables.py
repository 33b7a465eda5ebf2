"""Tables of study files that other packages add by entry points (group ``radioloc.study_tables``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radioloc.errors import InputError
from radioloc.plugins import registry
from radioloc.study.schema import toml_content


@dataclass(frozen=True, slots=True)
class StudyTable:
    """Declaration of a top-level table beside those that :func:`~radioloc.study.read_study` knows.

    Parameters
    ----------
    name : str
        Unique name, such as ``"images"``.
    record : type
        Dataclass of its keys. ``Study.extensions[name]`` is the record of a study of tracking that has the table.
    run : callable, optional
        A file with this table is a study of its own kind: function of its path that returns the result.
    command : str
        Name of the command that runs a study of its own kind.
    """

    name: str
    record: type
    run: Callable[[Path], Any] | None = None
    command: str = ""


STUDY_TABLES = registry("radioloc.study_tables", StudyTable, ())
"""Tables by name."""


def run_study_file(path: Path) -> Any:
    """Return the result of a study file of a kind that one of :data:`STUDY_TABLES` declares."""
    kinds = {entry.name: entry.run for entry in STUDY_TABLES.values() if entry.run is not None}
    for name in toml_content(path):
        if name in kinds:
            return kinds[name](path)
    raise InputError(f"{path}: expected a study with one of {', '.join(kinds) or 'no'} tables")
