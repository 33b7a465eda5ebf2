"""Comma-separated text out of columns of texts, dates and numbers, by Arrow and block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import ArrayLike, NDArray
from pyarrow import csv

from radioloc._version import __version__
from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.text_files import replaced_file
from radioloc.time import Epochs
from radioloc.time.dates import utc_to_text

# Some megabytes of text.
_ROWS_AT_ONCE = 2**14


def write_csv(
    path: str | Path, batches: Iterable[pyarrow.RecordBatch], *, comments: Iterable[str] = ()
) -> None:
    """Write a table; numbers with as many digits as give back the same float, null as nothing.

    All batches have the same columns; there is at least one, which may have no rows. Comments go on top, after ``#``.
    """
    notes = [f"# {comment}".rstrip() for text in comments for comment in text.split("\n")]
    options = csv.WriteOptions(include_header=False, quoting_style="none")
    with replaced_file(path) as temporary, temporary.open("wb") as stream:
        try:
            batches = iter(batches)
            first = next(batches)
            stream.write("\n".join([*notes, ",".join(first.schema.names), ""]).encode())
            with csv.CSVWriter(stream, first.schema, write_options=options) as writer:
                for batch in chain([first], batches):
                    writer.write_batch(batch)
        except UnicodeEncodeError as error:
            wrong = error.object[error.start : error.end]
            raise InputError(f"{wrong!r} is not text; leave it out") from error
        except pyarrow.ArrowInvalid as error:
            raise InputError(f"{path}: a text cannot stand between commas ({error})") from error


def batches_of(
    columns: Mapping[str, Any],
    decimals: Mapping[str, int] = MappingProxyType({}),
    units: Mapping[str, str] = MappingProxyType({}),
    rows_at_once: int = _ROWS_AT_ONCE,
) -> Iterator[pyarrow.RecordBatch]:
    """Some thousand rows at a time of columns of epochs, labels, texts or numbers, with their units.

    Of numbers with decimals the text; others stay numbers, null where they are not.
    """
    count = len(next(iter(columns.values())))
    for start in range(0, max(count, 1), rows_at_once):
        rows = slice(start, min(start + rows_at_once, count))
        arrays = {name: _cells(column, rows, decimals.get(name)) for name, column in columns.items()}
        fields = [
            pyarrow.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
            for name, array in arrays.items()
        ]
        schema = pyarrow.schema(fields, metadata={"radioloc": __version__})
        yield pyarrow.RecordBatch.from_arrays(list(arrays.values()), schema=schema)


def _cells(column: Any, rows: slice, decimals: int | None) -> pyarrow.Array:
    part: Any = column.codes[rows] if isinstance(column, Labels) else column[rows]
    match column:
        case Epochs():
            # Observations of one instant stand one after another in dense data.
            new = np.ones(len(part), dtype=bool)
            new[1:] = (part.jd[1:] != part.jd[:-1]) | (part.fraction[1:] != part.fraction[:-1])
            return _label_texts(np.cumsum(new) - 1, utc_to_text(part[new]).tolist())
        case Labels():
            return _label_texts(part, column.texts)
    if decimals is not None:
        # Python's formatting is exact; one operation for many numbers is twice as fast as one for each.
        values = part.tolist()
        text = (f"%.{decimals}f\n" * len(values)) % tuple(values)
        return pyarrow.array(text.split("\n")[:-1], pyarrow.string(), mask=np.isnan(part))
    if isinstance(part, np.ndarray) and part.dtype.kind != "U":
        return pyarrow.array(part, from_pandas=True)
    return _texts(part)


def _texts(values: ArrayLike) -> pyarrow.Array:
    return pyarrow.array(np.asarray(values, dtype=np.str_).tolist(), pyarrow.string())


def _label_texts(codes: NDArray[Any], labels: Sequence[str]) -> pyarrow.Array:
    """Texts of which few differ, from an index into them."""
    return pyarrow.DictionaryArray.from_arrays(pyarrow.array(codes), _texts(labels or [""]))
