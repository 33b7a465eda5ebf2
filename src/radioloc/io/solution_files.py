"""What a solution leaves on disk: its residuals as a table, its numbers as JSON."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.editing import Outcome
from radioloc.estimation.labels import Labels
from radioloc.io.csv_columns import Cells, fixed_cells, label_cells, lines_of, text_cells
from radioloc.io.dates import utc_cells
from radioloc.text_files import write_blocks, write_text
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
    columns: dict[str, tuple[int, Callable[[slice], Cells]]] = {
        "epoch_utc": (len(epoch), lambda rows: utc_cells(epoch[rows]))
    }
    for name, texts in (("type", types), ("path", paths), ("status", status)):
        columns[name] = len(texts), _text_column(texts)
    given = (observed_m, computed_m, residual_m, sigma_m, elevation_deg)
    for (name, decimals), values in zip(_RESIDUAL_DECIMALS.items(), given, strict=True):
        array = np.asarray(values, dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise InputError(
                f"{name} of observation {bad[0] + 1} is {array[bad[0]]}; residuals must be finite"
            )
        columns[name] = array.size if array.ndim == 1 else 0, _number_column(array, decimals)
    for name, (length, _) in columns.items():
        if length != len(epoch):
            raise InputError(f"{name} has {length} values, but there are {len(epoch)} observations")
    lines = lines_of([columns[name][1] for name in RESIDUAL_COLUMNS], len(epoch))
    write_blocks(path, itertools.chain([f"{','.join(RESIDUAL_COLUMNS)}\n".encode()], lines))


def _text_column(texts: TextColumn) -> Callable[[slice], Cells]:
    if isinstance(texts, Labels):
        return lambda rows: label_cells(texts, rows)
    if isinstance(texts, Outcome):
        return lambda rows: _outcome_cells(texts, rows)
    return lambda rows: text_cells(texts[rows])


def _outcome_cells(outcome: Outcome, rows: slice) -> Cells:
    cells = label_cells(outcome.given, rows)
    outliers, texts = outcome.outliers(rows)
    if len(outliers):
        reasons = text_cells(texts)
        cells = cells.astype(np.result_type(cells.dtype, reasons.dtype))
        cells[outliers] = reasons
    return cells


def _number_column(values: NDArray[np.float64], decimals: int) -> Callable[[slice], Cells]:
    return lambda rows: fixed_cells(values[rows], decimals)


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
