"""Observations from tables in memory: of pandas, Arrow, polars or astropy, or a dictionary of arrays.

They are what a file of the same columns would be (:mod:`radioloc.io.table_columns`), and are read by the same code.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import types

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.io.checks import Catalogue
from radioloc.io.dates import utc_to_picoseconds
from radioloc.io.table_columns import COLUMNS, SPLIT_EPOCH, ColumnReader, require_columns
from radioloc.measurements.observations import Observations
from radioloc.time import Epochs, to_scale
from radioloc.units import ASTROPY_UNITS, as_float_array, in_unit, unit_of

_KNOWN = (*COLUMNS, *SPLIT_EPOCH)
_SAME = {"value_m": "observed_m"}
"""Names in :meth:`Observations.to_table` that files do not have."""
_ORIGIN = ("file", "line")
_NAME = "table"


def observations_from(
    table: Any,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    constants: Mapping[str, Any] | None = None,
    *,
    catalogue: Catalogue | None = None,
    lunar: bool = True,
) -> Observations:
    """What :meth:`~radioloc.measurements.Observations.from_table` gives."""
    theirs = _columns(table)
    taken = _chosen(theirs, columns)
    units = dict(units or {})
    if unknown := [name for name in units if name not in theirs]:
        raise InputError(f"units names the column {unknown[0]!r}, but the table has {', '.join(theirs)}")
    n = len(next(iter(theirs.values()), ()))
    arrays: dict[str, Any] = {}
    for ours, name in taken.items():
        arrays |= _arrow(_SAME.get(ours, ours), theirs[name], units.get(name))
    for ours, value in (constants or {}).items():
        if ours in taken:
            raise InputError(f"{ours} is a column of the table, and given for all rows; give one of them")
        arrays |= _arrow(_SAME.get(ours, ours), _repeated(value, n), None)
    require_columns(_NAME, list(arrays), split_epoch=True)
    reader = ColumnReader(_NAME, catalogue or StationCatalogue.default())
    if n:
        reader.read(arrays, np.arange(1, n + 1, dtype=np.int32))
    return reader.observations(lunar=lunar)


def _columns(table: Any) -> dict[str, Any]:
    """Columns by name; those of Arrow as pairs of values and unit."""
    if hasattr(table, "__arrow_c_stream__"):
        arrow = pyarrow.table(table)
        return {
            name: _ArrowColumn(
                arrow[name], (arrow.schema.field(name).metadata or {}).get(b"unit", b"").decode()
            )
            for name in arrow.column_names
            if not name.startswith("__index_level_")  # the rows of pandas, numbered
        }
    if not (hasattr(table, "keys") and hasattr(table, "__getitem__")):
        raise InputError(
            f"{type(table).__name__} is no table; give one of pandas, Arrow or astropy, or a dictionary"
        )
    found = {name: table[name] for name in table.keys()}  # noqa: SIM118  # a Table is iterated by rows
    lengths = {name: len(column) for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"columns of a table are of one length, but these have {lengths}")
    return found


class _ArrowColumn:
    """A column of Arrow with the unit that its field states."""

    def __init__(self, values: pyarrow.ChunkedArray, unit: str) -> None:
        self.values, self.unit = values, unit

    def __len__(self) -> int:
        return len(self.values)


def _repeated(value: Any, n: int) -> Any:
    """A value for n rows, with its unit."""
    return value * np.ones(n) if hasattr(value, "unit") else np.full(n, value)


def _chosen(theirs: Mapping[str, Any], columns: Mapping[str, str] | None) -> dict[str, str]:
    """Names of the table's columns by ours."""
    renamed = dict(columns or {})
    for ours, name in renamed.items():
        if ours not in (*_KNOWN, *_SAME):
            raise InputError(f"columns: {ours!r} is not known; use {', '.join(_KNOWN)}")
        if name not in theirs:
            raise InputError(f"columns: the table has no {name!r} for {ours}; it has {', '.join(theirs)}")
    others = [name for name in theirs if name not in renamed.values()]
    taken = renamed | {name: name for name in others if name in (*_KNOWN, *_SAME) and name not in renamed}
    left = [name for name in others if name not in taken.values() and name not in _ORIGIN]
    if left and columns is None:
        raise InputError(
            f"column {left[0]!r} is not known; say in `columns` what it is ({', '.join(_KNOWN)}), or give an empty "
            "dictionary there to leave out what is not known"
        )
    return taken


def _arrow(name: str, column: Any, unit: str | None) -> dict[str, pyarrow.Array]:
    """A column as files have it; an epoch that is no text and no timestamp as two."""
    if name == "epoch_utc" and (hasattr(column, "jd1") or isinstance(column, Epochs)):
        days, picoseconds = utc_to_picoseconds(to_scale(column, "UTC"))
        return {"utc_date": pyarrow.array(days.astype("datetime64[D]")), "utc_ps": pyarrow.array(picoseconds)}
    wanted = "1" if name in ("relative_humidity", "ramped") else unit_of(name)
    if wanted is not None and name not in SPLIT_EPOCH:
        return {name: pyarrow.array(_numbers(name, column, unit, wanted), from_pandas=True)}
    if unit is not None:
        raise InputError(f"units: {name} has no unit; leave it out")
    if isinstance(column, _ArrowColumn):
        values = column.values.combine_chunks()
        zoned = types.is_timestamp(values.type) and values.type.tz
        return {name: values.cast(pyarrow.timestamp(values.type.unit, "UTC")) if zoned else values}
    values = np.ma.getdata(column)
    mask = np.ma.getmaskarray(column) if np.ma.isMaskedArray(column) else None
    texts = values.astype("U") if values.dtype.kind == "S" else values  # as FITS has them
    made = pyarrow.array(texts, mask=mask, from_pandas=True)
    return {
        name: made.combine_chunks() if isinstance(made, pyarrow.ChunkedArray) else made
    }  # of very many texts


def _numbers(name: str, column: Any, unit: str | None, wanted: str) -> NDArray[np.float64]:
    """Numbers in the unit that is wanted, from what the table or the caller says; NaN where masked or null."""
    own = column.unit if isinstance(column, _ArrowColumn) else str(getattr(column, "unit", None) or "")
    bare = (
        column.values.to_numpy() if isinstance(column, _ArrowColumn) else getattr(column, "unmasked", column)
    )
    numbers = as_float_array(np.ma.getdata(getattr(bare, "value", bare)), wanted, name)
    if (mask := getattr(column, "mask", None)) is not None:
        numbers = np.where(mask, np.nan, numbers)
    text = unit or own
    if not text:
        return numbers
    from astropy.units import Quantity, Unit

    try:
        stated, given = (Unit(ASTROPY_UNITS.get(one, one)) for one in (own or text, text))
    except ValueError:
        raise InputError(f"units: {text!r} of {name} is no unit that astropy knows") from None
    if stated != given:
        raise InputError(f"units: {name} is in {own}, as the table says, not in {unit}; leave it out")
    found: NDArray[np.float64] = in_unit(Quantity(numbers, given), wanted, name)
    return found
