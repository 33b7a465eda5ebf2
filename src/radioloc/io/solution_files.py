"""What a solution leaves on disk: its residuals as a table, its numbers as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.editing import Outcome
from radioloc.estimation.labels import Labels
from radioloc.text_files import write_text
from radioloc.time import Epochs

TextColumn = Sequence[str] | NDArray[np.str_] | Labels | Outcome
"""Texts of which a slice can be taken."""

_RESIDUAL_DECIMALS = {
    "observed_m": 7,
    "computed_m": 7,
    "residual_m": 6,
    "sigma_m": 6,
    "elevation_deg": 4,
}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_RESIDUAL_DECIMALS, "status")
"""Columns of a file of residuals, in order."""


def write_residuals(
    path: str | Path,
    *,
    epoch: Epochs,
    types: TextColumn,
    paths: TextColumn,
    observed_m: ArrayLike,
    computed_m: ArrayLike,
    residual_m: ArrayLike,
    sigma_m: ArrayLike,
    elevation_deg: ArrayLike,
    status: TextColumn,
) -> None:
    """Write residuals, one row per observation in the order given, columns :data:`RESIDUAL_COLUMNS`.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced at once.
    epoch : Epochs
        UTC of the observations, n epochs.
    types, paths, status : sequence of str, Labels or Outcome, length n
        Kind, path and what became of each observation (used, or why not).
    observed_m, computed_m, residual_m, sigma_m, elevation_deg : array_like, shape (n,)
        Whole light path as observed and computed, their difference, the standard deviation, and the lower
        of the stations' elevations.

    Raises
    ------
    InputError
        A column has another length, or holds a number that is not finite.
    FileFormatError
        The file cannot be written.
    """
    from radioloc.io.csv_file import batches_of, write_csv

    numbers = (observed_m, computed_m, residual_m, sigma_m, elevation_deg)
    columns: dict[str, Any] = {"epoch_utc": epoch, "type": types, "path": paths}
    columns |= {
        name: np.asarray(values, dtype=np.float64)
        for name, values in zip(_RESIDUAL_DECIMALS, numbers, strict=True)
    }
    columns["status"] = status
    for name, column in columns.items():
        length = 0 if isinstance(column, np.ndarray) and column.ndim != 1 else len(column)
        if length != len(epoch):
            raise InputError(f"{name} has {length} values, but there are {len(epoch)} observations")
        if name in _RESIDUAL_DECIMALS and not np.isfinite(column).all():
            bad = int(np.argmin(np.isfinite(column)))
            raise InputError(f"{name} of observation {bad + 1} is {column[bad]}; residuals must be finite")
    write_csv(path, batches_of(columns, _RESIDUAL_DECIMALS))


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a dictionary as JSON that any other program reads: numpy values as lists and numbers, never NaN.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced at once.
    content : mapping
        Nested mappings, sequences, text, booleans, numbers, numpy arrays and scalars, paths and None.

    Raises
    ------
    InputError
        A number is not finite or a value is of another type; names its key.
    FileFormatError
        The file cannot be written.
    """
    write_text(path, json.dumps(_plain(content, ""), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _plain(value: Any, where: str) -> Any:
    """Value in the types that JSON has."""
    match value:
        case Mapping():
            return {
                str(key): _plain(item, f"{where}.{key}" if where else str(key)) for key, item in value.items()
            }
        case np.ndarray() | np.generic():
            return _plain(value.tolist(), where)
        case list() | tuple():
            return [_plain(item, f"{where}[{place}]") for place, item in enumerate(value)]
        case float() if not math.isfinite(value):
            raise InputError(f"{where} is {value}, which JSON cannot hold; leave it out or give None")
        case Path():
            return str(value)
        case None | bool() | int() | float() | str():
            return value
    raise InputError(
        f"{where} is a {type(value).__name__}, which JSON cannot hold; give numbers, text or lists"
    )
