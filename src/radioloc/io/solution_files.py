"""What a solution leaves on disk: its residuals as a table, its numbers as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.io.dates import utc_to_text
from radioloc.text_files import write_text
from radioloc.time import Epochs

_RESIDUAL_FORMATS = {
    "observed_m": "%.7f",
    "computed_m": "%.7f",
    "residual_m": "%.6f",
    "sigma_m": "%.6f",
    "elevation_deg": "%.4f",
}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_RESIDUAL_FORMATS, "status")
"""Columns of a file of residuals, in order."""


def write_residuals(
    path: str | Path,
    *,
    epoch: Epochs,
    types: Sequence[str] | np.ndarray,
    paths: Sequence[str] | np.ndarray,
    observed_m: ArrayLike,
    computed_m: ArrayLike,
    residual_m: ArrayLike,
    sigma_m: ArrayLike,
    elevation_deg: ArrayLike,
    status: Sequence[str] | np.ndarray,
) -> None:
    """Write residuals, one row per observation in the order given, columns :data:`RESIDUAL_COLUMNS`.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced at once.
    epoch : Epochs
        UTC of the observations, n epochs.
    types, paths, status : sequence of str, length n
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
    texts = {"epoch_utc": utc_to_text(epoch), "type": list(types), "path": list(paths)}
    given = (observed_m, computed_m, residual_m, sigma_m, elevation_deg)
    for (name, form), values in zip(_RESIDUAL_FORMATS.items(), given, strict=True):
        array = np.asarray(values, dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise InputError(
                f"{name} of observation {bad[0] + 1} is {array[bad[0]]}; residuals must be finite"
            )
        texts[name] = [form % value for value in array.tolist()] if array.ndim == 1 else []
    texts["status"] = list(status)
    for name, column in texts.items():
        if len(column) != len(epoch):
            raise InputError(f"{name} has {len(column)} values, but there are {len(epoch)} observations")
    lines = [",".join(RESIDUAL_COLUMNS)]
    lines += [
        ",".join(row) for row in zip(*(map(str, texts[name]) for name in RESIDUAL_COLUMNS), strict=True)
    ]
    write_text(path, "\n".join(lines) + "\n")


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
