"""Records of arrays that have one row for each light path: rows of them taken, several of them joined."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.observations import Observations
from radioloc.time import Epochs
from radioloc.vectors import by_component


def joined(parts: list[Any]) -> Any:
    """Arrays, or records of them, joined row after row."""
    first = parts[0]
    if first is None or len(parts) == 1:
        return first
    if isinstance(first, tuple):
        return tuple(joined([part[i] for part in parts]) for i in range(len(first)))
    if isinstance(first, Observations | Epochs):
        return type(first).concatenate(parts)
    if is_dataclass(first):
        columns = {f.name: joined([getattr(part, f.name) for part in parts]) for f in fields(first)}
        return replace(first, **columns)  # type: ignore[type-var]
    if isinstance(first, dict):
        return {key: joined([part[key] for part in parts]) for key in first}
    return np.concatenate(parts)


def rows_of(value: Any, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Any:
    """Some rows of an array, or of all arrays of a record, which have one row per path; laid out by component."""
    if value is None:
        return None
    if isinstance(value, tuple):
        return tuple(rows_of(item, rows) for item in value)
    if isinstance(value, Observations):
        return value.select(rows)
    if isinstance(value, Epochs):
        return value[rows]
    if is_dataclass(value):
        parts = {field.name: rows_of(getattr(value, field.name), rows) for field in fields(value)}
        return replace(value, **parts)  # type: ignore[type-var]
    if isinstance(value, dict):
        return {key: rows_of(item, rows) for key, item in value.items()}
    return by_component(value[rows])
