"""Comma-separated text out of columns of texts, dates and numbers, by Arrow and block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import ArrayLike, NDArray
from pyarrow import compute, csv

from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.io.dates import utc_to_text
from radioloc.text_files import replaced_file
from radioloc.time import Epochs

# Some megabytes of text.
_ROWS_AT_ONCE = 2**14
# Beyond it floats are whole.
_LARGEST_WHOLE = 2.0**53
_DOUBT = 1e-5


def write_csv(
    path: str | Path, batches: Iterable[pyarrow.RecordBatch], *, comments: Iterable[str] = ()
) -> None:
    """Write a table; numbers with as many digits as give back the same float, null as nothing.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    batches : iterable of pyarrow.RecordBatch
        Rows, all with the same columns; at least one batch, which may have no rows.
    comments : iterable of str
        Lines to put on top, each after ``#``.

    Raises
    ------
    InputError
        A text holds a comma, a quote or the end of a line, or half a surrogate pair.
    FileFormatError
        The file cannot be written.
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


def batches_of(columns: Mapping[str, Any], decimals: Mapping[str, int]) -> Iterator[pyarrow.RecordBatch]:
    """Some thousand rows at a time of columns as texts.

    Parameters
    ----------
    columns : mapping of str to Epochs, Labels, array of float, or whatever a slice gives texts of
        By name, all of one length.
    decimals : mapping of str to int
        Of the columns that are numbers, how many decimals they have.
    """
    count = len(next(iter(columns.values())))
    for start in range(0, max(count, 1), _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, count))
        cells = {name: _cells(column, rows, decimals.get(name)) for name, column in columns.items()}
        yield pyarrow.record_batch(cells)


def _cells(column: Any, rows: slice, decimals: int | None) -> pyarrow.Array:
    match column:
        case Epochs():
            return date_texts(column[rows])
        case Labels():
            return label_texts(column.codes[rows], column.texts)
    part = column[rows]
    return texts(part) if decimals is None else fixed_texts(part, decimals)


def texts(values: ArrayLike) -> pyarrow.Array:
    """Texts as they are."""
    return pyarrow.array(np.asarray(values, dtype=np.str_).tolist(), pyarrow.string())


def label_texts(codes: NDArray[Any], labels: Sequence[str]) -> pyarrow.Array:
    """Texts of which few differ, from an index into them."""
    return pyarrow.DictionaryArray.from_arrays(pyarrow.array(codes), texts(labels or [""]))


def date_texts(utc: Epochs) -> pyarrow.Array:
    """Dates as :func:`radioloc.io.dates.utc_to_text` writes them."""
    # Observations of one instant stand one after another in dense data.
    new = np.ones(len(utc), dtype=bool)
    new[1:] = (utc.jd[1:] != utc.jd[:-1]) | (utc.fraction[1:] != utc.fraction[:-1])
    return label_texts(np.cumsum(new) - 1, utc_to_text(utc[new]).tolist())


def fixed_texts(values: NDArray[np.float64], decimals: int) -> pyarrow.Array:
    """Numbers with so many decimals, 1 to 8, the last one rounded as ``%.7f`` does.

    A float less its whole part is exact. Scaled it is rounded by far less than ``_DOUBT`` of the last decimal; what is
    nearer to half way between two texts than that is left to Python, and so are numbers without decimals.
    """
    size = np.abs(values)
    unusual = ~(size < _LARGEST_WHOLE)
    size[unusual] = 0.0
    whole = np.floor(size)
    scaled = (size - whole) * 10.0**decimals
    part = np.rint(scaled)
    unusual |= np.abs(scaled - part) > 0.5 - _DOUBT
    carry = part >= 10.0**decimals
    whole, part = whole + carry, np.where(carry, 0.0, part)
    sign = label_texts(np.signbit(values).astype(np.int8), ("", "-")).dictionary_decode()
    before, behind = (pyarrow.array(x.astype(np.int64)).cast("string") for x in (whole, part))
    behind = compute.utf8_lpad(behind, decimals, "0")
    made = compute.binary_join_element_wise(sign, before, ".", behind, "")
    exact = texts([f"{value:.{decimals}f}" for value in values[unusual].tolist()])
    return compute.replace_with_mask(made, pyarrow.array(unusual), exact)
