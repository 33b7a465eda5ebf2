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
    """Declaration of a top-level table.

    Parameters
    ----------
    name : str
        Unique name, such as ``"images"``.
    record : type
        Dataclass of its keys.
    run : callable
        A file with this table is a study of its own kind: function of its path that returns the result.
    """

    name: str
    record: type
    run: Callable[[Path], Any]


STUDY_TABLES = registry("radioloc.study_tables", StudyTable, ())
"""Tables by name."""


def run_study_file(path: Path) -> Any:
    """Return the result of a study file of a kind that one of :data:`STUDY_TABLES` declares."""
    for name in toml_content(path):
        if name in STUDY_TABLES:
            return STUDY_TABLES[name].run(path)
    raise InputError(f"{path}: expected a study with one of {', '.join(STUDY_TABLES) or 'no'} tables")
