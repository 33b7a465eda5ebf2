"""Observations as a Parquet file: the columns of the plain table, numbers as numbers.

All columns are those of :mod:`radioloc.io.table` but the epoch. A timestamp of Parquet counts nanoseconds and knows no
leap second; a time tag has picoseconds, and a laser range to the Moon needs those beyond the nanosecond, in which the
range changes by up to a micrometre. So the epoch is two columns of whole numbers, which any program reads alike:

==============  ======================================================================================
``utc_date``    UTC date (date32)
``utc_ps``      picoseconds of UTC since its midnight (int64); of a leap second 86400e12 to 86401e12
==============  ======================================================================================

Files of others may have ``epoch_utc`` instead, text or a timestamp. Numbers that were not recorded are null. The type,
path and time tag are dictionaries of texts. The unit of each column is in its metadata, those of the file name radioloc
and its version.

Source: Apache Parquet format, logical types. Needs pyarrow, which is imported when it is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from radioloc._version import __version__
from radioloc.errors import FileFormatError, InputError
from radioloc.estimation.labels import Labels
from radioloc.extras import optional
from radioloc.io.dates import utc_from_picoseconds, utc_from_text, utc_to_picoseconds
from radioloc.io.names import Catalogue
from radioloc.io.table import checked_observations, table_columns
from radioloc.io.table_head import require_columns
from radioloc.io.table_rows import CODED_TEXTS, OPTIONAL_NUMBERS, column_name, joined_columns, text_code
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.text_files import replaced_file, require_file
from radioloc.time import Epochs

MAGIC = b"PAR1"
"""First bytes of every Parquet file."""

_ROWS_AT_ONCE = 2**17
_UNITS = {"utc_ps": "ps", "relative_humidity": "1", "wavelength_um": "um"}
_TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def read_parquet(path: str | Path, *, catalogue: Catalogue | None = None) -> Observations:
    """Read a Parquet file of observations; the row stands for the line.

    Parameters
    ----------
    path : path-like
        The file.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; without it they stay as they are.

    Raises
    ------
    FileFormatError
        The file cannot be read or is damaged, a column is missing, unknown, of another type or there twice, or a value
        is missing or impossible. Names the row, counted from 1, as the line.
    InputError
        pyarrow is not installed, or the same observation is there twice.
    """
    pyarrow, parquet = _pyarrow()
    require_file(path)
    with _damage_told(path, pyarrow), parquet.ParquetFile(path) as file:
        header = list(file.schema_arrow.names)
        require_columns(path, header, split_epoch=True)
        reader = _Reader(path, catalogue)
        for batch in file.iter_batches(_ROWS_AT_ONCE):
            reader.read(batch)
    return checked_observations(path, reader.columns())


def write_parquet(path: str | Path, observations: Observations) -> None:
    """Write observations as a Parquet file that :func:`read_parquet` gives back unchanged.

    Epochs come back to 1e-12 s or to the last bit, whichever is more, and those that had up to 12 decimals to the
    last bit; all other numbers to the last bit.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    observations : Observations
        What to write; where the rows came from is not written.

    Raises
    ------
    InputError
        pyarrow is not installed.
    FileFormatError
        The file cannot be written.
    """
    pyarrow, parquet = _pyarrow()
    arrays, fields = [], []
    for name, array in _arrow_columns(pyarrow, observations):
        unit = _UNITS.get(
            name, name.rpartition("_")[2] if name.endswith(("_m", "_hpa", "_k", "_hz", "_s")) else ""
        )
        arrays.append(array)
        fields.append(pyarrow.field(name, array.type, metadata={"unit": unit} if unit else None))
    schema = pyarrow.schema(fields, metadata={"radioloc": __version__})
    with replaced_file(path) as temporary:
        parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), temporary)


def _arrow_columns(pyarrow: Any, observations: Observations) -> Iterator[tuple[str, Any]]:
    for name, column in table_columns(observations).items():
        match column:
            case Epochs():
                days, picoseconds = utc_to_picoseconds(column)
                yield "utc_date", pyarrow.array(days.astype("datetime64[D]"))
                yield "utc_ps", pyarrow.array(picoseconds)
            case Labels():
                texts = pyarrow.array(list(column.texts), pyarrow.string())
                yield name, pyarrow.DictionaryArray.from_arrays(pyarrow.array(column.codes), texts)
            case _:
                yield name, pyarrow.array(column, mask=np.isnan(column))


class _Reader:
    """Takes the rows of one file, batch by batch, and keeps their columns."""

    def __init__(self, path: str | Path, catalogue: Catalogue | None) -> None:
        self._path = path
        self._catalogue = catalogue
        self._links: dict[Link, int] = {}
        self._parts: dict[str, list[NDArray[Any]]] = {}
        self._rows = 0

    def read(self, batch: Any) -> None:
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        epoch = self._epoch(columns)
        taken = {"jd": epoch.jd, "fraction": epoch.fraction}
        for name, column in columns.items():
            convert = self._codes if name in CODED_TEXTS else self._numbers
            taken[column_name(name)] = convert(name, column)
        taken["line"] = np.arange(self._rows + 1, self._rows + 1 + len(batch), dtype=np.int32)
        for name, part in taken.items():
            self._parts.setdefault(name, []).append(part)
        self._rows += len(batch)

    def columns(self) -> dict[str, Any]:
        if not self._rows:
            raise FileFormatError(self._path, "has columns, but no observations")
        return joined_columns(self._parts) | {"links": tuple(self._links)}

    def _fail(self, name: str, row: int, problem: str) -> NoReturn:
        raise FileFormatError(self._path, f"{name}: {problem}", self._rows + row + 1)

    def _wrong_type(self, name: str, column: Any, wanted: str) -> NoReturn:
        raise FileFormatError(self._path, f"column {name} is of type {column.type}; give {wanted}")

    def _require_all(self, name: str, column: Any) -> None:
        if column.null_count:
            self._fail(
                name, int(np.argmax(column.is_null().to_numpy(zero_copy_only=False))), "is missing (null)"
            )

    def _numbers(self, name: str, column: Any) -> NDArray[np.float64]:
        if not (_is(column, "floating") or _is(column, "integer")):
            self._wrong_type(name, column, "numbers")
        if name not in OPTIONAL_NUMBERS:
            self._require_all(name, column)
        numbers: NDArray[np.float64] = column.cast("float64", safe=False).to_numpy(zero_copy_only=False)
        return numbers

    def _codes(self, name: str, column: Any) -> NDArray[Any]:
        if not _is(column, "dictionary"):
            column = column.dictionary_encode() if _is_text(column.type) else column
        if not _is(column, "dictionary") or not _is_text(column.type.value_type):
            self._wrong_type(name, column, "text")
        self._require_all(name, column)
        places = column.indices.to_numpy(zero_copy_only=False).astype(np.intp)
        texts = column.dictionary.to_pylist()
        codes = np.zeros(len(texts), dtype=CODED_TEXTS[name])
        # In the order of the rows, in which links are numbered; a dictionary may hold what no row has.
        used, first = np.unique(places, return_index=True)
        for place in used[np.argsort(first)].tolist():
            try:
                codes[place] = text_code(name, texts[place], self._links, self._catalogue)
            except InputError as error:
                self._fail(name, int(np.argmax(places == place)), str(error))
        return codes[places]

    def _epoch(self, columns: dict[str, Any]) -> Epochs:
        if "epoch_utc" not in columns:
            return self._split_epoch(columns.pop("utc_date"), columns.pop("utc_ps"))
        column = columns.pop("epoch_utc")
        self._require_all("epoch_utc", column)
        if _is(column, "dictionary"):
            column = column.dictionary_decode()
        if _is(column, "timestamp"):
            if column.type.tz not in (None, "UTC", "+00:00"):
                self._wrong_type("epoch_utc", column, "UTC")
            ticks = column.cast("int64").to_numpy(zero_copy_only=False)
            per_second = _TICKS[column.type.unit]
            days, rest = np.divmod(ticks, 86400 * per_second)
            return self._from_picoseconds("epoch_utc", days, rest * (10**12 // per_second))
        if not _is_text(column.type):
            self._wrong_type("epoch_utc", column, "text, a timestamp, or utc_date and utc_ps in its place")
        texts = column.to_pylist()
        try:
            return utc_from_text([text.strip() for text in texts])
        except InputError:
            for row, text in enumerate(texts):
                try:
                    utc_from_text([text.strip()])
                except InputError as error:
                    self._fail("epoch_utc", row, str(error))
            raise

    def _split_epoch(self, date: Any, picoseconds: Any) -> Epochs:
        if not _is(date, "date32"):
            self._wrong_type("utc_date", date, "a date (date32)")
        if not _is(picoseconds, "integer"):
            self._wrong_type("utc_ps", picoseconds, "whole numbers (int64)")
        self._require_all("utc_date", date)
        self._require_all("utc_ps", picoseconds)
        days = date.cast("int32").to_numpy(zero_copy_only=False).astype(np.int64)
        return self._from_picoseconds(
            "utc_ps", days, picoseconds.cast("int64").to_numpy(zero_copy_only=False)
        )

    def _from_picoseconds(self, name: str, days: NDArray[np.int64], picoseconds: NDArray[np.int64]) -> Epochs:
        try:
            return utc_from_picoseconds(days, picoseconds)
        except InputError:
            for row in range(len(days)):
                try:
                    utc_from_picoseconds(days[row : row + 1], picoseconds[row : row + 1])
                except InputError as error:
                    self._fail(name, row, str(error))
            raise


def _is(column: Any, kind: str) -> bool:
    """Whether an array is of a kind that ``pyarrow.types`` knows."""
    from pyarrow import types

    return bool(getattr(types, f"is_{kind}")(column.type))


def _is_text(type_: Any) -> bool:
    from pyarrow import types

    return bool(types.is_string(type_) or types.is_large_string(type_))


def _pyarrow() -> tuple[Any, Any]:
    need = "Parquet files need pyarrow:"
    return optional("pyarrow", need, "parquet"), optional("pyarrow.parquet", need, "parquet")


@contextmanager
def _damage_told(path: str | Path, pyarrow: Any) -> Iterator[None]:
    """Make what pyarrow says of a damaged file, or of one that cannot be read, one of our errors."""
    try:
        yield
    except (pyarrow.ArrowException, OSError) as error:
        [reason, *_] = [line.strip() for line in str(error).splitlines()] or ["damaged"]
        raise FileFormatError(
            path, f"cannot be read as Parquet ({reason}); fetch or write it again"
        ) from error
